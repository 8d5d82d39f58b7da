"""Forward steps of a clock without receive times, by the motion after a gap."""

from __future__ import annotations

import bisect

import numpy as np

from trajeval_ros.metrics.discontinuities.pose_stream import SidePoses
from trajeval_ros.metrics.discontinuities.relative_motion import (
    Difference,
    Pair,
    RelativeMotion,
)

_MOTION_S = 3.0  # motion after the gap that is compared
_EVERY_S = 0.2
_EXPLAINED = 0.2  # of the difference, at the step
_TIMES_MOVED = 3.0  # the motion exceeds the rest by this: a robot at rest agrees with any step


def clock_by_motion(
    stream: SidePoses,
    other: SidePoses,
    number: int,
    before_s: float,
    after_s: float,
    period_s: float,
    motion: RelativeMotion,
    limit_m: float,
) -> tuple[float, int] | None:
    """Return the size of a clock step, seconds, and the first row after it; None without one.

    Args:
        stream: The side whose clock is tested.
        other: The other side.
        number: 0 if the tested side is the groundtruth.
        before_s: Last time before the gap.
        after_s: Latest time after the gap.
        period_s: Usual step of the tested timestamps.
        motion: The relative motion of the sides.
        limit_m: Largest usual difference of such a motion.
    """
    stamps = stream.stamps
    row = max(bisect.bisect_left(stamps, before_s + 1e-9) - 1, 1)
    while row < len(stamps) and stamps[row] - stamps[row - 1] <= 2.5 * period_s:
        row += 1
        if stamps[row - 1] >= after_s:
            return None
    if row >= len(stamps) or stamps[row - 1] >= after_s:
        return None
    rows = [at for at in range(row, len(stamps)) if stamps[at] - stamps[row] <= _MOTION_S]
    rows = rows[:: max(1, int(_EVERY_S / period_s))]
    if len(rows) < 4 or len(other) < 4:
        return None

    def differences(step_s: float) -> list[Difference] | None:
        at = [row - 1, *rows]
        times = np.array([stamps[each] - (step_s if each >= row else 0.0) for each in at])
        positions, quaternions, is_known = other.at(times)
        if not is_known.all():
            return None
        pairs = []
        for index, each in enumerate(at):
            between = tuple(positions[index].tolist()), tuple(quaternions[index].tolist())
            tested = stream.positions[each], stream.quaternions[each]
            sides = (between, tested) if number == 1 else (tested, between)
            pairs.append(Pair(stamps[each], *sides[0], *sides[1]))
        return [motion.between(pairs[0], pair) for pair in pairs[1:]]

    as_read = differences(0.0)
    if as_read is None:
        return None
    whole_m, whole_deg, _ = _medians(as_read)
    step_s = stamps[row] - stamps[row - 1] - period_s
    best = None
    for size_s in step_s + period_s * np.arange(-2.0, 2.01, 0.5):
        shifted = differences(float(size_s))
        if shifted is None:
            continue
        rest_m, rest_deg, moved_m = _medians(shifted)
        if best is None or rest_m < best[0]:
            best = rest_m, rest_deg, moved_m, float(size_s)
    if best is None:
        return None
    rest_m, rest_deg, moved_m, size_s = best
    agrees = rest_m < min(_EXPLAINED * whole_m, limit_m) and moved_m > _TIMES_MOVED * rest_m
    # Small rotations are noise.
    agrees &= rest_deg < (0.5 if whole_deg >= 3.0 else 1.5) * max(whole_deg, 1e-9)
    return (size_s, row) if agrees else None


def _medians(differences: list[Difference]) -> tuple[float, float, float]:
    m, deg, moved_m = np.median(np.array(differences), axis=0)
    return float(m), float(deg), float(moved_m)
