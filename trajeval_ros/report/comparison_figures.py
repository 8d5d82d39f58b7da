"""The figures of a comparison: box plots, paths and errors over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.report import canvas
from trajeval_ros.report.absolute_figure import POSITION, ROTATION, ErrorRow, error_rows
from trajeval_ros.report.plane_panels import PlanePanels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BOXES_IN, _ERRORS_IN, _BELOW_IN = 2.0, 1.4, 0.5  # heights of panels, and of labels below them
_MOST_LINES = 3  # in one panel
_MOST_BOXES = 60  # in a row
_LONGEST_NAME = 22  # characters, below boxes
_LETTER_IN, _SLANT_DEG = 0.06, 30.0  # width of a character, and angle of names without space
_MOST_POINTS = 20  # dots at a box; more hide it
_LOG_RATIO = 10.0  # of the largest value to the median of all, above which the axis is logarithmic


@dataclass(frozen=True)
class Box:
    """A distribution: whiskers, quartiles and median, and the values if they are few.

    A single value is drawn as a dot without a box.
    """

    low: float
    first: float
    median: float
    third: float
    high: float
    points: tuple[float, ...] = ()

    @classmethod
    def of(cls, values: Sequence[float]) -> Box:
        """Return the box of values, with whiskers at the extremes."""
        low, first, median, third, high = np.percentile(values, [0, 25, 50, 75, 100]).tolist()
        points = tuple(values) if len(values) <= _MOST_POINTS else ()
        return cls(low, first, median, third, high, points)


@dataclass(frozen=True)
class BoxPlot:
    """Boxes by algorithm and group."""

    groups: Sequence[str]  # labels below the boxes: sequences or lengths
    # Name and boxes (one per group, or None) of every algorithm.
    series: Sequence[tuple[str, Sequence[Box | None]]]
    axis: str  # label of the groups; "" if it is evident
    label: str  # the quantity with its unit

    @property
    def is_logarithmic(self) -> bool:
        """Whether one value would hide the differences of all others."""
        boxes = [box for _, in_groups in self.series for box in in_groups if box is not None]
        largest = max(box.high for box in boxes)
        usual = float(np.median([box.median for box in boxes]))
        return min(box.low for box in boxes) > 0.0 and largest > _LOG_RATIO * usual


@dataclass(frozen=True, eq=False)
class PathsPlot:
    """Aligned paths and groundtruth, seen from above."""

    up: UpAxis  # up axis of the groundtruth's frame
    groundtruth: Floats  # (M, 3), metres, height last
    # Name and positions (M, 3) by position of the algorithm, which determines the colour.
    paths: Mapping[int, tuple[str, Floats]]


@dataclass(frozen=True, eq=False)
class ErrorsPlot:
    """Errors of algorithms over time."""

    # Name and errors (M, 3) by position of the algorithm: time (s), position (m), rotation (deg,
    # NaN if withheld).
    series: Mapping[int, tuple[str, Floats]]


def figure_of(plot: BoxPlot | PathsPlot | ErrorsPlot) -> Figure:
    """Draw a plot in the current style."""
    if isinstance(plot, BoxPlot):
        return _boxes(plot)
    return _paths(plot) if isinstance(plot, PathsPlot) else _errors(plot)


def _boxes(plot: BoxPlot) -> Figure:
    """Draw one box per algorithm and group, in several rows if necessary."""
    needed = -(-len(plot.groups) * len(plot.series) // _MOST_BOXES)
    in_row = -(-len(plot.groups) // needed)
    names = [_shortened(group) for group in plot.groups]
    rows = -(-len(names) // in_row)
    figure = canvas.new_figure(rows * (_BOXES_IN + _BELOW_IN))
    letters = (canvas.width_in() - 2.0 * _BELOW_IN) / in_row / _LETTER_IN
    slanted = max(map(len, names)) + 1 > letters
    grid = figure.subplots(rows, 1, sharey=True, squeeze=False)[:, 0]
    for row, axes in enumerate(grid):
        groups = range(row * in_row, min((row + 1) * in_row, len(names)))
        for place, (_, boxes) in enumerate(plot.series):
            _draw_boxes(axes, plot, [(group, boxes[group]) for group in groups], place)
        # Boxes of all rows have equal widths.
        axes.set_xlim(groups.start - 0.6, groups.start + in_row - 0.4)
        look = {"rotation": _SLANT_DEG, "ha": "right", "rotation_mode": "anchor"}
        axes.set_xticks(groups, [names[group] for group in groups], **(look if slanted else {}))
        axes.tick_params(axis="x", length=0)
        axes.grid(visible=False, axis="x")
        axes.set_ylabel(plot.label)
    if plot.is_logarithmic:
        grid[0].set_yscale("log")
    else:
        grid[0].set_ylim(bottom=0.0)
    if slanted:
        slant = np.sin(np.radians(_SLANT_DEG)) * max(map(len, names)) * _LETTER_IN
        figure.set_figheight(figure.get_figheight() + rows * slant)
    if plot.axis:
        grid[-1].set_xlabel(plot.axis)
    handles = [_patch(place) for place in range(len(plot.series))]
    canvas.legend_below(figure, handles, canvas.short_names([name for name, _ in plot.series]))
    return figure


def _draw_boxes(
    axes: Axes, plot: BoxPlot, boxes: Sequence[tuple[int, Box | None]], place: int
) -> None:
    """Draw the boxes of one algorithm with the dots of its trials; a single trial has no box."""
    colour, dashes = canvas.line_style(place)
    width = 0.8 / len(plot.series)
    shift = width * (place - (len(plot.series) - 1) / 2.0)
    numbers = [
        (group + shift, (box.low, box.first, box.median, box.third, box.high))
        for group, box in boxes
        if box is not None and len(box.points) != 1
    ]
    if numbers:
        canvas.draw_boxes(axes, numbers, 0.85 * width, colour=colour, dashes=dashes)
    for group, box in boxes:
        if box is not None and box.points:
            # Next to one another, so that equal trials are visible.
            spread = np.linspace(-0.2, 0.2, len(box.points)) if len(box.points) > 1 else 0.0
            x = group + shift + width * np.broadcast_to(spread, len(box.points))
            size = 2.5 if len(box.points) > 1 else 4.0
            axes.plot(x, box.points, "o", color=colour, markersize=size, linestyle="none")


def _patch(place: int) -> object:
    from matplotlib.patches import Patch

    colour, dashes = canvas.line_style(place)
    return Patch(facecolor=canvas.tint(colour), edgecolor=colour, linestyle=dashes)


def _paths(plot: PathsPlot) -> Figure:
    """Draw aligned paths and groundtruth: in one panel, or in one panel per path if many."""
    paths = {place: path[:, :2] for place, (_, path) in plot.paths.items()}
    groundtruth = plot.groundtruth[:, :2]
    is_split = len(paths) > _MOST_LINES
    panels = PlanePanels([groundtruth, *paths.values()], _names(plot.paths), "", is_split=is_split)
    for place, path in paths.items():
        panels.draw_path(place, path)
    known = groundtruth[np.isfinite(groundtruth).all(axis=1)]
    across, onward = ("xyz"[axis] for axis in plot.up.level)
    return panels.finish(groundtruth, known, (across, onward))


def _errors(plot: ErrorsPlot) -> Figure:
    """Draw errors over time: in common panels, or in one row per algorithm if many."""
    names = _names(plot.series)
    errors = {place: columns for place, (_, columns) in plot.series.items()}
    labels = [POSITION, ROTATION]
    if not any(np.isfinite(columns[:, 2]).any() for columns in errors.values()):
        labels.pop()
    kept = range(1, len(labels) + 1)
    if len(errors) > _MOST_LINES:
        rows = [
            ErrorRow(
                place,
                (names[place], *[""] * (len(labels) - 1)),
                tuple(columns[:, [0, column]] for column in kept),
            )
            for place, columns in errors.items()
        ]
        return error_rows(rows, "", "time [s]", labels)
    figure = canvas.new_figure(len(labels) * _ERRORS_IN + _BELOW_IN)
    panels = figure.subplots(len(labels), 1, sharex=True, squeeze=False)[:, 0]
    for column, axes, label in zip(kept, panels, labels, strict=True):
        for place, columns in errors.items():
            colour, dashes = canvas.line_style(place)
            axes.plot(
                columns[:, 0], columns[:, column], color=colour, linestyle=dashes, linewidth=1.0,
                label=names[place],
            )  # fmt: skip
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0.0)
    end = max(float(np.nanmax(columns[:, 0])) for columns in errors.values())
    panels[0].set_xlim(0.0, end or 1.0)
    panels[-1].set_xlabel("time [s]")
    handles, shown = panels[0].get_legend_handles_labels()
    canvas.legend_below(figure, handles, shown)
    return figure


def _names(named: Mapping[int, tuple[str, Floats]]) -> dict[int, str]:
    """Return the names in a legend, by position."""
    short = canvas.short_names([name for name, _ in named.values()])
    return dict(zip(named, short, strict=True))


def _shortened(name: str) -> str:
    """Return a name that fits below a box; long names are cut at the start."""
    [name] = canvas.short_names([name])
    return name if len(name) <= _LONGEST_NAME else f"…{name[1 - _LONGEST_NAME :]}"
