"""Regression gates: test whether a comparison is worse than its baseline by more than a margin."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from trajeval_ros.batch.common_change import common_change, shifted
from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.gate_tests import (
    FALSE_ALARMS,
    GateOutcome,
    compare,
    is_enough,
    more_failures,
)
from trajeval_ros.batch.gate_values import GateTrials, GateValues, Group
from trajeval_ros.batch.gate_verdicts import (
    ADVISED,
    FAILED,
    LOST,
    NEW,
    NO_WORSE,
    NOT_ALONE,
    UNDECIDED,
    WORSE,
    Failures,
    GateVerdict,
    Judgement,
    NumberVerdict,
    PooledVerdict,
)
from trajeval_ros.batch.known_spread import KnownSpread
from trajeval_ros.batch.noticeable import noticeable, noticeable_alone, spreads_within
from trajeval_ros.batch.relabelling import Size
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats


def judge(
    gates: Sequence[Gate],
    baseline: GateValues,
    now: GateValues,
    false_alarms: float = FALSE_ALARMS,
    *,
    paired: bool = False,
) -> Judgement:
    """Apply every gate to every algorithm on every sequence.

    Args:
        gates: The gates; all that are tested have the same part of the level.
        baseline: The older table.
        now: The newer table.
        false_alarms: Probability that any gate reports a regression without a change.
        paired: Whether trials of the same name have the same seed; relabellings then swap old and
            new within pairs.

    Raises:
        SettingsError: The baseline lacks the number of a gate, a trial is not in both tables, or
            there are too few pairs.
    """
    share = false_alarms / max(1, sum(gate.tested for gate in gates))
    verdicts = tuple(
        _judge_gate(gate, baseline, now, share, paired=paired and gate.tested) for gate in gates
    )
    return Judgement(verdicts, _failures(baseline, now, false_alarms), false_alarms)


def _failures(baseline: GateValues, now: GateValues, level: float) -> Failures:
    before, after = baseline.failed, now.failed
    both = [group for group in before if group in after]
    old, new = ([np.array(side[each]) for each in both] for side in (before, after))
    sums = [(int(sum(map(np.sum, side))), sum(map(len, side))) for side in (old, new)]
    return Failures(sums[0], sums[1], more_failures(old, new) if both else 1.0, level)


def _judge_gate(
    gate: Gate, baseline: GateValues, now: GateValues, level: float, *, paired: bool
) -> GateVerdict:
    before, after = baseline.trials(gate.path), now.trials_like(gate.path, baseline)
    verdicts: dict[Group, NumberVerdict] = {}
    judged: list[Group] = []
    for group in dict.fromkeys([*before, *after]):
        old, new = (side.get(group, GateTrials([])) for side in (before, after))
        reason = ""
        if paired and group in before and group in after:
            old, new = old.paired_with(new, ", ".join(group))
            before[group], after[group] = old, new
        if not np.isfinite(old.values).any():
            verdict = NEW if np.isfinite(new.values).any() else FAILED
        elif not np.isfinite(new.values).any():
            verdict = LOST
            reason = now.why_failed(group) if new.values else "not in this comparison"
        else:
            verdict = UNDECIDED
            judged.append(group)
        medians = (_median(old.values), _median(new.values))
        trials = (len(old.values), len(new.values))
        verdicts[group] = NumberVerdict(*group, *medians, trials, None, verdict, reason)
    copies = sum(side[group].copies for side in (before, after) for group in judged)
    if not gate.tested:
        for group in judged:
            beyond = _is_beyond(gate, before[group].values, after[group].values)
            verdicts[group] = replace(verdicts[group], verdict=WORSE if beyond else NO_WORSE)
        return GateVerdict(gate, None, tuple(verdicts.values()), copies)
    if not judged:
        return GateVerdict(gate, None, tuple(verdicts.values()), copies)
    sides = [(before[group].values, after[group].values) for group in judged]
    logarithms = [np.array([[*map(gate.logarithm, [*old, *new])]]) for old, new in sides]
    sizes = [(len(old), len(new)) for old, new in sides]
    if paired:
        _require_enough(gate, sum(old for old, _ in sizes), level)
    tested = _Tested(gate, logarithms, sizes, level, paired=paired)
    for place, group in enumerate(judged):
        verdict, reason = tested.verdict_of(place), ""
        asks_for_more = gate.deviations > 0.0 and len(judged) > 1
        if verdict == WORSE and asks_for_more and not _is_beyond(gate, *sides[place]):
            verdict, reason = UNDECIDED, f"within {gate.deviations:g} MAD"
        alone = _finite(gate, tested.alone[place])
        p, level_alone = tested.p_and_level_of(place)
        verdicts[group] = replace(
            verdicts[group],
            verdict=verdict,
            reason=reason,
            noticeable=alone,
            p=p,
            level=level_alone,
        )
    return GateVerdict(
        gate, tested.pooled, tuple(verdicts.values()), copies, paired, tested.advised()
    )


def _require_enough(gate: Gate, pairs: int, level: float) -> None:
    if is_enough(pairs, level):
        return
    needed = next(each for each in count() if is_enough(each, level))
    raise SettingsError(
        f"--paired: the gate '{gate}' has {counted(pairs, 'pair')} of trials, too few for its "
        f"level of {100 * level:g} % (the smallest p-value is 2^-{pairs}); use "
        f"{counted(needed, 'pair')} or remove --paired"
    )


class _Tested:
    """The tests of a gate, of the numbers that both comparisons have."""

    def __init__(
        self,
        gate: Gate,
        numbers: Sequence[Floats],
        sizes: Sequence[Size],
        level: float,
        *,
        paired: bool,
    ) -> None:
        self._paired = paired
        self._gate, self._numbers, self._sizes, self._level = gate, numbers, sizes, level
        moved = shifted(numbers, sizes, gate.margin)
        self._worse: GateOutcome
        self._better: GateOutcome
        if gate.spread_percent is None:
            self._worse = compare(moved, sizes, total=level, paired=paired)
            self._better = compare(moved, sizes, direction=-1.0, total=level, paired=paired)
            change = common_change(numbers, sizes, level, paired=paired)
            together, self.alone = math.inf, np.full(len(sizes), np.inf)
            if not paired:
                spreads = spreads_within(numbers, sizes)
                together = float(noticeable(spreads, sizes, gate.margin, level)[0])
                self.alone = noticeable_alone(spreads, sizes, gate.margin, level)[0]
        else:
            known = KnownSpread(gate.spread_percent / 100.0, sizes, level)
            self._worse, self._better = known.compare(moved), known.compare(moved, -1.0)
            change = known.common_change(numbers)
            together, self.alone = known.noticeable(gate.margin)
        self.pooled = PooledVerdict(
            count=len(sizes),
            verdict=_word(self._worse.pooled[0], self._better.pooled[0]),
            change=gate.change(change[0]),
            bounds=_bounds(gate, *change[1:]),
            noticeable=_finite(gate, together),
            p=float(self._worse.p_pooled[0]),
            level=self._worse.levels.pooled,
        )

    def p_and_level_of(self, place: int) -> tuple[float, float] | tuple[None, None]:
        """Return the p-value of a single number and its level; None if it is not tested."""
        if len(self._sizes) == 1:
            return self.pooled.p, self.pooled.level
        if not self._worse.levels.numbers:
            return None, None
        return float(self._worse.p_numbers[0, place]), float(self._worse.level_of_numbers[0])

    def verdict_of(self, place: int) -> str:
        """Return the verdict of a single number."""
        if len(self._sizes) == 1:
            return self.pooled.verdict
        word = _word(self._worse.numbers[0, place], self._better.numbers[0, place])
        if self._paired:
            levels = self._worse.levels
            is_judged = is_enough(self._sizes[place][0], levels.numbers)
        else:
            is_judged = bool(np.isfinite(self.alone[place]))
        return NOT_ALONE if word == UNDECIDED and not is_judged else word

    def advised(self) -> tuple[float, float, float] | None:
        """Return `GateVerdict.advised`."""
        if self._paired or np.isfinite(self.alone).any() or len(self._sizes) == 1:
            return None
        margin, sizes = self._gate.margin, [ADVISED] * len(self._sizes)
        spreads = spreads_within(self._numbers, self._sizes)
        together = noticeable(spreads, sizes, margin, self._level)
        alone = noticeable_alone(spreads, sizes, margin, self._level)[0]
        if np.isinf(alone).any():
            return None
        three = (float(together[0]), float(alone.min()), float(alone.max()))
        first, second, third = (abs(self._gate.change(each)) for each in three)
        return first, second, third


def _word(is_worse: Any, is_better: Any) -> str:
    return WORSE if is_worse else NO_WORSE if is_better else UNDECIDED


def _finite(gate: Gate, logarithm: float) -> float | None:
    return abs(gate.change(logarithm)) if np.isfinite(logarithm) else None


def _bounds(gate: Gate, low: float, high: float) -> tuple[float, float] | None:
    """Return the bounds of a logarithm as relative changes; None if one is infinite."""
    least, most = sorted(map(gate.change, (low, high)))
    return (least, most) if least > -1.0 and np.isfinite(most) else None


def _median(values: Sequence[float]) -> float | None:
    """Return the median, with failed trials as inf; None without trials."""
    if not values:
        return None
    ordered = sorted(values)
    return 0.5 * (ordered[(len(values) - 1) // 2] + ordered[len(values) // 2])


def _is_beyond(gate: Gate, before: Sequence[float], now: Sequence[float]) -> bool:
    """Return whether the new median exceeds margin and median absolute deviations."""
    finite = np.array([each for each in before if np.isfinite(each)])
    middle, after = float(np.median(finite)), _median(now)
    if after is None or np.isinf(after):
        return True
    deviation = gate.deviations * float(np.median(np.abs(finite - middle)))
    if gate.larger_is_worse:
        return after > middle * float(np.exp(gate.margin)) + deviation
    return after < middle * float(np.exp(-gate.margin)) - deviation
