"""Relative errors by length of the sub-trajectories, as box plots: Fig. 8 of the tutorial."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.relative_errors import RelativeErrors
from trajeval_ros.metrics.relative_evaluation import SubTrajectoryErrors, position_percent
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.report import canvas
from trajeval_ros.report.definitions import first_state_alignment_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANEL_IN, _BELOW_IN = 1.9, 0.5
_NARROWEST_IN, _NARROWEST_BOX_IN, _BESIDE_IN = 2.1, 0.12, 0.6
_COUNT_POINTS = 8.5
_MOST_COUNT_ROWS = 4
_UNITS = {"%": "% of the path", "f": "frames"}
_METRICS = {
    "position_m": "position error [m]",
    "position_percent": "position error [% of length]",
    "rotation_deg": "rotation error [deg]",
}


def relative_error(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw the distributions of position and rotation errors for every length."""
    lengths = evaluations[0].protocol.lengths
    title = f"Relative error of sub-trajectories, {first_state_alignment_of(evaluations)}"
    everything = [segments for e in evaluations for segments in e.relative or ()]
    if not any(segments.count for segments in everything):
        figure = canvas.new_figure(0.9, title)
        canvas.annotate(figure.subplots(), _why_nothing(evaluations))
        return figure
    in_metres = all(length.in_metres for length in lengths)
    metrics = [
        metric
        for metric in _METRICS
        if (in_metres or metric != "position_percent")
        and any(_errors(segments, metric) is not None for segments in everything)
    ]
    counts = [_counts(evaluations, group) for group in range(len(lengths))]
    count_rows = max(map(len, counts))
    columns = canvas.columns_of_panels(len(metrics), _NARROWEST_IN)
    boxes = len(evaluations) * len(lengths)
    if (canvas.width_in() / columns - _BESIDE_IN) / boxes < _NARROWEST_BOX_IN:
        columns = 1
    rows = -(-len(metrics) // columns)
    figure = canvas.new_figure(
        rows * (_PANEL_IN + _BELOW_IN + _COUNT_POINTS * count_rows / 72.0) + 0.4,
        f"{title}\nboxes: median and quartiles; whiskers: 5 % to 95 %; "
        "below: number of sub-trajectories",
    )
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[len(metrics) :]:
        axes.set_visible(False)
    for metric, axes in zip(metrics, panels, strict=False):
        for place, evaluation in enumerate(evaluations):
            _draw_boxes(axes, evaluation.relative or (), metric, place, len(evaluations))
        _write_counts(axes, counts)
        axes.set_ylabel(_METRICS[metric])
        axes.set_ylim(bottom=0.0)
        _label_lengths(axes, lengths, count_rows)
    _add_legend(figure, names)
    return figure


def length_labels(lengths: Sequence[Length]) -> tuple[list[str], str]:
    """Return the labels of lengths, and that of their axis with the unit if they share one."""
    across, units = "length of sub-trajectory", {length.unit for length in lengths}
    if len(units) > 1:
        return [length.text for length in lengths], across
    (unit,) = units
    return [f"{length.value:g}" for length in lengths], f"{across} [{_UNITS.get(unit, unit)}]"


def _draw_boxes(
    axes: Axes, all_segments: Sequence[SubTrajectoryErrors], metric: str, place: int, of: int
) -> None:
    """Draw the boxes of one estimate, the `place`-th of `of` estimates."""
    colour, dashes = canvas.line_style(place)
    width = 0.8 / of
    shift = width * (place - (of - 1) / 2.0)
    boxes = []
    for group, segments in enumerate(all_segments):
        errors = _errors(segments, metric)
        if errors is not None and len(errors):
            numbers = np.percentile(errors, [5, 25, 50, 75, 95]).tolist()
            boxes.append((group + shift, numbers))
    canvas.draw_boxes(axes, boxes, 0.85 * width, colour=colour, dashes=dashes)


def _counts(evaluations: Sequence[Evaluation], group: int) -> list[tuple[str, str]]:
    """Return the numbers of sub-trajectories of a length, with colours; of many their range."""
    counts = [e.relative[group].count if e.relative else 0 for e in evaluations]
    least, most = min(counts), max(counts)
    if least == most or len(counts) > _MOST_COUNT_ROWS:
        return [(str(least) if least == most else f"{least}–{most}", canvas.soft_ink())]
    return [(str(count), canvas.line_style(place)[0]) for place, count in enumerate(counts)]


def _write_counts(axes: Axes, counts: Sequence[Sequence[tuple[str, str]]]) -> None:
    """Write the numbers of sub-trajectories below every length."""
    for group, texts in enumerate(counts):
        for row, (text, colour) in enumerate(texts):
            axes.annotate(
                text,
                (group, 0.0),
                xycoords=("data", "axes fraction"),
                xytext=(0.0, -15.0 - _COUNT_POINTS * row),
                textcoords="offset points",
                ha="center",
                va="top",
                fontsize=7,
                color=colour,
            )


def _errors(segments: SubTrajectoryErrors, metric: str) -> Floats | None:
    """Return the errors (K,) of a metric; None if not available."""
    if metric == "position_percent":
        assert segments.length_m is not None
        return position_percent(segments.errors.position_m, segments.length_m)
    errors: Floats | None = getattr(segments.errors, metric)
    return errors


def _label_lengths(axes: Axes, lengths: Sequence[Length], count_rows: int) -> None:
    """Label the x axis with the lengths, below the counts."""
    labels, across = length_labels(lengths)
    axes.set_xticks(range(len(lengths)), labels)
    axes.set_xlim(-0.6, len(lengths) - 0.4)
    axes.grid(visible=False, axis="x")
    axes.tick_params(axis="x", length=0)
    axes.set_xlabel(across, labelpad=5.0 + _COUNT_POINTS * count_rows)


def _add_legend(figure: Figure, names: Sequence[str]) -> None:
    """Add a legend with the box style of every estimate."""
    from matplotlib.patches import Patch

    patches = []
    for place in range(len(names)):
        colour, dashes = canvas.line_style(place)
        patches.append(Patch(facecolor=canvas.tint(colour), edgecolor=colour, linestyle=dashes))
    canvas.legend_below(figure, patches, names)


def _why_nothing(evaluations: Sequence[Evaluation]) -> str:
    """Return why there are no relative errors."""
    if all(e.relative is None for e in evaluations):
        reasons = dict.fromkeys(e.doubts.about(RelativeErrors, "position_m") for e in evaluations)
        return f"Withheld: {'; '.join(reasons)}."
    longest = max(e.association.groundtruth.path_length_m for e in evaluations)
    lengths = ", ".join(length.text for length in evaluations[0].protocol.lengths)
    return f"No sub-trajectories of {lengths}: the paired path is {longest:.1f} m long."
