"""`trajeval evaluate`: evaluation of recorded runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.cli import figure_options, mend_options, options
from trajeval_ros.cli.deliver import deliver, refuse_inputs
from trajeval_ros.cli.pictures import Pictures
from trajeval_ros.cli.progress import progress
from trajeval_ros.cli.source_names import names_of
from trajeval_ros.cli.unused_options import require_used
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.requests.request_words import request_from
from trajeval_ros.io.results.requirement import Requirement
from trajeval_ros.io.sources import read_many
from trajeval_ros.io.text.hints import TextHints
from trajeval_ros.pipeline.pipeline import run
from trajeval_ros.report.figure_style import PLAIN, FigureStyle

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.pipeline.request import Request


def evaluate(
    by_position: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="GROUNDTRUTH ESTIMATE",
            help="Groundtruth and estimates, instead of --groundtruth and --estimate.",
            show_default=False,
        ),
    ] = None,
    groundtruth: options.GroundtruthIfNamedOption = None,
    estimate: options.EstimatesIfNamedOption = None,
    protocol: options.ProtocolOption = None,
    modality: options.ModalityOption = None,
    gauge: options.GaugeOption = None,
    align_states: options.AlignStatesOrTableOption = None,
    align_with: options.AlignWithOption = None,
    apply: options.ApplyOption = None,
    association: options.AssociationOption = None,
    max_time_difference: options.MaxTimeDifferenceOption = None,
    max_gap: options.MaxGapOption = None,
    time_offset: options.TimeOffsetOption = None,
    hand_eye: options.HandEyeOption = None,
    lever_arm: options.LeverArmOption = None,
    align_weights: options.AlignWeightsOption = None,
    datum: options.DatumOption = None,
    min_fix_status: options.MinFixStatusOption = None,
    max_fix_sigma: options.MaxFixSigmaOption = None,
    fix_correlation: options.FixCorrelationOption = None,
    continuous_model: options.ContinuousModelOption = None,
    groundtruth_noise: options.GroundtruthNoiseOption = None,
    lengths: options.LengthsOption = None,
    pairs: options.PairsOption = None,
    ate_form: options.AteFormOption = None,
    re_form: options.ReFormOption = None,
    covariance: options.CovarianceOption = None,
    rotation_covariance_frame: options.RotationCovarianceFrameOption = None,
    integrity: options.IntegrityOption = False,
    alert_limit: options.AlertLimitOption = None,
    risk: options.RiskOption = None,
    watch_limits: options.WatchLimitsOption = None,
    up: options.UpOption = None,
    start: options.StartOption = None,
    end: options.EndOption = None,
    columns: options.ColumnsOption = None,
    frame_rate: options.FrameRateOption = None,
    fix: mend_options.FixOption = None,
    estimate_scale: mend_options.EstimateScaleOption = None,
    groundtruth_scale: mend_options.GroundtruthScaleOption = None,
    quaternion_order: mend_options.QuaternionOrderOption = None,
    inverse: mend_options.InverseOption = None,
    estimate_axes: mend_options.EstimateAxesOption = None,
    clock_rate: mend_options.ClockRateOption = None,
    swap: mend_options.SwapOption = False,
    json: options.JsonOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Output folder for result.json, errors and aligned poses (errors.npz, "
            "errors.parquet) and figures.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="MCAP output file with errors, paths and statistics as ROS 2 messages, for "
            "Foxglove and PlotJuggler (docs/topics.md).",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Output file for Rerun's viewer. Open it with `trajeval view FILE`.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    viewer: Annotated[
        bool,
        typer.Option(
            "--viewer",
            help="Opens the result in Rerun's viewer.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    require: options.RequireOption = None,
    figure_format: figure_options.FigureFormatOption = None,
    figure_width: figure_options.FigureWidthOption = None,
    no_title: figure_options.NoTitleOption = False,
    style: figure_options.StyleOption = None,
    strict: options.StrictOption = False,
    quiet: options.QuietOption = False,
) -> None:
    r"""Evaluates estimated trajectories against groundtruth: ATE and relative errors.

    Evaluate a stereo-inertial VIO against groundtruth, from two text files:

        trajeval evaluate groundtruth.txt estimate.txt --modality stereo-inertial

    Evaluate two topics of a bag, and write result.json and figures to a folder:

        trajeval evaluate -g run.mcap:/mocap/pose -e run.mcap:/vio/odometry \
            --output result

    Estimate the clock offset and the pose of a motion capture marker (docs/calibration.md):

        trajeval evaluate -g mocap.txt -e vio.txt --time-offset auto --hand-eye auto

    Compute the metrics of evo or rpg_trajectory_evaluation: --protocol evo, --protocol rpg.

    Compute evo_rpe -d 10 -u f, and the ATE by the number of aligned states (tutorial, Table III):

        trajeval evaluate gt.txt vio.txt --protocol evo --gauge none --lengths 10f
        trajeval evaluate gt.txt vio.txt --align-states 1,25%,50%,75%,all

    Test the consistency of the covariances in the estimate's messages:

        trajeval evaluate gt.txt run:/odom --gauge yaw --align-states 1 \
            --covariance message

    Use GNSS fixes as groundtruth, with the antenna 1 m above the body (docs/gnss.md):

        trajeval evaluate run:/fix run:/odom --modality stereo-inertial \
            --lever-arm 0,0,1

    Use slow groundtruth with dropouts, such as RTK or a total station with 2 Hz and 1 cm:

        trajeval evaluate rtk.txt vio.txt --association continuous \
            --groundtruth-noise 0.01,1
    """
    request = request_from(
        {
            "protocol": protocol,
            "modality": modality,
            "gauge": gauge,
            "align_states": align_states,
            "align_with": align_with,
            "apply": apply,
            "association": association,
            "max_time_difference": max_time_difference,
            "max_gap": max_gap,
            "time_offset": time_offset,
            "hand_eye": hand_eye,
            "lever_arm": lever_arm,
            "align_weights": align_weights,
            "datum": datum,
            "min_fix_status": min_fix_status,
            "max_fix_sigma": max_fix_sigma,
            "fix_correlation": fix_correlation,
            "continuous_model": continuous_model,
            "groundtruth_noise": groundtruth_noise,
            "lengths": lengths,
            "pairs": pairs,
            "ate_form": ate_form,
            "re_form": re_form,
            "covariance": covariance,
            "rotation_covariance_frame": rotation_covariance_frame,
            "integrity": integrity,
            "alert_limit": alert_limit,
            "risk": risk,
            "watch_limits": watch_limits,
            "up": up,
            "start": start,
            "end": end,
            "fix": fix,
            "estimate_scale": estimate_scale,
            "groundtruth_scale": groundtruth_scale,
            "quaternion_order": quaternion_order,
            "inverse": inverse,
            "estimate_axes": estimate_axes,
            "clock_rate": clock_rate,
            "swap": swap or None,
        }
    )
    requirements = [Requirement.parse(text) for text in require or []]
    pictures = Pictures(rrd=rrd, viewer=viewer)
    pictures.check()
    look = FigureStyle.parse(figure_format, figure_width, style, has_titles=not no_title)
    look.check()
    if look != PLAIN and output is None:
        raise SettingsError("the options of figures need an output folder; add --output DIR")
    sources = _sources(by_position or [], groundtruth, estimate or [])
    refuse_inputs([mcap, rrd, None if json in (None, "-") else Path(json), output], sources)
    hints = TextHints.of(columns, frame_rate)
    every_hint = [hints.of_reference, *[hints] * (len(sources) - 1)]
    truth, *estimates = _read(sources, every_hint, request, strict=strict)
    require_used(hints, (note for each in (truth, *estimates) for note in each.notes))
    outcome = run(truth, estimates, request)
    deliver(
        outcome,
        requirements,
        json=json,
        output=output,
        quiet=quiet,
        pictures=pictures,
        mcap=mcap,
        look=look,
    )


def _sources(by_position: list[str], groundtruth: str | None, estimates: list[str]) -> list[str]:
    """Return the groundtruth and the estimates, from arguments or options.

    Raises:
        SettingsError: They are given as arguments and as options, or one is missing.
    """
    if by_position and (groundtruth is not None or estimates):
        raise SettingsError(
            "sources are given twice; use either GROUNDTRUTH ESTIMATE... or --groundtruth and "
            "--estimate"
        )
    truths = by_position[:1] if groundtruth is None else [groundtruth]
    estimates = estimates or by_position[1:]
    if truths and estimates:
        return [*truths, *estimates]
    missing = "groundtruth" if estimates else "estimate" if truths else "groundtruth and estimate"
    raise SettingsError(f"{missing} missing; call trajeval evaluate GROUNDTRUTH ESTIMATE")


def _read(
    sources: Sequence[str], hints: Sequence[TextHints], request: Request, *, strict: bool
) -> list[Trajectory]:
    """Read groundtruth and estimates, with covariances where they are needed."""
    covariances = [
        request.reads_groundtruth_covariances,
        *[request.reads_covariances] * (len(sources) - 1),
    ]
    names = names_of(sources)
    with progress(f"reading {', '.join(names)}") as advance:
        trajectories = read_many(
            sources,
            advance=advance,
            covariances=covariances,
            strict=strict,
            hints=hints,
        )
    return [
        dataclasses.replace(trajectory, name=name)
        for trajectory, name in zip(trajectories, names, strict=True)
    ]
