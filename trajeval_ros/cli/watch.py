"""`trajeval watch`: health of an estimate without groundtruth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import OUTPUT, argument, option, shared_options
from trajeval_ros.cli.programs import write_json
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.requests.setting import INPUT, WATCH_FACTORS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from trajeval_ros.watchdog.recording import Watched, WatchedRun
    from trajeval_ros.watchdog.watch_alarms import AlarmBook

_FAILS = ("alarm", "error")

_PARAMETERS = (
    argument("estimate", metavar="SOURCE",
        help="Estimate to watch, such as run.mcap:/odom."),
    option("--imu", metavar="BAG:TOPIC", panel=INPUT,
        help="IMU of the robot (sensor_msgs/Imu). Its axes are arbitrary."),
    option("--with", "partners", metavar="SOURCE", panel=INPUT, is_repeatable=True,
        help="Second estimate of the same robot, repeatable. Its frame, body and scale are "
        "arbitrary."),
    option("--map-to-odom", "corrections", metavar="SOURCE", panel=INPUT,
        help="Transform from the map to the estimate's frame, such as run.mcap:/tf:map.odom. "
        "Its corrections are monitored."),
    option("--factor", kind=float, metavar="K", default=1.0, panel=INPUT,
        help="Factor on all limits, for this robot and estimator."),
    option("--fail-on", metavar="alarm|error", panel=OUTPUT,
        help="Alarms that cause exit status 1: any, or only errors."),
    option("--figure", kind=Path, metavar="FILE", panel=OUTPUT,
        help="Output file of a figure with signals and limits: png, pdf, svg or pgf."),
    option("--rrd", kind=Path, metavar="FILE", panel=OUTPUT,
        help="Output file for Rerun's viewer: path, signals and limits. Open it with `trajeval "
        "view FILE`."),
    *shared_options("watch"),
)  # fmt: skip


@verb(*_PARAMETERS)
def watch(
    estimate: str,
    imu: str | None,
    partners: Sequence[str],
    corrections: str | None,
    factor: float,
    fail_on: str | None,
    figure: Path | None,
    rrd: Path | None,
    json: str | None,
    quiet: bool,
) -> None:
    r"""Monitors an estimate without groundtruth: jumps, freezes, divergence, yaw drift, clocks.

    Exit status 1 on an alarm:

        trajeval watch run:/odom --imu run:/imu --with run:/vio/odometry \
            --fail-on alarm

    A healthy run shows which --factor this robot needs.

    docs/watchdog.md lists what is detected, the detection delays and the limits of detection.
    """
    from trajeval_ros.cli.evaluation_output import refuse_inputs
    from trajeval_ros.cli.progress import report_dropped
    from trajeval_ros.watchdog.recording import watched
    from trajeval_ros.watchdog.watch_alarms import AlarmBook

    named = _named_sources(estimate, imu, partners, corrections)
    _check(factor, fail_on)
    if rrd is not None:
        from trajeval_ros.viewer.sdk import sdk

        sdk()  # raises at once if it is not installed
    refuse_inputs([figure, rrd, json], [*named.values()])
    run = _read(named)
    seen, book = watched(run), AlarmBook(factor)
    book.add(seen.signals)
    if rrd is not None:
        from trajeval_ros.viewer.watch_scene import write_watch

        write_watch(rrd, run.estimate, seen, book)
    _deliver(estimate, seen, book, json=json, figure=figure, quiet=quiet)
    report_dropped([run.estimate, *run.others.values()])
    failing = [alarm for alarm in book.alarms if fail_on == "alarm" or book.is_error(alarm)]
    if fail_on is not None and failing:
        raise click.exceptions.Exit(1)


def _check(factor: float, fail_on: str | None) -> None:
    """Raise SettingsError if a value is not valid."""
    low, high = WATCH_FACTORS
    if not low <= factor <= high:
        raise SettingsError(f"--factor must be from {low:g} to {high:g}, not {factor:g}")
    if fail_on is not None and fail_on not in _FAILS:
        raise SettingsError(f"--fail-on must be one of {', '.join(_FAILS)}, not {fail_on!r}")


def _named_sources(
    estimate: str, imu: str | None, partners: Sequence[str], corrections: str | None
) -> dict[str, str]:
    """Return the given sources by name."""
    from trajeval_ros.formatting.escaping import part_of_topic
    from trajeval_ros.io.source_names import names_of
    from trajeval_ros.watchdog.signals import pair_sources

    pairs = pair_sources([part_of_topic(item) for item in names_of(partners)])
    named = {"estimate": estimate, "imu": imu, "map": corrections}
    return {
        **{name: item for name, item in named.items() if item is not None},
        **dict(zip(pairs, partners, strict=True)),
    }


def _read(named: Mapping[str, str]) -> WatchedRun:
    """Read all sources."""
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.io.source_names import names_of
    from trajeval_ros.io.watched_sources import read_watched
    from trajeval_ros.watchdog.signals import PAIR

    with progress(f"reading {', '.join(names_of([named['estimate']]))}") as advance:
        return read_watched(
            named["estimate"],
            named.get("imu"),
            {name: item for name, item in named.items() if name.partition(".")[0] == PAIR},
            corrections=named.get("map"),
            advance=advance,
        )


def _deliver(
    estimate: str,
    seen: Watched,
    book: AlarmBook,
    *,
    json: str | None,
    figure: Path | None,
    quiet: bool,
) -> None:
    """Write the requested files and print the tables."""
    from trajeval_ros.io.results.watch_json import watch_json

    write_json(json, watch_json(estimate, seen, book))
    if figure is not None:
        from trajeval_ros.io.source_names import names_of
        from trajeval_ros.report import canvas
        from trajeval_ros.report.figure_style import apply_style
        from trajeval_ros.report.figures import write_figure
        from trajeval_ros.report.watch_report import watch_figure

        with apply_style():
            drawn = watch_figure(seen, book, *canvas.short_names(names_of([estimate])))
            write_figure(drawn, figure)
    if not quiet and json != "-":
        _print(seen, book)


def _print(seen: Watched, book: AlarmBook) -> None:
    from trajeval_ros.report import watch_report
    from trajeval_ros.report.console import Table, console, show

    terminal = console()
    for notice in seen.notices:
        terminal.remark("note", notice)
    if book.alarms:
        rows = watch_report.alarm_rows(book)
        show(terminal, Table("", watch_report.ALARM_WORDS, watch_report.ALARM_NUMBERS, rows))
    if seen.events:
        terminal.print(watch_report.events_line(seen), soft_wrap=True)
    rows = watch_report.signal_rows(seen, book)
    show(terminal, Table("", watch_report.SIGNAL_WORDS, watch_report.SIGNAL_NUMBERS, rows))
    terminal.print(watch_report.seen_line(seen, book), soft_wrap=True)
    terminal.print(watch_report.factor_line(seen, book), soft_wrap=True)
