"""The tables of an evaluation, as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from trajeval_ros.formatting.numbers import NOTHING, four_digits, whole_percent, with_unit
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.relative_evaluation import SubTrajectoryErrors
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.report.console import Table
from trajeval_ros.report.definitions import ABSOLUTE_LABELS, RELATIVE_LABELS

if TYPE_CHECKING:
    from trajeval_ros.likelihood.likelihood_assessment import LikelihoodAssessment
    from trajeval_ros.pipeline.outcome import RunOutcome

_STATISTICS = ("rmse", "mean", "median", "std", "min", "max", "p95")
# In narrower terminals some columns are omitted; the files on disk have all.
_WIDTH_FOR_MEDIANS = 140
_WIDTH_FOR_ALL = 110
_PARTS = ("horizontal_m", "vertical_m")
_WITHOUT_IF_NARROW = {"std", "min", "p95", "rotation_deg_per_m", "tilt_deg"}


_NUMBERS = (
    "ATE supported [m]",
    "of poses",
    "approx. 95 % [m]",
    "ATE weighted [m]",
    "NLL/pose [nats]",
    "chi2/dof",
    "scale z",
    "tilt z",
)


def absolute_table(evaluations: Sequence[Evaluation], width: int) -> Table:
    """Return the table of absolute errors, a row per estimate and metric."""
    shown = [statistic for statistic in _STATISTICS if _fits(statistic, width)]
    is_tutorial = evaluations[0].protocol.ate_form == "tutorial"
    title = "Absolute trajectory error" + is_tutorial * ", eq. (23) of the tutorial"
    table = Table(title, ["estimate", "error"], [*shown, "pairs"])
    for evaluation in evaluations:
        name = evaluation.estimate.name
        for metric, label in ABSOLUTE_LABELS.items():
            statistics = evaluation.ate.get(metric)
            if metric in _PARTS and not _are_apart(evaluation):
                continue
            if statistics is not None:
                numbers = [four_digits(getattr(statistics, column)) for column in shown]
                table.add([name, label, *numbers, str(statistics.count)])
                name = ""
            elif _is_withheld(evaluation, metric):
                table.add([name, label, *[NOTHING] * (len(shown) + 1)])
                name = ""
    return table


def _is_withheld(evaluation: Evaluation, metric: str) -> bool:
    """Return whether an absolute error exists, but is withheld."""
    if not evaluation.association.have_rotations:
        return False
    if metric == "velocity_mps" and evaluation.association.estimate.velocities is None:
        return False
    return metric in evaluation.doubts.of_existing.withheld(AbsoluteErrors)


def _are_apart(evaluation: Evaluation) -> bool:
    """Return whether horizontal and vertical errors have rows: for fixes and points."""
    return evaluation.groundtruth.kind != "poses"


def states_table(runs: Sequence[RunOutcome]) -> Table | None:
    """Return the RMSE by the number of aligned states; None if it is not configured."""
    if not any(run.by_states for run in runs):
        return None
    table = Table(
        "ATE (RMSE) by the number of aligned states",
        ["estimate", "states"],
        [ABSOLUTE_LABELS["position_m"], ABSOLUTE_LABELS["rotation_deg"], "states used"],
    )
    for run in runs:
        name = run.estimate.name
        for row in run.by_states:
            errors = [_rmse(statistics) for statistics in (row.position_m, row.rotation_deg)]
            used = NOTHING if row.states_used is None else str(row.states_used)
            table.add([name, row.states, *errors, used])
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


def relative_table(
    evaluations: Sequence[Evaluation], width: int, statistic: str = ""
) -> Table | None:
    """Return the table of relative errors, a row per estimate and length; None if there are none.

    `statistic`: of `RELATIVE_STATISTICS`. By default, numbers are RMSE for the errors of evo, else
    means and, in wide terminals, medians: few bad sub-trajectories dominate means.
    """
    metrics = [
        metric
        for metric in RELATIVE_LABELS
        if _fits(metric, width)
        and any(part.statistics.get(metric) for e in evaluations for part in e.relative or ())
    ]
    if not metrics:
        return None
    as_evo = all(evaluation.protocol.re_form == "evo" for evaluation in evaluations)
    shown = [statistic or ("rmse" if as_evo else "mean")]
    if not statistic and not as_evo and width >= _WIDTH_FOR_MEDIANS:
        shown.append("median")
    title = f"Relative error, {' ('.join(shown)}{')' * (len(shown) - 1)}"
    headings = [RELATIVE_LABELS[metric] for metric in metrics]
    table = Table(title, ["estimate", "length"], [*headings, "count"])
    for evaluation in evaluations:
        name = evaluation.estimate.name
        if evaluation.relative is None and evaluation.protocol.lengths:
            table.add([name, "all", *[NOTHING] * (len(metrics) + 1)])
        for segment in evaluation.relative or ():
            if not segment.count:
                continue  # a remark names the lengths without sub-trajectories
            cells = [_texts(segment.statistics.get(metric), shown) for metric in metrics]
            count = str(segment.count)
            table.add([name, _length_text(segment), *cells, count])
            name = ""
        pooled = evaluation.pooled["position_percent"]
        if pooled is not None and len(evaluation.relative or ()) > 1:
            cells = [_texts(evaluation.pooled.get(metric), shown) for metric in metrics]
            table.add([name, "all", *cells, str(pooled.count)])
    return table


def scale_table(evaluations: Sequence[Evaluation]) -> Table | None:
    """Return the table of the scale along the run, a row per estimate; None without any."""
    if not any(evaluation.scale_along_run for evaluation in evaluations):
        return None
    table = Table(
        "Scale along the run: path of the aligned estimate / path of the groundtruth",
        ["estimate", "length"],
        ["first", "last", "min", "max", "drift [%/100 m]", "count"],
    )
    for evaluation in evaluations:
        scale = evaluation.scale_along_run
        if scale is not None:
            ratios = scale.ratios
            shown = (ratios[0], ratios[-1], ratios.min(), ratios.max())
            cells = (*(f"{ratio:.3f}" for ratio in shown), scale.drift_text, str(len(ratios)))
            table.add([evaluation.estimate.name, with_unit(scale.length_m, "m"), *cells])
    return table


def _length_text(segment: SubTrajectoryErrors) -> str:
    """Return the measured length with its unit: 8 m, 1 s, 8.06 m for a percentage of the path."""
    if segment.length_m is None:
        return segment.length.text
    return with_unit(segment.length_m, "m")


def _fits(column: str, width: int) -> bool:
    """Return whether a terminal of this width shows a column."""
    return width >= _WIDTH_FOR_ALL or column not in _WITHOUT_IF_NARROW


def _texts(statistics: Statistics | None, shown: Sequence[str]) -> str:
    """Return one statistic as text, or two, the second in parentheses."""
    if statistics is None:
        return NOTHING
    first, *others = (four_digits(getattr(statistics, name)) for name in shown)
    return f"{first} ({others[0]})" if others else first


def probabilistic_table(assessments: Mapping[str, LikelihoodAssessment]) -> Table:
    """Return a row per estimate."""
    first = next(iter(assessments.values()))
    noise = first.continuous.samples.noise
    rivals = ["log Bayes factor, best competitor"] if len(assessments) > 1 else []
    table = Table(
        f"Against continuous groundtruth, model {first.continuous.model}, noise "
        f"{noise.position_m:g} m",
        ["estimate"],
        [*_NUMBERS, *rivals],
    )
    for name, assessment in assessments.items():
        against = [_against_rivals(assessment)] if rivals else []
        table.add([name, *_cells(assessment), *against])
    return table


def probabilistic_lines(assessments: Mapping[str, LikelihoodAssessment]) -> list[str]:
    """Return the remarks that all estimates share once, then the others with names."""
    remarks = [dict.fromkeys(assessment.statements) for assessment in assessments.values()]
    shared = [
        line for line in remarks[0] if all(line in lines_of_name for lines_of_name in remarks)
    ]
    lines = [f"  {line}" for line in shared]
    for name, lines_of_name in zip(assessments, remarks, strict=True):
        lines += [f"  {name}: {line}" for line in lines_of_name if line not in shared]
    return lines


def _cells(assessment: LikelihoodAssessment) -> list[str]:
    """Return the numbers of an estimate as texts."""
    ate, scores = assessment.ate, assessment.gauge_scores
    interval = NOTHING
    if ate.interval_m is not None:
        interval = " to ".join(map(four_digits, ate.interval_m))
    scale = tilt = NOTHING
    # Unobservable quantities are no errors: frames can be tilted, and a camera has no scale.
    gauge = assessment.error.residuals.gauge
    if scores is not None and scores.scale is not None and gauge is not Gauge.SIM3:
        scale = f"{scores.scale.z[0]:+.1f}"
    if scores is not None and gauge is Gauge.YAW:
        tilt = ", ".join(f"{z:+.1f}" for z in scores.tilt.z)
    return [
        NOTHING if ate.supported_m is None else four_digits(ate.supported_m),
        whole_percent(ate.supported_share),
        interval,
        four_digits(ate.weighted_m),
        f"{assessment.error.nll_per_pose:.2f}",
        f"{assessment.error.chi2_per_dof:.3g}",
        scale,
        tilt,
    ]


def _against_rivals(assessment: LikelihoodAssessment) -> str:
    """Return the log Bayes factor against the best competitor."""
    if not assessment.log_bayes:
        return NOTHING
    return f"{min(assessment.log_bayes.values()):+.1f}"
