"""Options that several verbs share: spelled, explained and checked alike."""

from __future__ import annotations

from typing import Annotated

import typer

from trajeval_ros.continuous_time.models import DEFAULT_MODEL, MODELS
from trajeval_ros.geometry.gauge import MODALITIES, Gauge
from trajeval_ros.metrics.protocol import ATE_FORMS, PROTOCOLS

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

GroundtruthOption = Annotated[
    str,
    typer.Option(
        "--groundtruth",
        "-g",
        metavar="SOURCE",
        help="PATH, BAG:TOPIC or BAG:/tf:PARENT.CHILD. Text (TUM, KITTI, EuRoC, OpenVINS, "
        "VINS-Mono) and bags (MCAP, rosbag2 sqlite3, ROS 1) are recognised by content.",
        rich_help_panel=INPUT,
    ),
]
EstimatesOption = Annotated[
    list[str],
    typer.Option(
        "--estimate",
        "-e",
        metavar="SOURCE",
        help="The trajectory to evaluate; repeat it to compare several.",
        rich_help_panel=INPUT,
    ),
]
ProtocolOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.yaml",
        help=f"A named set of settings: {', '.join(PROTOCOLS)}, or a file of your own "
        "(docs/definitions.md). Other options override it.",
        rich_help_panel=INPUT,
    ),
]
ModalityOption = Annotated[
    str | None,
    typer.Option(
        help=f"The sensors, which decide what alignment may change. {_MODALITIES}.",
        rich_help_panel=ALIGN,
    ),
]
GaugeOption = Annotated[
    str | None,
    typer.Option(
        help="What alignment may change, by name: "
        + ", ".join(each.value for each in Gauge)
        + " (se3 if neither gauge nor modality is given).",
        rich_help_panel=ALIGN,
    ),
]
AlignStatesOption = Annotated[
    str | None,
    typer.Option(
        metavar="all|N",
        help="Align by all matched states (default) or the first N; 1 aligns the first pose.",
        rich_help_panel=ALIGN,
    ),
]
AlignStatesOrTableOption = Annotated[
    str | None,
    typer.Option(
        "--align-states",
        metavar="all|N|LIST",
        help="Align by all matched states (default) or the first N; 1 aligns the first pose. A "
        "list such as 1,25%,50%,75%,all also gives a table of the ATE by each.",
        rich_help_panel=ALIGN,
    ),
]
AlignWithOption = Annotated[
    str | None,
    typer.Option(
        metavar="positions|poses",
        help="What decides the alignment's rotation: positions (default), or poses to let "
        "orientations help, for paths that are nearly straight.",
        rich_help_panel=ALIGN,
    ),
]
AssociationOption = Annotated[
    str | None,
    typer.Option(
        help="linear (default) interpolates the groundtruth at the estimate's stamps; "
        "nearest pairs stamps one to one; continuous models the groundtruth between its samples "
        "with its uncertainty, and computes likelihoods.",
        rich_help_panel=PAIR,
    ),
]
MaxTimeDifferenceOption = Annotated[
    float | None,
    typer.Option(metavar="S", help="Limit for nearest, seconds (0.02).", rich_help_panel=PAIR),
]
MaxGapOption = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        help="Never interpolate across a longer groundtruth gap, seconds (0.5). Steps between "
        "pairs up to it are always covered, longer ones by docs/definitions.md.",
        rich_help_panel=PAIR,
    ),
]
TimeOffsetOption = Annotated[
    str | None,
    typer.Option(
        metavar="S|auto",
        help="Added to the estimate's stamps, seconds. auto estimates it, and applies it if it "
        "is significant.",
        rich_help_panel=PAIR,
    ),
]
HandEyeOption = Annotated[
    str | None,
    typer.Option(
        metavar="none|auto|FILE",
        help="The pose of the groundtruth's marker in the estimate's body. auto estimates it, and "
        "applies it if it is significant; FILE is a TransformStamped in YAML.",
        rich_help_panel=PAIR,
    ),
]
ContinuousModelOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"For association continuous: {', '.join(MODELS)}. Default: {DEFAULT_MODEL}.",
        rich_help_panel=PAIR,
    ),
]
GroundtruthNoiseOption = Annotated[
    str | None,
    typer.Option(
        metavar="P,R",
        help="Standard deviations of the groundtruth's samples: position (m), rotation (deg). "
        "For association continuous (0.002,0.1) and --covariance.",
        rich_help_panel=PAIR,
    ),
]
ApplyOption = Annotated[
    str | None,
    typer.Option(
        metavar="all|scale",
        help="What of the alignment is applied: all of it (default), or the scale of gauge sim3 "
        "alone, as evo_ape -s.",
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
        help="Sub-trajectories from every pair of states (default; protocol evo: consecutive), or "
        "each from where the one before ends.",
        rich_help_panel=MEASURE,
    ),
]
AteFormOption = Annotated[
    str | None,
    typer.Option(
        help=f"{' or '.join(ATE_FORMS)}: difference of positions, or the tutorial's eq. (23), "
        "which depends on where the origin is.",
        rich_help_panel=MEASURE,
    ),
]
ReFormOption = Annotated[
    str | None,
    typer.Option(
        help="gauge, se3 (relative poses), matrices (the same by KITTI's matrices as they are) or "
        "tutorial (eq. 26 to the letter).",
        rich_help_panel=MEASURE,
    ),
]
CovarianceOption = Annotated[
    str | None,
    typer.Option(
        metavar="FILE.npz|message|none",
        help="Test whether errors fit the estimate's covariances: the joint covariance of all "
        "poses in a file, or the covariance of each pose in its message.",
        rich_help_panel=CONSISTENCY,
    ),
]
RotationCovarianceFrameOption = Annotated[
    str | None,
    typer.Option(
        metavar="world|body",
        help="Axes of the messages' rotation covariances: those of the fixed frame (default), as "
        "in ROS, or of the body, as OpenVINS publishes them.",
        rich_help_panel=CONSISTENCY,
    ),
]
UpOption = Annotated[
    str | None,
    typer.Option(
        metavar="AXIS[,AXIS]",
        help="The axis that points up (x, y, z, -x, -y, -z) in all frames, or in the "
        "groundtruth's and in the estimates', as in --up=-y,z. By default -y for KITTI's "
        "matrices and optical frames, else z. Gauges yaw and planar, yaw and tilt are about it.",
        rich_help_panel=INPUT,
    ),
]
StartOption = Annotated[
    str | None,
    typer.Option(
        metavar="S|@STAMP",
        help="Use only what is from then on: seconds after the first stamp of the groundtruth (or "
        "reference; without one, of each source), as in 10.5, or a stamp, as in @1403636580.5.",
        rich_help_panel=INPUT,
    ),
]
EndOption = Annotated[
    str | None,
    typer.Option(
        metavar="S|@STAMP|+S",
        help="Use only what is up to then: as --start, or +30 for 30 s after the start.",
        rich_help_panel=INPUT,
    ),
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Verify everything that is read of a bag, and exit with status 2 if it is damaged.",
        rich_help_panel=INPUT,
    ),
]
JsonOption = Annotated[
    str | None,
    typer.Option(
        metavar="FILE|-",
        help="Write the result as JSON; - prints it alone on stdout.",
        rich_help_panel=OUTPUT,
    ),
]
RequireOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="BOUND",
        help="Exit with status 1 unless it holds for every estimate; repeatable. "
        "Such as 'ate.position_m.rmse < 0.3' or 're.8m.position_percent.mean < 1'.",
        rich_help_panel=OUTPUT,
    ),
]
QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print nothing.", rich_help_panel=OUTPUT)
]
