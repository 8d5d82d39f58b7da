"""`trajeval watch`: health of an estimate without groundtruth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.cli import options
from trajeval_ros.exceptions import InputError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.watchdog.alarm_book import AlarmBook
    from trajeval_ros.watchdog.recording import Watched, WatchedRun

_FAILS = ("alarm", "error")
# A run with larger relative errors of 1 s is not healthy.
_HEALTHY_M, _HEALTHY_DEG = 0.3, 5.0


def watch(
    estimate: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="Estimate to watch, such as run.mcap:/odom, or the folder of a black box clip.",
        ),
    ],
    imu: Annotated[
        str | None,
        typer.Option(
            metavar="BAG:TOPIC",
            help="IMU of the robot (sensor_msgs/Imu). Its axes are arbitrary.",
            rich_help_panel=options.INPUT,
        ),
    ] = None,
    partners: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="SOURCE",
            help="Second estimate of the same robot, repeatable. Its frame, body and scale are "
            "arbitrary.",
            rich_help_panel=options.INPUT,
        ),
    ] = None,
    corrections: Annotated[
        str | None,
        typer.Option(
            "--map-to-odom",
            metavar="SOURCE",
            help="Transform from the map to the estimate's frame, such as run.mcap:/tf:map.odom. "
            "Its corrections are monitored.",
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
        float | None,
        typer.Option(
            metavar="K",
            help="Factor between the largest value of the healthy run and the limit (default 2, "
            "or that of the clip).",
            rich_help_panel=options.INPUT,
        ),
    ] = None,
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

        trajeval watch good:/odom --imu good:/imu --with good:/vio/odometry \
            --learn limits.yaml

    Watch another run, with exit status 1 on an alarm:

        trajeval watch run:/odom --imu run:/imu --with run:/vio/odometry \
            --limits limits.yaml --fail-on alarm

    Show what a node saw around an alarm:

        trajeval watch trajeval_black_box/20260314T150926.535Z_pair_m_1s \
            --rrd clip.rrd

    docs/watchdog.md lists what is detected, the detection delays and the limits of detection.
    """
    from trajeval_ros.cli.deliver import refuse_inputs
    from trajeval_ros.cli.watch_output import deliver_watch
    from trajeval_ros.io.live.watched_clip import is_clip

    named = _named_sources(estimate, imu, partners or [], corrections)
    sources = [*named.values(), *([] if groundtruth is None else [groundtruth])]
    _check(factor, fail_on)
    if rrd is not None:
        from trajeval_ros.viewer.sdk import sdk

        sdk()  # raises at once if it is not installed
    refuse_inputs([learn, figure, rrd, None if json in (None, "-") else Path(json)], sources)
    if is_clip(estimate):
        if len(sources) > 1 or learn is not None or limits is not None:
            raise SettingsError(
                f"{estimate} is a clip of the black box, with signals and limits; remove --imu, "
                "--with, --map-to-odom, --groundtruth, --learn and --limits"
            )
        states, seen, book = _of_clip(Path(estimate), factor, is_drawn=rrd is not None)
    else:
        _check_limits(learn, limits, groundtruth)
        states, seen, book = _of_run(named, groundtruth, learn, limits, factor)
    if rrd is not None:
        from trajeval_ros.viewer.watch_scene import write_watch

        assert states is not None
        write_watch(rrd, states, seen, book)
    deliver_watch(estimate, seen, book, json=json, figure=figure, quiet=quiet, learn=learn)
    failing = [each for each in book.alarms if fail_on == "alarm" or book.is_error(each)]
    if fail_on is not None and failing:
        raise typer.Exit(1)


def _of_run(
    named: Mapping[str, str],
    groundtruth: str | None,
    learn: Path | None,
    limits: Path | None,
    factor: float | None,
) -> tuple[Trajectory, Watched, AlarmBook]:
    """Return the states, signals and alarms of a run; learn limits if requested."""
    from trajeval_ros.io.requests.limits_file import read_limits, write_limits
    from trajeval_ros.watchdog.alarm_book import AlarmBook
    from trajeval_ros.watchdog.limits import DEFAULT_FACTOR, WatchLimits
    from trajeval_ros.watchdog.recording import watched

    known = None if limits is None else read_limits(limits)
    run, truth = _read(named, groundtruth)
    checked = "checked against groundtruth" if truth is not None else "not checked"
    if truth is not None:
        _require_healthy(truth, run.estimate)
    seen = watched(run)
    if learn is not None:
        known = WatchLimits.learned(seen.signals, seen.hours, named, checked)
        write_limits(learn, known)
    assert known is not None
    if learn is None:
        known.require_of(seen.signals)
    book = AlarmBook(known, factor or DEFAULT_FACTOR)
    book.add(seen.signals)
    return run.estimate, seen, book


def _of_clip(
    folder: Path, factor: float | None, *, is_drawn: bool
) -> tuple[Trajectory | None, Watched, AlarmBook]:
    """Return states, signals and alarms of a clip; states only if they are drawn."""
    from trajeval_ros.io.live.watched_clip import read_watched_clip
    from trajeval_ros.io.sources import read_trajectory

    clip = read_watched_clip(folder, factor)
    return read_trajectory(clip.estimate) if is_drawn else None, clip.seen, clip.book


def _check_limits(learn: Path | None, limits: Path | None, groundtruth: str | None) -> None:
    """Raise SettingsError if options contradict each other, before anything is read."""
    if (learn is None) == (limits is None):
        raise SettingsError(
            "watch needs limits of the same robot and estimator; give either --limits FILE, or "
            "--learn FILE with a healthy run"
        )
    if groundtruth is not None and learn is None:
        raise SettingsError("--groundtruth needs --learn; use trajeval evaluate to measure errors")


def _check(factor: float | None, fail_on: str | None) -> None:
    """Raise SettingsError if a value is not valid."""
    if factor is not None and not 1.0 <= factor < float("inf"):
        raise SettingsError(f"--factor must be at least 1, not {factor:g}")
    if fail_on is not None and fail_on not in _FAILS:
        raise SettingsError(f"--fail-on must be one of {', '.join(_FAILS)}, not {fail_on!r}")


def _named_sources(
    estimate: str, imu: str | None, partners: Sequence[str], corrections: str | None
) -> dict[str, str]:
    """Return the given sources by their names in limit files.

    Raises:
        SettingsError: Two second estimates have the same name.
    """
    from trajeval_ros.cli.source_names import names_of
    from trajeval_ros.formatting.topic_names import part_of_topic
    from trajeval_ros.watchdog.signals import pair_sources

    pairs = pair_sources([part_of_topic(each) for each in names_of(partners)])
    named = {"estimate": estimate, "imu": imu, "map": corrections}
    return {
        **{name: each for name, each in named.items() if each is not None},
        **dict(zip(pairs, partners, strict=True)),
    }


def _read(
    named: Mapping[str, str], groundtruth: str | None
) -> tuple[WatchedRun, Trajectory | None]:
    """Read all sources."""
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.cli.source_names import names_of
    from trajeval_ros.io.watched_sources import read_watched
    from trajeval_ros.watchdog.signals import PAIR

    with progress(f"reading {', '.join(names_of([named['estimate']]))}") as advance:
        return read_watched(
            named["estimate"],
            named.get("imu"),
            {name: each for name, each in named.items() if name.partition(".")[0] == PAIR},
            groundtruth,
            corrections=named.get("map"),
            advance=advance,
        )


def _require_healthy(truth: Trajectory, estimate: Trajectory) -> None:
    """Check that the relative errors over 1 s of a run to learn from are small.

    Raises:
        InputError: They are too large.
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
