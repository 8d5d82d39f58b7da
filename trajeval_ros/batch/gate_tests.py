"""Statistical tests of a gate: of all numbers together, of single numbers, and of failed runs.

Arrays are defined in `relabelling`. The logarithm of the margin is already subtracted from new
trials, so all tests are one-sided tests against zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import stdtr

from trajeval_ros.batch.relabelling import (
    Size,
    balanced_count,
    contrast,
    contrasts,
    relabellings,
    relabellings_of_all,
    scores_of,
    studentised,
    within_pairs,
)
from trajeval_ros.geometry.arrays import Booleans, Floats

FALSE_ALARMS = 0.025
RELABELLINGS = 4000
_BY_RELABELLING = 0.72  # fraction of the level for single numbers, tested by relabelling
_BY_STUDENT = 0.32  # the same if they are tested by Student's test
ENOUGH = 1.15  # least product of relabellings and level with which a test can reject
_FLOOR = 0.3  # least standard deviation of a single number, relative to the typical one
_TIE = 1e-9  # relative: sums of the same terms in another order are equal

Way = Literal["relabelling", "student", "known", "none"]


@dataclass(frozen=True)
class Levels:
    """The significance levels of the tests of a gate.

    Attributes:
        total: Probability of a false alarm of all tests together.
        pooled: Level of the test of all numbers together.
        numbers: Level of the tests of all single numbers together; 0 if they are not tested.
        pooled_by: Method of the pooled test.
        numbers_by: Method of the tests of single numbers.
    """

    total: float
    pooled: float
    numbers: float
    pooled_by: Way
    numbers_by: Way


def levels_of(
    sizes: Sequence[Size], total: float = FALSE_ALARMS, *, paired: bool = False
) -> Levels:
    """Divide the level between the pooled test and the tests of single numbers.

    The pooled test gets the whole level if the trials are too few to test single numbers. If there
    are too few relabellings for the pooled test, it is Student's test, or there is none.

    Args:
        sizes: Numbers of old and new trials, by number.
        total: Probability of a false alarm.
        paired: Whether trials are pairs.
    """
    if paired:
        return _levels_of_pairs(sizes, total)
    counts = [math.comb(old + new, new) for old, new in sizes]
    share = 0.0
    way: Way = "none"
    if len(sizes) > 1 and max(counts) * _BY_RELABELLING * total >= ENOUGH:
        share, way = _BY_RELABELLING * total, "relabelling"
    elif len(sizes) > 1 and any(min(each) > 1 for each in sizes):
        share, way = _BY_STUDENT * total, "student"
    if math.log(total - share) + sum(map(math.log, counts)) < 0.0:
        alone: Way = "none" if _is_one_trial(sizes) else "student"
        return Levels(total, total, 0.0, alone, "none")
    return Levels(total, total - share, share, "relabelling", way)


def _levels_of_pairs(sizes: Sequence[Size], total: float) -> Levels:
    pairs = sum(old for old, _ in sizes)
    share = _BY_RELABELLING * total
    alone = len(sizes) > 1 and is_enough(max(old for old, _ in sizes), share)
    if alone and is_enough(pairs, total - share):
        return Levels(total, total - share, share, "relabelling", "relabelling")
    return Levels(total, total, 0.0, "relabelling" if is_enough(pairs, total) else "none", "none")


def is_enough(pairs: int, level: float) -> bool:
    """Return whether a sign-flip test of this number of pairs can reach a level."""
    return 2.0**pairs * level >= ENOUGH


def levels_when_known(numbers: int, total: float) -> Levels:
    """Divide the level as `levels_of` does, for a known spread of the trials.

    Args:
        numbers: How many numbers there are.
        total: Probability of a false alarm.
    """
    if numbers == 1:
        return Levels(total, total, 0.0, "known", "none")
    share = _BY_RELABELLING * total
    return Levels(total, total - share, share, "known", "known")


def _is_one_trial(sizes: Sequence[Size]) -> bool:
    return len(sizes) == 1 and min(sizes[0]) < 2


@dataclass(frozen=True)
class GateOutcome:
    """The p-values of the tests of a gate.

    Attributes:
        levels: Significance levels.
        p_pooled: p-values of the pooled test, (comparisons,).
        p_numbers: p-values of single numbers, adjusted for multiple testing,
            (comparisons, numbers).
    """

    levels: Levels
    p_pooled: Floats
    p_numbers: Floats

    @property
    def pooled(self) -> Booleans:
        """Whether the pooled test rejects, (comparisons,)."""
        return self.p_pooled <= self.levels.pooled

    @property
    def level_of_numbers(self) -> Floats:
        """Level of single numbers, (comparisons,).

        If the pooled test rejects, its level is available to single numbers, too.
        """
        return np.where(self.pooled, self.levels.total, self.levels.numbers)

    @property
    def numbers(self) -> Booleans:
        """Whether the tests of single numbers reject, (comparisons, numbers)."""
        if not self.levels.numbers:
            return np.zeros(self.p_numbers.shape, dtype=np.bool_)
        return self.p_numbers <= self.level_of_numbers[:, None]


def compare(
    numbers: Sequence[Floats],
    sizes: Sequence[Size],
    *,
    direction: float = 1.0,
    total: float = FALSE_ALARMS,
    paired: bool = False,
    count: int = RELABELLINGS,
    random: np.random.Generator | None = None,
) -> GateOutcome:
    """Test whether new trials are worse than old ones.

    Args:
        numbers: Logarithms of the trials of every number, (comparisons, old + new).
        sizes: Numbers of old and new trials, by number.
        direction: 1 tests whether new trials are worse, -1 whether they are better.
        total: Probability of a false alarm.
        paired: Whether the i-th old and the i-th new trial of a number are a pair.
        count: Number of relabellings.
        random: Generator for relabellings; by default one with a fixed seed.
    """
    random = random or np.random.default_rng(0)
    levels = levels_of(sizes, total, paired=paired)
    shape = (len(numbers[0]), len(numbers))
    if levels.pooled_by != "relabelling":
        p = np.ones(shape[0])
        if levels.pooled_by == "student":
            p = student(numbers, sizes, direction)
        return GateOutcome(levels, p, np.ones(shape))
    scores = scores_of([within_pairs(z) for z in numbers] if paired else numbers)
    labels_of = relabellings_of_all(random, sizes, count, paired=paired)
    count = len(labels_of[0])
    single = levels.numbers_by == "relabelling"
    observed, sums = np.empty(shape), np.zeros((shape[0], count))
    mine, largest = np.zeros(shape[0]), np.full((shape[0], count), -np.inf)
    for place, (psi, size) in enumerate(zip(scores.psi, sizes, strict=True)):
        labels = labels_of[place]
        own = direction * contrast(psi, size)
        others = direction * contrasts(psi, size, labels)
        weight = weight_of(size) / scores.scales[:, place]
        mine += weight * own
        sums += weight[:, None] * others
        if single:
            ratio = scores.typical / scores.scales[:, place]
            observed[:, place] = studentised(own[:, None], psi, size, ratio)[:, 0]
            np.maximum(largest, studentised(others, psi, size, ratio), out=largest)
    p_pooled = share_at_least(sums, mine)
    p_numbers = np.ones(shape)
    if single:
        # Comparison with the largest t of all numbers (max-T) adjusts for multiple testing.
        for place in range(shape[1]):
            p_numbers[:, place] = share_at_least(largest, observed[:, place])
    elif levels.numbers_by == "student":
        p_numbers = _student_of_each(numbers, sizes, direction)
    return GateOutcome(levels, p_pooled, p_numbers)


def weight_of(size: Size) -> float:
    """Return the weight of a difference of means, proportional to its inverse variance."""
    old, new = size
    return old * new / (old + new)


def share_at_least(values: Floats, least: Floats) -> Floats:
    """Return the p-values of a permutation test, (comparisons,).

    Args:
        values: Statistics under relabellings, (comparisons, count).
        least: Observed statistics, (comparisons,), which count as one more relabelling.
    """
    edge = least - _TIE * (1.0 + np.abs(least))
    made: Floats = (1.0 + (values >= edge[:, None]).sum(1)) / (values.shape[1] + 1.0)
    return made


def _student_of_each(numbers: Sequence[Floats], sizes: Sequence[Size], direction: float) -> Floats:
    """Return Bonferroni-adjusted p-values of Student's test, (comparisons, numbers)."""
    deviations = [_deviation_within(z, size) for z, size in zip(numbers, sizes, strict=True)]
    typical = np.median(deviations, axis=0)
    each = [
        student([z], [size], direction, least=_FLOOR * typical)
        if min(size) > 1
        else np.ones(len(z))
        for z, size in zip(numbers, sizes, strict=True)
    ]
    judged = sum(min(size) > 1 for size in sizes)
    return np.minimum(1.0, np.stack(each, axis=1) * judged)


def with_worst(z: Floats) -> Floats:
    """Return trials (comparisons, trials) with failed ones replaced by the worst of the number."""
    fine = np.isfinite(z)
    worst = np.where(fine, z, -np.inf).max(1, keepdims=True)
    return np.where(fine, z, np.where(np.isfinite(worst), worst, 0.0))


def _squares_within(z: Floats, size: Size) -> Floats:
    old = size[0]
    sides = (z[:, :old], z[:, old:])
    made: Floats = sum(((side - side.mean(1, keepdims=True)) ** 2).sum(1) for side in sides)
    return made


def _deviation_within(z: Floats, size: Size) -> Floats:
    made: Floats = np.sqrt(_squares_within(with_worst(z), size) / max(sum(size) - 2, 1))
    return made


def mean_change(z: Floats, size: Size) -> Floats:
    """Return the mean of new trials minus the mean of old ones, (comparisons,)."""
    return contrast(with_worst(z), size)


def student(
    numbers: Sequence[Floats],
    sizes: Sequence[Size],
    direction: float = 1.0,
    *,
    least: Floats | None = None,
) -> Floats:
    """Return p-values of Student's test, (comparisons,); used if relabellings are too few.

    The variance is estimated within numbers. If all have one trial per side, it is estimated from
    the changes of the numbers. Differences of exchangeable trials are symmetric, so heavy tails
    make the test conservative.

    Args:
        numbers: As for `compare`.
        sizes: As for `compare`.
        direction: As for `compare`.
        least: For a single number: lower limit of its standard deviation, (comparisons,). The
            degrees of freedom are then those of its smaller side, because a side with few trials
            may lack an outlier by chance.
    """
    means = np.stack(
        [mean_change(z, size) for z, size in zip(numbers, sizes, strict=True)], axis=1
    )
    amount, inner = len(sizes), sum(sum(size) - 2 for size in sizes)
    if inner == 0:
        error, degrees = means.std(1, ddof=1) / math.sqrt(amount), amount - 1
    else:
        squares = sum(
            _squares_within(with_worst(z), size) for z, size in zip(numbers, sizes, strict=True)
        )
        variance = squares / inner * sum(1.0 / old + 1.0 / new for old, new in sizes)
        error, degrees = np.sqrt(variance) / amount, inner
    if least is not None:
        old, new = sizes[0]
        error = np.maximum(error, least * math.sqrt(1.0 / old + 1.0 / new))
        degrees = 2 * min(old, new) - 2
    change = direction * means.mean(1)
    # Without spread (a coverage of 100 % in all trials) there is no test.
    t = np.divide(change, error, out=np.zeros_like(change), where=error > 0.0)
    made: Floats = np.where(error > 0.0, stdtr(degrees, -t), 1.0)
    return made


def more_failures(before: Sequence[Booleans], now: Sequence[Booleans]) -> float:
    """Return the p-value of the hypothesis that new runs do not fail more often.

    It is a permutation test, stratified by number, with the weights of Mantel and Haenszel.

    Args:
        before: Whether old runs failed, (old,) by number.
        now: Whether new runs failed, (new,) by number.
    """
    random = np.random.default_rng(0)
    sizes = [(len(old), len(new)) for old, new in zip(before, now, strict=True)]
    count = max((balanced_count(RELABELLINGS, size) for size in sizes), default=1)
    mine, sums = np.zeros(1), np.zeros((1, count))
    for old, new, size in zip(before, now, sizes, strict=True):
        failed = np.concatenate([old, new]).astype(np.float64)[None]
        mine += weight_of(size) * contrast(failed, size)
        sums += weight_of(size) * contrasts(failed, size, relabellings(random, size, count))
    return float(share_at_least(sums, mine)[0])
