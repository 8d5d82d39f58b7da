"""Regression gates: test whether a comparison is worse than its baseline by more than a margin."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trajeval_ros.batch.gate import Gate, GateTrials, GateValues, Group
from trajeval_ros.batch.permutation_tests import (
    PermutationTest,
    Sample,
    can_reject,
    equal_trials,
    more_failures,
    more_trials,
)
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.numbers import counted

FALSE_ALARMS = 0.025
WORSE, NO_WORSE, UNDECIDED = "worse", "no worse", "undecided"
NOT_ALONE, LOST, NEW, FAILED = "not judged alone", "lost", "new", "failed"
MORE_FAILURES = "more failures"

Size = tuple[int, int]
Sides = dict[Group, tuple[GateTrials, GateTrials]]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The verdict on one number, or on all of a gate."""

    verdict: str  # an identifier from above; `lost` and `new`: values in one comparison only
    noticeable: float | None = None  # change that is detected in 80 % of comparisons
    p: float | None = None  # adjusted for all gates and numbers; None if not tested alone
    level: float | None = None  # significance level of p

    @property
    def fails(self) -> bool:
        """Whether this is a regression."""
        return self.verdict in (WORSE, LOST)


@dataclass(frozen=True, kw_only=True)
class NumberVerdict(Verdict):
    """The verdict on a number of one algorithm on one sequence."""

    group: Group
    medians: tuple[float | None, float | None]  # old and new; inf if half of the trials failed
    trials: Size  # old and new; identical runs count once
    reason: str = ""  # why the values are lost

    @property
    def change(self) -> float | None:
        """The relative change of the medians; None if it can't be computed."""
        before, now = self.medians
        if not before or now is None or math.isinf(before + now):
            return None
        return (now - before) / before


@dataclass(frozen=True, kw_only=True)
class PooledVerdict(Verdict):
    """The verdict on all numbers of a gate together."""

    count: int  # of numbers
    change: float  # common relative change, 0.05 for 5 %
    bounds: tuple[float, float] | None  # of the change; None if there are too few trials
    more_trials: int  # that the test needs per number now to decide at all


@dataclass(frozen=True)
class GateVerdict:
    """The verdicts of a gate."""

    gate: Gate
    numbers: tuple[NumberVerdict, ...]
    copies: int  # omitted trials: their poses are identical to those of another trial
    paired: bool
    pooled: PooledVerdict | None = None  # None for an untested gate or without numbers

    @property
    def undecided(self) -> list[NumberVerdict]:
        """The numbers with verdict `undecided`."""
        return [number for number in self.numbers if number.verdict == UNDECIDED]

    @property
    def verdict(self) -> str:
        """`worse` or `lost` if a number or all together are; else `no worse` or `undecided`."""
        words = [number.verdict for number in self.numbers]
        together = words if self.pooled is None else [self.pooled.verdict]
        verdicts = {*together, *words} & {WORSE, LOST} or {*together} & {NO_WORSE}
        return WORSE if WORSE in verdicts else verdicts.pop() if verdicts else UNDECIDED

    def why_it_cannot_fail(self, false_alarms: float) -> str:
        """Return why no error, however large, gives the verdict `worse`, and what does; or ""."""
        if self.pooled is None or not self.pooled.more_trials:
            return ""
        values = counted(self.pooled.count, "value")
        enough = equal_trials(self.pooled.count, false_alarms)
        copies = " (identical ones count once)" if self.copies else ""
        return (
            f"{values} with so few trials{copies} cannot be significant at "
            f"{100 * false_alarms:g} %; use "
            f"{counted(enough, 'trial')} on both sides, or "
            f"{self.pooled.more_trials} more per value now"
        )


@dataclass(frozen=True, kw_only=True)
class Failures(Verdict):
    """The test whether more runs fail, of groups in both comparisons.

    The verdict is `more failures` or `undecided`; there is no test for "not more".
    """

    before: Size  # failed and all runs
    now: Size


@dataclass(frozen=True)
class Judgement:
    """The verdicts of all gates, and the probability of a false alarm of all together."""

    gates: tuple[GateVerdict, ...]
    failures: Failures
    false_alarms: float

    @property
    def verdict(self) -> str:
        """`worse`, `lost` or `more failures`; else `no worse` (all gates) or `undecided`."""
        words = {gate.verdict for gate in self.gates}
        verdicts = words | {self.failures.verdict}
        good = NO_WORSE if words == {NO_WORSE} else UNDECIDED
        return next((word for word in (WORSE, LOST, MORE_FAILURES) if word in verdicts), good)

    @property
    def fails(self) -> bool:
        """Whether the verdict is a regression."""
        return self.verdict in (WORSE, LOST, MORE_FAILURES)


def judge(
    gates: Sequence[Gate],
    baseline: GateValues,
    now: GateValues,
    false_alarms: float = FALSE_ALARMS,
    *,
    paired: bool = False,
) -> Judgement:
    """Apply every gate to every algorithm on every sequence; the tested gates share the level.

    `paired`: whether trials of the same name have the same seed; relabellings then swap old and
    new within pairs.
    """
    sides = [_sides(gate, baseline, now, paired=paired and gate.tested) for gate in gates]
    verdicts = [_by_medians(*item, paired=paired) for item in zip(gates, sides, strict=True)]
    tested = [place for place, item in enumerate(verdicts) if item.undecided]
    if tested:
        made = _tested([verdicts[item] for item in tested], [sides[item] for item in tested],
                       false_alarms, paired=paired)  # fmt: skip
        for place, verdict in zip(tested, made, strict=True):
            verdicts[place] = verdict
    return Judgement(tuple(verdicts), _failures(baseline, now, false_alarms), false_alarms)


def _failures(baseline: GateValues, now: GateValues, level: float) -> Failures:
    before, after = baseline.failed, now.failed
    both = [group for group in before if group in after]
    old, new = ([np.array(side[item]) for item in both] for side in (before, after))
    sums = [(int(sum(map(np.sum, side))), sum(map(len, side))) for side in (old, new)]
    p = more_failures(old, new) if both else 1.0
    verdict = MORE_FAILURES if p <= level else UNDECIDED
    return Failures(verdict=verdict, p=p, level=level, before=sums[0], now=sums[1])


def _sides(gate: Gate, baseline: GateValues, now: GateValues, *, paired: bool) -> Sides:
    """Return the trials of both tables by algorithm and sequence."""
    before, after = (item.trials(gate.path, baseline) for item in (baseline, now))
    made: Sides = {}
    for group in dict.fromkeys([*before, *after]):
        old, new = (side.get(group, GateTrials()) for side in (before, after))
        both = paired and group in before and group in after
        made[group] = old.paired_with(new, ", ".join(group)) if both else (old, new)
    return made


def _by_medians(gate: Gate, sides: Sides, *, paired: bool) -> GateVerdict:
    """Return the verdicts without a test, `undecided` if one follows."""
    numbers, copies = [], 0
    for group, (old, new) in sides.items():
        has_old, has_new = (np.isfinite(item.values).any() for item in (old, new))
        verdict, reason = UNDECIDED, ""
        if not has_old:
            verdict = NEW if has_new else FAILED
        elif not has_new:
            verdict = LOST
            reason = new.why_failed if new.values else "not in this comparison"
        elif not gate.tested:
            verdict = WORSE if _is_beyond(gate, old, new) else NO_WORSE
        elif paired and not np.isfinite(np.add(old.values, new.values)).any():
            verdict = NOT_ALONE
        copies += old.copies + new.copies if has_old and has_new else 0
        trials = len(old.values), len(new.values)
        medians = _median(old.values), _median(new.values)
        numbers.append(NumberVerdict(group=group, medians=medians, trials=trials,
                                     verdict=verdict, reason=reason))  # fmt: skip
    return GateVerdict(gate, tuple(numbers), copies, paired and gate.tested)


def _tested(
    verdicts: Sequence[GateVerdict], sides: Sequence[Sides], level: float, *, paired: bool
) -> Iterator[GateVerdict]:
    """Yield the verdicts of gates that share a level."""
    groups = list(dict.fromkeys(item.group for every in verdicts for item in every.undecided))
    samples = []
    for group in groups:
        both = [side[group] for side in sides]
        z = [item.gate.logarithms([*old.values, *new.values])
             for item, (old, new) in zip(verdicts, both, strict=True)]  # fmt: skip
        old, new = np.split(np.column_stack(z), [len(both[0][0].values)])
        samples.append(Sample(old, new, paired=paired))
    for verdict in verdicts if paired else []:
        pairs = sum(item.trials[0] for item in verdict.undecided)
        _require_enough(verdict.gate, pairs, level)
    test = PermutationTest(samples, np.array([item.gate.margin for item in verdicts]), level)
    common, alone = test.detectable()
    for k, verdict in enumerate(verdicts):
        gate, sizes = verdict.gate, [item.trials for item in verdict.undecided]
        together = _found(gate, common[k], [(side.together[k], side.level_together)
                                            for side in (test.worse, test.better)])  # fmt: skip
        low, high = sorted(gate.change(item) for item in (test.low[k], test.high[k]))
        pooled = PooledVerdict(
            count=len(sizes),
            change=gate.change(test.change[k]),
            bounds=(low, high) if low > -1.0 and math.isfinite(high) else None,
            more_trials=0 if paired else more_trials(sizes, level),
            **together,
        )
        numbers = {item.group: item for item in verdict.numbers}
        for number in verdict.undecided:
            place, verdict_of_group = groups.index(number.group), together
            if len(sizes) > 1 and not test.tests_alone[place]:
                verdict_of_group = {"verdict": NOT_ALONE}
            elif len(sizes) > 1:
                tests = [(side.alone[place, k], side.level_alone)
                         for side in (test.worse, test.better)]  # fmt: skip
                verdict_of_group = _found(gate, alone[place, k], tests)
            numbers[number.group] = replace(number, **verdict_of_group)
        yield replace(verdict, numbers=tuple(numbers.values()), pooled=pooled)


def _found(gate: Gate, noticeable: float, tests: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """Return the attributes of a `Verdict`, from p-values and levels for worse and for better."""
    worse, better = (p <= level for p, level in tests)
    return {
        "verdict": WORSE if worse else NO_WORSE if better else UNDECIDED,
        "noticeable": abs(gate.change(noticeable)) if math.isfinite(noticeable) else None,
        "p": float(tests[0][0]),
        "level": tests[0][1],
    }


def _require_enough(gate: Gate, pairs: int, level: float) -> None:
    if can_reject(2**pairs, level):
        return
    needed = math.ceil(-math.log2(level))
    raise SettingsError(
        f"--paired: the gate '{gate}' has {counted(pairs, 'pair')} of trials, too few for its "
        f"level of {100 * level:g} % (the smallest p-value is 2^-{pairs}); use "
        f"{counted(needed, 'pair')} or remove --paired"
    )


def _median(values: Sequence[float]) -> float | None:
    """Return the median, with failed trials as inf; None without trials."""
    return statistics.median(values) if values else None


def _is_beyond(gate: Gate, before: GateTrials, now: GateTrials) -> bool:
    """Return whether the new median is worse than the old one of finite values by the margin."""
    old, new = _median([*filter(math.isfinite, before.values)]), _median(now.values)
    if old is None or new is None or math.isinf(new):
        return True
    sign = -1.0 if gate.is_share else 1.0
    return sign * new > sign * old * math.exp(sign * gate.margin)
