"""Discontinuities of groundtruth and estimate, live and recorded."""

from __future__ import annotations

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.clock_steps import ClockSteps
from trajeval_ros.metrics.discontinuities.events import SIDES, Event
from trajeval_ros.metrics.discontinuities.frozen_parts import FrozenParts
from trajeval_ros.metrics.discontinuities.pairs import PairSource
from trajeval_ros.metrics.discontinuities.pose_stream import SidePoses
from trajeval_ros.metrics.discontinuities.relative_motion import RelativeMotion
from trajeval_ros.metrics.discontinuities.step_search import StepSearch


class Discontinuities:
    """Takes the poses of both sides in order of arrival and finds events.

    The events are equal for batches of any size, but for rounding. The memory is that of about
    one minute.

    Example:
        >>> import numpy as np
        >>> stamps = np.arange(0, 60_000_000_000, 100_000_000)
        >>> seconds = stamps / 1e9
        >>> poses = np.zeros((600, 7))
        >>> poses[:, 0], poses[:, 1], poses[:, 6] = np.sin(seconds), np.cos(seconds / 3.0), 1.0
        >>> jumped = poses.copy()
        >>> jumped[300:, 0] += 2.0
        >>> search = Discontinuities(oriented=False)
        >>> search.add("groundtruth", stamps, poses)
        >>> search.add("estimate", stamps, jumped)
        >>> [(event.kind, event.side, event.end_ns) for event in search.finish()]
        [('step', 'estimate', 30000000000)]
    """

    def __init__(self, *, oriented: bool = True, unusual: Stamps | None = None) -> None:
        """Create it before the first message; without orientations, positions are compared.

        `unusual`: timestamps (K,) of the only motions that can be steps, if no timestamp is
        irregular; else None.
        """
        self._unusual = unusual
        self.events: list[Event] = []  # in order of detection
        self._streams = SidePoses(oriented=oriented), SidePoses(oriented=oriented)
        self._source = PairSource(self._streams)
        self._motion = RelativeMotion(oriented=oriented)
        self._steps: StepSearch | None = None  # None until the rates are known
        self._frozen = FrozenParts(dict(zip(SIDES, self._streams, strict=True)))
        self._clocks = ClockSteps(self._source, self._motion, self.events)

    @property
    def frozen(self) -> list[Event]:
        """The events of frozen parts that last."""
        return self._frozen.present

    @property
    def settled_until_ns(self) -> int | None:
        """Timestamp until which no later event begins; None before the first pairs are judged."""
        newest_s = [stream.newest_s for stream in self._streams if len(stream)]
        is_repeated = any(
            len(stream) and stream.newest_s > stream.stamps[-1] for stream in self._streams
        )
        if self._steps is not None and self._steps.open is not None:
            return self._clocks.ns(self._steps.open.begin[0])
        if is_repeated and len(newest_s) == len(self._streams):
            return self._clocks.ns(min(newest_s))
        if self._steps is None or self._steps.previous is None:
            return None
        return self._clocks.ns(self._steps.previous[0])

    def add(
        self, side: str, stamps: Stamps, poses: Floats, received: Stamps | None = None
    ) -> None:
        """Take N messages of a side.

        Args:
            side: `groundtruth` or `estimate`.
            stamps: (N,) int64, nanoseconds, in order of arrival.
            poses: (N, 7), metres and xyzw; (N, 3) without orientations.
            received: (N,) int64, nanoseconds, receive times; None if unknown.
        """
        if not len(stamps):
            return
        if self._clocks.zero_ns is None:
            self._clocks.zero_ns = int(stamps[0])
        number, zero_ns = SIDES.index(side), self._clocks.zero_ns
        seconds = (stamps - zero_ns) / NANOSECONDS
        stream = self._streams[number]
        if self._unusual is None:
            times = None if received is None else (received - zero_ns) / NANOSECONDS
            seconds, poses, steps = stream.clock.take(seconds, times, poses)
            for step in steps:
                self._clocks.add(number, step)
        else:  # a step in a gap may have been corrected
            seconds += stream.clock.shift_s
        stream.store(seconds, poses)
        self._advance()

    def finish(self) -> list[Event]:
        """Return all events in order of time, after the last message."""
        for number, stream in enumerate(self._streams):
            corrected, rows, steps = stream.clock.close()
            for step in steps:
                self._clocks.add(number, step)
            stream.store(corrected, rows)
        self._advance(at_end=True)
        if self._steps is not None:
            self._steps.finish()
        self.events.sort(key=lambda event: event.t_ns)
        return self.events

    def _advance(self, *, at_end: bool = False) -> None:
        if self._source.periods is None:
            if not self._source.begin(at_end=at_end):
                return
            unusual_s = None
            if self._unusual is not None:
                unusual_s = (self._unusual - self._clocks.ns(0.0)) / NANOSECONDS
            self._steps = StepSearch(
                self._source, self._motion, self.events, self._clocks, unusual_s
            )
        assert self._steps is not None
        while self._steps.take(self._source.new_pairs()):
            pass  # a clock step was corrected: pair again
        self.events += (
            event for event, _ in self._frozen.advance(self._clocks.ns, self._motion.scale)
        )
        step = self._steps.open
        self._source.drop_old(None if step is None else float(step.begin[0]))
