"""`trajeval evaluate`: evaluation of recorded runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.cli.command import arguments, verb
from trajeval_ros.cli.evaluation_output import refuse_inputs, write_and_print
from trajeval_ros.cli.options import (
    OUTPUT,
    argument,
    option,
    require_used,
    settings_options,
    shared_options,
    sources_of,
)
from trajeval_ros.cli.pictures import Pictures
from trajeval_ros.cli.progress import progress, read_shown
from trajeval_ros.exceptions import InputError, SettingsError, require_one_of
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Level, note
from trajeval_ros.geometry.source_info import ASSUMED
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.requests.setting import EVALUATE
from trajeval_ros.io.source_names import names_with, split_name
from trajeval_ros.io.sources import BAG_ENDINGS, parse_source
from trajeval_ros.io.text.hints import SideHints
from trajeval_ros.pipeline.pipeline import run
from trajeval_ros.report.definitions import RELATIVE_STATISTICS
from trajeval_ros.report.figure_style import PLAIN, FigureStyle

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.io.results.requirement import Requirement
    from trajeval_ros.io.roles import LikelyEvaluation

_GAUGES = ("gauge", "modality", "protocol")  # settings that state a gauge
_PARAMETERS = (
    argument("by_position", metavar="GROUNDTRUTH ESTIMATE", count=-1, is_required=False,
        help="Groundtruth and estimates, instead of --groundtruth and --estimate. NAME=ESTIMATE "
        "names an estimate. A bag or folder alone is evaluated by its likely roles."),
    *shared_options(EVALUATE),
    *settings_options(EVALUATE),
    option("--output", kind=Path, metavar="DIR", panel=OUTPUT, is_common=True,
        help="Output folder for a page (report.html), result.json, errors and aligned poses "
        "(errors.npz, errors.parquet) and figures."),
    option("--statistic", metavar="|".join(RELATIVE_STATISTICS), panel=OUTPUT,
        help="Statistic of the relative errors on the terminal. Default: mean, for protocol evo "
        "rmse. Files have all."),
    option("--diagnosis", kind=bool, panel=OUTPUT,
        help="Prints all tests of the diagnosis with their results (docs/diagnosis.md)."),
    option("--mcap", kind=Path, metavar="FILE", panel=OUTPUT,
        help="MCAP output file with errors, paths and statistics as ROS 2 messages, for "
        "Foxglove and PlotJuggler (docs/topics.md)."),
    option("--rrd", kind=Path, metavar="FILE", panel=OUTPUT,
        help="Output file for Rerun's viewer. Open it with `trajeval view FILE`."),
    option("--viewer", kind=bool, panel=OUTPUT, help="Opens the result in Rerun's viewer."),
)  # fmt: skip


@verb(*_PARAMETERS)
def evaluate(
    by_position: Sequence[str],
    groundtruth: str | None,
    estimate: Sequence[str],
    columns: tuple[str, ...],
    frame_rate: float | None,
    strict: bool,
    json: str | None,
    require: Sequence[str],
    quiet: bool,
    figure_format: str | None,
    figure_width: str | None,
    no_title: bool,
    style: Path | None,
    output: Path | None,
    statistic: str | None,
    diagnosis: bool,
    mcap: Path | None,
    rrd: Path | None,
    viewer: bool,
    **settings: Any,
) -> None:
    r"""Evaluates estimated trajectories against groundtruth: ATE and relative errors.

    Evaluate a stereo-inertial VIO against groundtruth, from two text files:

        trajeval evaluate groundtruth.txt estimate.txt --modality stereo-inertial

    Evaluate a bag by the likely roles of its topics, or two of them with figures:

        trajeval evaluate run.mcap
        trajeval evaluate -g run.mcap:/mocap/pose -e run.mcap:/vio/odometry \
            --output result

    Estimate the clock offset and the pose of a motion capture marker:

        trajeval evaluate -g mocap.txt -e vio.txt --time-offset auto --hand-eye auto

    Compute evo_rpe -d 10 -u f, and the ATE by the number of aligned states:

        trajeval evaluate gt.txt vio.txt --protocol evo --gauge none --lengths 10f
        trajeval evaluate gt.txt vio.txt --align-states 1,25%,50%,75%,all

    Test the consistency of the covariances in the estimate's messages:

        trajeval evaluate gt.txt run:/odom --gauge yaw --align-states 1 \
            --covariance message

    Use GNSS fixes, with the antenna 1 m above the body (docs/gnss.md):

        trajeval evaluate run:/fix run:/odom --modality stereo-inertial \
            --lever-arm 0,0,1

    Use slow groundtruth with dropouts, such as from a total station:

        trajeval evaluate rtk.txt vio.txt --association continuous \
            --groundtruth-noise 0.01,1
    """
    chosen = None
    recorded: dict[str, Trajectory] = {}
    if recording := _recording_of(by_position, groundtruth, estimate):
        is_gauge_given = any(settings[name] for name in _GAUGES)
        chosen = _chosen_evaluation(recording, recorded, is_gauge_given=is_gauge_given)
        by_position, groundtruth, estimate = (), chosen.groundtruth, chosen.estimates
        settings["modality"] = chosen.modality or settings["modality"]
    request = request_from(settings)
    requirements: list[Requirement] = []
    if require:
        from trajeval_ros.io.results.requirement import Requirement

        requirements = [Requirement.parse(text) for text in require]
    require_one_of(statistic or "mean", RELATIVE_STATISTICS, "statistic")
    pictures = Pictures(rrd=rrd, viewer=viewer)
    pictures.check()
    look = FigureStyle.parse(figure_format, figure_width, style, has_titles=not no_title)
    look.check()
    if look != PLAIN and output is None:
        raise SettingsError("the options of figures need an output folder; add --output DIR")
    truth, *named = sources_of("evaluate", by_position, groundtruth, estimate)
    split = [("", truth), *map(split_name, named)]
    sources = [source for _, source in split]
    names = names_with([name for name, _ in split], sources)
    refuse_inputs([mcap, rrd, json, output], sources)
    hints = SideHints.of(columns, frame_rate)
    every_hint = [hints.groundtruth, *[hints.estimate] * (len(sources) - 1)]
    flags = [request.reads_covariances] * (len(sources) - 1)
    flags = [request.reads_groundtruth_covariances, *flags]
    is_read = all(source in recorded for source in sources)
    if is_read and not (strict or request.received or columns or frame_rate or any(flags)):
        reference, *estimates = _as_read(recorded, sources, names)
    else:
        reference, *estimates = read_shown(
            sources,
            names,
            covariances=flags,
            strict=strict,
            hints=every_hint,
            received=request.received,
        )
    recorded.clear()  # the other topics
    require_used(list(zip(every_hint, [reference, *estimates], strict=True)))
    if chosen is not None:
        reference = _with_reasons(reference, chosen)
    outcome = run(reference, estimates, request)
    write_and_print(
        outcome,
        requirements,
        json=json,
        output=output,
        quiet=quiet,
        diagnosis=diagnosis,
        statistic=statistic or "",
        pictures=pictures,
        mcap=mcap,
        look=look,
        repeat=_repeated(chosen, recording) if chosen else "",
    )


def _recording_of(by_position: Sequence[str], *named: object) -> str:
    """Return the only source of a command if it is a bag, a log or a folder; "" otherwise.

    A missing or damaged file with the ending of a bag or log is one, so its reader states why.
    """
    if len(by_position) != 1 or any(named):
        return ""
    path = Path(by_position[0])
    if path.is_dir() or path.suffix in (".ulg", *BAG_ENDINGS):
        return by_position[0]
    is_bag = path.is_file() and parse_source(by_position[0]).is_bag
    return by_position[0] if is_bag else ""


def _chosen_evaluation(
    recording: str, read: dict[str, Trajectory], *, is_gauge_given: bool
) -> LikelyEvaluation:
    """Return the likely evaluation of a recording; `read` receives its trajectories by SOURCE.

    Raises:
        InputError: No groundtruth or no estimate is likely, or two evaluations are equally likely.
    """
    import shlex

    from trajeval_ros.io.roles import describe_all, likely_evaluations
    from trajeval_ros.report.console import console

    with progress(f"searching {recording}") as advance:
        description = describe_all(Path(recording), read, advance)
    likely = likely_evaluations(description, has_one_gauge=is_gauge_given)
    if len(likely) == 1 and likely[0].groundtruth:
        return likely[0]
    if not likely:
        look = f"trajeval info {shlex.quote(recording)}"
        damage = [f"; {item.text}" for item in description.remarks if item.level is Level.ERROR]
        raise InputError(
            f"{recording} has no two likely sides; list its topics: {look}{''.join(damage)}"
        )
    commands = [evaluation.command() for evaluation in likely]
    if not likely[0].groundtruth:
        raise InputError(f"{recording} has no likely groundtruth; name it: {commands[0]}")
    for command in commands:
        console().print(command, soft_wrap=True)
    raise InputError(
        f"{recording} has {counted(len(likely), 'likely evaluation')}, so none is calculated; "
        "call one of these commands"
    )


def _as_read(
    read: Mapping[str, Trajectory], sources: Sequence[str], names: Sequence[str]
) -> list[Trajectory]:
    """Return trajectories of the search as reading them again without covariances does."""
    return [
        dataclasses.replace(
            read[source],
            name=name,
            reading=dataclasses.replace(read[source].reading, source=source),
        )
        for source, name in zip(sources, names, strict=True)
    ]


def _with_reasons(groundtruth: Trajectory, chosen: LikelyEvaluation) -> Trajectory:
    """Return the groundtruth with a note for every choice."""
    notes = tuple(note(ASSUMED, reason) for reason in chosen.reasons)
    reading = groundtruth.reading
    reading = dataclasses.replace(reading, remarks=(*reading.remarks, *notes))
    return dataclasses.replace(groundtruth, reading=reading)


def _repeated(chosen: LikelyEvaluation, recording: str) -> str:
    """Return the command with sources and sensors in place of the recording."""
    import shlex

    given = [word for word in arguments() if word != recording]
    command = dataclasses.replace(chosen, options="").command()
    return " ".join([command, *map(shlex.quote, given)])
