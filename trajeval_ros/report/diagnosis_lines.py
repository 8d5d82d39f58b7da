"""Diagnosis and corrections as lines below the result."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.formatting.numbers import NOTHING, four_digits

if TYPE_CHECKING:
    from trajeval_ros.calibration.calibrated import Ate
    from trajeval_ros.diagnosis.findings import Diagnosis
    from trajeval_ros.pipeline.outcome import RunOutcome


def diagnosis_lines(run: RunOutcome) -> list[str]:
    """Return a line for the correction that was applied, and one per detected mistake."""
    lines = []
    if run.mended is not None:
        finding, before, after = run.mended.finding, run.mended.before, run.mended.after
        lines.append(
            f"  corrected with {finding.option} (--fix): ATE {_ate(before)} before, "
            f"{_ate(after)} after; {finding.sentence}"
        )
    return lines + [f"  diagnosis: {finding.text}" for finding in run.diagnosis.findings]


def explanation(diagnosis: Diagnosis) -> list[str]:
    """Return a line per test: its statistics, and the mistakes found or why it is not possible."""
    lines = []
    for test in diagnosis.examined:
        scores = ", ".join(f"{name} {value:.4g}" for name, value in test.scores.items())
        said = ", ".join(seen.cause for seen in test.seen) or test.why_not or "no mistake"
        lines.append(f"{test.test}: {said}" + (f" ({scores})" if scores else ""))
    return lines


def _ate(ate: Ate) -> str:
    turned = NOTHING if ate.rotation_deg is None else four_digits(ate.rotation_deg)
    return f"{four_digits(ate.position_m)} m, {turned} deg"
