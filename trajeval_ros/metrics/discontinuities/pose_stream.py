"""One side's poses with corrected timestamps, and how smooth they are."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.metrics.discontinuities.relative_motion import Quaternion, Vector
from trajeval_ros.metrics.discontinuities.stamp_steps import Message, StampSteps

_SAME = 1e-9  # largest difference of repeated numbers
FROZEN_S = 1.0  # an estimate at 2 Hz that is published at a higher rate repeats a pose for 0.5 s
# Poses before an interval that give the usual innovation, and that are kept to know a gap.
_BEFORE, _AFTER = 30, 3


@dataclass
class Repeats:
    """An interval in which a part of the pose is repeated exactly."""

    part: str  # `position` or `rotation`
    begin_s: float
    end_s: float
    is_over: bool = False


@dataclass(frozen=True)
class Innovation:
    """Largest change of a side's own velocity within an interval, as a displacement."""

    m: float
    deg: float
    gap_s: float  # longest step of the timestamps; infinite if too few poses are known
    usual_m: float
    usual_deg: float


class SidePoses:
    """The poses of one side, without repeated ones, so that a frozen pose is a gap."""

    def __init__(self, *, oriented: bool) -> None:
        self.clock = StampSteps()
        self.stamps: list[float] = []
        self.positions: list[Vector] = []
        self.quaternions: list[Quaternion] = []
        self.repeats: list[Repeats] = []  # of at least `FROZEN_S`, or not over
        self.newest_s = -math.inf
        self._oriented = oriented
        self._has_rotated = False

    def __len__(self) -> int:
        """Return the number of stored poses."""
        return len(self.stamps)

    def store(self, message: Message) -> None:
        """Store a pose with a corrected timestamp; late, repeated and invalid ones are not."""
        stamp, pose, _ = message
        if stamp <= self.newest_s:
            return
        position: Vector = (pose[0], pose[1], pose[2])
        quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
        if self._oriented:
            length = math.sqrt(sum(value * value for value in pose[3:7]))
            if not math.isfinite(length) or length == 0.0:
                return
            x, y, z, w = (value / length for value in pose[3:7])
            quaternion = (x, y, z, w)
        if not math.isfinite(sum(position)):
            return
        if self.stamps:
            before_s = max(self.newest_s, self.stamps[-1])
            held = _is_same(position, self.positions[-1])
            stands = self._oriented and _is_same(quaternion, self.quaternions[-1])
            self._has_rotated |= self._oriented and not stands
            # A sensor without orientation may write the identity.
            stands &= self._has_rotated
            self._repeat("position", before_s, stamp, is_same=held)
            self._repeat("rotation", before_s, stamp, is_same=stands)
            if held or stands:
                self.newest_s = stamp
                return
        self.newest_s = stamp
        self.stamps.append(stamp)
        self.positions.append(position)
        self.quaternions.append(quaternion)

    def store_all(self, stamps: Floats, poses: Floats) -> bool:
        """Store poses (N, 7) with increasing stamps (N,), if all of them are valid and moving.

        The result is that of `store`, pose by pose; False if that is needed.
        """
        if not self.stamps or stamps[0] <= self.newest_s:
            return False
        if any(not interval.is_over for interval in self.repeats):
            return False
        positions = poses[:, :3]
        last = np.array(self.positions[-1])
        moved = np.abs(np.diff(positions, axis=0, prepend=last[None])).max(axis=1)
        if not moved.min() > _SAME or not np.isfinite(moved).all():
            return False
        columns = [(0.0, 0.0, 0.0, 1.0)] * len(stamps)
        if self._oriented:
            lengths = np.sqrt(np.einsum("ni,ni->n", poses[:, 3:7], poses[:, 3:7]))
            if not (np.isfinite(lengths).all() and lengths.min() > 0.0):
                return False
            quaternions = poses[:, 3:7] / lengths[:, None]
            before = np.array(self.quaternions[-1])
            turned = np.abs(np.diff(quaternions, axis=0, prepend=before[None])).max(axis=1)
            if not turned.min() > _SAME:
                return False
            self._has_rotated = True
            columns = list(map(tuple, quaternions.tolist()))
        self.stamps += stamps.tolist()
        self.positions += map(tuple, positions.tolist())
        self.quaternions += columns
        self.newest_s = self.stamps[-1]
        return True

    def at(self, times: Floats, longest_s: float = math.inf) -> tuple[Floats, Floats, Booleans]:
        """Interpolate at N times between stored poses that are at most `longest_s` apart.

        Returns:
            Positions (N, 3), quaternions (N, 4), and which rows (N,) are known.
        """
        low = max(bisect.bisect_right(self.stamps, float(times.min())) - 1, 0)
        high = bisect.bisect_left(self.stamps, float(times.max())) + 1
        known = np.array(self.stamps[low:high])
        if len(known) < 2:
            return np.zeros((len(times), 3)), np.zeros((len(times), 4)), times < -math.inf
        rows = np.clip(np.searchsorted(known, times, "right") - 1, 0, len(known) - 2)
        width = known[rows + 1] - known[rows]
        share = (times - known[rows]) / width
        is_known = (share >= -_SAME) & (share <= 1.0 + _SAME) & (width <= longest_s)
        positions = np.array(self.positions[low:high])
        quaternions = np.array(self.quaternions[low:high])
        share, one, two = share[:, None], quaternions[rows], quaternions[rows + 1]
        two = np.where(np.sum(one * two, axis=1, keepdims=True) < 0.0, -two, two)
        between = positions[rows] + share * (positions[rows + 1] - positions[rows])
        return between, lie.normalized((1.0 - share) * one + share * two), is_known

    def shift_from(self, index: int, seconds: float) -> None:
        """Subtract seconds from the timestamps from an index on."""
        self.clock.shift_s -= seconds
        self.stamps[index:] = [stamp - seconds for stamp in self.stamps[index:]]
        self.newest_s -= seconds

    def drop_before(self, stamp: float) -> int:
        """Drop poses before a time, but for some, and return their number."""
        count = max(bisect.bisect_left(self.stamps, stamp) - _BEFORE, 0)
        for column in (self.stamps, self.positions, self.quaternions):
            del column[:count]
        return count

    def innovation(self, begin_s: float, end_s: float, margin_s: float) -> Innovation:
        """Return the largest innovation between two times.

        The velocity of a step is compared with those of the steps before and after it. A
        rotation by 180 deg and back is a constant rate: it is compared with the second ones, too.
        `margin_s` is zero if the times are timestamps of this side.
        """
        low = bisect.bisect_left(self.stamps, begin_s - max(margin_s, 1e-9))
        high = bisect.bisect_right(self.stamps, end_s + max(margin_s, 1e-9))
        low, high = max(low - _BEFORE, 0), min(high + _AFTER, len(self))
        stamps = np.array(self.stamps[low:high])
        if len(stamps) < 4:
            return Innovation(0.0, 0.0, math.inf, 0.0, 0.0)
        first = max(bisect.bisect_left(self.stamps, begin_s + 1e-9) - 1 - low, 0)
        last = min(bisect.bisect_left(self.stamps, end_s - 1e-9) - low, len(stamps) - 1)
        steps = np.diff(stamps)
        quaternions = np.array(self.quaternions[low:high])
        turned = lie.multiply(lie.conjugate(quaternions[:-1]), quaternions[1:])
        velocities = np.diff(np.array(self.positions[low:high]), axis=0) / steps[:, None]
        rates = _rotation_vectors(turned) / steps[:, None]
        inside = slice(first, max(last, first + 1))
        by_m = _changes(velocities, steps, 1)
        by_deg = np.degrees(_changes(rates, steps, 1))
        second = np.degrees(_changes(rates, steps, 2))
        by_deg = np.maximum(by_deg, np.where(np.isfinite(second), second, 0.0))
        usual = [
            float(np.median(values[: first + 1])) if first > 3 else 0.0
            for values in (by_m, by_deg)
        ]
        m, deg, gap_s = (float(values[inside].max()) for values in (by_m, by_deg, steps))
        return Innovation(m, deg, gap_s, *usual)

    def _repeat(self, part: str, before_s: float, stamp: float, *, is_same: bool) -> None:
        is_open = (each for each in self.repeats if each.part == part and not each.is_over)
        interval = next(is_open, None)
        if interval is None:
            if is_same:
                self.repeats.append(Repeats(part, before_s, stamp))
        elif is_same:
            interval.end_s = stamp
        else:
            interval.is_over = True
            if interval.end_s - interval.begin_s < FROZEN_S:
                self.repeats.remove(interval)


def _is_same(one: Vector | Quaternion, other: Vector | Quaternion) -> bool:
    return all(abs(a - b) <= _SAME for a, b in zip(one, other, strict=True))


def _changes(rates: Floats, steps: Floats, apart: int) -> Floats:
    """Return the smaller change of a rate (N, 3) to those `apart` before and after, (N,)."""
    before, after = np.full((2, len(steps)), np.inf)
    changes = np.linalg.norm(rates[apart:] - rates[:-apart], axis=1)
    before[apart:], after[:-apart] = changes * steps[apart:], changes * steps[:-apart]
    smaller: Floats = np.minimum(before, after)
    return smaller


def _rotation_vectors(quaternions: Floats) -> Floats:
    """Return the rotation vectors (N, 3) of quaternions (N, 4), radians."""
    vectors = np.where(quaternions[:, 3:] < 0.0, -1.0, 1.0) * quaternions[:, :3]
    lengths = np.linalg.norm(vectors, axis=1)
    angles = 2.0 * np.arctan2(lengths, np.abs(quaternions[:, 3]))
    factors = np.where(lengths > 1e-9, angles / np.maximum(lengths, 1e-12), 2.0)
    rotated: Floats = vectors * factors[:, None]
    return rotated
