"""Trials of advice: a correction is applied in memory and evaluated before it is advised.

This replaces margins: of several causes that short motions cannot distinguish, the errors of the
whole path select one, and a correction that does not reduce them is not advised.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from trajeval_ros.diagnosis.causes import DISCONTINUITIES
from trajeval_ros.diagnosis.findings import WITHHELD_DEG, Diagnosis, Examined, Finding, Tried
from trajeval_ros.exceptions import TrajevalError

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation

# Evaluates and diagnoses again with corrections, one after the other.
Again: TypeAlias = Callable[[Sequence[Mapping[str, str]]], tuple["Evaluation", Diagnosis]]

_EQUAL = 1.1  # ratio of the errors of two corrections that are equally good
_MOST = 3  # trials with the next finding
_LEAST = 1e-9  # an error of zero, for logarithms
_WITHOUT_BODY = "without the body's rotation"
# These are measured without their corrections, and hold if the corrections do not help.
_HOLD = {
    "clock_offset", "clock_drift", "gap_bridged", "body", "lever_arm", "frozen", "frozen_at_start",
    "diverged", *DISCONTINUITIES,
}  # fmt: skip


def with_tried_advice(found: Diagnosis, before: Evaluation | None, again: Again) -> Diagnosis:
    """Return the findings whose corrections reduce the errors, with the errors of both.

    The corrections of a finding are tried together with those of the more severe ones. `before`
    is the evaluation without any, or None if there is none.
    """
    steps: list[Mapping[str, str]] = []
    kept: list[Finding] = []
    scores: dict[str, float] = {}
    for finding in found.findings:
        candidates = [each for each in finding.rivals or (finding,) if each.correction]
        others = [each for each in finding.rivals if not each.correction]
        if not candidates:
            kept.append(finding)
            continue
        tried = [_trial(each, each.correction, steps, before, again) for each in candidates]
        possible = [each for each in tried if each is not None]
        scores |= {each.name: each.tried.after.position_m for each in possible}
        trials = [each for each in possible if each.helps]
        # The drift can hide the effect, which is then no evidence against the finding.
        clean = [each for each in possible if each.is_possible and not each.found.findings]
        if clean and all(each.found.findings for each in trials):
            trials = []
        is_double = finding.cause == "conventions"  # a third mistake is unlikely
        if not (trials or clean or is_double):  # other mistakes can hide it, too
            first = possible[:_MOST]
            together = [_with_next(each, steps, before, again) for each in first]
            trials = [each for each in together if each is not None]
            # With an unknown rotation of the body, several names fit the motion in a plane.
            if len({each.finding.cause for each in first}) > 1:
                trials = [each for each in trials if each.tried.then != _WITHOUT_BODY]
        if trials:
            best = _selected(finding, trials)
            before = best.evaluation
            kept.append(best.finding)
            steps.append(best.finding.correction)
        elif others and is_double:
            kept += others
        elif finding.cause in _HOLD or any(each.is_possible for each in possible):
            # Without a smaller error, no name is better than another that leaves no finding.
            same = {each.finding.sentence for each in clean}
            stated = clean[0].finding if len(same) == 1 else finding
            kept.append(stated.without_advice(was_tried=bool(possible)))
        else:
            kept += others
    examined = (*found.examined, Examined("tried advice", scores)) if scores else found.examined
    return Diagnosis(tuple(kept), examined)


class _Trial(NamedTuple):
    finding: Finding  # with the errors
    tried: Tried
    evaluation: Evaluation  # with the correction
    found: Diagnosis  # with the correction

    @property
    def helps(self) -> bool:
        """Return whether the errors fall, and the cause is gone."""
        return self.finding.is_gone(self.found) and self.tried.helps(self.finding.cause)

    @property
    def is_possible(self) -> bool:
        """Return whether the cause is gone, and no known error grows."""
        position, rotation = self.tried.ratios
        withheld = self.tried.after.rotation_deg is None
        grows = position >= _EQUAL or not (withheld or rotation < _EQUAL)
        return self.finding.is_gone(self.found) and not grows

    def judged(self, tried: Tried) -> _Trial:
        """Return the trial with other errors."""
        return self._replace(finding=dataclasses.replace(self.finding, tried=tried), tried=tried)

    @property
    def name(self) -> str:
        """The cause and the values of its correction."""
        return " ".join([self.finding.cause, *self.finding.correction.values()])

    @property
    def size(self) -> float:
        """The logarithm of the product of the errors; withheld rotations are wrong."""
        after = self.tried.after
        turned_deg = WITHHELD_DEG if after.rotation_deg is None else after.rotation_deg
        return math.log(max(after.position_m, _LEAST)) + math.log(max(turned_deg, _LEAST))


def _trial(
    finding: Finding,
    correction: Mapping[str, str],
    steps: Sequence[Mapping[str, str]],
    before: Evaluation | None,
    again: Again,
) -> _Trial | None:
    """Return the trial of a correction; None if it is not possible, as without timestamps."""
    try:
        evaluation, found = again([*steps, correction])
    except TrajevalError:
        return None
    tried = dataclasses.replace(Tried.of(before, evaluation), is_next=bool(steps))
    finding = dataclasses.replace(finding, correction=correction, tried=tried)
    return _Trial(finding, tried, evaluation, found)


def _with_next(
    trial: _Trial, steps: Sequence[Mapping[str, str]], before: Evaluation | None, again: Again
) -> _Trial | None:
    """Return a trial that helps if the next finding is corrected, too; None if it does not."""
    then = trial.found.suggested
    if then is None or not then.correction or not trial.finding.is_gone(trial.found):
        return None
    both = _trial(trial.finding, then.correction, [*steps, trial.finding.correction], None, again)
    if then.cause == "body" and (both is None or both.found.named("body")):
        return _without_body(trial, then)
    if both is None:
        return None
    alone = _trial(then, then.correction, steps, before, again)
    compared = Tried.of(before if alone is None else alone.evaluation, both.evaluation)
    together = Tried.of(before, both.evaluation)
    if not (compared.helps(trial.finding.cause) and together.helps(trial.finding.cause)):
        return None
    tried = dataclasses.replace(together, is_next=bool(steps), then=then.option)
    return trial.judged(tried)


def _without_body(trial: _Trial, body: Finding) -> _Trial | None:
    """Return a trial that helps but for the rotation of the body, which no trial determines."""
    after = dataclasses.replace(trial.tried.after, rotation_deg=body.evidence["rest_deg"])
    tried = dataclasses.replace(trial.tried, after=after, then=_WITHOUT_BODY)
    return trial.judged(tried) if tried.helps(trial.finding.cause) else None


def _selected(finding: Finding, trials: list[_Trial]) -> _Trial:
    """Return the trial with the smallest errors; if others are equal, with their statement."""
    best = min(trials, key=lambda each: each.size)
    equal = [each for each in trials if each.size < best.size + math.log(_EQUAL)]
    if len({each.finding.sentence for each in equal}) == 1:
        return equal[0]
    correction, tried = best.finding.correction, best.tried
    return best._replace(
        finding=dataclasses.replace(finding, correction=correction, tried=tried, rivals=())
    )
