"""Discontinuities of groundtruth and estimate, live and recorded.

Pairs at the slower side's timestamps are compared by their motions (`relative_motion`). A motion
that differs by more than usual begins a step. It returns, or it stays; the side whose own
velocity changes little there is exonerated, and the other one is guilty.
"""

from __future__ import annotations

import itertools
import math
from collections import deque

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities import events as kinds
from trajeval_ros.metrics.discontinuities.clock_by_motion import clock_by_motion
from trajeval_ros.metrics.discontinuities.events import SIDES, UNDECIDED, Event
from trajeval_ros.metrics.discontinuities.exoneration import SideVerdict, guilty_side
from trajeval_ros.metrics.discontinuities.frozen_parts import FrozenParts
from trajeval_ros.metrics.discontinuities.motion_history import MotionHistory
from trajeval_ros.metrics.discontinuities.open_step import (
    OpenStep,
    both_edges,
    by_parts,
    is_back,
    ratio_of,
)
from trajeval_ros.metrics.discontinuities.pairs import PairSource
from trajeval_ros.metrics.discontinuities.pose_stream import SidePoses
from trajeval_ros.metrics.discontinuities.relative_motion import (
    BodyState,
    Difference,
    Pair,
    RelativeMotion,
    UsualDifferences,
    rotation_beyond,
)

_BURN_IN_S, _BURN_IN_PAIRS = 4.0, 12  # the first pairs are judged in retrospect
# A step stays after this time and number of calm pairs: longer delays an alarm, shorter takes
# an outlier for a step.
_CALM_S, _CALM_PAIRS = 1.0, 5
_AFTER_GAP_S = 3.2  # motion after a gap that determines a clock step
_LOST_S, _LOST_PAIRS = 10.0, 5  # steps without a calm second
# Smallest events, as multiples of the limit. Single poses of heavy-tailed noise exceed 1.5.
_LEAST_RATIO, _LEAST_RATIO_OF_OUTLIER = 1.5, 2.5
_RETURN_S = 60.0  # longest excursion whose return is known
_FLIP_DEG = 60.0  # smallest rotation of a flip: corrections of a heading are smaller
_FLIP_M = 0.15  # a marker that flips moves its centre less
_SMOOTH = 0.34  # innovation as a fraction of a step, of a side whose position did not jump
_LEAST_LATER_M = 0.09  # motion after a flip that shows whether the body is another
_BETTER = 0.7  # of the error against earlier pairs, after a correction


class Discontinuities:
    """Takes the poses of both sides in order of arrival and finds events.

    The events are equal for batches of any size. The memory is that of about one minute.

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

    def __init__(self, *, oriented: bool = True) -> None:
        """Create it before the first message; without orientations, positions are compared."""
        self.events: list[Event] = []  # in order of detection
        self._streams = SidePoses(oriented=oriented), SidePoses(oriented=oriented)
        self._source = PairSource(self._streams)
        self._motion = RelativeMotion(oriented=oriented)
        self._history = MotionHistory(self._motion, 0.0, 1.0)  # replaced when the rates are known
        self._frozen = FrozenParts(self._streams)
        self._zero_ns: int | None = None
        self._burn_in: list[Pair] | None = []
        self._first: Pair | None = None
        self._previous: Pair | None = None
        self._open: OpenStep | None = None
        # Steps that may return: begin, end, event, and the body's rotation before them.
        self._stayed: deque[tuple[Pair, Pair, Event, BodyState]] = deque(maxlen=8)

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
        if self._open is not None:
            return self._ns(self._open.begin.t)
        if is_repeated and len(newest_s) == len(self._streams):
            return self._ns(min(newest_s))
        return None if self._previous is None else self._ns(self._previous.t)

    # Messages

    def add(
        self, side: str, stamps: Stamps, poses: Floats, received: Stamps | None = None
    ) -> None:
        """Take N messages of a side.

        Args:
            side: `groundtruth` or `estimate`.
            stamps: (N,) int64, nanoseconds, in order of arrival.
            poses: (N, 7), metres and xyzw; (N, 3) without orientations.
            received: (N,) int64, nanoseconds, times of reception; None if unknown.
        """
        if not len(stamps):
            return
        if self._zero_ns is None:
            self._zero_ns = int(stamps[0])
        number = SIDES.index(side)
        stream = self._streams[number]
        seconds = (stamps - self._zero_ns) / NANOSECONDS
        times = None if received is None else (received - self._zero_ns) / NANOSECONDS
        begin = 0
        while begin < len(seconds):
            rows = slice(begin, begin + stream.clock.regular_count)
            begin = rows.stop
            self._add_some(
                number, seconds[rows], poses[rows], None if times is None else times[rows]
            )
        self._advance()

    def _add_some(self, number: int, seconds: Floats, poses: Floats, times: Floats | None) -> None:
        stream = self._streams[number]
        if stream.clock.is_regular(seconds, times):
            corrected = seconds + stream.clock.shift_s
            if not stream.store_all(corrected, poses):
                for stamp, pose in zip(corrected.tolist(), poses.tolist(), strict=True):
                    stream.store((stamp, pose, None))
            return
        received = [None] * len(seconds) if times is None else times.tolist()
        for message in zip(seconds.tolist(), poses.tolist(), received, strict=True):
            messages, step = stream.clock.add(message)
            if step is not None:
                self._add_clock_step(number, step.at_s, step.size_s, is_sure=step.is_sure)
            for each in messages:
                stream.store(each)

    def finish(self) -> list[Event]:
        """Return all events in order of time, after the last message."""
        for number, stream in enumerate(self._streams):
            messages, step = stream.clock.close()
            if step is not None:
                self._add_clock_step(number, step.at_s, step.size_s, is_sure=step.is_sure)
            for corrected in messages:
                stream.store(corrected)
        self._advance(at_end=True)
        if self._burn_in is not None and len(self._burn_in) >= 6:
            self._end_burn_in()
        step_left = self._open
        if step_left is not None and step_left.ratio >= _LEAST_RATIO_OF_OUTLIER:
            verdict = self._guilty(step_left.begin, step_left.after, step_left.size, (True, True))
            if verdict.side:
                # The recording ends before it is known whether the step stays.
                verdict = SideVerdict(verdict.side, UNDECIDED, verdict.innovations, verdict.gap_s)
                self._add(kinds.STEP, verdict, step_left, step_left.pairs[-1])
        self.events.sort(key=lambda event: event.t_ns)
        return self.events

    def _add_clock_step(self, number: int, at_s: float, size_s: float, *, is_sure: bool) -> None:
        at_ns = self._ns(at_s)
        for event in self.events[-4:]:
            is_other = event.kind == kinds.CLOCK_STEP and event.side == SIDES[1 - number]
            is_alike = abs(event.s - size_s) < 0.1 * abs(size_s) + 0.05
            apart_s = abs(event.t_ns - at_ns) / NANOSECONDS
            if is_other and is_alike and apart_s < 1.0 + abs(size_s):
                event.side, event.t_ns = kinds.BOTH, max(event.t_ns, at_ns)
                event.end_ns = event.t_ns
                return
        certainty = "sure" if is_sure else "likely"
        self.events.append(
            Event(kinds.CLOCK_STEP, SIDES[number], at_ns, at_ns, s=size_s, certainty=certainty)
        )

    # Pairs

    def _advance(self, *, at_end: bool = False) -> None:
        if self._source.periods is None:
            if not self._source.begin(at_end=at_end):
                return
            begin_s, period_s = self._source.begin_s, self._source.period_s
            self._history = MotionHistory(self._motion, begin_s, period_s)
        again = True
        while again:
            again = False
            shifts = [stream.clock.shift_s for stream in self._streams]
            for pair in self._source.new_pairs():
                self._take(pair)
                if [stream.clock.shift_s for stream in self._streams] != shifts:
                    again = True  # a clock step was corrected: pair again
                    break
        self.events += self._frozen.advance(self._motion.scale, self._ns)
        self._source.drop_old(None if self._open is None else self._open.begin.t)

    # Steps

    def _take(self, pair: Pair) -> None:
        if self._burn_in is None:
            self._judge(pair)
            return
        self._burn_in.append(pair)
        is_long = pair.t - self._burn_in[0].t >= _BURN_IN_S
        if is_long and len(self._burn_in) >= _BURN_IN_PAIRS:
            self._end_burn_in()

    def _end_burn_in(self) -> None:
        pairs, self._burn_in = self._burn_in or [], None
        for one, other in itertools.pairwise(pairs):
            if other.t - one.t < 2.5 * self._period_s:
                self._usual.add(0, self._motion.between(one, other))
        for pair in pairs:
            self._judge(pair)

    def _judge(self, pair: Pair) -> None:
        previous, self._previous = self._previous, pair
        if previous is None:
            self._first = pair
            self._history.begin_at(pair, is_learned=False)
            return
        seconds, step = pair.t - previous.t, self._open
        # Inside a flip, directions in the body are those of another body.
        flipped = step is not None and step.size.deg > 25.0
        difference = self._motion.between(previous, pair, by_length=flipped)
        limits = self._usual.limit(seconds)
        is_unusual = difference.m > limits[0] or difference.deg > limits[1]
        if step is not None:
            self._continue(step, pair, difference, is_unusual=is_unusual)
            return
        if is_unusual:
            pairs = [previous, pair]
            self._open = OpenStep(previous, difference, difference, limits, seconds, pair.t, pairs)
            return
        if seconds < 2.5 * self._period_s:
            self._history.add_calm(previous, pair, difference)
        self._good(pair)

    def _continue(
        self, step: OpenStep, pair: Pair, difference: Difference, *, is_unusual: bool
    ) -> None:
        total = self._motion.between(step.begin, pair)
        returns = step.is_back(total, self._usual.limit(pair.t - step.begin.t))
        returns = returns and step.has_edge(difference)
        step.add(pair, total, is_unusual=is_unusual)
        since_s = pair.t - step.after.t
        in_gap = step.gap_s > 2.5 * min(self._periods)
        if returns:
            self._return(step, pair)
        elif in_gap and not step.clock_is_tested and since_s >= _AFTER_GAP_S:
            step.clock_is_tested = True
            self._correct_clock(step)
        elif (
            len(step.pairs) >= _CALM_PAIRS + 2
            and pair.t - step.last_s >= max(_CALM_S, 4.0 * self._period_s)
            and (not in_gap or step.clock_is_tested)
        ):
            self._stay(step)
        elif since_s > _LOST_S and step.unusual > _LOST_PAIRS:
            self._lose(step, pair)

    # Ends of steps

    def _return(self, step: OpenStep, pair: Pair) -> None:
        """Close a step after which the poses returned to the former path."""
        self._open = None
        last = step.pairs[-2] if len(step.pairs) > 2 else step.after
        parts = by_m, by_deg = step.by_parts
        out = self._guilty(step.begin, step.after, step.size, parts)
        back = self._guilty(last, pair, self._motion.between(last, pair), parts)
        verdict = both_edges(out, back)
        if verdict.side and step.ratio >= _LEAST_RATIO_OF_OUTLIER:
            held = verdict.side in SIDES and self._moves_smoothly(verdict.side, step)
            is_flip = by_deg and step.size.deg > _FLIP_DEG
            is_flip &= not by_m or step.size.m < 2.0 * _FLIP_M or held
            event = self._add(kinds.FLIP if is_flip else kinds.OUTLIER, verdict, step, pair)
            event.s, event.poses = last.t - step.after.t, len(step.pairs) - 2
        self._good(pair)

    def _moves_smoothly(self, side: str, step: OpenStep) -> bool:
        number = SIDES.index(side)
        margin_s = self._margin_s(number)
        innovation = self._streams[number].innovation(step.begin.t, step.after.t, margin_s)
        scale = self._motion.scale if number else 1.0
        return scale * innovation.m < _SMOOTH * step.size.m

    def _stay(self, step: OpenStep) -> None:
        """Close a step after a calm second."""
        self._open = None
        row = step.end_of_motion()
        begin, end = step.begin, step.pairs[row]
        size = self._motion.between(begin, end)
        limits = self._usual.limit(end.t - begin.t)
        parts = by_m, by_deg = by_parts(size, limits)
        ratio, first_ratio = ratio_of(size, limits), ratio_of(step.first, step.limits)
        if ratio < _LEAST_RATIO and first_ratio > 2.0 * _LEAST_RATIO and row > 1:
            rest, step.pairs = step.pairs[row:], step.pairs[: row + 1]
            self._return(step, rest[0])  # in small steps
            for pair in rest[1:]:
                self._good(pair)
            return
        if ratio < _LEAST_RATIO:
            self._resume(step, row)
            return
        verdict = self._guilty(begin, end, size, parts)
        if not verdict.side:  # both sides move smoothly: a divergence, no discontinuity
            self._resume(step, row)
            return
        if self._ends_excursion(verdict, end):
            self._resume(step, row)
            return
        before = self._motion.state
        is_rotated = self._body_rotates(step, row) if by_deg and size.deg > 10.0 else None
        kind = kinds.STEP
        if by_deg and size.deg > _FLIP_DEG and (is_rotated or (is_rotated is None and not by_m)):
            kind = kinds.FLIP_STAYS
        elif verdict.side in (kinds.ESTIMATE, UNDECIDED):
            kind = self._kind_of_step(begin, end, size, verdict)
        kept = (size.m if by_m else 0.0, size.deg if by_deg else 0.0, size.groundtruth_m)
        step.size, step.limits = Difference(*kept), limits
        event = self._add(kind, verdict, step, end)
        event.poses = row
        self._stayed.append((begin, end, event, before))
        if kind != kinds.CORRECTION:
            self._history.begin_part()
        self._resume(step, row)

    def _kind_of_step(self, begin: Pair, end: Pair, size: Difference, verdict: SideVerdict) -> str:
        """Return whether the estimate restarted, was corrected, or made another step."""
        assert self._first is not None
        scale, origin = self._motion.scale, (0.0, 0.0, 0.0)
        near_m = scale * min(
            math.dist(end.position, self._first.position), math.dist(end.position, origin)
        )
        far_m = scale * math.dist(begin.position, self._first.position)
        marks = [mark for mark in self._history.marks if begin.t - mark.t > _BURN_IN_S]
        marks = marks[: len(marks) // 2]  # a loop closure agrees with the oldest poses
        if verdict.side == kinds.ESTIMATE and near_m < min(max(size.m / 4.0, 0.1), far_m / 3.0):
            return kinds.RESTART
        if len(marks) > 2:
            before, after = (
                float(np.median([self._motion.between(mark, pair).m for mark in marks]))
                for pair in (begin, end)
            )
            if after < _BETTER * before:
                return kinds.CORRECTION
        return kinds.STEP

    def _ends_excursion(self, verdict: SideVerdict, end: Pair) -> bool:
        """Return whether the poses return to the path before an earlier step that stayed."""
        for stayed in reversed(self._stayed):
            begin, start, event, before = stayed
            sides = {event.side, verdict.side}
            if end.t - start.t > _RETURN_S or (len(sides) > 1 and UNDECIDED not in sides):
                continue
            rows = before[0] if event.kind == kinds.FLIP_STAYS else None
            total = self._motion.between(begin, end, rows=rows)
            limit_m, _ = self._usual.limit(end.t - begin.t)
            is_known = not event.m or limit_m < 2.0 * event.m
            if is_known and is_back(total, Difference(event.m, event.deg, 0.0)):
                is_flip = event.deg > _FLIP_DEG
                event.kind = kinds.FLIP if is_flip else kinds.OUTLIER
                event.end_ns, event.s, event.poses = self._ns(end.t), end.t - start.t, 0
                event.side = verdict.side if event.side == UNDECIDED else event.side
                if is_flip and before[0] is not None:
                    self._motion.state = before
                self._stayed.remove(stayed)
                return True
        return False

    def _body_rotates(self, step: OpenStep, row: int) -> bool | None:
        """Rotate the learned body after a flip that stays, if later motions agree with it better.

        Returns None if the later motion is too short to decide.
        """
        if self._motion.rotation is None or not self._motion.oriented:
            return None
        end = step.pairs[row]
        beyond = rotation_beyond(self._motion, step.begin, end)
        rows = beyond @ self._motion.rotation
        later = [
            pair
            for pair in step.pairs[row + 1 :]
            if math.dist(pair.groundtruth_position, end.groundtruth_position) > _LEAST_LATER_M
        ][::3]
        if len(later) < 3:
            return False if later else None
        same, rotated = (
            float(
                np.median(
                    [
                        ratio_of(
                            self._motion.between(end, pair, rows=known),
                            self._usual.limit(pair.t - end.t),
                        )
                        for pair in later
                    ]
                )
            )
            for known in (None, rows)
        )
        if rotated >= same / 2.0:
            return False
        self._motion.rotate(beyond)
        return True

    def _lose(self, step: OpenStep, pair: Pair) -> None:
        """Close a step whose poses neither return nor calm down."""
        self._open = None
        verdict = self._guilty(step.begin, step.after, step.size, step.by_parts)
        last = self.events[-1] if self.events else None
        if (
            last is not None
            and last.kind == kinds.LOST
            and (self._ns(step.begin.t) - last.end_ns < 2 * NANOSECONDS)
        ):
            last.end_ns = self._ns(pair.t)
        elif verdict.side:
            self._add(kinds.LOST, verdict, step, pair).poses = step.unusual
        self._history.begin_at(pair, is_learned=False)
        self._previous = pair

    def _resume(self, step: OpenStep, row: int) -> None:
        """Continue with the pairs after a step."""
        pairs = step.pairs[row:]
        self._history.begin_at(pairs[0])
        if not self._motion.oriented:
            self._motion.forget_frame()
        for pair in pairs:
            self._good(pair)

    def _correct_clock(self, step: OpenStep) -> None:
        """Correct a forward clock step in a gap, which only the motion shows, and pair again."""
        limit_m = self._usual.limit(2.0)[0]
        for number in (1, 0):
            streams = self._streams[number], self._streams[1 - number]
            period_s = self._periods[number]
            times = step.begin.t, step.after.t
            found = clock_by_motion(*streams, number, *times, period_s, self._motion, limit_m)
            if found is None:
                continue
            size_s, row = found
            self._streams[number].shift_from(row, size_s)
            self._add_clock_step(number, step.begin.t, size_s, is_sure=False)
            self._previous, self._open = step.begin, None
            self._source.rewind(step.begin.t)
            return

    def _good(self, pair: Pair) -> None:
        self._previous = pair
        self._history.add(pair)

    @property
    def _usual(self) -> UsualDifferences:
        return self._history.usual

    @property
    def _periods(self) -> tuple[float, float]:
        assert self._source.periods is not None
        return self._source.periods

    @property
    def _period_s(self) -> float:
        return self._source.period_s

    def _guilty(
        self, begin: Pair, end: Pair, size: Difference, parts: tuple[bool, bool]
    ) -> SideVerdict:
        innovations = []
        for number, stream in enumerate(self._streams):
            margin_s = self._margin_s(number)
            innovations.append(stream.innovation(begin.t, end.t, margin_s))
        return guilty_side(innovations, self._periods, self._motion.scale, size, parts)

    def _margin_s(self, number: int) -> float:
        return 0.0 if number == self._source.base else 1.01 * self._periods[number]

    def _add(self, kind: str, verdict: SideVerdict, step: OpenStep, end: Pair) -> Event:
        by_m, by_deg = step.by_parts
        event = Event(
            kind,
            verdict.side,
            self._ns(step.begin.t),
            self._ns(end.t),
            m=step.size.m if by_m else 0.0,
            deg=step.size.deg if by_deg else 0.0,
            certainty=verdict.certainty,
            ratio=step.ratio,
            gap_s=verdict.gap_s,
            innovations=verdict.innovations,
        )
        self.events.append(event)
        return event

    def _ns(self, seconds: float) -> int:
        return (self._zero_ns or 0) + round(seconds * NANOSECONDS)
