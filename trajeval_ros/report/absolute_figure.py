"""The absolute error over the distance travelled: Fig. 7 of the tutorial."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.numbers import whole_percent
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.report import canvas
from trajeval_ros.report.definitions import absolute_form_of, alignment_of, why_no_rotation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_IN, _PANEL_IN = 6.2, 1.8
_DISTANCE = "distance travelled [m]"
_YAW_COLOUR, _TILT_COLOUR = "#E69F00", "#009E73"


def absolute_error(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw position and rotation error of each estimate, with its rmse."""
    withheld = all(each.absolute.rotation_deg is None for each in evaluations)
    figure = canvas.new_figure(_WIDTH_IN, _PANEL_IN)
    upper = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for place, (evaluation, name) in enumerate(zip(evaluations, names, strict=True)):
        coverage = whole_percent(evaluation.association.groundtruth_coverage)
        _draw(upper, evaluation, "position_m", place, f"{name}, {coverage} covered, ", "m")
    upper.set_ylabel("position error [m]")
    upper.set_ylim(bottom=0.0)
    canvas.head(upper, _WIDTH_IN, f"{absolute_form_of(evaluations)}\n{alignment_of(evaluations)}")
    longest = max(each.association.groundtruth.path_length_m for each in evaluations)
    upper.set_xlim(0.0, max(longest, 1e-9))
    if withheld:
        upper.set_xlabel(_DISTANCE)
        lower = figure.add_axes((0.0, -0.55, 1.0, 0.15))
        reasons = dict.fromkeys(why_no_rotation(each) for each in evaluations)
        canvas.say_instead(lower, f"Rotation error withheld: {'; '.join(reasons)}.")
        return figure
    lower = figure.add_axes((0.0, -1.0, 1.0, 1.0), sharex=upper)
    upper.tick_params(labelbottom=False)
    lower.set_xlabel(_DISTANCE)
    rows = _draw_rotation(lower, evaluations, names)
    # The legend of the lower panel goes between the two.
    lower.set_position((0.0, -1.0 - (0.2 + canvas.LEGEND_ROW_IN * rows) / _PANEL_IN, 1.0, 1.0))
    return figure


def _draw_rotation(axes: Axes, evaluations: Sequence[Evaluation], names: Sequence[str]) -> int:
    """Draw the angle, of a single estimate also yaw and tilt; return the legend's rows."""
    for place, (evaluation, name) in enumerate(zip(evaluations, names, strict=True)):
        if evaluation.absolute.rotation_deg is None:
            colour, dashes = canvas.line_style(place)
            axes.plot([], [], color=colour, linestyle=dashes, label=f"{name}, withheld")
        elif len(evaluations) == 1:
            _draw(axes, evaluation, "yaw_deg", place, "yaw, ", "deg", _YAW_COLOUR)
            _draw(axes, evaluation, "tilt_deg", place, "tilt, ", "deg", _TILT_COLOUR)
            _draw(axes, evaluation, "rotation_deg", place, "rotation, ", "deg")
        else:
            _draw(axes, evaluation, "rotation_deg", place, f"{name}, ", "deg")
    axes.set_ylabel("rotation error [deg]")
    axes.set_ylim(bottom=0.0)
    return canvas.head(axes, _WIDTH_IN)


def _draw(
    axes: Axes,
    evaluation: Evaluation,
    metric: str,
    place: int,
    label: str,
    unit: str,
    part_colour: str | None = None,
) -> None:
    """Draw one metric, lightly where it is a part of another one, and its rmse across."""
    errors: Floats | None = getattr(evaluation.absolute, metric)
    statistics = evaluation.ate[metric]
    if errors is None or statistics is None:
        return
    colour, dashes = canvas.line_style(place)
    truth = evaluation.association.groundtruth
    columns = np.stack([truth.travelled, errors], axis=1)
    rows = canvas.thinned(columns, truth.stamps, evaluation.protocol.association.max_gap_s)
    axes.plot(
        *rows.T,
        color=part_colour or colour,
        linestyle=dashes,
        linewidth=0.7 if part_colour else 1.0,
        alpha=0.75 if part_colour else 1.0,
        label=f"{label}rmse {statistics.rmse:.3g} {unit}",
    )
    if part_colour is None:
        axes.axhline(statistics.rmse, color=colour, linewidth=0.8, linestyle=(0, (5, 4)))
