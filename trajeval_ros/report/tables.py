"""The tables of an evaluation, as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from trajeval_ros.formatting.numbers import NOTHING, four_digits, with_unit
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.relative_evaluation import SubTrajectoryErrors
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.report.console import add_rows, new_table
from trajeval_ros.report.definitions import RE_FORM_TEXTS
from trajeval_ros.report.metric_labels import ABSOLUTE_LABELS, RELATIVE_LABELS

if TYPE_CHECKING:
    from rich.table import Table

    from trajeval_ros.pipeline.outcome import RunOutcome

_STATISTICS = ("rmse", "mean", "median", "std", "min", "max", "p95")
# In narrower terminals some columns are omitted; the files on disk have all.
_WIDTH_FOR_MEDIANS = 140
_WIDTH_FOR_ALL = 110
_PARTS = ("horizontal_m", "vertical_m")
_WITHOUT_IF_NARROW = {"std", "min", "p95", "rotation_deg_per_m", "tilt_deg"}


def absolute_table(evaluations: Sequence[Evaluation], width: int) -> Table:
    """Return the table of absolute errors, a row per estimate and metric."""
    shown = [statistic for statistic in _STATISTICS if _fits(statistic, width)]
    form = evaluations[0].protocol.ate_form
    title = f"Absolute trajectory error, {form} form"
    table = new_table(title, ["estimate", "error"], [*shown, "pairs"])
    for evaluation in evaluations:
        name = evaluation.estimate.name
        for metric, label in ABSOLUTE_LABELS.items():
            statistics = evaluation.ate.get(metric)
            if statistics is not None and (metric not in _PARTS or _are_apart(evaluation)):
                numbers = [four_digits(getattr(statistics, column)) for column in shown]
                add_rows(table, [[name, label, *numbers, str(statistics.count)]])
                name = ""
    return table


def _are_apart(evaluation: Evaluation) -> bool:
    """Return whether horizontal and vertical errors have rows: for fixes and points."""
    return evaluation.groundtruth.kind != "poses"


def states_table(runs: Sequence[RunOutcome]) -> Table | None:
    """Return the RMSE by the number of aligned states; None if it is not configured."""
    if not any(run.by_states for run in runs):
        return None
    table = new_table(
        "ATE (RMSE) by the number of aligned states",
        ["estimate", "states"],
        [ABSOLUTE_LABELS["position_m"], ABSOLUTE_LABELS["rotation_deg"], "states used"],
    )
    for run in runs:
        name = run.estimate.name
        for row in run.by_states:
            errors = [_rmse(statistics) for statistics in (row.position_m, row.rotation_deg)]
            used = NOTHING if row.states_used is None else str(row.states_used)
            add_rows(table, [[name, row.states, *errors, used]])
            name = ""
    return table


def states_remarks(runs: Sequence[RunOutcome]) -> list[str]:
    """Return the reasons for missing numbers in `states_table`, one per line."""
    return [
        f"{run.estimate.name}: aligned by {row.states}: {row.reason}"
        for run in runs
        for row in run.by_states
        if row.reason
    ]


def _rmse(statistics: Statistics | None) -> str:
    """Return the RMSE as text."""
    return NOTHING if statistics is None else four_digits(statistics.rmse)


def relative_table(evaluations: Sequence[Evaluation], width: int) -> Table | None:
    """Return the table of relative errors, a row per estimate and length; None if there are none.

    Numbers are means and, in wide terminals, medians: few bad sub-trajectories dominate means.
    """
    metrics = [
        metric
        for metric in RELATIVE_LABELS
        if _fits(metric, width)
        and any(part.statistics.get(metric) for e in evaluations for part in e.segments or ())
    ]
    if not metrics:
        return None
    with_medians = width >= _WIDTH_FOR_MEDIANS
    what = "mean (median)" if with_medians else "mean"
    title = f"Relative error, {what}: {RE_FORM_TEXTS[evaluations[0].protocol.re_form]}"
    headings = [RELATIVE_LABELS[metric] for metric in metrics]
    table = new_table(title, ["estimate", "length"], [*headings, "count"])
    for evaluation in evaluations:
        name = evaluation.estimate.name
        for segment in evaluation.segments or ():
            cells = [_mean(segment.statistics.get(metric), with_medians) for metric in metrics]
            count = str(segment.count)
            add_rows(table, [[name, _length_text(segment), *cells, count]])
            name = ""
        pooled = evaluation.pooled["position_percent"]
        if pooled is not None and len(evaluation.segments or ()) > 1:
            cells = [_mean(evaluation.pooled.get(metric), with_medians) for metric in metrics]
            add_rows(table, [[name, "all", *cells, str(pooled.count)]])
    return table


def _length_text(segment: SubTrajectoryErrors) -> str:
    """Return the measured length with its unit: 8 m, 1 s, 8.06 m for a percentage of the path."""
    if segment.length_m is None:
        return segment.length.text
    return with_unit(segment.length_m, "m")


def _fits(column: str, width: int) -> bool:
    """Return whether a terminal of this width shows a column."""
    return width >= _WIDTH_FOR_ALL or column not in _WITHOUT_IF_NARROW


def _mean(statistics: Statistics | None, with_median: bool) -> str:
    """Return the mean, with the median in parentheses if wanted, as text."""
    if statistics is None:
        return NOTHING
    mean = four_digits(statistics.mean)
    return f"{mean} ({four_digits(statistics.median)})" if with_median else mean
