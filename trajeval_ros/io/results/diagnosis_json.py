"""The `diagnosis` and `mended` blocks of result.json."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trajeval_ros.diagnosis.findings import Diagnosis, Finding
    from trajeval_ros.diagnosis.mending import Mended


def diagnosis_json(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Return the findings about an estimate, the most severe first."""
    return [_finding(each) for each in diagnosis.findings]


def mended_json(mended: Mended | None) -> dict[str, Any] | None:
    """Return the corrected finding, and the ATE before and after; None without a correction."""
    if mended is None:
        return None
    return {
        **_finding(mended.finding),
        "before": dataclasses.asdict(mended.before),
        "after": dataclasses.asdict(mended.after),
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "cause": finding.cause,
        "sentence": finding.sentence,
        "advice": finding.advice,
        "option": finding.option or None,
        "confidence": finding.confidence,
        "explained": finding.explained,
        "evidence": {
            name: value for name, value in finding.evidence.items() if math.isfinite(value)
        },
    }
