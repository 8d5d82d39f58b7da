"""The scale along the run, over the distance travelled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.report import canvas
from trajeval_ros.report.definitions import alignment_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEIGHT_IN = 2.1


def scale_along_run(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw the ratios of path lengths of the estimates, with their drift."""
    figure = canvas.new_figure(
        _HEIGHT_IN,
        f"Scale along the run, estimate's path / groundtruth's path\n{alignment_of(evaluations)}",
    )
    axes = figure.subplots()
    for place, (evaluation, name) in enumerate(zip(evaluations, names, strict=True)):
        scale = evaluation.scale_along_run
        if scale is None:
            continue
        colour, dashes = canvas.line_style(place)
        axes.plot(
            scale.travelled_m,
            scale.ratios,
            color=colour,
            linestyle=dashes,
            marker="o",
            markersize=3,
            label=f"{name}, drift {scale.drift_text} % per 100 m",
        )
    if not axes.lines:
        canvas.annotate(axes, "No scale along the run: it needs gauge sim3 and a longer path.")
        return figure
    axes.axhline(1.0, color=canvas.groundtruth_colour(), linewidth=0.8, linestyle=(0, (5, 4)))
    axes.set_xlim(left=0.0)
    axes.set_xlabel("distance travelled [m]")
    axes.set_ylabel("scale")
    canvas.grow(figure, canvas.legend_above(axes))
    return figure
