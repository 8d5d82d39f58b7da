"""One side's poses with corrected timestamps, and how smooth they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.metrics.discontinuities.stamp_steps import StampSteps
from trajeval_ros.metrics.statistics import median

_SAME = 1e-9  # largest difference of repeated numbers
_COLUMNS = slice(0, 3), slice(3, 7)  # of the position and of the orientation
_IDENTITY = 0.0, 0.0, 0.0, 1.0  # without orientations
_FROZEN_S = 1.0  # an estimate at 2 Hz that is published at a higher rate repeats a pose for 0.5 s
POSE, POSITION, ROTATION = "pose", "position", "rotation"  # parts that can be repeated
# Poses that are stored: all, those of which some part differs from the pose before, or both do.
ALL, ANY_DIFFERS, BOTH_DIFFER = range(3)
# Poses before an interval that give the usual innovation, and that are kept to know a gap.
_BEFORE, _AFTER = 30, 3


@dataclass
class Repeats:
    """An interval in which a part of the pose is repeated exactly."""

    part: str
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
    period_s: float  # usual step of the timestamps before it


class SidePoses:
    """The poses of one side, and repeats of their parts."""

    def __init__(
        self,
        *,
        oriented: bool,
        parts: Sequence[str] = (POSITION, ROTATION),
        stored: int = BOTH_DIFFER,
        frozen_s: float = _FROZEN_S,
    ) -> None:
        """Create it empty.

        Args:
            oriented: Whether the poses have orientations.
            parts: The parts whose repeats are reported.
            stored: Which poses are stored; without repeated ones, a frozen pose is a gap.
            frozen_s: The shortest repeats.
        """
        self.clock = StampSteps()
        self.repeats: list[Repeats] = []  # of at least `frozen_s`, or not over
        self.frozen_s = frozen_s
        self.newest_s = -math.inf  # repeated poses included
        self._oriented, self._parts, self._stored = oriented, parts, stored
        self._has_rotated = False
        self.first: Floats = np.zeros(7)  # the first pose
        self._last: Floats | None = None  # the newest pose, also if it is repeated
        # Seconds and poses xyz xyzw, with room for more, and the rows in use.
        self._stamps: Floats = np.empty(0)
        self._poses: Floats = np.empty((0, 7))
        self._begin = self._end = 0

    def __len__(self) -> int:
        """Return the number of stored poses."""
        return self._end - self._begin

    @property
    def stamps(self) -> Floats:
        """The timestamps (N,), seconds: a view."""
        return self._stamps[self._begin : self._end]

    @property
    def poses(self) -> Floats:
        """The poses (N, 7), metres and xyzw: a view."""
        return self._poses[self._begin : self._end]

    def row_from(self, seconds: float) -> int:
        """Return the row of the first pose at a time or later."""
        return int(self.stamps.searchsorted(seconds))

    def row_after(self, seconds: float) -> int:
        """Return the row of the first pose after a time."""
        return int(self.stamps.searchsorted(seconds, "right"))

    def store(self, stamps: Floats, poses: Floats) -> None:
        """Store N poses with corrected timestamps; late, repeated and invalid ones are not.

        `poses` (N, 7), or (N, 3) without orientations.
        """
        if not len(stamps):
            return
        rows = np.empty((len(stamps), 7))
        rows[:, :3] = poses[:, :3]
        rows[:, 3:] = lie.normalized(poses[:, 3:7]) if self._oriented else _IDENTITY
        kept = np.isfinite(stamps) & np.isfinite(rows).all(axis=1)
        newest = np.maximum.accumulate(np.where(kept, stamps, -math.inf))
        kept &= stamps > np.maximum(np.append(-math.inf, newest[:-1]), self.newest_s)
        if not kept.all():
            stamps, rows = stamps[kept], rows[kept]
        if self._last is None and len(stamps):
            self._append(stamps[:1], rows[:1])
            self.newest_s, self.first, self._last = float(stamps[0]), rows[0], rows[0]
            stamps, rows = stamps[1:], rows[1:]
        if self._last is None or not len(stamps):
            return
        held, stands = (self._is_same(rows, columns) for columns in _COLUMNS)
        # A sensor without orientation may write the identity.
        rotated = np.logical_or.accumulate(~stands) | self._has_rotated
        self._has_rotated = bool(rotated[-1])
        repeated = {POSE: held & stands, POSITION: held, ROTATION: stands & rotated}
        for part in self._parts:
            self._repeat(part, self.newest_s, stamps, repeated[part])
        self.newest_s, self._last = float(stamps[-1]), rows[-1]
        dropped = repeated[POSE]
        if self._stored == BOTH_DIFFER:
            dropped = held | repeated[ROTATION]
        if self._stored != ALL and dropped.any():
            stamps, rows = stamps[~dropped], rows[~dropped]
        self._append(stamps, rows)

    def _is_same(self, rows: Floats, columns: slice) -> Booleans:
        """Return which rows (N, 7) repeat columns of the row before."""
        assert self._last is not None
        first = np.diff(rows[:, columns.start], prepend=self._last[columns.start])
        is_same: Booleans = np.abs(first) <= _SAME
        if is_same.any():  # the first column decides most often
            steps = np.diff(rows[:, columns], axis=0, prepend=self._last[None, columns])
            is_same &= np.logical_and.reduce(np.abs(steps) <= _SAME, axis=1)
        return is_same

    def at(self, times: Floats, longest_s: float = math.inf) -> tuple[Floats, Booleans]:
        """Interpolate at N times between stored poses that are at most `longest_s` apart.

        Returns:
            Poses (N, 7), and which rows (N,) are known.
        """
        low = max(self.row_after(float(times.min())) - 1, 0)
        high = min(self.row_after(float(times.max())) + 1, len(self))
        known, poses = self.stamps[low:high], self.poses[low:high]
        if len(known) < 2:
            return np.zeros((len(times), 7)), times < -math.inf
        rows = np.clip(np.searchsorted(known, times, "right") - 1, 0, len(known) - 2)
        width = known[rows + 1] - known[rows]
        share = (times - known[rows]) / width
        is_known = (share >= -_SAME) & (share <= 1.0 + _SAME) & (width <= longest_s)
        share, one, two = share[:, None], poses[rows], poses[rows + 1]
        opposite = np.einsum("ni,ni->n", one[:, 3:], two[:, 3:]) < 0.0
        two[opposite, 3:] *= -1.0
        between = one + share * (two - one)
        between[:, 3:] = lie.normalized(between[:, 3:])
        return between, is_known

    def shift_from(self, index: int, seconds: float) -> None:
        """Subtract seconds from the timestamps from an index on."""
        self.clock.shift_s -= seconds
        self.stamps[index:] -= seconds
        self.newest_s -= seconds

    def drop_before(self, stamp: float) -> int:
        """Drop poses before a time, but for some, and return their number."""
        count = max(self.row_from(stamp) - _BEFORE, 0)
        self._begin += count
        return count

    def innovation(self, begin_s: float, end_s: float, margin_s: float) -> Innovation:
        """Return the largest innovation between two times.

        The velocity of a step is compared with those of the steps before and after it. A
        rotation by 180 deg and back is a constant rate: it is compared with the second ones, too.
        `margin_s` is zero if the times are timestamps of this side.
        """
        low = max(self.row_from(begin_s - max(margin_s, 1e-9)) - _BEFORE, 0)
        high = min(self.row_after(end_s + max(margin_s, 1e-9)) + _AFTER, len(self))
        stamps, poses = self.stamps[low:high], self.poses[low:high]
        if len(stamps) < 4:
            return Innovation(0.0, 0.0, math.inf, 0.0, 0.0, 0.0)
        first = max(self.row_from(begin_s + 1e-9) - 1 - low, 0)
        last = min(self.row_from(end_s - 1e-9) - low, len(stamps) - 1)
        steps, by_m, by_deg = innovations(stamps, poses)
        inside = slice(first, max(last, first + 1))
        usual_m, usual_deg = (
            median(values[: first + 1]) if first > 3 else 0.0 for values in (by_m, by_deg)
        )
        period_s = median(steps[:first] if first > 3 else steps)
        m, deg, gap_s = (float(values[inside].max()) for values in (by_m, by_deg, steps))
        return Innovation(m, deg, gap_s, usual_m, usual_deg, period_s)

    def _append(self, stamps: Floats, poses: Floats) -> None:
        if self._end + len(stamps) > len(self._stamps):
            size = 2 * (len(self) + len(stamps))
            larger = np.empty(size), np.empty((size, 7))
            larger[0][: len(self)], larger[1][: len(self)] = self.stamps, self.poses
            self._begin, self._end = 0, len(self)
            self._stamps, self._poses = larger
        rows = slice(self._end, self._end + len(stamps))
        self._stamps[rows], self._poses[rows] = stamps, poses
        self._end = rows.stop

    def _repeat(self, part: str, before_s: float, stamps: Floats, is_same: Booleans) -> None:
        """Begin, extend and end intervals; `before_s`: the timestamp before the first one."""
        is_open = (repeat for repeat in self.repeats if repeat.part == part and not repeat.is_over)
        interval = next(is_open, None)
        if interval is None and not is_same.any():
            return
        edges: Indices = np.flatnonzero(np.diff(is_same)) + 1
        for begin, end in zip([0, *edges], [*edges, len(is_same)], strict=True):
            if not is_same[begin]:
                if interval is not None:
                    interval.is_over = True
                    if interval.end_s - interval.begin_s < self.frozen_s:
                        self.repeats.remove(interval)
                interval = None
                continue
            if interval is None:
                begin_s = float(stamps[begin - 1]) if begin else before_s
                interval = Repeats(part, begin_s, begin_s)
                self.repeats.append(interval)
            interval.end_s = float(stamps[end - 1])


def innovations(stamps: Floats, poses: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the steps (N - 1,) between timestamps (N,), and the changes of velocity in them.

    These are displacements over the steps, metres and deg, of poses (N, 7).
    """
    steps = np.diff(stamps)
    rotated = lie.multiply(lie.conjugate(poses[:-1, 3:]), poses[1:, 3:])
    velocities = np.diff(poses[:, :3], axis=0) / steps[:, None]
    rates = lie.rotation_vector(rotated) / steps[:, None]
    by_deg = np.degrees(_changes(rates, steps, 1))
    second = np.degrees(_changes(rates, steps, 2))
    by_deg = np.maximum(by_deg, np.where(np.isfinite(second), second, 0.0))
    return steps, _changes(velocities, steps, 1), by_deg


def _changes(rates: Floats, steps: Floats, apart: int) -> Floats:
    """Return the smaller change of a rate (N, 3) to those `apart` before and after, (N,)."""
    before, after = np.full((2, len(steps)), np.inf)
    changes = np.linalg.norm(rates[apart:] - rates[:-apart], axis=1)
    before[apart:], after[:-apart] = changes * steps[apart:], changes * steps[:-apart]
    smaller: Floats = np.minimum(before, after)
    return smaller
