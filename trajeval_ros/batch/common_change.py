"""The common change of all numbers of a gate, with the confidence bounds of its pooled test."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from trajeval_ros.batch.gate_tests import (
    FALSE_ALARMS,
    RELABELLINGS,
    levels_of,
    mean_change,
    share_at_least,
    student,
    weight_of,
)
from trajeval_ros.batch.relabelling import (
    Scores,
    Size,
    contrast,
    contrasts,
    relabellings_of_all,
    scores_of,
    within_pairs,
)
from trajeval_ros.geometry.arrays import Floats

Change = tuple[float, float, float]


def common_change(
    numbers: Sequence[Floats],
    sizes: Sequence[Size],
    total: float = FALSE_ALARMS,
    *,
    paired: bool = False,
) -> Change:
    """Return the common change of one comparison, its lower and its upper bound, as logarithms.

    The bounds invert the pooled test: they are the shifts of new trials at which its verdict
    changes. So they agree with the verdict of the gate. Both are one-sided, at the pooled level.
    All shifts use the same relabellings. The bounds are infinite if the test can't reject.

    Args:
        numbers: Logarithms of the trials of every number, (1, old + new).
        sizes: Numbers of old and new trials, by number.
        total: Probability of a false alarm.
        paired: Whether the i-th old and the i-th new trial of a number are a pair.
    """
    levels = levels_of(sizes, total, paired=paired)
    changes = [float(mean_change(z, size)[0]) for z, size in zip(numbers, sizes, strict=True)]
    if levels.pooled_by == "none":
        return float(np.mean(changes)), -math.inf, math.inf
    finite = np.concatenate([z[np.isfinite(z)] for z in numbers])
    span = 20.0 * (1.0 + float(np.ptp(finite)))
    p_of: Callable[[float, float], float]
    if levels.pooled_by == "student":

        def p_of(shift: float, direction: float) -> float:
            return float(student(shifted(numbers, sizes, shift), sizes, direction)[0])

        estimate = float(np.mean(changes))
    else:
        test = _PooledTest(numbers, sizes, paired=paired)
        span = max(float(np.ptp(z[np.isfinite(z)])) for z in numbers) + 1e-6
        p_of = test.p
        estimate = _where_it_turns(-span, span, lambda shift: test.statistic(shift) > 0.0)
    if p_of(-span, 1.0) > levels.pooled:
        return estimate, -math.inf, math.inf
    low = _where_it_turns(-span, estimate, lambda shift: p_of(shift, 1.0) <= levels.pooled)
    high = _where_it_turns(estimate, span, lambda shift: p_of(shift, -1.0) > levels.pooled)
    return estimate, low, high


def shifted(numbers: Sequence[Floats], sizes: Sequence[Size], shift: float) -> list[Floats]:
    """Return the numbers with a shift subtracted from their new trials."""
    return [
        np.concatenate([z[:, :old], z[:, old:] - shift], axis=1)
        for z, (old, _) in zip(numbers, sizes, strict=True)
    ]


class _PooledTest:
    """The pooled test of one comparison for any shift, with the relabellings of `compare`."""

    def __init__(self, numbers: Sequence[Floats], sizes: Sequence[Size], *, paired: bool) -> None:
        random = np.random.default_rng(0)
        self._labels = relabellings_of_all(random, sizes, RELABELLINGS, paired=paired)
        self._numbers, self._sizes, self._paired = numbers, sizes, paired

    def _scores(self, shift: float) -> Scores:
        numbers = shifted(self._numbers, self._sizes, shift)
        return scores_of([within_pairs(z) for z in numbers] if self._paired else numbers)

    def statistic(self, shift: float) -> float:
        """Return the observed statistic after a shift of the new trials."""
        scores = self._scores(shift)
        return sum(
            weight_of(size) / float(scores.scales[0, place]) * float(contrast(psi, size)[0])
            for place, (psi, size) in enumerate(zip(scores.psi, self._sizes, strict=True))
        )

    def p(self, shift: float, direction: float) -> float:
        """Return the p-value after a shift of the new trials; `direction` as for `compare`."""
        scores = self._scores(shift)
        sums = sum(
            weight_of(size) / scores.scales[0, place] * contrasts(psi, size, self._labels[place])
            for place, (psi, size) in enumerate(zip(scores.psi, self._sizes, strict=True))
        )
        mine = np.array([direction * self.statistic(shift)])
        return float(share_at_least(direction * np.asarray(sums), mine)[0])


def _where_it_turns(low: float, high: float, is_below: Callable[[float], bool]) -> float:
    """Return by bisection where a condition that is true at `low` becomes false."""
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_below(middle) else (low, middle)
    return 0.5 * (low + high)
