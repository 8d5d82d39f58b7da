"""`trajeval watch`: health of an estimate without groundtruth."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.cli import options
from trajeval_ros.exceptions import InputError, SettingsError

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.watchdog.alarm_book import AlarmBook
    from trajeval_ros.watchdog.recording import Watched, WatchedRun

_FAILS = ("alarm", "error")
# A run with larger relative errors of 1 s is not healthy.
_HEALTHY_M, _HEALTHY_DEG = 0.3, 5.0


def watch(
    estimate: Annotated[
        str,
        typer.Argument(metavar="SOURCE", help="Estimate to watch, such as run.mcap:/odom."),
    ],
    imu: Annotated[
        str | None,
        typer.Option(
            metavar="BAG:TOPIC",
            help="IMU of the robot (sensor_msgs/Imu). Its axes are arbitrary.",
            rich_help_panel=options.INPUT,
        ),
    ] = None,
    partner: Annotated[
        str | None,
        typer.Option(
            "--with",
            metavar="SOURCE",
            help="Second estimate of the same robot. Its frame, body and scale are arbitrary.",
            rich_help_panel=options.INPUT,
        ),
    ] = None,
    learn: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Output file for limits learned from this healthy run.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    limits: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File with learned limits.",
            rich_help_panel=options.INPUT,
        ),
    ] = None,
    groundtruth: Annotated[
        str | None,
        typer.Option(
            "--groundtruth",
            "-g",
            metavar="SOURCE",
            help="Groundtruth for --learn. A run with errors above "
            f"{_HEALTHY_M:g} m or {_HEALTHY_DEG:g} deg over 1 s is refused.",
            rich_help_panel=options.INPUT,
        ),
    ] = None,
    factor: Annotated[
        float,
        typer.Option(
            metavar="K",
            help="Factor between the largest value of the healthy run and the limit.",
            rich_help_panel=options.INPUT,
        ),
    ] = 2.0,
    fail_on: Annotated[
        str | None,
        typer.Option(
            metavar="alarm|error",
            help="Alarms that cause exit status 1: any, or only errors.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    json: options.JsonOption = None,
    figure: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Output file of a figure with signals and limits: png, pdf, svg or pgf.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Output file for Rerun's viewer: path, signals and limits. "
            "Open it with `trajeval view FILE`.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    quiet: options.QuietOption = False,
) -> None:
    r"""Monitors an estimate without groundtruth: jumps, freezes, divergence, yaw drift, clocks.

    Learn limits from a healthy run of the same robot and estimator:

        trajeval watch good:/odom --imu good:/imu --with good:/vio/odometry --learn limits.yaml

    Watch another run, with exit status 1 on an alarm:

        trajeval watch run:/odom --imu run:/imu --with run:/vio/odometry --limits limits.yaml \
            --fail-on alarm

    docs/watchdog.md lists what is detected, the detection delays and the limits of detection.
    """
    from trajeval_ros.cli.deliver import refuse_inputs
    from trajeval_ros.io.requests.limits_file import read_limits, write_limits
    from trajeval_ros.watchdog.alarm_book import AlarmBook
    from trajeval_ros.watchdog.limits import WatchLimits
    from trajeval_ros.watchdog.recording import watched

    _check(learn, limits, groundtruth, factor, fail_on)
    sources = [each for each in (estimate, imu, partner, groundtruth) if each is not None]
    refuse_inputs([learn, figure, rrd, None if json in (None, "-") else Path(json)], sources)
    known = None if limits is None else read_limits(limits)
    if rrd is not None:
        from trajeval_ros.viewer.sdk import sdk

        sdk()  # refuses at once where there is none
    run, truth = _read(estimate, imu, partner, groundtruth)
    checked = "checked against groundtruth" if truth is not None else "not checked"
    if truth is not None:
        _require_healthy(truth, run.estimate)
    seen = watched(run)
    if learn is not None:
        named = {"estimate": estimate, "imu": imu, "with": partner}
        origins = {name: each for name, each in named.items() if each is not None}
        known = WatchLimits.learned(seen.signals, seen.hours, origins, checked)
        write_limits(learn, known)
    assert known is not None
    if learn is None:
        known.require_of(seen.signals)
    book = AlarmBook(known, factor)
    book.add(seen.signals)
    if rrd is not None:
        from trajeval_ros.viewer.watch_scene import write_watch

        write_watch(rrd, run.estimate, seen, book)
    _deliver(estimate, seen, book, json=json, figure=figure, quiet=quiet, learn=learn)
    failing = [each for each in book.alarms if fail_on == "alarm" or book.is_error(each)]
    if fail_on is not None and failing:
        raise typer.Exit(1)


def _check(
    learn: Path | None,
    limits: Path | None,
    groundtruth: str | None,
    factor: float,
    fail_on: str | None,
) -> None:
    """Refuse options that contradict each other, before anything is read."""
    if (learn is None) == (limits is None):
        raise SettingsError(
            "watch needs limits of the same robot and estimator; give either --limits FILE, or "
            "--learn FILE with a healthy run"
        )
    if groundtruth is not None and learn is None:
        raise SettingsError("--groundtruth needs --learn; use trajeval evaluate to measure errors")
    if not 1.0 <= factor < float("inf"):
        raise SettingsError(f"--factor must be at least 1, not {factor:g}")
    if fail_on is not None and fail_on not in _FAILS:
        raise SettingsError(f"--fail-on must be one of {', '.join(_FAILS)}, not {fail_on!r}")


def _read(
    estimate: str, imu: str | None, partner: str | None, groundtruth: str | None
) -> tuple[WatchedRun, Trajectory | None]:
    """Read all sources."""
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.cli.source_names import names_of
    from trajeval_ros.io.watched_sources import read_watched

    with progress(f"reading {', '.join(names_of([estimate]))}") as advance:
        return read_watched(estimate, imu, partner, groundtruth, advance)


def _require_healthy(truth: Trajectory, estimate: Trajectory) -> None:
    """Refuse a run to learn from whose relative errors of 1 s are large.

    Raises:
        InputError: They are.
    """
    from trajeval_ros.metrics.protocol import Protocol
    from trajeval_ros.pipeline.pipeline import evaluate

    found = evaluate(truth, estimate, Protocol(gauge="sim3", lengths=("1s",)))
    assert found.segments is not None
    (segment,) = found.segments
    for metric, limit, unit in (
        ("position_m", _HEALTHY_M, "m"),
        ("rotation_deg", _HEALTHY_DEG, "deg"),
    ):
        statistics = segment.statistics[metric]
        if statistics is not None and statistics.max > limit:
            raise InputError(
                f"{estimate.name} is not a healthy run: its relative error over 1 s reaches "
                f"{statistics.max:.3g} {unit}, and the limit is {limit:g} {unit}; choose another "
                "run"
            )


def _deliver(
    estimate: str,
    seen: Watched,
    book: AlarmBook,
    *,
    json: str | None,
    figure: Path | None,
    quiet: bool,
    learn: Path | None,
) -> None:
    """Write and print what was asked for."""
    from trajeval_ros.io.json_file import json_text
    from trajeval_ros.io.results.watch_json import watch_json
    from trajeval_ros.io.writing import write_text

    text = json_text(watch_json(estimate, seen, book), indent=2)
    if json == "-":
        sys.stdout.write(text)
    elif json is not None:
        write_text(Path(json), text, follow_link=True)
    if figure is not None:
        from trajeval_ros.cli.source_names import names_of
        from trajeval_ros.report import canvas
        from trajeval_ros.report.figure_style import house_style
        from trajeval_ros.report.figures import write_figure
        from trajeval_ros.report.watch_figure import watch_figure

        with house_style():
            drawn = watch_figure(seen, book, *canvas.short_names(names_of([estimate])))
            write_figure(drawn, figure)
    if not quiet and json != "-":
        _print(seen, book, learn)


def _print(seen: Watched, book: AlarmBook, learn: Path | None) -> None:
    from trajeval_ros.report import watch_lines
    from trajeval_ros.report.console import add_rows, console, new_table, show

    terminal = console()
    for notice in seen.notices:
        terminal.print(f"note: {notice}", soft_wrap=True)
    if book.alarms:
        table = new_table("", watch_lines.ALARM_WORDS, watch_lines.ALARM_NUMBERS)
        add_rows(table, watch_lines.alarm_rows(book))
        show(terminal, table)
    table = new_table("", watch_lines.SIGNAL_WORDS, watch_lines.SIGNAL_NUMBERS)
    add_rows(table, watch_lines.signal_rows(seen, book))
    show(terminal, table)
    if learn is None:
        terminal.print(watch_lines.seen_line(seen, book), soft_wrap=True)
        terminal.print(watch_lines.evidence_line(book.limits, book.factor), soft_wrap=True)
        return
    said = (
        "healthy against groundtruth, in windows of 1 s"
        if book.limits.checked == "checked against groundtruth"
        else "not checked for health: inspect the largest values and their times, or add "
        "--groundtruth"
    )
    terminal.print(f"wrote {learn} from {seen.hours:.3f} h; {said}", soft_wrap=True)
