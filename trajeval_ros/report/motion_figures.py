"""Figures of trajectories: paths, and positions, angles and speeds over time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.exceptions import InputError, require_one_of
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.lie import euler_angles
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.trajectory_edits import PLANES
from trajeval_ros.geometry.travelled import speeds
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.report import canvas
from trajeval_ros.report.line_thinning import thinned
from trajeval_ros.report.plane_panels import PlanePanels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIMES = ("xyz", "rpy", "speed")
PLOTS = (*PLANES, "3d", *TIMES)
COLOURS_BY = {"error": "position error [m]", "speed": "speed [m/s]"}
_TOP_PERCENTILE = 99.0  # of the values, so that one outlier does not give all one colour
_RULE = AssociationRule()
_PANEL_IN, _REST_IN = 1.25, 0.5
_3D_IN = 0.85  # height relative to the width
_MOST_COLOURED = 4000  # line segments of a coloured path
_REFERENCE = -1  # position of the reference in the list of lines


@dataclass(frozen=True)
class Colours:
    """Colours along a path."""

    by: str  # one of `COLOURS_BY`
    largest: float | None = None  # value at the end of the scale; None for a high percentile


def motion_drawings(
    kinds: Sequence[str],
    trajectories: Sequence[Trajectory],
    reference: Trajectory | None,
    *,
    colours: Colours | None = None,
) -> dict[str, canvas.Drawing]:
    """Return the functions that draw the figures, by file name.

    `reference`: trajectory in the background; None for none. `colours`: along paths in a plane;
    None for one colour per trajectory.
    """
    for kind in kinds:
        require_one_of(kind, PLOTS, "plot")
    everything = [*trajectories, *([] if reference is None else [reference])]
    for trajectory in everything:
        if colours is not None and colours.by == "speed" and not trajectory.reading.stamped:
            raise InputError(
                f"{trajectory.name} has no timestamps, which --colour-by speed needs; set "
                "--frame-rate"
            )
        if "rpy" in kinds and trajectory.quaternions is None:
            raise InputError(f"{trajectory.name} has no orientations; remove rpy")
    drawings: dict[str, canvas.Drawing] = {}
    for kind in kinds:
        if kind in PLANES:
            drawings[f"path_{kind}"] = partial(_plane, trajectories, reference, kind, colours)
        elif kind == "3d":
            drawings["path_3d"] = partial(_space, trajectories, reference)
        else:
            drawings[f"{kind}_over_time"] = partial(_over_time, trajectories, reference, kind)
    return drawings


def _plane(
    trajectories: Sequence[Trajectory],
    reference: Trajectory | None,
    plane: str,
    colours: Colours | None,
) -> Figure:
    """Draw paths in a plane, in one colour per trajectory or coloured by a quantity."""
    across, up = ("xyz".index(axis) for axis in plane)
    names = canvas.short_names([trajectory.name for trajectory in trajectories])
    paths = [trajectory.positions[:, (across, up)] for trajectory in trajectories]
    groundtruth = None if reference is None else reference.positions[:, (across, up)]
    panels = PlanePanels(
        [*paths, *([] if groundtruth is None else [groundtruth])],
        dict(enumerate(names)),
        "",
        is_split=colours is not None or None,
    )
    if colours is None:
        for place, (trajectory, path) in enumerate(zip(trajectories, paths, strict=True)):
            panels.draw_path(place, thinned(path, trajectory.stamps, _RULE.is_gap))
    else:
        known = [_values(trajectory, reference, colours.by) for trajectory in trajectories]
        largest = colours.largest
        if largest is None:
            item = np.concatenate([values for _, _, values in known])
            largest = float(np.percentile(item, _TOP_PERCENTILE))
        for place, (positions, stamps, values) in enumerate(known):
            panels.draw_coloured(
                place, _pieces(positions[:, (across, up)], stamps, values), largest
            )
        panels.add_ramp(
            COLOURS_BY[colours.by], is_exceeded=any(values.max() > largest for *_, values in known)
        )
    marked = groundtruth if groundtruth is not None else paths[0] if len(paths) == 1 else None
    line = (
        None
        if reference is None or groundtruth is None
        else thinned(groundtruth, reference.stamps, _RULE.is_gap)
    )
    return panels.finish(line, marked, (plane[0], plane[1]), "reference")


def _values(
    trajectory: Trajectory, reference: Trajectory | None, colour_by: str
) -> tuple[Floats, Stamps, Floats]:
    """Return positions (N, 3), stamps (N,) and the values (N,) that determine the colours."""
    if colour_by == "speed":
        linear, _ = _speeds(trajectory)
        return trajectory.positions[1:], trajectory.stamps[1:], linear
    if reference is None:
        raise InputError("errors need a reference; give --reference SOURCE")
    pairs = associate(reference, trajectory, _RULE)
    errors = np.linalg.norm(pairs.estimate.positions - pairs.groundtruth.positions, axis=1)
    return pairs.estimate.positions, pairs.estimate.stamps, errors


def _pieces(path: Floats, stamps: Stamps, values: Floats) -> tuple[Floats, Floats]:
    """Return at most `_MOST_COLOURED` segments (M, 2, 2) and the largest value along each (M,)."""
    every = max(1, -(-len(path) // _MOST_COLOURED))
    rows = np.unique([*range(0, len(path), every), len(path) - 1])
    if len(rows) < 2:
        return np.empty((0, 2, 2)), np.empty(0)
    lines = np.stack([path[rows[:-1]], path[rows[1:]]], axis=1)
    largest = np.maximum.reduceat(values, rows[:-1])
    steps = np.diff(stamps)
    gap = _RULE.is_gap(steps) & (steps > 5.0 * float(np.median(steps)))
    passed = np.concatenate([[0], np.cumsum(gap)])[rows]
    connected = np.diff(passed) == 0
    return lines[connected], largest[connected]


def _space(trajectories: Sequence[Trajectory], reference: Trajectory | None) -> Figure:
    """Draw paths in three dimensions."""
    figure = canvas.new_figure(_3D_IN * canvas.width_in())
    axes = figure.add_subplot(projection="3d")
    for place, name, trajectory in _lines(trajectories, reference):
        rows = thinned(trajectory.positions, trajectory.stamps, _RULE.is_gap)
        axes.plot(*rows.T, **_look(place), label=name)
    # Equal scales, with space for the labels.
    axes.autoscale_view(tight=True)
    spans = [np.ptp(limits) for limits in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())]
    axes.set_box_aspect(np.maximum(spans, 1e-3 * max(spans)), zoom=0.85)
    for axis, span in zip((axes.xaxis, axes.yaxis, axes.zaxis), spans, strict=True):
        axis.get_major_locator().set_params(nbins=6 if span > 0.3 * max(spans) else 2)
    first = trajectories[0] if reference is None else reference
    if len(trajectories) == 1 or reference is not None:
        canvas.mark_ends(axes, first.positions)
    for axis, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        canvas.label_coordinates(axis, name)
    canvas.legend_below(figure, *axes.get_legend_handles_labels())
    return figure


def _speeds(trajectory: Trajectory) -> tuple[Floats, Floats | None]:
    return speeds(trajectory.stamps, trajectory.positions, trajectory.quaternions)


def _over_time(
    trajectories: Sequence[Trajectory], reference: Trajectory | None, kind: str
) -> Figure:
    """Draw positions, angles or speeds over time, or over the index if timestamps are missing."""
    lines = _lines(trajectories, reference)
    is_timed = all(trajectory.reading.stamped for _, _, trajectory in lines)
    if not is_timed:
        lines = [(place, name, _by_index(trajectory)) for place, name, trajectory in lines]
    origin = min(int(trajectory.stamps.min()) for _, _, trajectory in lines)
    labels = {
        "xyz": ("x [m]", "y [m]", "z [m]"),
        "rpy": ("roll [deg]", "pitch [deg]", "yaw [deg]"),
        "speed": ("speed [m/s]", "turn rate [deg/s]"),
    }[kind]
    if kind == "speed" and not is_timed:
        labels = ("step [m/pose]", "turn [deg/pose]")
    if kind == "speed" and all(trajectory.quaternions is None for _, _, trajectory in lines):
        labels = labels[:1]
    figure = canvas.new_figure(_PANEL_IN * len(labels) + _REST_IN)
    panels = figure.subplots(len(labels), 1, sharex=True, squeeze=False).ravel()
    begun = _columns(lines[0][2], kind)
    for place, name, trajectory in lines:
        stamps, columns = _columns(trajectory, kind)
        if kind == "rpy":
            columns -= _whole_turns(stamps, columns, *begun)
        seconds = (stamps - origin) / NANOSECONDS
        rows = thinned(np.column_stack([seconds, columns]), stamps, _RULE.is_gap)
        for axes, column in zip(panels, rows.T[1:], strict=False):
            axes.plot(rows[:, 0], column, **_look(place), label=name)
    for axes, label in zip(panels, labels, strict=True):
        if kind == "xyz":
            canvas.label_coordinates(axes.yaxis, label[0])
        else:
            axes.set_ylabel(label)
        if kind == "speed":
            axes.set_ylim(bottom=0.0)
    panels[-1].set_xlabel("time [s]" if is_timed else "pose")
    figure.align_ylabels()
    canvas.legend_below(figure, *panels[0].get_legend_handles_labels())
    return figure


def _by_index(trajectory: Trajectory) -> Trajectory:
    """Return a trajectory with the indices of its poses as seconds."""
    return dataclasses.replace(
        trajectory, stamps=NANOSECONDS * np.arange(len(trajectory), dtype=np.int64)
    )


def _columns(trajectory: Trajectory, kind: str) -> tuple[Stamps, Floats]:
    """Return stamps (M,) and the values to draw (M, K)."""
    if kind == "xyz":
        return trajectory.stamps, trajectory.positions
    if kind == "speed":
        linear, turning = _speeds(trajectory)
        columns = [linear] if turning is None else [linear, np.degrees(turning)]
        return trajectory.stamps[1:], np.column_stack(columns)
    assert trajectory.quaternions is not None
    angles = euler_angles(trajectory.quaternions)[:, ::-1]
    # Unwrapped: no jump from 180 to -180 degrees.
    return trajectory.stamps, np.degrees(np.unwrap(angles, axis=0))


def _whole_turns(stamps: Stamps, angles: Floats, at: Stamps, others: Floats) -> Floats:
    """Return the whole turns, degrees (M, 3), between unwrapped angles and others (K, 3).

    Unwrapped angles of two trajectories separate by whole turns, mostly near pitches of 90
    degrees. Before and after the others, they are those of the nearest common time.
    """
    near = np.column_stack([np.interp(stamps, at, column) for column in others.T])
    full_rotations = 360.0 * np.round((angles - near) / 360.0)
    common = np.searchsorted(stamps, stamps.clip(at[0], at[-1])).clip(max=len(stamps) - 1)
    return np.asarray(full_rotations[common], dtype=float)


def _lines(
    trajectories: Sequence[Trajectory], reference: Trajectory | None
) -> list[tuple[int, str, Trajectory]]:
    """Return position, name and states of every line, the reference first."""
    names = canvas.short_names([trajectory.name for trajectory in trajectories])
    lines = list(zip(range(len(trajectories)), names, trajectories, strict=True))
    return lines if reference is None else [(_REFERENCE, "reference", reference), *lines]


def _look(place: int) -> Mapping[str, object]:
    """Return the line style of the trajectory at a position in the list."""
    if place == _REFERENCE:
        return {"color": canvas.groundtruth_colour(), "linewidth": 1.6}
    colour, dashes = canvas.line_style(place)
    return {"color": colour, "linestyle": dashes, "linewidth": 1.0}
