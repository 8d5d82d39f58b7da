"""Verification of findings: their corrections are applied in memory, and evaluated once."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

from trajeval_ros.diagnosis.causes import DISCONTINUITIES
from trajeval_ros.diagnosis.findings import Diagnosis, Verification
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
    first, is_possible, checked = correctable[0], False, None
    for corrected in (correctable, correctable[:1]):
        steps = list({str(one.correction): one.correction for one in corrected}.values())
        options = dict.fromkeys(one.option for one in corrected if one.option != first.option)
        with contextlib.suppress(TrajevalError):
            after = reevaluate(steps)
            is_possible, tried = True, Verification.of(before, after, tuple(options))
            if first.is_confirmed_by(tried):
                checked = dataclasses.replace(first, tried=tried)
                break
        if len(steps) == 1:
            break
    if checked is None and is_possible and first.cause not in _MEASURED:
        rest = tuple(finding for finding in diagnosis.findings if finding is not first)
        return verified(dataclasses.replace(diagnosis, findings=rest), before, reevaluate)
    checked = checked or first.without_advice(is_possible=is_possible)
    findings = tuple(checked if one is first else one for one in diagnosis.findings)
    return dataclasses.replace(diagnosis, findings=findings)
