"""Permutation tests: relabellings of trials, and scores of trials that do not depend on labels.

A *number* is a metric of one algorithm on one sequence. Its trials are logarithms of the metric,
in an array (comparisons, old + new) with old trials first. A gate has one comparison, a simulation
of the tests has many. A failed trial is +inf.

The null hypothesis is that nothing changed. Then the labels "old" and "new" are exchangeable
within every number, for any distribution of the trials. So the values of a statistic under
relabellings are its null distribution. If trials are pairs (the i-th old and the i-th new trial
have the same seed), labels are exchangeable only within pairs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats

Size = tuple[int, int]

PRIOR = 4.0  # weight of the typical spread in `shrunk`, in degrees of freedom
CLIP = 1.5  # largest score, in spreads; a failed trial has this score
_NORMAL = 1.2533  # standard deviation / mean absolute deviation of a normal distribution
LEAST_SPREAD = 1e-12


@dataclass(frozen=True)
class Scores:
    """Scores of trials: deviations from the median of the number, in spreads, clipped.

    Attributes:
        psi: Scores within +-1.5, (comparisons, trials) by number.
        scales: Spreads, shrunk towards the typical one, (comparisons, numbers).
        typical: Median spread of all numbers, (comparisons,).
    """

    psi: list[Floats]
    scales: Floats
    typical: Floats


def balanced_count(count: int, size: Size) -> int:
    """Return the number of relabellings to use.

    It is `count`, or, if there are no more than `count` different ones, the next multiple of them.
    """
    total = math.comb(sum(size), size[1])
    return total * -(-count // total) if total <= count else count


def relabellings_of_all(
    random: np.random.Generator, sizes: Sequence[Size], count: int, *, paired: bool
) -> list[Booleans]:
    """Return relabellings of every number, (relabellings, old + new), True for new.

    All numbers have the same number of relabellings, at least `count`.
    """
    if paired:
        return _swaps(random, [old for old, _ in sizes], count)
    count = max(balanced_count(count, size) for size in sizes)
    return [relabellings(random, size, count) for size in sizes]


def within_pairs(z: Floats) -> Floats:
    """Return trials minus the mean of their pair, (comparisons, old + new).

    This removes the effect of the common seed. A swap of old and new only flips the signs. In a
    pair with one failed run, this run is +inf and the other -inf. If both failed, both are 0.
    """
    old, new = np.split(z, 2, axis=1)
    failed = np.isinf(old) & np.isinf(new)
    half = 0.5 * (np.where(failed, 0.0, new) - np.where(failed, 0.0, old))
    return np.concatenate([-half, half], axis=1)


def _swaps(random: np.random.Generator, pairs: Sequence[int], count: int) -> list[Booleans]:
    """Return relabellings that swap old and new within pairs.

    If there are no more than `count` of all numbers together, all occur, equally often.
    """
    amount = sum(pairs)
    if 2**amount <= count:
        every = (np.arange(2**amount)[:, None] >> np.arange(amount)) & 1 == 1
        swapped = np.tile(every, (-(-count // 2**amount), 1))
    else:
        swapped = random.random((count, amount)) < 0.5
    parts = np.split(swapped, np.cumsum(pairs)[:-1], axis=1)
    return [np.concatenate([part, ~part], axis=1) for part in parts]


def relabellings(random: np.random.Generator, size: Size, count: int) -> Booleans:
    """Return relabellings of one number, (count, old + new), True for new.

    If there are no more than `count` different ones, all occur equally often, in random order.
    Otherwise the smallest p-value, such as 1/70, would be random, above or below the level.
    """
    old, new = size
    total = math.comb(old + new, new)
    if total <= count:
        every = np.zeros((total, old + new), dtype=np.bool_)
        for row, chosen in enumerate(combinations(range(old + new), new)):
            every[row, list(chosen)] = True
        times = -(-count // total)
        rows = np.concatenate([random.permutation(total) for _ in range(times)])[:count]
        balanced: Booleans = every[rows]
        return balanced
    chosen_new = random.random((count, old + new)).argpartition(new - 1, axis=1)[:, :new]
    made = np.zeros((count, old + new), dtype=np.bool_)
    np.put_along_axis(made, chosen_new, True, axis=1)
    return made


def median_of_finite(values: Floats) -> Floats:
    """Return medians of the finite values over the last axis; +inf if there are none."""
    fine = np.isfinite(values)
    count = fine.sum(-1)
    ordered = np.sort(np.where(fine, values, np.inf), axis=-1)
    places = np.stack([np.maximum(count - 1, 0) // 2, count // 2], axis=-1)
    places = np.minimum(places, values.shape[-1] - 1)
    middle: Floats = np.take_along_axis(ordered, places, axis=-1).mean(-1)
    return middle


def centre_and_spread(values: Floats) -> tuple[Floats, Floats]:
    """Return medians and spreads of finite values over the last axis.

    The spread is the mean absolute deviation about the median, scaled to the standard deviation
    of a normal distribution. It does not depend on labels, so permutation tests are exact.
    """
    fine = np.isfinite(values)
    middle = np.where(fine.any(-1), median_of_finite(values), 0.0)
    count = np.maximum(fine.sum(-1), 2)
    away = np.abs(np.where(fine, values - middle[..., None], 0.0)).sum(-1) / count
    # For a normal distribution, the expected mean absolute deviation about the sample median is
    # equal for 2k and 2k + 1 values.
    even = count - count % 2
    return middle, _NORMAL * np.sqrt(even / (even - 1.0)) * away


def scores_of(numbers: Sequence[Floats]) -> Scores:
    """Return the clipped scores of the trials of all numbers."""
    parts = [centre_and_spread(z) for z in numbers]
    raw = np.stack([spread for _, spread in parts], axis=1)
    typical = median_of_finite(np.where(raw > 0.0, raw, np.inf))
    typical = np.where(np.isfinite(typical), typical, LEAST_SPREAD)
    weights = np.array([z.shape[1] - 1.0 for z in numbers])
    scales = shrunk(raw, typical[:, None], weights)
    psi = [
        np.clip((z - middle[:, None]) / scales[:, place, None], -CLIP, CLIP)
        for place, (z, (middle, _)) in enumerate(zip(numbers, parts, strict=True))
    ]
    return Scores(psi, scales, typical)


def shrunk(spreads: Floats, typical: Floats, degrees: Floats) -> Floats:
    """Return spreads shrunk towards the typical one: the fewer trials, the more.

    Args:
        spreads: Spreads, (comparisons, numbers).
        typical: Typical spread, (comparisons, 1).
        degrees: Degrees of freedom of the spreads, (numbers,).
    """
    made: Floats = np.sqrt((PRIOR * typical**2 + degrees * spreads**2) / (PRIOR + degrees))
    return made


def contrast(psi: Floats, size: Size) -> Floats:
    """Return the mean of new scores minus the mean of old ones, (comparisons,)."""
    old = size[0]
    made: Floats = psi[:, old:].mean(1) - psi[:, :old].mean(1)
    return made


def contrasts(psi: Floats, size: Size, labels: Booleans) -> Floats:
    """Return `contrast` for all relabellings, (comparisons, relabellings)."""
    old, new = size
    chosen: Floats = psi @ labels.T.astype(np.float64)
    made: Floats = chosen / new - (psi.sum(1, keepdims=True) - chosen) / old
    return made


def studentised(differences: Floats, psi: Floats, size: Size, ratio: Floats) -> Floats:
    """Return t statistics of contrasts, with a spread that is shrunk towards the typical one.

    Args:
        differences: Contrasts, (comparisons, K).
        psi: Scores, (comparisons, trials).
        size: Numbers of old and new trials.
        ratio: Typical spread divided by the spread of the number, (comparisons,).
    """
    old, new = size
    harmonic = old * new / (old + new)
    squares = ((psi - psi.mean(1, keepdims=True)) ** 2).sum(1)[:, None]
    within = np.maximum(squares - harmonic * differences**2, 0.0)
    variance = (PRIOR * ratio[:, None] ** 2 + within) / (PRIOR + old + new - 2.0)
    made: Floats = math.sqrt(harmonic) * differences / np.sqrt(variance + 1e-300)
    return made
