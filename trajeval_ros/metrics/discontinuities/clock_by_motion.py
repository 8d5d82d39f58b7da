"""Forward steps of a clock without receive times, by the motion after a gap."""

from __future__ import annotations

import numpy as np

from trajeval_ros.metrics.discontinuities.open_step import GAP
from trajeval_ros.metrics.discontinuities.pose_stream import SidePoses
from trajeval_ros.metrics.discontinuities.relative_motion import RelativeMotion
from trajeval_ros.metrics.statistics import median

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
    first = max(stream.row_from(before_s + 1e-9) - 1, 1)
    gaps = np.flatnonzero(np.diff(stamps[first - 1 :]) > GAP * period_s)
    row = first + int(gaps[0]) if len(gaps) else len(stamps)
    if row >= len(stamps) or stamps[row - 1] >= after_s:
        return None
    rows = np.arange(row, stream.row_after(float(stamps[row]) + _MOTION_S))
    rows = rows[:: max(1, int(_EVERY_S / period_s))]
    if len(rows) < 4 or len(other) < 4:
        return None
    at = np.append(row - 1, rows)

    def differences(step_s: float) -> tuple[float, float, float] | None:
        """Return the medians of the differences, metres and deg, and of the motion, metres."""
        between, is_known = other.at(stamps[at] - np.where(at >= row, step_s, 0.0))
        if not is_known.all():
            return None
        sides = (between, stream.poses[at]) if number == 1 else (stream.poses[at], between)
        pairs = np.hstack([stamps[at, None], *sides])
        difference = motion.between(pairs[0], pairs[1:])
        m, deg, moved_m = (median(values) for values in difference[:3])
        return m, deg, moved_m

    as_read = differences(0.0)
    if as_read is None:
        return None
    whole_m, whole_deg, _ = as_read
    step_s = float(stamps[row] - stamps[row - 1]) - period_s
    best = None
    for size_s in step_s + period_s * np.arange(-2.0, 2.01, 0.5):
        shifted = differences(float(size_s))
        if shifted is None:
            continue
        rest_m, rest_deg, moved_m = shifted
        if best is None or rest_m < best[0]:
            best = rest_m, rest_deg, moved_m, float(size_s)
    if best is None:
        return None
    rest_m, rest_deg, moved_m, size_s = best
    agrees = rest_m < min(_EXPLAINED * whole_m, limit_m) and moved_m > _TIMES_MOVED * rest_m
    # Small rotations are noise.
    agrees &= rest_deg < (0.5 if whole_deg >= 3.0 else 1.5) * max(whole_deg, 1e-9)
    return (size_s, row) if agrees else None
