"""The noticeable worsening: a gate detects it with a probability (power) of 80 %."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import nctdtrinc, stdtrit

from trajeval_ros.batch.gate_tests import ENOUGH, FALSE_ALARMS, levels_of
from trajeval_ros.batch.relabelling import (
    LEAST_SPREAD,
    PRIOR,
    Size,
    centre_and_spread,
    median_of_finite,
    shrunk,
)
from trajeval_ros.geometry.arrays import Floats

POWER = 0.8
_EFFICIENCY = 0.85  # statistical efficiency of clipped scores, by simulation


def noticeable(
    spreads: Floats,
    sizes: Sequence[Size],
    margin: float,
    total: float = FALSE_ALARMS,
) -> Floats:
    """Return the noticeable common worsening of all numbers as a logarithm, (comparisons,).

    Args:
        spreads: Standard deviations by `spreads_within`, (comparisons, numbers).
        sizes: Numbers of old and new trials, by number.
        margin: Logarithm of the margin.
        total: Probability of a false alarm.

    Returns:
        The worsening, including the margin; inf if the trials are too few for a test.
    """
    levels = levels_of(sizes, total)
    runs = len(spreads)
    if levels.pooled_by == "none":
        return np.full(runs, np.inf)
    inverse = np.array([1.0 / old + 1.0 / new for old, new in sizes])
    degrees = sum(sum(size) - 2 for size in sizes) or len(sizes) - 1
    if levels.pooled_by == "student":
        error = np.sqrt((spreads**2 * inverse).sum(1)) / len(sizes)
    else:
        error = 1.0 / np.sqrt(_EFFICIENCY * (1.0 / (inverse * spreads**2)).sum(1))
    made: Floats = margin + _reach(levels.pooled, degrees, degrees) * error
    return made


def noticeable_alone(
    spreads: Floats,
    sizes: Sequence[Size],
    margin: float,
    total: float = FALSE_ALARMS,
) -> Floats:
    """Return the noticeable worsening of single numbers as logarithms, (comparisons, numbers).

    The arguments are those of `noticeable`. Numbers that are not tested have inf.
    """
    if len(sizes) == 1:
        return noticeable(spreads, sizes, margin, total)[:, None]
    levels = levels_of(sizes, total)
    made = np.full((len(spreads), len(sizes)), np.inf)
    if not levels.numbers:
        return made
    by_student = levels.numbers_by == "student"
    for place, (old, new) in enumerate(sizes):
        enough = by_student or math.comb(old + new, new) * levels.numbers >= ENOUGH
        if min(old, new) > 1 and enough:
            inner = old + new - 2.0
            judged, known = inner + PRIOR, inner + PRIOR
            if by_student:
                judged, known = 2.0 * min(old, new) - 2.0, inner
            reach = _reach(levels.numbers / len(sizes), judged, known)
            made[:, place] = margin + reach * spreads[:, place] * math.sqrt(1.0 / old + 1.0 / new)
    return made


def _reach(level: float, judged: float, known: float) -> float:
    """Return the change that Student's test detects with power `POWER`, in standard errors.

    Args:
        level: Significance level of the one-sided test.
        judged: Degrees of freedom of the critical value.
        known: Degrees of freedom of the estimated spread, so of the noncentral t distribution.
    """
    return float(nctdtrinc(known, 1.0 - POWER, -stdtrit(judged, level)))


def spreads_within(numbers: Sequence[Floats], sizes: Sequence[Size]) -> Floats:
    """Return spreads about the medians of the two sides, (comparisons, numbers).

    They are shrunk towards the typical spread. The scales of `Scores` can't be used, because they
    are about one median of both sides, so a true change increases them.
    """
    raw = []
    for z, (old, _) in zip(numbers, sizes, strict=True):
        sides = [side for side in (z[:, :old], z[:, old:]) if side.shape[1] > 1] or [z]
        weights = np.array([side.shape[1] - 1.0 for side in sides])
        spreads = np.stack([centre_and_spread(side)[1] for side in sides], axis=1)
        raw.append(np.sqrt((weights * spreads**2).sum(1) / weights.sum()))
    stacked: Floats = np.maximum(np.stack(raw, axis=1), LEAST_SPREAD)
    if len(sizes) == 1:
        return stacked
    typical = median_of_finite(stacked)[:, None]
    return shrunk(stacked, typical, np.array([max(sum(size) - 2.0, 1.0) for size in sizes]))
