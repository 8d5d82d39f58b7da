"""Coverage: how much of the groundtruth's time the pairs span. It stands beside every ATE."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS


def coverage_of(
    pair_stamps: Indices, truth_time: int, truth_count: int, max_gap_s: float
) -> float:
    """Return the share of the groundtruth's time that pairs span.

    Pairs no further apart than the maximum gap, or than twice the usual step of sparse keyframes,
    span the time between them. Of groundtruth that is all gaps, it is the share of states.

    Args:
        pair_stamps: (N,) of the pairs, nanoseconds.
        truth_time: The groundtruth's time that pairs can span, nanoseconds: the sum of its steps
            that are no gaps, or all of it where gaps are paired in.
        truth_count: Number of groundtruth states.
        max_gap_s: Longest step that is no gap.
    """
    if truth_time == 0:
        return min(1.0, len(pair_stamps) / truth_count)
    steps = np.diff(np.sort(pair_stamps))
    limit = round(max_gap_s * NANOSECONDS)
    if len(steps):
        limit = max(limit, 2 * int(np.median(steps)))
    return min(1.0, float(steps[steps <= limit].sum() / truth_time))


def time_without_gaps(stamps: Indices, max_gap_s: float) -> int:
    """Return the sum of the steps between sorted stamps that are no gaps, nanoseconds."""
    steps = stamps[1:] - stamps[:-1]
    return int(steps[steps <= round(max_gap_s * NANOSECONDS)].sum())
