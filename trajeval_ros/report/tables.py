"""The result lines and the tables of an evaluation, as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.few_pairs import few_pairs
from trajeval_ros.diagnosis.warnings import completeness_in_words, reasons
from trajeval_ros.formatting.numbers import (
    NOTHING,
    counted,
    four_digits,
    percent,
    significant,
    with_unit,
)
from trajeval_ros.geometry.up_axis import ASSUMED, UpAxis
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.relative_evaluation import SubTrajectoryErrors
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.report.console import add_rows, new_table

if TYPE_CHECKING:
    from rich.table import Table

    from trajeval_ros.consistency.result import Consistency
    from trajeval_ros.metrics.own_error import OwnError
    from trajeval_ros.pipeline.outcome import RunOutcome

STATISTICS = ("rmse", "mean", "median", "std", "min", "max", "p95")
# In narrower terminals some columns are omitted; the files on disk have all.
_WIDTH_FOR_MEDIANS = 140
_WIDTH_FOR_ALL = 110
_PARTS = ("horizontal_m", "vertical_m")
_WITHOUT_IF_NARROW = {"std", "min", "p95", "rotation_deg_per_m", "tilt_deg"}
ABSOLUTE = {
    "position_m": "position [m]",
    "horizontal_m": "horizontal [m]",
    "vertical_m": "vertical [m]",
    "rotation_deg": "rotation [deg]",
    "yaw_deg": "yaw [deg]",
    "tilt_deg": "tilt [deg]",
    "velocity_mps": "velocity [m/s]",
    "gyroscope_bias": "gyroscope bias [rad/s]",
    "accelerometer_bias": "accelerometer bias [m/s^2]",
    "rotation_part": "rotation part",
    "full": "full pose",
}
RELATIVE = {
    "position_m": "position [m]",
    "position_percent": "position [%]",
    "rotation_deg": "rotation [deg]",
    "rotation_deg_per_m": "rotation [deg/m]",
    "yaw_deg": "yaw [deg]",
    "tilt_deg": "tilt [deg]",
    "velocity_mps": "velocity [m/s]",
    "distance_m": "distance [m]",
    "distance_percent": "distance [%]",
    "rotation_part": "rotation part",
    "full": "full pose",
}
METHODS = {
    "auto": "groundtruth interpolated (for points and fixes the estimate), gaps up to "
    "{0.max_gap_s:g} s",
    "linear": "groundtruth interpolated, gaps up to {0.max_gap_s:g} s",
    "groundtruth-stamps": "estimate interpolated at the groundtruth's timestamps, gaps up to "
    "{0.max_gap_s:g} s",
    "continuous": "groundtruth at the estimate's timestamps from model {0.model}, including gaps",
    "nearest": "nearest timestamps one to one, within {0.max_time_difference_s:g} s",
    "rpg": "nearest timestamps one to one, under {0.max_time_difference_s:g} s",
    "evo": "nearest timestamps many to one, within {0.max_time_difference_s:g} s",
    "index": "paired by frame or row index",
}
WEIGHTS = {
    "none": "",
    "covariance": ", weighted by covariance",
    "groundtruth-covariance": ", weighted by the groundtruth's covariance",
}
RE_FORMS = {
    "gauge": "first state aligned by the gauge, position difference at the end",
    "se3": "relative poses, SE(3) at the first state",
    "tutorial": "eq. (26) of the tutorial",
    "matrices": "relative poses, with the matrices of the file",
    "fitted": "yaw and position fitted to every sub-trajectory, position difference at the end",
    "evo": "relative poses, as evo_rpe",
    "euler": "relative poses, as rpg_trajectory_evaluation; yaw and tilt are its Euler angles",
}


def verdict(evaluation: Evaluation) -> list[str]:
    """Return the result lines: errors, definitions and coverage."""
    position, rotation = evaluation.ate["position_m"], evaluation.ate["rotation_deg"]
    assert position is not None
    name = evaluation.estimate.name or "estimate"
    turned = (
        "rotation withheld" if rotation is None else f"{with_unit(rotation.rmse, 'deg')} rotation"
    )
    protocol, pairs = evaluation.protocol, evaluation.association
    states = evaluation.alignment.states_used
    how = "first state" if states == 1 else f"first {states} states"
    if protocol.align_states is None:
        how = f"all {states} states"
    modality = f" for {protocol.modality}" if protocol.modality else ""
    poses = " with orientations" if protocol.align_with == "poses" else ""
    weights = WEIGHTS[protocol.align_weights]
    if protocol.apply == "scale":
        how += ", only its scale applied"
    scale = (
        f", scale {evaluation.alignment.similarity.scale:.4f}" if protocol.gauge.has_scale else ""
    )
    return [
        f"{name}: ATE {with_unit(position.rmse, 'm')} position, {turned} "
        f"(rmse{_drift(evaluation)})"
        + (f"; {few}" if (few := few_pairs(protocol, pairs)) else ""),
        f"  aligned by {protocol.gauge.value} ({protocol.gauge.description}){modality}, "
        f"{how}{poses}{weights}{scale}; {METHODS[pairs.rule.method].format(pairs.rule)}",
        f"  {_covered(evaluation)}{_dropped(evaluation)}",
        *_up(evaluation.groundtruth.up, evaluation.estimate.up),
        *_score(evaluation),
    ]


def own_error_line(own: OwnError) -> str:
    """Return the line about an estimate's own error, without the noise of fixes."""
    worth = (
        f"{counted(own.fixes, 'fix', 'fixes')}, equivalent to {own.effective_fixes:.2g} "
        "independent fixes"
    )
    guess = ", from approximate covariances of the driver" if own.by_guess else ""
    low, high = own.interval_m
    if own.resolved:
        said = (
            f"  own error {own.ate_m:.3g} m (95 % interval {low:.3g} to {high:.3g} m); {worth} "
            f"(correlation time {own.correlation_s:g} s), noise {own.noise_rms_m:.2g} m"
        )
    else:
        why = (
            ("the fixes have too many jumps")
            if own.jumps and 2.0 * own.ate_m >= high - low
            else "the fixes have too much noise"
        )
        said = (
            f"  own error below {high:.3g} m (95 %), no lower limit since {why}; {worth} "
            f"(correlation time {own.correlation_s:g} s), noise {own.noise_rms_m:.2g} m"
        )
    return said + guess


def _covered(evaluation: Evaluation) -> str:
    """Return the coverage of both sides as text."""
    pairs = evaluation.association
    if pairs.estimate_coverage is None:
        return completeness_in_words(evaluation)
    coverage, path_m = pairs.coverage, f"({pairs.groundtruth.path_length_m:.1f} m)"
    return (
        f"{len(pairs)} {coverage.of_what} cover {percent(pairs.estimate_coverage)} of the "
        f"estimate's poses and {percent(coverage.covered)} of the groundtruth's time {path_m}"
        + (f", {coverage.gap_in_words}" if coverage.longest_gap else "")
    )


def _up(groundtruth: UpAxis, estimate: UpAxis) -> list[str]:
    """Return a line about the up axes, unless both are assumed."""
    if {groundtruth.origin, estimate.origin} == {ASSUMED}:
        return []
    return [f"  vertical axes: groundtruth {groundtruth}, estimate {estimate}"]


def _score(evaluation: Evaluation) -> list[str]:
    """Return lines about recall and score, if the protocol has them."""
    score, recall = evaluation.score, evaluation.recall
    lines = []
    if recall is not None:
        shares = zip(recall.percent, recall.bounds_m, strict=True)
        level = " (level)" if recall.dimensions == 2 else ""
        within = ", ".join(f"{share:.4g} % within {bound:g} m" for share, bound in shares)
        lines.append(f"  recall of all points{level}: {within}")
    if score is None:
        return lines
    found = [
        f"{count} under {bound:g} m"
        for bound, count in zip(score.bounds_m, score.found, strict=False)
        if count
    ]
    found.append(f"{score.found[-1]} beyond, {score.missing} missing")
    return [
        *lines,
        f"  score {score.value:.4g} of {score.best:g} for {score.references} points: "
        + ", ".join(found),
    ]


def _drift(evaluation: Evaluation) -> str:
    """Return the drift over the longest sub-trajectories as text."""
    drift = evaluation.drift
    if drift is None:
        return ""
    mean, length = significant(drift.percent.mean, 3), with_unit(drift.length_m, "m")
    return f"); drift {mean} % of {length} (mean"


def _dropped(evaluation: Evaluation) -> str:
    """Return the numbers of dropped states by reason as text."""
    dropped = evaluation.association.dropped
    return f"; dropped: {reasons(dropped)}" if dropped else ""


def absolute_table(evaluations: Sequence[Evaluation], width: int) -> Table:
    """Return the table of absolute errors, a row per estimate and metric."""
    shown = [statistic for statistic in STATISTICS if _fits(statistic, width)]
    form = evaluations[0].protocol.ate_form
    title = f"Absolute trajectory error, {form} form"
    table = new_table(title, ["estimate", "error"], [*shown, "pairs"])
    for evaluation in evaluations:
        name = evaluation.estimate.name
        for metric, label in ABSOLUTE.items():
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
        [ABSOLUTE["position_m"], ABSOLUTE["rotation_deg"], "states used"],
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

    It has means and, if the width allows it, medians: a few bad sub-trajectories dominate the
        mean.
    """
    metrics = [
        metric
        for metric in RELATIVE
        if _fits(metric, width)
        and any(part.statistics.get(metric) for e in evaluations for part in e.segments or ())
    ]
    if not metrics:
        return None
    with_medians = width >= _WIDTH_FOR_MEDIANS
    what = "mean (median)" if with_medians else "mean"
    title = f"Relative error, {what}: {RE_FORMS[evaluations[0].protocol.re_form]}"
    headings = [RELATIVE[metric] for metric in metrics]
    table = new_table(title, ["estimate", "length"], [*headings, "count"])
    for evaluation in evaluations:
        name = evaluation.estimate.name
        for segment in evaluation.segments or ():
            cells = [_mean(segment.statistics.get(metric), with_medians) for metric in metrics]
            count = str(segment.count)
            add_rows(table, [[name, length_text(segment), *cells, count]])
            name = ""
        pooled = evaluation.pooled["position_percent"]
        if pooled is not None and len(evaluation.segments or ()) > 1:
            cells = [_mean(evaluation.pooled.get(metric), with_medians) for metric in metrics]
            add_rows(table, [[name, "all", *cells, str(pooled.count)]])
    return table


def length_text(segment: SubTrajectoryErrors) -> str:
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


def consistency_lines(name: str, consistency: Consistency) -> list[str]:
    """Return the result of a consistency test as lines."""
    lines = [
        "",
        f"{name}: {consistency.verdict}; covariances from {consistency.covariance_source}, gauge "
        f"{consistency.gauge.value}",
        f"  {consistency.statement}",
    ]
    joint, per_pose = consistency.joint, consistency.per_pose
    if joint is not None:
        low, high = joint.band_95
        lines.append(
            f"  joint NEES / dof {joint.nees / joint.dof:.3f} (95 % interval of consistent runs: "
            f"{low:.3f} to {high:.3f}; {joint.dof} dof)"
        )
    if per_pose is not None:
        # Errors of one run are correlated: the interval needs a known number of effective dof.
        band = ""
        if per_pose.band_95 is not None and per_pose.effective_dof is not None:
            low, high = per_pose.band_95
            band = (
                f" (95 % interval of consistent runs: {low:.2f} to {high:.2f}; "
                f"{per_pose.effective_dof:.1f} effective of {6 * per_pose.poses} dof)"
            )
        limit = ""
        if per_pose.limit_95 is not None:
            limit = f" (95 % of consistent runs: below {per_pose.limit_95:.2f})"
        position, rotation = per_pose.position, per_pose.rotation
        lines += [
            f"  NEES / 6 of single poses: mean {per_pose.mean:.3f}{band}, largest "
            f"{per_pose.max:.3f}{limit}",
            f"  NEES / 3 of orientations: mean {rotation.mean:.3f}, largest {rotation.max:.3f}",
            f"  NEES / 3 of positions: mean {position.mean:.3f}, largest {position.max:.3f}",
        ]
        if consistency.exactness == "as published":
            lines.append(
                f"  NEES as printed by ov_eval: mean_ori = {3.0 * rotation.mean:.3f} | mean_pos "
                f"= {3.0 * position.mean:.3f}"
            )
    return lines
