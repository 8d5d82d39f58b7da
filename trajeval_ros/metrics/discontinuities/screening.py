"""A fast test of recorded runs: whether any motion is unusual enough to be a discontinuity.

The search takes about 0.1 ms per pair, which is more than the whole evaluation. Most recordings
have no motion that it would examine, which columns of all pairs show in a hundredth of the time.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps, lengths
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.discontinuities.open_step import GAP
from trajeval_ros.metrics.discontinuities.stamp_steps import SMALLEST_S
from trajeval_ros.metrics.discontinuities.usual_differences import LEAST_DEG, LEAST_M
from trajeval_ros.metrics.statistics import median

_FEW_PAIRS = 500  # the search takes no noticeable time
_BLOCK = 240  # pairs with a common median: as many as the search remembers
# Multiple of the median: fewer than the 6 of the search, since the alignment of all pairs is less
# exact than the search's own.
_OF_MEDIAN = 4.0


def may_have_events(
    pairs: Association, similarity: Similarity, groundtruth: Trajectory, estimate: Trajectory
) -> bool:
    """Return whether the search for discontinuities can have a result.

    `groundtruth`, `estimate`: in the order of their sources. `similarity`: aligns the pairs.
    """
    if len(pairs) < _FEW_PAIRS:
        return True
    sides = groundtruth, estimate
    if any(_has_irregular_stamps(side) or _has_repeats(side) for side in sides):
        return True
    true, aligned = pairs.groundtruth, similarity.trajectory(pairs.estimate)
    roots = _roots_of_steps(true.stamps)
    changes = np.diff(true.positions - aligned.positions, axis=0)
    if _is_unusual(lengths(changes), roots, LEAST_M):
        return True
    if true.quaternions is None or aligned.quaternions is None:
        return False
    errors = lie.multiply(lie.conjugate(true.quaternions), aligned.quaternions)
    cosines = np.abs(np.einsum("ni,ni->n", errors[1:], errors[:-1]))
    angles = np.degrees(2.0 * np.arccos(np.minimum(cosines, 1.0)))
    return _is_unusual(angles, roots, LEAST_DEG)


def _has_irregular_stamps(side: Trajectory) -> bool:
    """Return whether timestamps go back, or differ from regular receive times."""
    steps = np.diff(side.stamps)
    if steps.min(initial=1) <= 0:
        return True
    received = side.reading.receive_times
    if received is None:
        return False
    more = steps - np.diff(received.times)
    return bool(np.abs(more).max(initial=0) > SMALLEST_S * NANOSECONDS)


def _has_repeats(side: Trajectory) -> bool:
    """Return whether a part of a pose is repeated, but for a rotation that never changes."""
    parts = [side.positions] if side.quaternions is None else [side.positions, side.quaternions]
    repeats = [(part[1:] == part[:-1]).all(axis=1) for part in parts]
    return bool(repeats[0].any() or (repeats[-1].any() and not repeats[-1].all()))


def _roots_of_steps(stamps: Stamps) -> Floats:
    """Return the roots of the steps (N - 1,) over the usual step, 1 for steps without a gap.

    Differences grow with the root of the time.
    """
    steps = np.diff(stamps).astype(np.float64)
    ratios = steps / max(median(steps), 1.0)
    return np.sqrt(np.where(ratios > GAP, ratios, 1.0))


def _is_unusual(changes: Floats, roots: Floats, least: float) -> bool:
    """Return whether a change (N,) exceeds the limit about it; `least`: the smallest limit."""
    for begin in range(0, len(changes), _BLOCK):
        block = changes[max(0, min(begin, len(changes) - _BLOCK)) : begin + _BLOCK]
        limit = max(least, _OF_MEDIAN * median(block))
        rows = slice(begin, begin + _BLOCK)
        if (changes[rows] > limit * roots[rows]).any():
            return True
    return False
