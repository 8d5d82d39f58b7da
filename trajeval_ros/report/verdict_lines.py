"""The result lines of an evaluation: errors, their definitions, coverage and diagnosis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.diagnosis.evaluation_tests import few_pairs
from trajeval_ros.formatting.numbers import (
    NOTHING,
    counted,
    four_digits,
    significant,
    whole_percent,
    with_unit,
)
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import ASSUMED, UpAxis
from trajeval_ros.geometry.valid_poses import reasons
from trajeval_ros.metrics.discontinuities.events import DIVERGED, FROZEN
from trajeval_ros.metrics.discontinuities.parts import together_m
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.pipeline.evaluation_remarks import SCALE_DRIFT
from trajeval_ros.pipeline.input_remarks import completeness_in_words
from trajeval_ros.report.definitions import (
    METHOD_TEXTS,
    RE_FORM_TEXTS,
    alignment_of,
    first_state_alignment_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from trajeval_ros.calibration.apply import Ate
    from trajeval_ros.diagnosis.findings import Diagnosis
    from trajeval_ros.likelihood.likelihood_assessment import LikelihoodAssessment
    from trajeval_ros.likelihood.uncertain_ate import UncertainAte
    from trajeval_ros.metrics.discontinuities.parts import RunPart
    from trajeval_ros.metrics.noise_corrected_ate import NoiseCorrectedAte
    from trajeval_ros.pipeline.outcome import RunOutcome


_MOSTLY = 1.0 / 3.0  # of the rotation ATE: a standard deviation that explains it
_STATED = ("few_pairs", "identical")  # causes that the line or the numbers state already
_LOST = {FROZEN: "froze", DIVERGED: "diverged"}  # errors of the estimator


def verdict(
    evaluation: Evaluation,
    likelihood: LikelihoodAssessment | None = None,
    *,
    split: bool = False,
) -> list[str]:
    """Return the result lines: errors, the worst place, a drifting scale, alignment, coverage.

    With a `likelihood`, the first line has the ATE of poses that the groundtruth supports.
    `split` states the ATE of the parts between restarts, which are aligned separately.
    """
    position, rotation = evaluation.ate["position_m"], evaluation.ate["rotation_deg"]
    assert position is not None
    name = evaluation.estimate.name or "estimate"
    protocol, pairs = evaluation.protocol, evaluation.association
    rotation_text = "rotation withheld"
    if rotation is not None:
        rotation_text = f"rotation {with_unit(rotation.rmse, 'deg')}"
        if pairs.has_headings_only:
            rotation_text += " including tilt against 2-D headings"
    elif evaluation.relative is None and protocol.lengths:
        rotation_text = "rotation and drift withheld"
    kitti = f"{evaluation.kitti_ranking}; " if evaluation.kitti_ranking else ""
    how = "without" if protocol.gauge is Gauge.NONE else "after"
    whole = f"position error {with_unit(position.rmse, 'm')} RMSE {how} alignment (ATE)"
    together = together_m(evaluation.parts) if split else None
    if together is not None:
        whole += f" ({counted(len(evaluation.parts), 'part')}: {with_unit(together, 'm')})"
    supported = "" if likelihood is None else _supported(likelihood.ate, how)
    has_gaps = likelihood is not None and likelihood.ate.supported_share < 1.0
    few = few_pairs(protocol, pairs)
    return [
        f"{name}: {kitti}{supported or whole}, {rotation_text}{_drift(evaluation)}"
        + (f"; {few}" if few else ""),
        *(
            [f"  {whole} over all pairs, gaps of the groundtruth included"]
            if supported and has_gaps
            else []
        ),
        f"  {_worst(evaluation)}",
        *(f"  {remark.text}" for remark in evaluation.remarks if remark.code == SCALE_DRIFT),
        f"  {alignment_of([evaluation], brief=True)}; {_share(evaluation)}",
        *([_split(evaluation.parts)] if split else []),
        *_score(evaluation),
    ]


def definitions(evaluation: Evaluation) -> list[str]:
    """Return the lines below the tables: alignment, association, pairs and axes in full."""
    pairs = evaluation.association
    return [
        f"{evaluation.estimate.name or 'estimate'}: {alignment_of([evaluation])}"
        f"{_spread(evaluation)}; {METHOD_TEXTS[pairs.rule.method].format(pairs.rule)}",
        *_covered(evaluation),
        *(
            [f"  relative errors: {_relative_form(evaluation)}"]
            if any(part.count for part in evaluation.relative or ())
            else []
        ),
        *_up(evaluation.groundtruth.up, evaluation.estimate.up),
    ]


def _relative_form(evaluation: Evaluation) -> str:
    form = evaluation.protocol.re_form
    if form != "gauge":
        return RE_FORM_TEXTS[form]
    return f"{first_state_alignment_of([evaluation])}, position difference at the end"


def _worst(evaluation: Evaluation) -> str:
    """Return the largest position error and the largest drift over the longest length."""
    pairs, errors = evaluation.association, evaluation.absolute.position_m
    row = int(np.argmax(errors))
    travelled = pairs.groundtruth.travelled[row]
    text = (
        f"worst: {with_unit(errors[row], 'm')} at {_when(evaluation, row)} "
        f"({travelled:.4g} m travelled)"
    )
    drift = evaluation.drift
    part = next(
        (part for part in evaluation.relative or () if drift and part.length_m == drift.length_m),
        None,
    )
    start = None if part is None else part.worst_start
    if drift is None or start is None or evaluation.kitti_ranking:
        return text
    most, length = significant(drift.percent.max, 3), with_unit(drift.length_m, "m")
    return f"{text}; worst {length}: {most} % from {_when(evaluation, start)}"


def _when(evaluation: Evaluation, row: int) -> str:
    """Return the time of a pair since the groundtruth's begin; without timestamps its number."""
    if evaluation.association.rule.method == "index":
        return f"pair {row + 1}"
    since_ns = evaluation.association.groundtruth.stamps[row] - evaluation.groundtruth.stamps.min()
    return f"{since_ns / NANOSECONDS:.1f} s"


def _share(evaluation: Evaluation) -> str:
    """Return how much of the groundtruth is covered."""
    pairs = evaluation.association
    if pairs.estimate_coverage is None:
        return completeness_in_words(evaluation)
    text = f"{whole_percent(pairs.coverage.covered)} of the groundtruth covered"
    gap = pairs.coverage.longest_gap
    return text if gap is None else f"{text}, longest gap {gap}"


def _split(parts: Sequence[RunPart]) -> str:
    """Return the line about the parts between restarts and steps."""
    if not parts:
        return "  no restart, and no step far above the errors: one part"
    alignments = sum(part.ate is not None for part in parts)
    sizes = ", ".join(
        f"{part.duration_s:.0f} s {'-' if part.ate is None else with_unit(part.ate, 'm')}"
        for part in parts
    )
    return (
        f"  {counted(len(parts), 'part')} between restarts and steps, "
        f"{counted(alignments, 'alignment')} (position ATE; not below 5 s or 10 pairs): {sizes}"
    )


def _supported(ate: UncertainAte, how: str) -> str:
    """Return the ATE of the poses that the groundtruth supports; empty without one."""
    if ate.supported_m is None:
        return ""
    interval = ""
    if ate.interval_m is not None:
        low, high = (with_unit(limit, "m") for limit in ate.interval_m)
        interval = f", approximate 95 % interval {low} to {high}"
    return (
        f"position error {with_unit(ate.supported_m, 'm')} RMSE {how} alignment (ATE{interval}) "
        f"over {whole_percent(ate.supported_share)} of the poses"
    )


def _spread(evaluation: Evaluation) -> str:
    """Return the alignment's standard deviation as text, if the rotation ATE is mostly that."""
    rotation, freedom = evaluation.ate["rotation_deg"], evaluation.alignment.freedom
    if rotation is None or freedom is None or freedom.std_deg < _MOSTLY * rotation.rmse:
        return ""
    angle = "yaw" if freedom.rot_z else "rotation"
    return f", standard deviation of its {angle} {freedom.std_deg:.2g} deg"


def _covered(evaluation: Evaluation) -> list[str]:
    """Return the coverage of both sides, and the numbers of dropped states by reason."""
    pairs = evaluation.association
    dropped = f"dropped: {reasons(pairs.dropped)}" if pairs.dropped else ""
    if pairs.estimate_coverage is None:
        return [f"  {dropped}"] if dropped else []
    coverage, path_m = pairs.coverage, f"({pairs.groundtruth.path_length_m:.1f} m)"
    return [
        f"  {counted(len(pairs), 'pair')} cover {whole_percent(pairs.estimate_coverage)} of the "
        f"estimate's poses and {whole_percent(coverage.covered)} of the groundtruth's time "
        + path_m
        + (f", {coverage.gap_in_words}" if coverage.longest_gap else "")
        + (f"; {dropped}" if dropped else "")
    ]


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
    counts = [
        f"{count} under {bound:g} m"
        for bound, count in zip(score.bounds_m, score.counts, strict=False)
        if count
    ]
    counts.append(f"{score.counts[-1]} beyond, {score.missing} missing")
    return [
        *lines,
        f"  score {score.value:.4g} of {score.best:g} for {score.references} points: "
        + ", ".join(counts),
    ]


def _drift(evaluation: Evaluation) -> str:
    """Return the drift over the longest sub-trajectories as text."""
    drift = evaluation.drift
    if drift is None or evaluation.kitti_ranking:
        return ""
    mean, length = significant(drift.percent.mean, 3), with_unit(drift.length_m, "m")
    return f", drift {mean} % over {length}"


def noise_corrected_line(ate: NoiseCorrectedAte) -> str:
    """Return the line about the noise-corrected ATE, without the noise of fixes."""
    independent = significant(ate.effective_fixes, 2)
    worth = f"{counted(ate.fixes, 'fix', 'fixes')}, equivalent to {independent} independent fixes"
    guess = ", from approximate covariances of the driver" if ate.by_guess else ""
    low, high = ate.interval_m
    if ate.resolved:
        sentence = (
            f"  noise-corrected ATE {ate.ate_m:.3g} m (95 % interval {low:.3g} to {high:.3g} m); "
            f"{worth} (correlation time {ate.correlation_s:g} s), noise {ate.noise_rms_m:.2g} m"
        )
    else:
        why = (
            ("the fixes have too many jumps")
            if ate.jumps and 2.0 * ate.ate_m >= high - low
            else "the fixes have too much noise"
        )
        sentence = (
            f"  noise-corrected ATE below {high:.3g} m (95 %), no lower limit since {why}; "
            f"{worth} (correlation time {ate.correlation_s:g} s), noise {ate.noise_rms_m:.2g} m"
        )
    return sentence + guess


def diagnosis_lines(run: RunOutcome) -> list[str]:
    """Return a line per correction that was applied, and one per detected mistake."""
    lines = []
    for finding in run.corrected:
        tried, option = finding.tried, finding.option
        assert tried is not None
        assert tried.before is not None
        if not option.startswith("--correct"):
            option += " (--correct)"
        errors = f"{tried.name} {_ate(tried.before)} before, {_ate(tried.after)} after"
        lines.append(f"  corrected with {option}: {errors}; {finding.sentence}")
    return lines + [f"  diagnosis: {finding.text}" for finding in run.diagnosis.findings]


def doubt(diagnosis: Diagnosis) -> str:
    """Return the end of the first result line if a mistake dominates the errors: its cause."""
    graver = [
        finding.cause for finding in diagnosis.findings if finding.rank >= CAUSES["scale"].rank
    ]
    shown = [item.replace("_", " ") for item in graver if item not in (*_STATED, *_LOST)]
    lost = [_LOST[item] for item in graver if item in _LOST]
    return (f"; the estimate {' and '.join(lost)}" if lost else "") + (
        f"; not an error of the estimator alone: {', '.join(shown)}" if shown else ""
    )


def explanation(diagnosis: Diagnosis) -> list[str]:
    """Return a line per test: its statistics, and the mistakes found or why it is not possible."""
    lines = []
    for test in diagnosis.examined:
        scores = ", ".join(f"{name} {value:.4g}" for name, value in test.scores.items())
        result = ", ".join(seen.cause for seen in test.seen) or test.why_not or "no mistake"
        lines.append(f"{test.test}: {result}" + (f" ({scores})" if scores else ""))
    return lines


def _ate(ate: Ate) -> str:
    rotation_text = NOTHING if ate.rotation_deg is None else four_digits(ate.rotation_deg)
    return f"{four_digits(ate.position_m)} m, {rotation_text} deg"
