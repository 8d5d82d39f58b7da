"""Frozen poses, positions and rotations: exact repeats that are no rest of the robot.

With two streams, the other side moves meanwhile. In one stream alone, they follow an abrupt stop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.discontinuities.events import (
    FROZEN,
    FROZEN_POSITION,
    FROZEN_ROTATION,
    GROUNDTRUTH,
    Event,
    Loss,
)
from trajeval_ros.metrics.discontinuities.pose_stream import (
    POSE,
    POSITION,
    ROTATION,
    Repeats,
    SidePoses,
)

# Motion of the other side that is no noise; the noise of fixes is metres.
MOVED_M, MOVED_OF_FIXES_M, _MOVED_DEG = 0.15, 10.0, 10.0
_STILL = 0.15  # of this motion: the other side has not started to move
_KINDS = {POSE: FROZEN, POSITION: FROZEN_POSITION, ROTATION: FROZEN_ROTATION}
# Of one stream alone. The speeds before a stop: the usual one, and the last one, over some steps,
# since wheels do not move in every period. A robot brakes to less than a half before it stops.
_USUAL_S, _LAST_S, _LAST_STEPS, _ABRUPT = 1.0, 0.1, 2, 0.5
# Motion that the last speed predicts: a slow wheel repeats its pose for a time. Slower robots stop
# abruptly.
_PREDICTED = {POSITION: (0.05, 0.05), ROTATION: (10.0, 10.0)}  # m and m/s, deg and deg/s


@dataclass(eq=False)
class _RepeatedPart:
    side: str
    repeats: Repeats
    other: SidePoses | None  # the other side
    least_s: float  # time from which on it is frozen
    begin_s: float  # the other side is still until here
    until_s: float  # and known until here
    pose: Floats | None = None  # of the other side at the begin
    m: float = 0.0  # motion of the other side
    deg: float = 0.0
    event: Event | None = None

    @property
    def lasts_s(self) -> float:
        return self.repeats.end_s - self.repeats.begin_s


class FrozenParts:
    """Follows the repeats of one stream alone, or of both sides."""

    def __init__(self, streams: Mapping[str, SidePoses], moved_m: float = MOVED_M) -> None:
        """Create it with the streams by side; less than `moved_m` is noise of the other one."""
        self._streams, self._moved_m = streams, moved_m
        self._repeating: list[_RepeatedPart] = []
        self._rests = False  # whether a rotation has rested: wheels hold it while they drive

    @property
    def present(self) -> list[Event]:
        """The events that last."""
        lasting = (item for item in self._repeating if not item.repeats.is_over)
        return [item.event for item in lasting if item.event]

    def settled_until_s(self, side: str) -> float:
        """Return the time until which no later event of a side begins, seconds."""
        begins_s = (item.begin_s for item in self._repeating if item.side == side)
        return min(begins_s, default=math.inf)

    def advance(
        self, nanoseconds: Callable[[float], int], scale: float = 1.0
    ) -> Iterator[tuple[Event, float]]:
        """Yield new events and the times at which they are known; those that last are extended.

        `scale` is metres per unit of the estimate.
        """
        for item in self._repeating:
            self._see_rest(item)
        for side, stream in self._streams.items():
            known = [item.repeats for item in self._repeating]
            for repeats in stream.repeats:
                if not any(repeats is item for item in known):
                    self._begin(side, repeats)
            stream.repeats[:] = [repeats for repeats in stream.repeats if not repeats.is_over]
        for item in list(self._repeating):
            self._follow(item, scale if item.side == GROUNDTRUTH else 1.0)
            is_over = item.repeats.is_over
            if item.other is not None:
                is_over &= item.other.newest_s >= item.repeats.end_s
            if item.event is None and item.lasts_s >= item.least_s and self._moved(item) >= 1.0:
                of_kind = Loss if item.repeats.part == POSE else Event
                begin = nanoseconds(item.begin_s)
                item.event = of_kind(_KINDS[item.repeats.part], item.side, begin, begin)
                yield item.event, item.repeats.begin_s + item.least_s
            if item.event is not None:
                end_s = item.repeats.end_s
                item.event.t_ns, item.event.end_ns = map(nanoseconds, (item.begin_s, end_s))
                item.event.s, item.event.m, item.event.deg = end_s - item.begin_s, item.m, item.deg
                if item.other is None:
                    item.event.ratio = item.event.s / item.least_s
                else:
                    item.event.certainty = "sure"
                if isinstance(item.event, Loss):
                    item.event.is_over = is_over
            if is_over:
                self._repeating.remove(item)

    def _begin(self, side: str, repeats: Repeats) -> None:
        stream, least_s = self._streams[side], self._streams[side].frozen_s
        other = next((item for item in self._streams.values() if item is not stream), None)
        if other is None:
            is_rest = repeats.part == ROTATION and self._rests
            least_s = math.inf if is_rest else _time_after_stop_s(repeats, stream)
        begin_s = repeats.begin_s
        item = _RepeatedPart(side, repeats, other, least_s, begin_s, begin_s)
        self._repeating.append(item)
        self._see_rest(item)

    def _see_rest(self, item: _RepeatedPart) -> None:
        """See a rotation that repeated for a time: later ones may be rests, too."""
        is_long = item.lasts_s >= self._streams[item.side].frozen_s
        self._rests |= item.repeats.part == ROTATION and item.repeats.is_over and is_long

    def _moved(self, item: _RepeatedPart) -> float:
        """Return the motion of the other side as a multiple of noise; infinite without one."""
        if item.other is None:
            return math.inf
        return max(item.m / self._moved_m, item.deg / _MOVED_DEG)

    def _follow(self, item: _RepeatedPart, scale: float) -> None:
        """Measure the other side's motion."""
        repeats, other = item.repeats, item.other
        if other is None:
            return
        begin, end = other.row_from(item.until_s), other.row_after(repeats.end_s)
        if begin >= end:
            return
        item.until_s = float(other.stamps[end - 1]) + 1e-9
        if item.pose is None:
            item.pose = other.poses[begin].copy()
        first = max(begin - 1, 0)
        poses, stamps = other.poses[first:end], other.stamps[first:end]
        m, deg = np.zeros((2, len(poses)))
        if repeats.part != ROTATION:
            m = scale * np.linalg.norm(poses[:, :3] - item.pose[:3], axis=1)
        if repeats.part != POSITION:
            rotations = lie.multiply(lie.conjugate(item.pose[3:]), poses[:, 3:])
            deg = np.degrees(lie.angle(rotations))
        moved = np.maximum(m / self._moved_m, deg / _MOVED_DEG)
        # Of two poses in succession: one outlier of the other side is no motion.
        lesser_m, lesser_deg, lesser = (np.minimum(v[1:], v[:-1]) for v in (m, deg, moved))
        if self._moved(item) < 1.0:
            begins = np.flatnonzero(lesser >= 1.0)
            still = np.flatnonzero(moved[: begins[0] + 1 if len(begins) else None] < _STILL)
            if len(still):
                item.begin_s = max(item.begin_s, float(stamps[still[-1]]))
        item.m = float(lesser_m.max(initial=item.m))
        item.deg = float(lesser_deg.max(initial=item.deg))


def _time_after_stop_s(repeats: Repeats, stream: SidePoses) -> float:
    """Return the time of repeats from which on they are no rest, infinite if the robot braked."""
    begin = max(stream.row_from(repeats.begin_s - _USUAL_S) - 1, 0)
    end = stream.row_after(repeats.begin_s + 1e-9)
    stamps, poses = stream.stamps[begin:end], stream.poses[begin:end]
    if len(stamps) < 3:
        return math.inf
    if repeats.part == POSITION:
        steps = np.diff(poses[:, :3], axis=0)
    else:
        rotations = lie.multiply(lie.conjugate(poses[:-1, 3:]), poses[1:, 3:])
        steps = np.degrees(lie.rotation_vector(rotations))
    moved, rest = _PREDICTED[repeats.part]
    first = min(int(stamps.searchsorted(stamps[-1] - _LAST_S)), len(stamps) - 1 - _LAST_STEPS)
    usual = float(np.linalg.norm(steps, axis=1).sum() / (stamps[-1] - stamps[0]))
    # A wheel that stops can still make its last count.
    counted = np.maximum(np.abs(steps[first:].sum(axis=0)) - _resolution_of(steps), 0.0)
    last = float(np.linalg.norm(counted) / (stamps[-1] - stamps[first]))
    is_abrupt = last > max(_ABRUPT * usual, rest)
    return max(stream.frozen_s, moved / last) if is_abrupt else math.inf


def _resolution_of(steps: Floats) -> Floats:
    """Return the least step of every axis of (N, 3) that rests between its steps, or else 0."""
    lengths = np.abs(steps)
    least: Floats = np.where(lengths > 0.0, lengths, np.inf).min(axis=0)
    return np.where((lengths == 0.0).any(axis=0) & np.isfinite(least), least, 0.0)
