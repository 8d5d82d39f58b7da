"""Which side made a step: not the one that moves smoothly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from trajeval_ros.metrics.discontinuities.events import ESTIMATE, GROUNDTRUTH, SIDES, UNDECIDED
from trajeval_ros.metrics.discontinuities.pose_stream import Innovation
from trajeval_ros.metrics.discontinuities.relative_motion import Size

GAP_PERIODS = 4.0  # a longer step of timestamps is a gap: the motion in it is unknown
# Innovation as a fraction of the step: a smooth side has none, a guilty one nearly all of it.
EXONERATES, _CONVICTS = 0.34, 0.5
_TIMES_USUAL = 3.0  # an innovation that is unusual for its side
_TIMES_OTHER = 3.0  # an innovation that is unusual next to the other side's
SLOWEST_S = 0.5  # a slower side does not show which one jumped


@dataclass(frozen=True)
class SideVerdict:
    """The side that made a step; "" if neither jumps."""

    side: str
    certainty: str
    innovations: tuple[float, float]  # as fractions of the step
    gap_s: float = 0.0  # gap of the guilty side


def guilty_side(
    innovations: Sequence[Innovation],
    scale: float,
    size: Size,
    parts: tuple[bool, bool],
) -> SideVerdict:
    """Return the side that made a step, by exoneration.

    `innovations`: of groundtruth and estimate. `scale`: metres per unit of the estimate. `parts`:
    whether the step is one of the position and of the rotation.
    """
    by_m, by_deg = parts
    m, deg = max(size.m, 1e-9), max(size.deg, 1e-9)
    shares, whole, odd, gaps = [], [], [], []
    periods_s = [innovation.period_s for innovation in innovations]
    for innovation, unit in zip(innovations, (1.0, scale), strict=True):
        is_whole = innovation.gap_s <= max(GAP_PERIODS * innovation.period_s, 1e-3)
        moved = unit * innovation.m
        whole.append(is_whole)
        gaps.append(0.0 if is_whole or math.isinf(innovation.gap_s) else innovation.gap_s)
        shares.append(max(moved / m if by_m else 0.0, innovation.deg / deg if by_deg else 0.0))
        least_m = max(EXONERATES * m, _TIMES_USUAL * unit * innovation.usual_m)
        least_deg = max(EXONERATES * deg, _TIMES_USUAL * innovation.usual_deg)
        is_odd = (by_m and moved > least_m) or (by_deg and innovation.deg > least_deg)
        odd.append(is_whole and is_odd)
    both = shares[0], shares[1]
    undecided = SideVerdict(UNDECIDED, UNDECIDED, both, max(gaps))
    free = [is_whole and share < EXONERATES for is_whole, share in zip(whole, both, strict=True)]
    if all(free):
        return SideVerdict("", "", both)
    if periods_s[0] > SLOWEST_S:
        return undecided
    if any(free):
        number = 1 if free[0] else 0
        is_sure = not whole[number] or both[number] > _CONVICTS
        return SideVerdict(SIDES[number], "sure" if is_sure else "likely", both, gaps[number])
    if not all(whole) or max(periods_s) > SLOWEST_S:
        return undecided
    if odd[0] != odd[1]:
        return SideVerdict(SIDES[int(odd[1])], "likely", both)
    if both[1] > _TIMES_OTHER * both[0]:
        return SideVerdict(ESTIMATE, "likely", both)
    if both[0] > _TIMES_OTHER * both[1]:
        return SideVerdict(GROUNDTRUTH, "likely", both)
    return undecided
