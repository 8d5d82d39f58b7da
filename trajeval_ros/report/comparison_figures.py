"""Figures of a comparison as files: box plots, paths, and errors over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.report import canvas
from trajeval_ros.report.comparison_plots import Box, BoxPlot, ErrorsPlot, PathsPlot
from trajeval_ros.report.error_rows import ErrorRow, error_rows
from trajeval_ros.report.plane_panels import PlanePanels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BOXES_IN, _PANEL_IN, _REST_IN = 2.2, 1.4, 0.75
_TIME = "time [s]"
_DOT, _LONE_DOT = 3.0, 4.5  # marker sizes, points: of trials, and if there is one trial each


def figure_of(plot: BoxPlot | PathsPlot | ErrorsPlot) -> Figure:
    """Draw the figure of a plot."""
    if isinstance(plot, BoxPlot):
        return box_plot(plot)
    return overlay(plot) if isinstance(plot, PathsPlot) else errors_over_time(plot)


def box_plot(plot: BoxPlot) -> Figure:
    """Draw one box per algorithm and group."""
    from matplotlib.patches import Patch

    figure = canvas.new_figure(_BOXES_IN)
    axes = figure.subplots()
    width = 0.8 / len(plot.series)
    legend = canvas.short_names([algorithm for algorithm, _ in plot.series])
    handles = []
    known = [box for _, boxes in plot.series for box in boxes if box is not None]
    marker = _LONE_DOT if max(len(box.points) for box in known) == 1 else _DOT
    for place, (_, boxes) in enumerate(plot.series):
        colour, dashes = canvas.line_style(place)
        shift = width * (place - (len(plot.series) - 1) / 2.0)
        _draw_boxes(axes, boxes, shift, 0.85 * width, place, marker)
        handles.append(Patch(facecolor=canvas.tint(colour), edgecolor=colour, linestyle=dashes))
    named = [one_line(group) for group in plot.groups]
    slanted = canvas.is_too_wide(named)
    axes.set_xticks(
        range(len(plot.groups)),
        named,
        rotation=30 if slanted else 0,
        ha="right" if slanted else "center",
        rotation_mode="anchor" if slanted else "default",
    )
    axes.set_xlim(-0.6, len(plot.groups) - 0.4)
    axes.set_ylim(bottom=0.0)
    axes.grid(visible=False, axis="x")
    axes.tick_params(axis="x", length=0)
    if len(plot.series) > 1:
        for between in range(1, len(plot.groups)):
            axes.axvline(between - 0.5, color=canvas.grid_colour(), linewidth=0.6, zorder=0.5)
    axes.set_xlabel(plot.axis)
    axes.set_ylabel(plot.label)
    canvas.legend_below(figure, handles, legend)
    return figure


def _draw_boxes(
    axes: Axes,
    boxes: Sequence[Box | None],
    shift: float,
    width: float,
    place: int,
    marker: float,
) -> None:
    """Draw the boxes of one algorithm, with a dot per trial."""
    colour, dashes = canvas.line_style(place)
    known = [(group, box) for group, box in enumerate(boxes) if box is not None]
    canvas.draw_boxes(
        axes,
        [
            (group + shift, (box.low, box.first, box.median, box.third, box.high))
            for group, box in known
            if len(box.points) != 1
        ],
        width,
        colour=colour,
        dashes=dashes,
    )
    # Next to one another, so that equal trials are visible.
    places = [group + shift + width * _beside(len(box.points)) for group, box in known]
    points = [box.points for _, box in known]
    if any(points):
        axes.plot(
            np.concatenate(places),
            np.concatenate(points),
            linestyle="none",
            marker="o",
            markersize=marker,
            color=colour,
            zorder=3,
        )


def _beside(count: int) -> Floats:
    """Return x coordinates (count,) within a box of width 1; the centre for one."""
    return np.linspace(-0.25, 0.25, count) if count != 1 else np.zeros(1)


def overlay(plot: PathsPlot) -> Figure:
    """Draw aligned paths over the groundtruth, from above."""
    truth, paths = plot.truth, plot.paths
    legend = canvas.short_names([name for name, _ in paths.values()])
    panels = PlanePanels(
        [truth[:, :2], *(path[:, :2] for _, path in paths.values())],
        dict(zip(paths, legend, strict=True)),
        "",
    )
    for place, (_, path) in paths.items():
        panels.draw_path(place, path[:, :2])
    across, onward = ("xyz"[axis] for axis in plot.up.level)
    return panels.finish(truth[:, :2], truth[:, :2], (across, onward))


def errors_over_time(plot: ErrorsPlot) -> Figure:
    """Draw the errors of the algorithms over time."""
    series = plot.series
    legend = canvas.short_names([name for name, _ in series.values()])
    lines = {place: (_line(each, 1), _line(each, 2)) for place, (_, each) in series.items()}
    if canvas.is_crowded(len(series)):
        rows = [
            ErrorRow(place, (name, "withheld" if lines[place][1] is None else ""), lines[place])
            for place, name in zip(series, legend, strict=True)
        ]
        return error_rows(rows, "", _TIME)
    figure = canvas.new_figure(2 * _PANEL_IN + _REST_IN)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for (place, both), name in zip(lines.items(), legend, strict=True):
        colour, dashes = canvas.line_style(place)
        for axes, line in zip((upper, lower), both, strict=True):
            if line is not None:
                axes.plot(*line.T, color=colour, linestyle=dashes, linewidth=1.0, label=name)
    for axes, label in ((upper, "position error [m]"), (lower, "rotation error [deg]")):
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0.0)
    upper.set_xlim(left=0.0)
    lower.set_xlabel(_TIME)
    canvas.legend_below(figure, *upper.get_legend_handles_labels())
    return figure


def _line(errors: Floats, column: int) -> Floats | None:
    """Return time and one error (M, 2); None if all are NaN."""
    known = np.isfinite(errors[:, column]).any()
    return errors[:, [0, column]] if known else None
