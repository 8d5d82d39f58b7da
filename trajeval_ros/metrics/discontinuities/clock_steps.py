"""Clock steps of both sides: from timestamps, or in a gap from the motion after it."""

from __future__ import annotations

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.clock_by_motion import clock_by_motion
from trajeval_ros.metrics.discontinuities.events import BOTH, CLOCK_STEP, SIDES, Event
from trajeval_ros.metrics.discontinuities.open_step import PairStep
from trajeval_ros.metrics.discontinuities.pairs import PairSource
from trajeval_ros.metrics.discontinuities.relative_motion import RelativeMotion
from trajeval_ros.metrics.discontinuities.stamp_steps import StampStep


class ClockSteps:
    """Appends the events of clock steps, and corrects timestamps after a step in a gap.

    Attributes:
        zero_ns: Timestamp of zero seconds, nanoseconds; None before the first message.
    """

    def __init__(self, source: PairSource, motion: RelativeMotion, events: list[Event]) -> None:
        self.zero_ns: int | None = None
        self._source, self._motion, self._events = source, motion, events

    def ns(self, seconds: float) -> int:
        """Return the timestamp of a time, seconds."""
        return (self.zero_ns or 0) + round(float(seconds) * NANOSECONDS)

    def add(self, number: int, step: StampStep) -> None:
        """Append the step of a side's clock; with that of the other side it is one of both."""
        at_ns, size_s = self.ns(step.at_s), step.size_s
        for event in self._events[-4:]:
            is_other = event.kind == CLOCK_STEP and event.side == SIDES[1 - number]
            is_alike = abs(event.s - size_s) < 0.1 * abs(size_s) + 0.05
            apart_s = abs(event.t_ns - at_ns) / NANOSECONDS
            if is_other and is_alike and apart_s < 1.0 + abs(size_s):
                event.side, event.t_ns = BOTH, max(event.t_ns, at_ns)
                event.end_ns = event.t_ns
                return
        certainty = "sure" if step.is_sure else "likely"
        self._events.append(
            Event(CLOCK_STEP, SIDES[number], at_ns, at_ns, s=size_s, certainty=certainty)
        )

    def correct(self, step: PairStep, limit_m: float) -> bool:
        """Correct a forward clock step in the gap of a step, if there is one; return whether.

        Only the motion shows it; `limit_m` is its usual difference, metres. The pairs then
        continue before the gap.
        """
        assert self._source.periods is not None
        before_s, after_s = float(step.begin[0]), float(step.after[0])
        for number in (1, 0):
            stream, other = self._source.streams[number], self._source.streams[1 - number]
            period_s = self._source.periods[number]
            matched = clock_by_motion(
                stream, other, number, before_s, after_s, period_s, self._motion, limit_m
            )
            if matched is None:
                continue
            size_s, row = matched
            stream.shift_from(row, size_s)
            self.add(number, StampStep(before_s, size_s, is_sure=False))
            self._source.rewind(before_s)
            return True
        return False
