"""Verification of findings: their corrections are applied in memory, and evaluated once."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

from trajeval_ros.diagnosis.causes import DISCONTINUITIES
from trajeval_ros.diagnosis.findings import Diagnosis, Finding, Tried
from trajeval_ros.exceptions import TrajevalError

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation

# Evaluates with corrections, one after the other.
Reevaluate: TypeAlias = Callable[[Sequence[Mapping[str, str]]], "Evaluation"]

# These are measured directly, as repeated poses or steps, so they hold whatever the errors do.
_MEASURED = {
    "flat", "gap_bridged", "frozen", "frozen_at_start", "diverged", *DISCONTINUITIES,
}  # fmt: skip


def verified(diagnosis: Diagnosis, before: Evaluation | None, reevaluate: Reevaluate) -> Diagnosis:
    """Return the findings with the errors before and after their corrections.

    The corrections of all findings are evaluated together. If an error grows, that of the first
    one is evaluated alone; if the error grows still, the finding is no cause. It is dropped, and
    the others are verified. `before` is the evaluation without corrections, or None without one.
    """
    correctable = [finding for finding in diagnosis.findings if finding.correction]
    if not correctable:
        return diagnosis
    first = correctable[0]
    tried, is_possible = None, False
    for corrected in (correctable, correctable[:1]):
        steps = list({str(one.correction): one.correction for one in corrected}.values())
        options = dict.fromkeys(one.option for one in corrected if one.option != first.option)
        try:
            after = reevaluate(steps)
        except TrajevalError:
            after = None
        if after is not None:
            is_possible = True
            joint = Tried.of(before, after, " and ".join(options))
            if not joint.raises_errors(first.cause):
                tried = joint
                break
        if len(steps) == 1:
            break
    checked = _checked(first, tried, is_possible=is_possible)
    if checked is None:
        rest = tuple(finding for finding in diagnosis.findings if finding is not first)
        return verified(dataclasses.replace(diagnosis, findings=rest), before, reevaluate)
    findings = (checked if one is first else one for one in diagnosis.findings)
    return dataclasses.replace(diagnosis, findings=tuple(findings))


def _checked(finding: Finding, tried: Tried | None, *, is_possible: bool) -> Finding | None:
    """Return a finding with its verification; None if its correction increases the errors."""
    if tried is not None:
        return dataclasses.replace(finding, tried=tried)
    if is_possible and finding.cause not in _MEASURED:
        return None
    return finding.without_advice(is_possible=is_possible)
