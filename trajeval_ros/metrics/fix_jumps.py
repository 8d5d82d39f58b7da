"""Jumps of fixes: stretches in which an estimate and its fixes are suddenly apart, and back again.

Multipath does that without a word in the fix's covariance, and so may an estimate. A flag is for a
second figure; nothing is dropped by it in silence.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS

_TIMES_MEDIAN = 5.0
_LONGEST_NS = 30 * NANOSECONDS


def jumps_of(stamps: Stamps, errors: Floats) -> Booleans:
    """Return which of the pairs lie in a jump, (N,).

    A jump begins with a level step of the error beyond five medians of such steps. It ends where
    the error is back within as much of where it was, or where such steps have undone the first:
    a large jump turns the alignment, under which the errors wander. A level that is kept for 30 s
    is believed.

    Args:
        stamps: (N,), nanoseconds, increasing.
        errors: (N, 3), groundtruth less aligned estimate, metres, z up.
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
