"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trajeval_ros.continuous_time.models import DEFAULT_MODEL, MODELS
from trajeval_ros.geometry.gauge import MODALITIES, Gauge
from trajeval_ros.metrics.named_protocols import PROTOCOLS
from trajeval_ros.metrics.protocol import ALIGN_WEIGHTS

GNSS = "GNSS fixes and surveyed points"
INPUT, ALIGN, PAIR, MEASURE, CONSISTENCY, OUTPUT = (
    "Input",
    "Alignment",
    "Association",
    "Errors",
    "Consistency",
    "Output",
)
_MODALITIES = "; ".join(
    f"{gauge.value}: {', '.join(name for name, its in MODALITIES.items() if its is gauge)}"
    for gauge in Gauge
    if gauge in MODALITIES.values()
)

GroundtruthIfNamedOption = Annotated[
    str | None,
    typer.Option(
        "--groundtruth",
        "-g",
        metavar="SOURCE",
        help="Groundtruth: PATH, BAG:TOPIC or BAG:/tf:PARENT.CHILD; - reads text from stdin. The "
        "format is detected from the content: text (TUM, KITTI, EuRoC, OpenVINS, VINS-Mono) or "
        "bag (MCAP, rosbag2 sqlite3, ROS 1).",
        rich_help_panel=INPUT,
    ),
]
EstimatesIfNamedOption = Annotated[
    list[str] | None,
    typer.Option(
        "--estimate",
        "-e",
        metavar="SOURCE",
        help="Trajectory to evaluate. Repeat the option to evaluate several.",
        rich_help_panel=INPUT,
    ),
]
ProtocolOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.yaml",
        help=f"Named set of settings: {', '.join(PROTOCOLS)}, or a YAML file "
        "(docs/definitions.md). Other options override it.",
        rich_help_panel=INPUT,
    ),
]
ModalityOption = Annotated[
    str | None,
    typer.Option(
        help=f"Sensors of the estimator; they determine the gauge. {_MODALITIES}.",
        rich_help_panel=ALIGN,
    ),
]
GaugeOption = Annotated[
    str | None,
    typer.Option(
        help="Transformation that the alignment fits: "
        + ", ".join(each.value for each in Gauge)
        + " (default: se3).",
        rich_help_panel=ALIGN,
    ),
]
AlignStatesOption = Annotated[
    str | None,
    typer.Option(
        metavar="all|N",
        help="States used for the alignment: all pairs (default) or the first N. With 1, the "
        "first poses are aligned.",
        rich_help_panel=ALIGN,
    ),
]
AlignStatesOrTableOption = Annotated[
    str | None,
    typer.Option(
        "--align-states",
        metavar="all|N|LIST",
        help="States used for the alignment: all pairs (default) or the first N. With 1, the "
        "first poses are aligned. A list such as 1,25%,50%,75%,all adds a table with the ATE of "
        "every entry.",
        rich_help_panel=ALIGN,
    ),
]
AlignWithOption = Annotated[
    str | None,
    typer.Option(
        metavar="positions|poses",
        help="Data that determine the rotation of the alignment: positions (default), or poses "
        "to include orientations, for nearly straight paths.",
        rich_help_panel=ALIGN,
    ),
]
AssociationOption = Annotated[
    str | None,
    typer.Option(
        help="Pairing method. linear (default for poses): interpolate the groundtruth at the "
        "estimate's timestamps. groundtruth-stamps (default for points and GNSS fixes): "
        "interpolate the estimate at the groundtruth's timestamps. nearest: pair nearest "
        "timestamps one to one. continuous: model the groundtruth and its uncertainty over "
        "time, and compute likelihoods.",
        rich_help_panel=PAIR,
    ),
]
MaxTimeDifferenceOption = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        help="Largest time difference of a pair for nearest, in seconds. Default: 0.02.",
        rich_help_panel=PAIR,
    ),
]
MaxGapOption = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        help="Longest gap to interpolate across, in seconds. Default: 0.5. It also defines "
        "coverage (docs/definitions.md).",
        rich_help_panel=PAIR,
    ),
]
TimeOffsetOption = Annotated[
    str | None,
    typer.Option(
        metavar="S|auto",
        help="Offset added to the estimate's timestamps, in seconds. auto estimates it and "
        "applies it if it is statistically significant.",
        rich_help_panel=PAIR,
    ),
]
HandEyeOption = Annotated[
    str | None,
    typer.Option(
        metavar="none|auto|SOURCE",
        help="Pose of the groundtruth's marker in the estimate's body: a TransformStamped in a "
        "YAML file, or a static transform in a bag (BAG:/tf_static:BODY.MARKER). auto estimates "
        "it and applies it if it is statistically significant.",
        rich_help_panel=PAIR,
    ),
]
LeverArmOption = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z",
        help="Position of the GNSS antenna or prism in the estimate's body frame, in metres.",
        rich_help_panel=GNSS,
    ),
]
AlignWeightsOption = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(ALIGN_WEIGHTS),
        help="Weights of the alignment: equal (default), or from the position covariances of the "
        "estimate or of the groundtruth.",
        rich_help_panel=ALIGN,
    ),
]
DatumOption = Annotated[
    str | None,
    typer.Option(
        metavar="LAT,LON,HEIGHT",
        help="Origin of the east-north-up frame of GNSS fixes, in degrees and metres above the "
        "ellipsoid. Default: the first fix that is used.",
        rich_help_panel=GNSS,
    ),
]
MinFixStatusOption = Annotated[
    int | None,
    typer.Option(
        metavar="0|1|2",
        help="Minimum status of a fix: 0 any fix, 1 satellite-based, 2 ground-based "
        "augmentation. Many drivers use the same status for float and fixed RTK.",
        rich_help_panel=GNSS,
    ),
]
MaxFixSigmaOption = Annotated[
    float | None,
    typer.Option(
        metavar="M",
        help="Largest horizontal standard deviation of a fix per axis, from its own covariance, "
        "in metres.",
        rich_help_panel=GNSS,
    ),
]
FixCorrelationOption = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        help="Correlation time of the fix errors, in seconds, for the interval of the estimate's "
        "own error. Default: 100.",
        rich_help_panel=GNSS,
    ),
]
ContinuousModelOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"Motion model for association continuous: {', '.join(MODELS)}. Default: "
        f"{DEFAULT_MODEL}.",
        rich_help_panel=PAIR,
    ),
]
GroundtruthNoiseOption = Annotated[
    str | None,
    typer.Option(
        metavar="P,R",
        help="Standard deviations of the groundtruth: position (m), rotation (deg). For "
        "--covariance and association continuous. Default of the latter: 0.002,0.1.",
        rich_help_panel=PAIR,
    ),
]
ApplyOption = Annotated[
    str | None,
    typer.Option(
        metavar="all|scale",
        help="Part of the alignment to apply: all (default), or only the scale of gauge sim3, as "
        "evo_ape -s does.",
        rich_help_panel=ALIGN,
    ),
]
LengthsOption = Annotated[
    str | None,
    typer.Option(
        metavar="LIST",
        help="Sub-trajectory lengths for the relative error: 8,16,24 (metres), 1s,5s "
        "(seconds), 1f,10f (frames), 5deg (of rotation), 10%,20% (of the path) or none. "
        "Default: 8,16,24,32,40.",
        rich_help_panel=MEASURE,
    ),
]
PairsOption = Annotated[
    str | None,
    typer.Option(
        metavar="all|consecutive",
        help="Sub-trajectories start at every state (default), or consecutive: at the end of the "
        "previous one (default of protocol evo).",
        rich_help_panel=MEASURE,
    ),
]
AteFormOption = Annotated[
    str | None,
    typer.Option(
        help="Form of the ATE: plain (default): difference of positions; evo: also errors of "
        "whole poses; tutorial: eq. (23), which depends on the choice of the origin.",
        rich_help_panel=MEASURE,
    ),
]
ReFormOption = Annotated[
    str | None,
    typer.Option(
        help="Form of the relative error: gauge, se3 (relative poses), matrices (as se3, with "
        "KITTI's matrices as stored) or tutorial (eq. 26).",
        rich_help_panel=MEASURE,
    ),
]
CovarianceOption = Annotated[
    str | None,
    typer.Option(
        metavar="SOURCE",
        help="Consistency test of errors and covariances. Source of the covariances: FILE.npz "
        "with the joint covariance of all poses, message for one covariance per pose in the "
        "messages, or none.",
        rich_help_panel=CONSISTENCY,
    ),
]
RotationCovarianceFrameOption = Annotated[
    str | None,
    typer.Option(
        metavar="world|body",
        help="Axes of rotation covariances in messages: world (default), as in ROS, or body, as "
        "in OpenVINS.",
        rich_help_panel=CONSISTENCY,
    ),
]
IntegrityOption = Annotated[
    bool,
    typer.Option(
        "--integrity",
        help="Integrity test: compares errors with the protection levels that the covariances "
        "give at --risk.",
        rich_help_panel=CONSISTENCY,
    ),
]
AlertLimitOption = Annotated[
    str | None,
    typer.Option(
        metavar="M[,DEG]",
        help="Largest acceptable position error (horizontal and vertical), and heading error.",
        rich_help_panel=CONSISTENCY,
    ),
]
RiskOption = Annotated[
    float | None,
    typer.Option(
        metavar="P",
        help="Probability that an error may exceed its protection level (1e-5).",
        rich_help_panel=CONSISTENCY,
    ),
]
WatchLimitsOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="With --integrity: limits of `trajeval watch`, whose errors count as alerts in the "
        "time to alert.",
        rich_help_panel=CONSISTENCY,
    ),
]
UpOption = Annotated[
    str | None,
    typer.Option(
        metavar="AXIS[,AXIS]",
        help="Vertical axis (x, y, z, -x, -y or -z) of all frames, or of the groundtruth and of "
        "the estimates, as in --up=-y,z. Default: -y for KITTI matrices and optical frames, "
        "otherwise z. It defines gauges yaw and planar, and the yaw and tilt errors.",
        rich_help_panel=INPUT,
    ),
]
StartOption = Annotated[
    str | None,
    typer.Option(
        metavar="S|@STAMP",
        help="Start of the evaluated time span: seconds after the first timestamp of the "
        "groundtruth (or reference), as in 10.5, or a timestamp, as in @1403636580.5.",
        rich_help_panel=INPUT,
    ),
]
EndOption = Annotated[
    str | None,
    typer.Option(
        metavar="S|@STAMP|+S",
        help="End of the evaluated time span: as --start, or +30 for 30 s after the start.",
        rich_help_panel=INPUT,
    ),
]
ColumnsOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help="Columns of text files (except the groundtruth or reference), as in 't x y z qw qx "
        "qy qz'. Use _ for columns to ignore. Names: docs/trajectory.md.",
        rich_help_panel=INPUT,
    ),
]
FrameRateOption = Annotated[
    float | None,
    typer.Option(
        metavar="HZ",
        help="Pose rate of text files without timestamps, such as KITTI, TartanAir and g2o.",
        rich_help_panel=INPUT,
    ),
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Verification of all data read from a bag. Exits with status 2 if it is damaged.",
        rich_help_panel=INPUT,
    ),
]
JsonOption = Annotated[
    str | None,
    typer.Option(
        metavar="FILE|-",
        help="JSON output file. With -, only the JSON is printed to stdout.",
        rich_help_panel=OUTPUT,
    ),
]
RequireOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="BOUND",
        help="Requirement for every estimate; exits with status 1 if it is not met. Repeatable. "
        "Examples: 'ate.position_m.rmse < 0.3', 're.8m.position_percent.mean < 1'.",
        rich_help_panel=OUTPUT,
    ),
]
QuietOption = Annotated[
    bool,
    typer.Option(
        "--quiet",
        "-q",
        help="No output on the terminal except warnings about missing data.",
        rich_help_panel=OUTPUT,
    ),
]
