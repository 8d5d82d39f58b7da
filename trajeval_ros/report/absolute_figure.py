"""The absolute error over the distance travelled: Fig. 7 of the tutorial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.numbers import significant, whole_percent
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.report import canvas
from trajeval_ros.report.definitions import absolute_form_of, alignment_of, why_no_rotation
from trajeval_ros.report.line_thinning import thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANEL_IN = 1.6
_BELOW_IN = 0.5
_DISTANCE = "distance travelled [m]"
_YAW_PLACE, _TILT_PLACE = 4, 2  # positions of their colours in the colour cycle
_ROW_IN, _REST_IN = 0.95, 0.5
POSITION, ROTATION = "position [m]", "rotation [deg]"


def absolute_error(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw position and rotation errors of the estimates, with their RMSE.

    For fixes and points, which have no orientation, horizontal and vertical errors are drawn, too.
    """
    withheld = all(e.absolute.rotation_deg is None for e in evaluations)
    parts = _parts_apart(evaluations) if withheld else []
    if canvas.is_crowded(len(evaluations)):
        return _row_each(evaluations, names, parts)
    title = _title(evaluations)
    if withheld:
        reasons = dict.fromkeys(why_no_rotation(item) for item in evaluations)
        title += f"\nRotation error withheld: {'; '.join(reasons)}."
    panels = 1 + len(parts) + (not withheld)
    figure = canvas.new_figure(panels * _PANEL_IN + _BELOW_IN, title)
    drawn = figure.subplots(panels, 1, squeeze=False).ravel()
    upper, rows = drawn[0], 0
    for axes, part in zip(drawn, ("position", *parts), strict=False):
        for place, (evaluation, name) in enumerate(zip(evaluations, names, strict=True)):
            coverage = whole_percent(evaluation.association.groundtruth_coverage)
            label = f"{name}, {coverage} covered, " if axes is upper else f"{name}, "
            _draw(axes, evaluation, f"{part}_m", place, label, "m")
        axes.set_ylabel(f"{part} error [m]")
        axes.set_ylim(bottom=0.0)
        rows += canvas.legend_above(axes)
    if not withheld:
        rows += _draw_rotation(drawn[-1], evaluations, names)
    for axes in drawn[1:]:
        axes.sharex(upper)
    for axes in drawn[:-1]:
        axes.tick_params(labelbottom=False)
    upper.set_xlim(0.0, _longest(evaluations))
    drawn[-1].set_xlabel(_DISTANCE)
    canvas.grow(figure, rows)
    return figure


def _parts_apart(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return the components of position errors to draw; those of fixes differ in accuracy."""
    if all(e.groundtruth.kind == "poses" for e in evaluations):
        return []
    parts = ("horizontal", "vertical")
    return [part for part in parts if any(e.ate[f"{part}_m"] for e in evaluations)]


def _row_each(
    evaluations: Sequence[Evaluation], names: Sequence[str], parts: Sequence[str]
) -> Figure:
    """Draw one row per estimate: position and rotation, or the components of the position."""
    metrics = [f"{part}_m" for part in parts] or ["position_m", "rotation_deg"]
    rows = []
    for place, (evaluation, name) in enumerate(zip(evaluations, names, strict=True)):
        coverage = whole_percent(evaluation.association.groundtruth_coverage)
        first, *others = (_rmse(evaluation, metric) for metric in metrics)
        rows.append(
            ErrorRow(
                place,
                (f"{name}\n{first}, {coverage} covered", *others),
                tuple(_line(evaluation, metric) for metric in metrics),
            )
        )
    labels = [f"{part} [m]" for part in parts] or [POSITION, ROTATION]
    return error_rows(rows, _title(evaluations), _DISTANCE, labels)


def _rmse(evaluation: Evaluation, metric: str) -> str:
    """Return the RMSE of a metric as a text with its unit."""
    statistics, unit = evaluation.ate[metric], metric.rpartition("_")[2]
    return "withheld" if statistics is None else f"RMSE {significant(statistics.rmse, 3)} {unit}"


def _title(evaluations: Sequence[Evaluation]) -> str:
    return f"{absolute_form_of(evaluations)}\n{alignment_of(evaluations)}"


def _longest(evaluations: Sequence[Evaluation]) -> float:
    return max(
        1e-9, *(evaluation.association.groundtruth.path_length_m for evaluation in evaluations)
    )


def _draw_rotation(axes: Axes, evaluations: Sequence[Evaluation], names: Sequence[str]) -> int:
    """Draw angles, for one estimate also yaw and tilt; return the number of legend rows."""
    for place, (evaluation, name) in enumerate(zip(evaluations, names, strict=True)):
        if evaluation.absolute.rotation_deg is None:
            colour, dashes = canvas.line_style(place)
            axes.plot([], [], color=colour, linestyle=dashes, label=f"{name}, withheld")
        elif len(evaluations) == 1:
            _draw(axes, evaluation, "yaw_deg", _YAW_PLACE, "yaw, ", "deg", is_part=True)
            _draw(axes, evaluation, "tilt_deg", _TILT_PLACE, "tilt, ", "deg", is_part=True)
            _draw(axes, evaluation, "rotation_deg", place, "rotation, ", "deg")
        else:
            _draw(axes, evaluation, "rotation_deg", place, f"{name}, ", "deg")
    axes.set_ylabel("rotation error [deg]")
    axes.set_ylim(bottom=0.0)
    return canvas.legend_above(axes)


def _draw(
    axes: Axes,
    evaluation: Evaluation,
    metric: str,
    place: int,
    label: str,
    unit: str,
    *,
    is_part: bool = False,
) -> None:
    """Draw one metric (thin if it is a component of another one), and its RMSE as a line."""
    statistics, line = evaluation.ate[metric], _line(evaluation, metric)
    if statistics is None or line is None:
        return
    colour, dashes = canvas.line_style(place)
    axes.plot(
        *line.T,
        color=colour,
        linestyle=dashes,
        linewidth=0.7 if is_part else 1.0,
        alpha=0.75 if is_part else 1.0,
        label=f"{label}RMSE {significant(statistics.rmse, 3)} {unit}",
    )
    if not is_part:
        axes.axhline(statistics.rmse, color=colour, linewidth=0.8, linestyle=(0, (5, 4)))


def _line(evaluation: Evaluation, metric: str) -> Floats | None:
    """Return the metric over the distance, (M, 2), thinned; None if withheld."""
    errors: Floats | None = getattr(evaluation.absolute, metric)
    if errors is None:
        return None
    groundtruth = evaluation.association.groundtruth
    columns = np.stack([groundtruth.travelled, errors], axis=1)
    return thinned(columns, groundtruth.stamps, evaluation.protocol.association.is_gap)


@dataclass(frozen=True, eq=False)
class ErrorRow:
    """The errors of one estimate."""

    place: int  # position of the estimate, which determines its colour
    titles: tuple[str, ...]  # title lines above every one of its K errors
    # The K errors over time or distance, (M, 2); None if not available.
    errors: tuple[Floats | None, ...]


def error_rows(
    rows: Sequence[ErrorRow], title: str, across: str, labels: Sequence[str] = (POSITION, ROTATION)
) -> Figure:
    """Draw the errors of several estimates."""
    figure = canvas.new_figure(_ROW_IN * len(rows) + _REST_IN, title)
    grid = figure.subplots(len(rows), len(labels), sharex=True, sharey="col", squeeze=False)
    lines = 1
    for panels, row in zip(grid, rows, strict=True):
        colour, _ = canvas.line_style(row.place)
        for column, (axes, label) in enumerate(zip(panels, labels, strict=True)):
            for other in rows:
                errors = other.errors[column]
                if errors is not None:
                    axes.plot(*errors.T, color=canvas.soft_ink(), alpha=0.3, linewidth=0.4)
            its = row.errors[column]
            if its is not None:
                axes.plot(*its.T, color=colour, linewidth=1.0)
            room_in = canvas.width_in() / (1.1 * len(labels))
            heading = "\n".join(
                canvas.wrapped(line, room_in) for line in row.titles[column].split("\n")
            )
            lines = max(lines, heading.count("\n") + 1)
            axes.set_title(heading, color=colour, loc="left")
            axes.set_ylabel(label)
            axes.set_ylim(bottom=0.0)
    known = [errors for row in rows for errors in row.errors if errors is not None]
    grid[0, 0].set_xlim(0.0, max(1e-9, *(float(np.nanmax(errors[:, 0])) for errors in known)))
    for axes in grid[-1]:
        axes.set_xlabel(across)
    canvas.grow(figure, lines * len(rows))
    return figure
