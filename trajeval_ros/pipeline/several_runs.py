"""What needs all estimates of one groundtruth: equal ones, Bayes factors, jumps of GNSS fixes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.diagnose import same_estimate
from trajeval_ros.pipeline.fix_remarks import fix_remarks
from trajeval_ros.pipeline.outcome import RunOutcome

if TYPE_CHECKING:
    from trajeval_ros.formatting.remarks import Remark
    from trajeval_ros.geometry.fix_selection import FixRule


def with_same_estimates_named(runs: Sequence[RunOutcome]) -> list[RunOutcome]:
    """Return the runs with a finding for an estimate that equals a previous one."""
    named = []
    for number, run in enumerate(runs):
        same = same_estimate(run.estimate, [earlier.estimate for earlier in runs[:number]])
        if same is not None:
            diagnosis = run.diagnosis.with_others([same])
            run = dataclasses.replace(with_remarks([same.remark], run), diagnosis=diagnosis)
        named.append(run)
    return named


def with_bayes_factors(runs: Sequence[RunOutcome]) -> Iterator[RunOutcome]:
    """Yield the runs with Bayes factors between their likelihoods."""
    assessments = [run.likelihood for run in runs if run.likelihood is not None]
    if len(assessments) < 2:
        yield from runs
        return
    from trajeval_ros.likelihood.likelihood_assessment import with_bayes_factors

    names = [run.estimate.name for run in runs]
    for run, assessment in zip(runs, with_bayes_factors(names, assessments), strict=True):
        yield dataclasses.replace(run, likelihood=assessment)


def with_noise_corrected_ates(runs: list[RunOutcome], rule: FixRule) -> list[RunOutcome]:
    """Return the runs with errors without the noise of GNSS fixes, and warnings about fixes."""
    evaluations = [run.evaluation for run in runs]
    known = any(run.calibrated is not None and run.calibrated.lever_applied for run in runs)
    if evaluations[0].groundtruth.reading.fixes is None:
        remarks = (
            fix_remarks(evaluation, rule, lever_arm_known=known) for evaluation in evaluations
        )
        both = zip(remarks, runs, strict=True)
        return [with_remarks(more, run, len(run.diagnosis.findings)) for more, run in both]
    from trajeval_ros.metrics.noise_corrected_ate import noise_corrected_ates

    results = []
    for run, (corrected, why) in zip(
        runs, noise_corrected_ates(evaluations, rule.correlation_s), strict=True
    ):
        more = fix_remarks(
            run.evaluation, rule, corrected, why, lever_arm_known=known, of=len(runs)
        )
        run = with_remarks(more, run, len(run.diagnosis.findings))
        results.append(dataclasses.replace(run, noise_corrected_ate=corrected))
    return results


def with_remarks(more: Sequence[Remark], run: RunOutcome, after: int = 0) -> RunOutcome:
    """Return a run with more remarks, after the first ones, which are about findings."""
    if not more:
        return run
    given = run.evaluation.remarks
    remarks = (*given[:after], *more, *given[after:])
    return dataclasses.replace(
        run, evaluation=dataclasses.replace(run.evaluation, remarks=remarks)
    )
