"""Discontinuities of one pose stream alone, by its own smoothness.

A motion is compared with those before and after it at constant velocity, in place of the motion of
the other side. A step of the position differs from both; the begin of a motion differs from one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.events import CLOCK_STEP, ESTIMATE, GAP, Event
from trajeval_ros.metrics.discontinuities.exoneration import GAP_PERIODS
from trajeval_ros.metrics.discontinuities.frozen_parts import FrozenParts
from trajeval_ros.metrics.discontinuities.open_step import ratio_of
from trajeval_ros.metrics.discontinuities.pose_stream import ANY_DIFFERS, SidePoses
from trajeval_ros.metrics.discontinuities.stamp_steps import StampStep
from trajeval_ros.metrics.discontinuities.stream_limits import StreamLimits
from trajeval_ros.metrics.discontinuities.stream_motion import (
    StreamMotions,
    against_earlier,
    one_motion,
    stream_motions,
)
from trajeval_ros.metrics.discontinuities.stream_steps import StreamSteps
from trajeval_ros.metrics.statistics import median

_INTERVAL_S = 10.0  # limits are learned after such intervals, and the first one in retrospect
_LEAST_POSES = 20  # of the first interval
_MEMORY_S = 45.0  # of poses: the longest learned lag and an interval
_FROZEN_S = 0.5  # shortest repeats after an abrupt stop
_CONFIRMED_S = 1.0  # time until a step of a clock is known


class KnownEvent(NamedTuple):
    """An event as it was when it became known; the event itself may change later."""

    event: Event
    known_ns: int  # timestamp
    kind: str
    ratio: float


class OneStream:
    """Takes the poses of one stream in order of arrival and finds events.

    The events are equal for batches of any size, but for rounding. The memory is that of about a
    minute. A step is known one pose after it; if the poses return later, its event becomes an
    outlier or a flip.

    Example:
        >>> import numpy as np
        >>> stamps = np.arange(0, 60_000_000_000, 100_000_000)
        >>> seconds = stamps / 1e9
        >>> positions = np.column_stack([np.sin(seconds), np.cos(seconds / 3.0), seconds])
        >>> positions[300:, 0] += 2.0
        >>> stream = OneStream("groundtruth", oriented=False)
        >>> _ = stream.add(stamps, positions)
        >>> [(event.kind, event.side, event.end_ns) for event in stream.finish()]
        [('step', 'groundtruth', 30000000000)]
    """

    def __init__(self, side: str = ESTIMATE, *, oriented: bool = True) -> None:
        """Create it before the first message; without orientations, positions are tested."""
        self.events: list[Event] = []  # in order of detection
        self._side = side
        self._stream = SidePoses(oriented=oriented, stored=ANY_DIFFERS, frozen_s=_FROZEN_S)
        self._frozen = FrozenParts({side: self._stream})
        # None until the rate is known.
        self._limits: StreamLimits | None = None
        self._steps: StreamSteps | None = None
        self._longest_s = 0.0  # step between messages that is no gap
        self._stamps: Floats = np.empty(0)  # of messages that are not tested for gaps yet
        self._next = 1  # row of the end of the next motion
        self._successive = 0  # unusual motions in succession before it
        self._interval_end_s = 0.0
        self._zero_ns: int | None = None
        self._new: list[KnownEvent] = []

    @property
    def frozen(self) -> list[Event]:
        """The events of frozen parts that last."""
        return self._frozen.present

    def add(
        self, stamps: Stamps, poses: Floats, received: Stamps | None = None
    ) -> list[KnownEvent]:
        """Take N messages; return the events that are known by them.

        Args:
            stamps: (N,) int64, nanoseconds, in order of arrival.
            poses: (N, 7), metres and xyzw; (N, 3) without orientations.
            received: (N,) int64, nanoseconds, receive times; None if unknown.
        """
        if len(stamps):
            if self._zero_ns is None:
                self._zero_ns = int(stamps[0])
            seconds = (stamps - self._zero_ns) / NANOSECONDS
            times = None if received is None else (received - self._zero_ns) / NANOSECONDS
            self._store(*self._stream.clock.take(seconds, times, poses))
            self._advance(at_end=False)
        new, self._new = self._new, []
        return new

    def finish(self) -> list[Event]:
        """Return all events in order of time, after the last message."""
        self._store(*self._stream.clock.close())
        self._advance(at_end=True)
        self.events.sort(key=lambda event: event.t_ns)
        return self.events

    def _store(self, stamps: Floats, poses: Floats, steps: list[StampStep]) -> None:
        for step in steps:
            at_ns, certainty = self._ns(step.at_s), "sure" if step.is_sure else "likely"
            event = Event(CLOCK_STEP, self._side, at_ns, at_ns, s=step.size_s, certainty=certainty)
            self._add(event, step.at_s + _CONFIRMED_S)
        newest_s = self._stamps[-1] if len(self._stamps) else -np.inf
        latest = np.maximum.accumulate(np.append(newest_s, stamps))
        self._stamps = np.append(self._stamps, stamps[stamps > latest[:-1]])
        self._stream.store(stamps, poses)

    def _advance(self, *, at_end: bool) -> None:
        if self._limits is None:
            self._limits = self._first_limits(at_end=at_end)
        if self._limits is None:
            return
        self._find_gaps()
        stamps = self._stream.stamps
        while self._next < len(stamps) - 1:
            interval = int(stamps.searchsorted(self._interval_end_s))
            end = min(interval, len(stamps) - 1)
            if end > self._next:
                self._judge(self._limits, self._next, end)
                self._next = end
            if end == interval:
                self._limits.learn(interval)
                passed = (stamps[interval] - self._interval_end_s) // _INTERVAL_S
                self._interval_end_s += _INTERVAL_S * (passed + 1.0)
        for event, known_s in self._frozen.advance(self._ns):
            self._add(event, known_s)
        if stamps[-1] - stamps[0] > 1.5 * _MEMORY_S:
            oldest_s = float(stamps[self._next - 1]) - _MEMORY_S
            self._next -= self._stream.drop_before(oldest_s)

    def _first_limits(self, *, at_end: bool) -> StreamLimits | None:
        """Return limits that are learned in the first interval, or None before its end."""
        stamps = self._stream.stamps
        if len(stamps) < 4:
            return None
        least = min(_LEAST_POSES, len(stamps) - 1)
        end_s = max(float(stamps[0]) + _INTERVAL_S, float(stamps[least]))
        last = min(int(stamps.searchsorted(end_s)), len(stamps) - 1)
        if not at_end and (least < _LEAST_POSES or last == len(stamps) - 1):
            return None
        period_s = median(np.diff(stamps[:last]))
        until = int(self._stamps.searchsorted(stamps[last]))
        self._longest_s = GAP_PERIODS * median(np.diff(self._stamps[:until]))
        self._interval_end_s = end_s
        limits = StreamLimits(self._stream, period_s)
        motions = self._motions(limits, 1, last)
        limits.keep(motions, np.ones(len(motions.m), dtype=bool))
        limits.learn(last)
        origin = self._stream.first[:3]
        self._steps = StreamSteps(self._side, origin, period_s, self.events, self._ns)
        return limits

    def _find_gaps(self) -> None:
        stamps, self._stamps = self._stamps, self._stamps[-1:]
        for row in np.flatnonzero(np.diff(stamps) > self._longest_s):
            begin_s, end_s = stamps[row : row + 2].tolist()
            begin, end, size_s = self._ns(begin_s), self._ns(end_s), end_s - begin_s
            event = Event(GAP, self._side, begin, end, s=size_s, certainty="sure")
            event.ratio = size_s / self._longest_s
            self._add(event, end_s)

    def _judge(self, limits: StreamLimits, begin: int, end: int) -> None:
        """Compare the motions that end at rows of one interval with its limits."""
        assert self._steps is not None
        stamps, poses = self._stream.stamps, self._stream.poses
        motions = self._motions(limits, begin, end)
        limit_m, limit_deg = limits.limit(motions.seconds)
        unusual = (motions.m > limit_m) | (motions.deg > limit_deg)
        if stamps[begin] >= limits.learned_until_s:
            limits.keep(motions, ~unusual)
        last = -1  # the last unusual motion
        for number in np.flatnonzero(unusual).tolist():
            self._successive = self._successive if number == last + 1 else 0
            pair = float(limit_m[number]), float(limit_deg[number])
            motion = one_motion(stamps, poses, motions, number, limits.longest_s)
            good = begin + number - 1 - self._successive
            if self._successive and good > 0:
                motion = against_earlier(stamps, poses, motion, good)
            if ratio_of(motion.size, pair) <= 1.0:
                continue
            event = self._steps.follow(motion, pair)
            self._successive, last, limits.part_s = self._successive + 1, number, motion.end_s
            if event is not None:
                self._tell(event, motion.known_s)
        self._successive = self._successive if last == len(unusual) - 1 else 0

    def _motions(self, limits: StreamLimits, begin: int, end: int) -> StreamMotions:
        """Return the motions between successive poses that end at rows."""
        ends, stream = np.arange(begin, end), self._stream
        return stream_motions(stream.stamps, stream.poses, ends - 1, ends, limits.longest_s)

    def _add(self, event: Event, known_s: float) -> None:
        self.events.append(event)
        self._tell(event, known_s)

    def _tell(self, event: Event, known_s: float) -> None:
        self._new.append(KnownEvent(event, self._ns(known_s), event.kind, event.ratio))

    def _ns(self, seconds: float) -> int:
        return (self._zero_ns or 0) + round(float(seconds) * NANOSECONDS)
