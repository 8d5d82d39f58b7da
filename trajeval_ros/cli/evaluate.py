"""`trajeval evaluate`: recorded runs, end to end."""

from __future__ import annotations

import dataclasses
import logging
import shutil
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.cli.names import names_of
from trajeval_ros.cli.progress import progress
from trajeval_ros.evaluation import evaluate as evaluate_pair
from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.gauge import MODALITIES, Gauge
from trajeval_ros.io import results
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.protocol import ATE_FORMS, PROTOCOLS
from trajeval_ros.requirement import Requirement
from trajeval_ros.settings import protocol_from

if TYPE_CHECKING:
    from trajeval_ros.protocol import Protocol
    from trajeval_ros.trajectory import Trajectory

INPUT, ALIGN, PAIR, MEASURE, OUTPUT = (
    "Input",
    "Alignment",
    "Association",
    "Errors",
    "Output",
)
_HAVE_FIGURES = find_spec("matplotlib") is not None
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
            help=f"A named bundle of settings: {', '.join(PROTOCOLS)}. Options below override it.",
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
            "nearest pairs stamps one to one.",
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
        float | None,
        typer.Option(
            metavar="S", help="Added to the estimate's stamps, seconds.", rich_help_panel=PAIR
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
            help="Write result.json, errors.npz and figures there.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    require: Annotated[
        list[str] | None,
        typer.Option(
            metavar="BOUND",
            help="Exit with status 1 unless it holds for every estimate; repeatable. "
            "Such as 'ate.position_m.rmse < 0.3' or 're.8m.position_percent.mean < 1'.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print nothing.", rich_help_panel=OUTPUT)
    ] = False,
) -> None:
    """Say how wrong estimated trajectories are: ATE and relative error against groundtruth.

    Two text files, groundtruth and a stereo-inertial VIO:

        trajeval evaluate -g groundtruth.txt -e estimate.txt --modality stereo-inertial

    Two topics of a bag, with result.json and figures in a folder:

        trajeval evaluate -g run.mcap:/mocap/pose -e run.mcap:/vio/odometry --output result

    Numbers as evo or the authors' toolbox compute them: --protocol evo, --protocol rpg.
    """
    settings = protocol_from(
        protocol,
        gauge=gauge,
        modality=modality,
        align_states=align_states,
        association=association,
        max_time_difference=max_time_difference,
        max_gap=max_gap,
        time_offset=time_offset,
        lengths=lengths,
        ate_form=ate_form,
        re_form=re_form,
    )
    requirements = [Requirement.parse(text) for text in require or []]
    names = names_of([groundtruth, *estimate])
    truth = _read(groundtruth, names[0])
    runs = [
        _run(source, name, truth, settings)
        for source, name in zip(estimate, names[1:], strict=True)
    ]
    result = results.result_of(
        results.Input.of(groundtruth, truth, runs[0].evaluation.groundtruth), runs
    )
    # A requirement that names nothing is a mistake to be told before anything is written.
    unmet = [
        f"{run['estimate']['name']}: {why}"
        for run in result["runs"]
        for requirement in requirements
        if (why := requirement.unmet(run))
    ]
    if output is not None:
        _write_folder(output, result, runs)
    if json == "-":
        sys.stdout.write(results.to_json(result))
    elif json is not None:
        results.write_text(Path(json), results.to_json(result))
    if not quiet and json != "-":
        chose_gauge = gauge is not None or modality is not None or protocol != "default"
        _print(runs, output, gauge_given=chose_gauge)
    for line in unmet:
        print(f"trajeval: {line}", file=sys.stderr)
    if unmet:
        raise typer.Exit(1)


def _read(source: str, name: str) -> Trajectory:
    with progress(f"reading {name}") as advance:
        trajectory = read_trajectory(source, advance=advance)
    return dataclasses.replace(trajectory, name=name)


def _run(source: str, name: str, groundtruth: Trajectory, settings: Protocol) -> results.Run:
    read = _read(source, name)
    try:
        evaluation = evaluate_pair(groundtruth, read, settings)
    except TrajevalError as error:
        raise InputError(f"{source}: {error}") from error
    return results.Run(results.Input.of(source, read, evaluation.estimate), evaluation)


def _write_folder(folder: Path, result: dict[str, object], runs: list[results.Run]) -> None:
    """Write everything under a temporary name first, so that nothing is ever half written."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        results.write_errors(temporary / "errors.npz", runs)
        if _HAVE_FIGURES:
            # That matplotlib can't write into the user's home is no news about trajectories.
            logging.getLogger("matplotlib").setLevel(logging.ERROR)
            from trajeval_ros.report.plots import write_figures

            write_figures([run.evaluation for run in runs], temporary)
        (temporary / "result.json").write_text(results.to_json(result), encoding="utf-8")
        folder.mkdir(exist_ok=True)
        for file in sorted(temporary.iterdir()):
            file.replace(folder / file.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _print(runs: list[results.Run], output: Path | None, *, gauge_given: bool) -> None:
    from trajeval_ros.report import tables

    evaluations = [run.evaluation for run in runs]
    terminal = tables.console()
    for evaluation in evaluations:
        for line in tables.verdict(evaluation):
            terminal.print(line, soft_wrap=True)
    if not gauge_given:
        terminal.print(
            "  gauge se3 by default: --modality mono, stereo, stereo-inertial, ... picks the one "
            "that fits the sensors",
            soft_wrap=True,
        )
    terminal.print()
    terminal.print(tables.absolute_table(evaluations))
    relative = tables.relative_table(evaluations, terminal.width)
    if relative is not None:
        terminal.print()
        terminal.print(relative)
    if output is not None:
        terminal.print(f"\n{_contents(output)}", soft_wrap=True)
    terminal.file.flush()
    remarks = tables.console(sys.stderr)
    for trajectory in (evaluations[0].groundtruth, *(each.estimate for each in evaluations)):
        if trajectory.notes:
            remarks.print(
                f"note: {trajectory.name}: {'; '.join(trajectory.notes)}", soft_wrap=True
            )
    for evaluation in evaluations:
        for warning in evaluation.warnings:
            remarks.print(f"warning: {evaluation.estimate.name}: {warning}", soft_wrap=True)


def _contents(folder: Path) -> str:
    if _HAVE_FIGURES:
        return f"result.json, errors.npz and figures are in {folder}"
    return (
        f"result.json and errors.npz are in {folder}; for figures, install matplotlib: "
        "pip install 'trajeval-ros[plot]'"
    )
