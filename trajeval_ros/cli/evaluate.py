"""`trajeval evaluate`: recorded runs, end to end."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.calibration.apply import Wanted, evaluate_calibrated
from trajeval_ros.cli.calibration_options import parse_offset, parse_wanted
from trajeval_ros.cli.consistency_options import CovarianceSettings
from trajeval_ros.cli.deliver import deliver, refuse_inputs
from trajeval_ros.cli.pictures import Pictures
from trajeval_ros.cli.probabilistic_options import CONTINUOUS, assessed, with_model
from trajeval_ros.cli.progress import progress
from trajeval_ros.cli.source_names import names_of
from trajeval_ros.continuous_time.models import DEFAULT_MODEL, MODELS
from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.geometry.gauge import MODALITIES, Gauge
from trajeval_ros.io.protocol_file import is_protocol_file, read_protocol
from trajeval_ros.io.results import result_json
from trajeval_ros.io.results.requirement import Requirement
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.evaluation import evaluate as evaluate_pair
from trajeval_ros.metrics.protocol import ATE_FORMS, PROTOCOLS
from trajeval_ros.metrics.settings import protocol_from

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Calibrated
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.metrics.protocol import Protocol

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


def evaluate(
    groundtruth: Annotated[
        str,
        typer.Option(
            "--groundtruth",
            "-g",
            metavar="SOURCE",
            help="PATH, BAG:TOPIC or BAG:/tf:PARENT.CHILD. Text (TUM, KITTI, EuRoC, OpenVINS, "
            "VINS-Mono) and bags (MCAP, rosbag2 sqlite3, ROS 1) are told apart by content.",
            rich_help_panel=INPUT,
        ),
    ],
    estimate: Annotated[
        list[str],
        typer.Option(
            "--estimate",
            "-e",
            metavar="SOURCE",
            help="The trajectory to be judged; repeat it to compare several.",
            rich_help_panel=INPUT,
        ),
    ],
    protocol: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE.yaml",
            help=f"A bundle of settings: {', '.join(PROTOCOLS)}, or a file of your own "
            "(docs/definitions.md). Options below override it.",
            rich_help_panel=INPUT,
        ),
    ] = "default",
    modality: Annotated[
        str | None,
        typer.Option(
            help=f"The sensors, which decide what alignment may change. {_MODALITIES}.",
            rich_help_panel=ALIGN,
        ),
    ] = None,
    gauge: Annotated[
        str | None,
        typer.Option(
            help="What alignment may change, by name: "
            + ", ".join(each.value for each in Gauge)
            + " (se3 if neither is given).",
            rich_help_panel=ALIGN,
        ),
    ] = None,
    align_states: Annotated[
        str | None,
        typer.Option(
            metavar="all|N",
            help="Align by all matched states (default) or the first N; 1 aligns the first pose.",
            rich_help_panel=ALIGN,
        ),
    ] = None,
    association: Annotated[
        str | None,
        typer.Option(
            help="linear, the default, interpolates the groundtruth at the estimate's stamps; "
            "nearest pairs stamps one to one; continuous knows how uncertain the groundtruth is "
            "between its samples, and says how likely the estimate is.",
            rich_help_panel=PAIR,
        ),
    ] = None,
    max_time_difference: Annotated[
        float | None,
        typer.Option(metavar="S", help="Limit for nearest, seconds (0.02).", rich_help_panel=PAIR),
    ] = None,
    max_gap: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="Never interpolate across a longer groundtruth gap, seconds (0.5).",
            rich_help_panel=PAIR,
        ),
    ] = None,
    time_offset: Annotated[
        str | None,
        typer.Option(
            metavar="S|auto",
            help="Added to the estimate's stamps, seconds. auto estimates it, and applies it if "
            "the recording shows it beyond doubt.",
            rich_help_panel=PAIR,
        ),
    ] = None,
    hand_eye: Annotated[
        str,
        typer.Option(
            metavar="none|auto|FILE",
            help="The pose of the groundtruth's marker in the estimate's body: estimated, and "
            "applied if beyond doubt, or a TransformStamped in YAML.",
            rich_help_panel=PAIR,
        ),
    ] = "none",
    continuous_model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"For association continuous: {', '.join(MODELS)}. Default: {DEFAULT_MODEL}.",
            rich_help_panel=PAIR,
        ),
    ] = None,
    groundtruth_noise: Annotated[
        str | None,
        typer.Option(
            metavar="P,R",
            help="Standard deviations of the groundtruth's samples: position (m), rotation (deg). "
            "For association continuous (0.002,0.1) and --covariance.",
            rich_help_panel=PAIR,
        ),
    ] = None,
    lengths: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Sub-trajectory lengths for the relative error: 8,16,24 (metres), 1s,5s "
            "(seconds), 10%,20% (of the path) or none. Default: 8,16,24,32,40.",
            rich_help_panel=MEASURE,
        ),
    ] = None,
    ate_form: Annotated[
        str | None,
        typer.Option(
            help=f"{' or '.join(ATE_FORMS)}: difference of positions, or the tutorial's eq. (23), "
            "which depends on where the origin is.",
            rich_help_panel=MEASURE,
        ),
    ] = None,
    re_form: Annotated[
        str | None,
        typer.Option(
            help="gauge, se3 (relative poses, as KITTI) or tutorial (eq. 26 to the letter).",
            rich_help_panel=MEASURE,
        ),
    ] = None,
    covariance: Annotated[
        str,
        typer.Option(
            metavar="FILE.npz|message|none",
            help="Judge whether the estimate is as sure as it should be: by the joint covariance "
            "of all its poses in a file, or by what its messages say of each.",
            rich_help_panel=CONSISTENCY,
        ),
    ] = "none",
    rotation_covariance_frame: Annotated[
        str,
        typer.Option(
            metavar="world|body",
            help="About which axes the messages' rotation covariances are: the fixed frame's, as "
            "ROS has it, or the body's, as OpenVINS publishes them.",
            rich_help_panel=CONSISTENCY,
        ),
    ] = "world",
    json: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|-",
            help="Write the result as JSON; - prints it alone on stdout.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write result.json, errors.npz, figures and run.rrd (for Rerun) there.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a picture for Rerun's viewer; `trajeval view FILE` shows it.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    viewer: Annotated[
        bool,
        typer.Option(
            "--viewer",
            help="Show them in Rerun's viewer, until it is closed.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    require: Annotated[
        list[str] | None,
        typer.Option(
            metavar="BOUND",
            help="Exit with status 1 unless it holds for every estimate; repeatable. "
            "Such as 'ate.position_m.rmse < 0.3' or 're.8m.position_percent.mean < 1'.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict",
            help="Verify all that is read of a bag, and exit with status 2 if it is damaged.",
            rich_help_panel=INPUT,
        ),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print nothing.", rich_help_panel=OUTPUT)
    ] = False,
) -> None:
    """Say how wrong estimated trajectories are: ATE and relative error against groundtruth.

    Two text files, groundtruth and a stereo-inertial VIO:

        trajeval evaluate -g groundtruth.txt -e estimate.txt --modality stereo-inertial

    Two topics of a bag, with result.json and figures in a folder:

        trajeval evaluate -g run.mcap:/mocap/pose -e run.mcap:/vio/odometry --output result

    Groundtruth of a marker body with a clock of its own (docs/calibration.md):

        trajeval evaluate -g mocap.txt -e vio.txt --time-offset auto --hand-eye auto

    Numbers as evo or the authors' toolbox compute them: --protocol evo, --protocol rpg.

    Whether the estimator is as sure as it should be, from the covariances in its messages:

        trajeval evaluate -g gt.txt -e run:/odom --gauge yaw --align-states 1 --covariance message

    Slow groundtruth with dropouts, such as RTK or a total station of 2 Hz and 1 cm:

        trajeval evaluate -g rtk.txt -e vio.txt --association continuous --groundtruth-noise 0.01,1
    """
    wanted = parse_wanted(time_offset, hand_eye)
    settings = protocol_from(
        read_protocol(Path(protocol)) if is_protocol_file(protocol) else protocol,
        gauge=gauge,
        modality=modality,
        align_states=align_states,
        association=association,
        max_time_difference=max_time_difference,
        max_gap=max_gap,
        time_offset=parse_offset(time_offset),
        lengths=lengths,
        ate_form=ate_form,
        re_form=re_form,
    )
    covariances = CovarianceSettings.parse(
        covariance,
        rotation_covariance_frame,
        groundtruth_noise,
        continuous=settings.association.method == CONTINUOUS,
    )
    settings = with_model(settings, continuous_model, covariances.groundtruth_noise)
    requirements = [Requirement.parse(text) for text in require or []]
    pictures = Pictures(rrd=rrd, viewer=viewer, in_output=True)
    pictures.check()
    refuse_inputs(
        [rrd, None if json in (None, "-") else Path(json), output], [groundtruth, *estimate]
    )
    names = names_of([groundtruth, *estimate])
    truth = _read(groundtruth, names[0], strict=strict)
    runs: list[result_json.Run] = []
    for source, name in zip(estimate, names[1:], strict=True):
        # One calibration for all: estimates with parameters of their own can't be ranked.
        same_as = runs[0].calibrated if runs else None
        runs.append(
            _run(source, name, truth, settings, covariances, wanted, same_as, strict=strict)
        )
    runs = assessed(runs)
    result = result_json.result_of(
        result_json.Input.of(groundtruth, truth, runs[0].evaluation.groundtruth), runs
    )
    chose_gauge = gauge is not None or modality is not None or protocol != "default"
    deliver(
        result,
        runs,
        requirements,
        json=json,
        output=output,
        quiet=quiet,
        gauge_given=chose_gauge,
        pictures=pictures,
    )


def _read(
    source: str, name: str, *, covariances: bool = False, strict: bool = False
) -> Trajectory:
    with progress(f"reading {name}") as advance:
        trajectory = read_trajectory(
            source, advance=advance, covariances=covariances, strict=strict
        )
    return dataclasses.replace(trajectory, name=name)


def _run(
    source: str,
    name: str,
    groundtruth: Trajectory,
    settings: Protocol,
    covariances: CovarianceSettings,
    wanted: Wanted,
    same_as: Calibrated | None,
    *,
    strict: bool,
) -> result_json.Run:
    weighted = covariances.from_messages or settings.align_weights == "covariance"
    read = _read(source, name, covariances=weighted, strict=strict)
    calibrated = None
    try:
        if wanted.anything:
            calibrated = evaluate_calibrated(groundtruth, read, settings, wanted, same_as=same_as)
            evaluation = calibrated.evaluation
        else:
            evaluation = evaluate_pair(groundtruth, read, settings)
        consistency = covariances.judge(evaluation)
    except TrajevalError as error:
        raise InputError(f"{source}: {error}") from error
    return result_json.Run(
        result_json.Input.of(source, read, evaluation.estimate),
        evaluation,
        consistency=consistency,
        calibrated=calibrated,
    )
