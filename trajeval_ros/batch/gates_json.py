"""The verdicts of gates as JSON: the contents of gates.md with all digits.

The schema is `trajeval-gates/1`; docs/compare.md describes every field.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from trajeval_ros import __version__
from trajeval_ros.batch.gate_verdicts import (
    ADVISED,
    Failures,
    GateVerdict,
    Judgement,
    NumberVerdict,
    PooledVerdict,
)
from trajeval_ros.batch.relabelling import Size
from trajeval_ros.io.json_file import json_text

SCHEMA = "trajeval-gates/1"


def to_json(judgement: Judgement, title: str, remarks: Sequence[str]) -> str:
    """Return the verdicts of all gates and numbers as JSON; unknown values are null."""
    content = {
        "schema": SCHEMA,
        "version": __version__,
        "title": title,
        "notes": list(remarks),
        "verdict": judgement.verdict,
        "false_alarms": judgement.false_alarms,
        "gates": [_gate(each) for each in judgement.gates],
        "failures": _failures(judgement.failures),
    }
    return json_text(content, indent=2)


def _gate(verdict: GateVerdict) -> dict[str, Any]:
    gate = verdict.gate
    return {
        "gate": str(gate),
        "path": gate.path,
        "margin": gate.percent / 100.0,
        "deviations": gate.deviations,
        "spread": None if gate.spread_percent is None else gate.spread_percent / 100.0,
        "tested": gate.tested,
        "paired": verdict.paired,
        "verdict": verdict.verdict,
        "together": None if verdict.pooled is None else _together(verdict.pooled),
        "numbers": [_number(each) for each in verdict.numbers],
        "copies": verdict.copies,
        "advised": None if verdict.advised is None else _advised(*verdict.advised),
    }


def _together(pooled: PooledVerdict) -> dict[str, Any]:
    return {
        "count": pooled.count,
        "verdict": pooled.verdict,
        "change": _finite(pooled.change),
        "bounds": None if pooled.bounds is None else list(pooled.bounds),
        "noticeable": pooled.noticeable,
        "p": pooled.p,
        "level": pooled.level,
    }


def _number(number: NumberVerdict) -> dict[str, Any]:
    old, new = number.trials
    return {
        "algorithm": number.algorithm,
        "sequence": number.sequence,
        "verdict": number.verdict,
        "reason": number.reason,
        "before": {"median": _finite(number.before), "trials": old},
        "now": {"median": _finite(number.now), "trials": new},
        "change": number.change,
        "noticeable": number.noticeable,
        "p": number.p,
        "level": number.level,
    }


def _advised(together: float, least: float, most: float) -> dict[str, Any]:
    old, new = ADVISED
    noticeable = {"together": _finite(together), "alone": [_finite(least), _finite(most)]}
    return {"before": {"trials": old}, "now": {"trials": new}, "noticeable": noticeable}


def _failures(failures: Failures) -> dict[str, Any]:
    return {
        "verdict": failures.verdict,
        "before": _failed(failures.before),
        "now": _failed(failures.now),
        "p": failures.p,
        "level": failures.level,
    }


def _failed(size: Size) -> dict[str, int]:
    failed, runs = size
    return {"failed": failed, "runs": runs}


def _finite(value: float | None) -> float | None:
    """Return a number; None for inf, the median if half of the trials failed."""
    return None if value is None or not math.isfinite(value) else value
