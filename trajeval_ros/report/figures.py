"""The figures of an evaluation, as in the tutorial's section VI (Fig. 6 to 8)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.report import canvas
from trajeval_ros.report.absolute_figure import absolute_error
from trajeval_ros.report.relative_figure import relative_error
from trajeval_ros.report.trajectory_figure import side_view, top_view


def write_figures(
    evaluations: Sequence[Evaluation], folder: Path, names: Sequence[str] | None = None
) -> list[Path]:
    """Write PNG figures of estimates that were evaluated against one groundtruth.

    `trajectory_top.png` and, but for planar evaluations, `trajectory_side.png`: aligned
    estimates, groundtruth and correspondences. `absolute_error.png`: over the distance
    travelled. `relative_error.png`: by length, unless the protocol has no lengths.

    Args:
        evaluations: One per estimate, with the same groundtruth and protocol.
        folder: Existing folder; figures of the same names are replaced.
        names: What legends call the estimates; by default their trajectories' names.

    Returns:
        The files that were written.

    Raises:
        InputError: matplotlib is not installed.
    """
    legend = canvas.short_names(names or [each.estimate.name for each in evaluations])
    protocol = evaluations[0].protocol
    figures = {"trajectory_top.png": top_view}
    if protocol.gauge is not Gauge.PLANAR:
        figures["trajectory_side.png"] = side_view
    figures["absolute_error.png"] = absolute_error
    if protocol.lengths:
        figures["relative_error.png"] = relative_error
    with canvas.house_style():
        return [
            canvas.save(draw(evaluations, legend), folder / name) for name, draw in figures.items()
        ]
