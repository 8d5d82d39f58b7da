"""Clock steps of both sides: from timestamps, or in a gap from the motion after it."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.events import BOTH, CLOCK_STEP, SIDES, Event
from trajeval_ros.metrics.discontinuities.open_step import GAP, PairStep
from trajeval_ros.metrics.discontinuities.pairs import PairSource
from trajeval_ros.metrics.discontinuities.relative_motion import RelativeMotion
from trajeval_ros.metrics.discontinuities.stamp_steps import StampStep
from trajeval_ros.metrics.statistics import median

_MOTION_S = 3.0  # motion after the gap that is compared
_EVERY_S = 0.2
_EXPLAINED = 0.2  # of the difference, at the step
_TIMES_MOVED = 3.0  # the motion exceeds the rest by this: a robot at rest agrees with any step


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
        before_s, after_s = float(step.begin[0]), float(step.after[0])
        for number in (1, 0):
            matched = self._by_motion(number, before_s, after_s, limit_m)
            if matched is not None:
                size_s, row = matched
                stream = self._source.streams[number]
                last_s = float(stream.stamps[row - 1])
                stream.shift_from(row, size_s)
                # Timestamps that step back are known before the pairs are searched.
                for event in self._events:
                    is_later = event.kind == CLOCK_STEP and event.t_ns > self.ns(last_s)
                    if is_later and event.side == SIDES[number]:
                        event.t_ns -= round(size_s * NANOSECONDS)
                        event.end_ns = event.t_ns
                self.add(number, StampStep(last_s, size_s, is_sure=False))
                self._source.rewind(before_s)
                return True
        return False

    def _by_motion(
        self, number: int, before_s: float, after_s: float, limit_m: float
    ) -> tuple[float, int] | None:
        """Return the size of a clock step, seconds, and the first row after it; None without one.

        Args:
            number: The side whose clock is tested: 0 for the groundtruth.
            before_s: Last time before the gap.
            after_s: Latest time after the gap.
            limit_m: Largest usual difference of such a motion.
        """
        assert self._source.periods is not None
        period_s = self._source.periods[number]
        stream, other = self._source.streams[number], self._source.streams[1 - number]
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
        # After a restart in the gap, only the motion since then is that of the other side.
        firsts = (row - 1, row) if self._motion.oriented else (row - 1,)
        sizes_s = (self._size(number, row, np.append(at, rows), limit_m) for at in firsts)
        size_s = next((size_s for size_s in sizes_s if size_s is not None), None)
        return None if size_s is None else (size_s, row)

    def _size(self, number: int, row: int, at: Indices, limit_m: float) -> float | None:
        """Return the size of a step before a row by the motion from the first of rows to the rest.

        It is None if no step explains the motion, or if none is needed.
        """
        assert self._source.periods is not None
        period_s = self._source.periods[number]
        stream, other = self._source.streams[number], self._source.streams[1 - number]
        stamps = stream.stamps

        def differences(step_s: float) -> tuple[float, float, float] | None:
            """Return the medians of the differences, metres and deg, and of the motion, metres."""
            between, is_known = other.at(stamps[at] - np.where(at >= row, step_s, 0.0))
            if not is_known.all():
                return None
            sides = (between, stream.poses[at]) if number == 1 else (stream.poses[at], between)
            pairs = np.hstack([stamps[at, None], *sides])
            difference = self._motion.between(pairs[0], pairs[1:])
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
        return size_s if agrees else None
