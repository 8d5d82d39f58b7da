"""The picture of a watched run: the path coloured by signal / limit, and plots of the signals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.formatting.numbers import with_unit
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.writing import write_whole
from trajeval_ros.viewer import colours, entity_data, scene_entities
from trajeval_ros.viewer.blueprint import (
    event_list,
    state_lanes,
    until_now,
    whole_run,
    with_panels,
)
from trajeval_ros.viewer.paths import gaps, origin_for, peaks, pieces, spread
from trajeval_ros.viewer.sdk import sdk
from trajeval_ros.viewer.sinks import recording_writer
from trajeval_ros.viewer.state_lanes import ERROR, OK, WARNING, send_lane
from trajeval_ros.watchdog.recording import Watched
from trajeval_ros.watchdog.signals import signal_of
from trajeval_ros.watchdog.watch_alarms import AlarmBook

PATH, POSE = f"{scene_entities.WORLD}/watched/path", f"{scene_entities.WORLD}/watched/pose"
_PLOTS = "watch"
_KINDS = {
    "pair": "Second estimate",
    "imu": "IMU",
    "twist": "Twist",
    "map": "Map corrections",
    "": "Only poses",
}
_LIMIT = "limit"
_MOST_POINTS, _MOST_ROWS, _MOST_NUMBERS = 50_000, 2000, 20_000
_MOST_POSES = 3000
_SHORTEST_S = 0.1  # of an alarm in a lane: that of a jump has no duration


def write_watch(path: Path, estimate: Trajectory, seen: Watched, book: AlarmBook) -> None:
    """Write a Rerun file (.rrd) of a watched run."""
    ratios = {
        name: readings.values / book.limit(name)
        for name, readings in seen.signals.items()
        if len(readings.values)
    }
    kinds = [kind for kind in _KINDS if any(signal_of(ratio).needs == kind for ratio in ratios)]

    def draw(recording: Any) -> None:
        _draw_path(recording, estimate, seen, ratios)
        for name, values in ratios.items():
            _draw_signal(recording, name, _stamps(seen, seen.signals[name].seconds), values)
        for kind in kinds:
            _draw_limit(recording, kind, seen)
        _tell(recording, seen, book)

    write = recording_writer(estimate.name or "estimate", _blueprint(kinds), draw)
    write_whole(path, write, follow_link=True)


def _stamps(seen: Watched, seconds: Floats) -> Stamps:
    stamps: Stamps = seen.origin + np.rint(seconds * NANOSECONDS).astype(np.int64)
    return stamps


def _entity(kind: str, name: str) -> str:
    return f"{_PLOTS}/{kind or 'poses'}/{name}"


def _draw_path(
    recording: Any, estimate: Trajectory, seen: Watched, ratios: dict[str, Floats]
) -> None:
    """Draw the path, coloured by the largest ratio of signal and limit, and the pose."""
    nearest = np.zeros(len(estimate))
    for name, values in ratios.items():
        stamps = _stamps(seen, seen.signals[name].seconds)
        rows = np.minimum(np.searchsorted(estimate.stamps, stamps), len(estimate) - 1)
        np.maximum.at(nearest, rows, values)
    origin = origin_for(estimate.positions)
    some = spread(len(estimate), _MOST_POINTS)
    stamps, points = estimate.stamps[some], estimate.positions[some] - origin
    rows = pieces(len(some), gaps(stamps), _MOST_ROWS)
    if len(rows):
        drawn = entity_data.path_by_error(points, nearest[some], rows, 1.0)
        drawn.send(recording, PATH, stamps[rows[:, -1]])
    few = spread(len(estimate), _MOST_POSES)
    rotations = None if estimate.quaternions is None else estimate.quaternions[few]
    poses = entity_data.poses(estimate.positions[few] - origin, rotations)
    poses.send(recording, POSE, estimate.stamps[few])


def _draw_signal(recording: Any, name: str, stamps: Stamps, values: Floats) -> None:
    rerun, _ = sdk()
    entity = _entity(signal_of(name).needs, name)
    recording.log(entity, rerun.SeriesLines(names=[name]), static=True)
    some = peaks(values, _MOST_NUMBERS)
    entity_data.numbers(values[some]).send(recording, entity, stamps[some])


def _draw_limit(recording: Any, kind: str, seen: Watched) -> None:
    rerun, _ = sdk()
    entity = _entity(kind, _LIMIT)
    style = rerun.SeriesLines(colors=[colours.BAND], names=[_LIMIT], widths=[2.0])
    recording.log(entity, style, static=True)
    ends = _stamps(seen, np.array([seen.armed_s, seen.end_s]))
    entity_data.numbers(np.ones(2)).send(recording, entity, ends)


def _tell(recording: Any, seen: Watched, book: AlarmBook) -> None:
    """Log starts and ends of alarms, and findings about the sources."""

    def say(seconds: float, text: str, *, warn: bool) -> None:
        [stamp] = _stamps(seen, np.array([seconds]))
        entity_data.log(
            recording, scene_entities.EVENTS, int(stamp), entity_data.event(text, warn=warn)
        )

    for notice in seen.notices:
        say(seen.armed_s, notice, warn=False)
    say(seen.armed_s, "armed", warn=False)
    changes: dict[str, list[tuple[float, str]]] = {}
    for alarm in book.alarms:
        unit = signal_of(alarm.signal).unit
        level = "error" if book.is_error(alarm) else "warning"
        peak, limit = (with_unit(item, unit) for item in (alarm.peak, alarm.limit))
        message = f"{level}: {alarm.signal} up to {peak}, limit {limit}"
        say(alarm.begin_s, message, warn=True)
        lane = changes.setdefault(alarm.signal, [(seen.armed_s, OK)])
        lane.append((alarm.begin_s, ERROR if book.is_error(alarm) else WARNING))
        if alarm.is_over:
            lane.append((max(alarm.last_s, alarm.begin_s + _SHORTEST_S), OK))
            say(alarm.last_s, f"{alarm.signal} is below its limit again", warn=False)
    for signal, lane in changes.items():
        stamps = _stamps(seen, np.array([seconds for seconds, _ in lane]))
        send_lane(
            recording,
            scene_entities.lane(scene_entities.ALARM, signal),
            stamps,
            [state for _, state in lane],
        )


def _blueprint(kinds: list[str]) -> Any:
    _, layout = sdk()
    plots = [
        layout.TimeSeriesView(
            origin=f"/{_entity(kind, '').rstrip('/')}",
            name=f"{_KINDS[kind]}: value over limit",
            axis_x=whole_run(),
            plot_legend=layout.PlotLegend(layout.Corner2D.LeftTop),
        )
        for kind in kinds
    ]
    return with_panels(
        layout.Horizontal(
            layout.Vertical(
                layout.Spatial3DView(
                    origin=f"/{scene_entities.WORLD}",
                    name="Watched estimate, coloured by the largest value over limit, 0 to 1",
                    overrides={PATH: [until_now()]},
                    background=layout.Background(color=colours.BACKGROUND),
                ),
                layout.Tabs(state_lanes("Alarms"), event_list("Events")),
                row_shares=[3, 1],
            ),
            layout.Vertical(*plots),
        )
    )
