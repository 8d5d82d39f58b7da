"""Jumps of GNSS fixes: periods in which the error between estimate and fixes steps away and back.

Multipath causes them without an increase of the fix's covariance; an estimate can cause them, too.
Flagged pairs stay in the evaluation and are left out of an additional result only.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS

_TIMES_MEDIAN = 5.0
_LONGEST_NS = 30 * NANOSECONDS


def jumps_of(stamps: Stamps, errors: Floats) -> Booleans:
    """Return which of the pairs are in a jump, (N,).

    A jump starts with a horizontal step of the error above five times the median step. It ends
    when the error is back within that distance of its value before the jump, or when later large
    steps have cancelled the first: a large jump rotates the alignment, so that the error drifts.
    A change that lasts 30 s is no jump.

    Args:
        stamps: (N,), nanoseconds, increasing.
        errors: (N, 3), groundtruth minus aligned estimate, metres, z up.
    """
    flags = np.zeros(len(errors), dtype=bool)
    level = errors[:, :2]
    moved = np.diff(level, axis=0)
    steps = np.hypot(*moved.T)
    if not len(steps):
        return flags
    limit = _TIMES_MEDIAN * float(np.median(steps))
    leaps = np.concatenate([[[0.0, 0.0]], np.cumsum(moved * (steps > limit)[:, None], axis=0)])
    past = 0
    for begin in np.flatnonzero(steps > limit).tolist():
        if begin < past:
            continue
        end = int(stamps.searchsorted(stamps[begin] + _LONGEST_NS))
        within = slice(begin + 1, end)
        near = np.hypot(*(level[within] - level[begin]).T) <= limit
        near |= np.hypot(*(leaps[within] - leaps[begin]).T) <= limit
        if near.any():
            past = begin + 1 + int(near.argmax())
            flags[begin + 1 : past] = True
    return flags
