"""Results that need several estimates of one groundtruth."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

from trajeval_ros.diagnosis.fix_hints import about_fixes, about_unused_rule
from trajeval_ros.diagnosis.mending import same_estimate
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.metrics.input_summary import InputSummary
from trajeval_ros.pipeline.outcome import RunOutcome


def compared_with(others: Sequence[InputSummary], found: RunOutcome) -> RunOutcome:
    """Return an outcome with a warning if its estimate equals one of the others."""
    same = same_estimate(found.estimate, others)
    if same is None:
        return found
    warnings = (same.text, *found.evaluation.warnings)
    return dataclasses.replace(
        found,
        evaluation=dataclasses.replace(found.evaluation, warnings=warnings),
        diagnosis=found.diagnosis.with_others([same]),
    )


def with_bayes_factors(runs: Sequence[RunOutcome]) -> Iterator[RunOutcome]:
    """Yield the runs with Bayes factors between their likelihoods."""
    assessments = [run.likelihood for run in runs if run.likelihood is not None]
    if len(assessments) < 2:
        yield from runs
        return
    from trajeval_ros.likelihood.assessment import compared

    names = [run.estimate.name for run in runs]
    for run, assessment in zip(runs, compared(names, assessments), strict=True):
        yield dataclasses.replace(run, likelihood=assessment)


def with_own_errors(runs: list[RunOutcome], rule: FixRule) -> list[RunOutcome]:
    """Return the runs with own errors, if the groundtruth is GNSS fixes.

    Otherwise they have a warning about settings of fixes.
    """
    if runs[0].evaluation.groundtruth.fixes is None:
        unused = about_unused_rule(rule)
        return [_with_more(run, unused) for run in runs] if unused else runs
    from trajeval_ros.metrics.own_error import own_errors

    evaluations = [run.evaluation for run in runs]
    found = own_errors(evaluations, rule.correlation_s)
    named = any(run.calibrated is not None and run.calibrated.lever_applied for run in runs)
    return [
        _with_more(
            dataclasses.replace(run, own_error=own),
            about_fixes(run.evaluation, own, why, lever_arm_known=named, of=len(runs)),
        )
        for run, (own, why) in zip(runs, found, strict=True)
    ]


def _with_more(run: RunOutcome, warnings: Sequence[str]) -> RunOutcome:
    """Return a run with more warnings, after those about findings."""
    findings = len(run.diagnosis.findings)
    given = run.evaluation.warnings
    every = (*given[:findings], *warnings, *given[findings:])
    return dataclasses.replace(run, evaluation=dataclasses.replace(run.evaluation, warnings=every))
