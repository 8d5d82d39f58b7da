"""What was diagnosed and mended, in lines that stand under the headline number."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.formatting.numbers import NOTHING, four_digits

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Ate
    from trajeval_ros.diagnosis.findings import Diagnosis
    from trajeval_ros.pipeline.outcome import RunOutcome


def diagnosis_lines(run: RunOutcome) -> list[str]:
    """Return a line for what was mended, and one for each mistake that the recording shows."""
    lines = []
    if run.mended is not None:
        finding, before, after = run.mended.finding, run.mended.before, run.mended.after
        lines.append(
            f"  corrected with {finding.option} (--fix): ATE {_ate(before)} before, "
            f"{_ate(after)} after; {finding.sentence}"
        )
    return lines + [f"  diagnosis: {each.text}" for each in run.diagnosis.findings]


def explanation(diagnosis: Diagnosis) -> list[str]:
    """Return a line for each test: its statistics, and what it accepts or why it says nothing."""
    lines = []
    for each in diagnosis.examined:
        scores = ", ".join(f"{name} {value:.4g}" for name, value in each.scores.items())
        said = ", ".join(seen.cause for seen in each.seen) or each.why_not or "nothing"
        lines.append(f"{each.test}: {said}" + (f" ({scores})" if scores else ""))
    return lines


def _ate(ate: Ate) -> str:
    turned = NOTHING if ate.rotation_deg is None else four_digits(ate.rotation_deg)
    return f"{four_digits(ate.position_m)} m, {turned} deg"
