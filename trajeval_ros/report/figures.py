"""The figures of an evaluation (tutorial, section VI, Fig. 6 to 8)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.exceptions import require_one_of
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.io.writing import write_whole
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.report import canvas
from trajeval_ros.report.absolute_figure import absolute_error
from trajeval_ros.report.figure_output import save
from trajeval_ros.report.figure_style import FORMATS, apply_style
from trajeval_ros.report.relative_figure import relative_error
from trajeval_ros.report.scale_figure import scale_along_run
from trajeval_ros.report.trajectory_figure import side_view, top_view

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from trajeval_ros.pipeline.outcome import Outcome

_DRAWINGS = {
    "top": top_view,
    "side": side_view,
    "absolute": absolute_error,
    "relative": relative_error,
    "scale": scale_along_run,
}


def draw(
    evaluations: Evaluation | Sequence[Evaluation],
    kind: str = "top",
    path: str | Path | None = None,
) -> Figure:
    """Draw one figure of estimates that were evaluated against the same groundtruth.

    Args:
        evaluations: One, or several with the same groundtruth and protocol.
        kind: `top` or `side`: aligned estimates and groundtruth from above or from the side;
            `absolute`: errors over the distance travelled; `relative`: errors by length;
            `scale`: the scale along the run, for gauge sim3.
        path: File to write in addition, as PNG, PDF, SVG or PGF by its suffix; None for none.

    Returns:
        The figure, independent of pyplot. A notebook shows it as the result of a cell.

    Raises:
        SettingsError: The kind is unknown.
        InputError: matplotlib is not installed, or the file cannot be written.

    Example:
        >>> from trajeval_ros import draw, evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> figure = draw(evaluate(flight.groundtruth, flight.estimate), "absolute")
        >>> type(figure).__name__
        'Figure'
    """
    require_one_of(kind, _DRAWINGS, "figure")
    given = [evaluations] if isinstance(evaluations, Evaluation) else list(evaluations)
    with apply_style():
        figure = _DRAWINGS[kind](given, canvas.short_names([e.estimate.name for e in given]))
        if path is not None:
            write_figure(figure, Path(path))
    return figure


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure of the default style in the format of the file's suffix."""
    suffix = path.suffix.removeprefix(".")
    require_one_of(suffix, FORMATS, "figure format")
    write_whole(path, lambda temporary: save(figure, temporary, suffix), follow_link=True)


def outcome_drawings(outcome: Outcome) -> dict[str, canvas.Drawing]:
    """Return the functions that draw all figures of an outcome, by file name."""
    runs = outcome.runs
    drawings = evaluation_drawings([run.evaluation for run in runs])
    for place, run in enumerate(runs, start=1):
        suffix = f"_{place}" if len(runs) > 1 else ""
        if run.consistency is not None:
            from trajeval_ros.report.consistency_figure import consistency_drawings

            named = run.estimate.name, suffix
            drawings |= consistency_drawings(run.evaluation, run.consistency, *named)
        if run.available is not None and run.available.samples is not None:
            from trajeval_ros.report.available_figure import as_available_figure

            draw = partial(as_available_figure, run.evaluation, run.available)
            drawings[f"as_available{suffix}"] = draw
        if run.integrity is not None:
            from trajeval_ros.report.consistency_figure import stanford

            (short,) = canvas.short_names([run.estimate.name])
            drawings[f"stanford{suffix}"] = partial(stanford, run.integrity, short)
    likely = outcome.likelihoods
    if likely:
        from trajeval_ros.report.probabilistic_figures import probabilistic_drawings

        drawings |= probabilistic_drawings(list(likely.values()), list(likely))
    return drawings


def evaluation_drawings(evaluations: Sequence[Evaluation]) -> dict[str, canvas.Drawing]:
    """Return the functions that draw estimates of the same groundtruth, by file name.

    `trajectory_top` and, except for gauge planar, `trajectory_side`: aligned estimates,
    groundtruth and correspondences. `absolute_error`: over the distance travelled.
    `relative_error`: by length, if the protocol has lengths. `scale`: along the
    run, if the gauge has a scale. `evaluations`: one per estimate, with
    the same groundtruth and protocol.
    """
    legend = canvas.short_names([e.estimate.name for e in evaluations])
    protocol = evaluations[0].protocol
    drawings: dict[str, canvas.Drawing] = {
        "trajectory_top": partial(top_view, evaluations, legend)
    }
    if protocol.gauge is not Gauge.PLANAR:
        drawings["trajectory_side"] = partial(side_view, evaluations, legend)
    drawings["absolute_error"] = partial(absolute_error, evaluations, legend)
    if protocol.lengths:
        drawings["relative_error"] = partial(relative_error, evaluations, legend)
    if any(evaluation.scale_along_run is not None for evaluation in evaluations):
        drawings["scale"] = partial(scale_along_run, evaluations, legend)
    return drawings
