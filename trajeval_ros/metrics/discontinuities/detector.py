"""Discontinuities of groundtruth and estimate, live and recorded.

Pairs at the slower side's timestamps are compared by their motions (`relative_motion`). A motion
that differs by more than usual begins a step. It returns, or it stays; the side whose own
velocity changes little there is exonerated, and the other one is guilty.
"""

from __future__ import annotations

import bisect
import dataclasses
import itertools
import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.discontinuities import events as kinds
from trajeval_ros.metrics.discontinuities.clock_by_motion import clock_by_motion
from trajeval_ros.metrics.discontinuities.events import SIDES, UNDECIDED, Event
from trajeval_ros.metrics.discontinuities.exoneration import GAP_PERIODS, SideVerdict, guilty_side
from trajeval_ros.metrics.discontinuities.frozen_parts import FrozenParts
from trajeval_ros.metrics.discontinuities.pose_stream import SidePoses
from trajeval_ros.metrics.discontinuities.relative_motion import (
    CELL_S,
    LAGS,
    BodyState,
    Difference,
    Pair,
    RelativeMotion,
    UsualDifferences,
    rotation_beyond,
)

_BLOCK_S = 1.0  # of recorded streams, as a live node receives them
_LEAST_POSES, _LEAST_OVERLAP_S = (10, 5), 4.0  # before the rates are known
_BURN_IN_S, _BURN_IN_PAIRS = 4.0, 12  # the first pairs are judged in retrospect
_LEAST_GAP_S = 0.175  # a shorter step of timestamps is interpolated at any rate
# A step stays after this time and number of calm pairs: longer delays an alarm, shorter takes
# an outlier for a step.
_CALM_S, _CALM_PAIRS = 1.0, 5
_AFTER_GAP_S = 3.2  # motion after a gap that determines a clock step
_LOST_S, _LOST_PAIRS = 10.0, 5  # steps without a calm second
# Smallest events, as multiples of the limit. Single poses of heavy-tailed noise exceed 1.5.
_LEAST_RATIO, _LEAST_RATIO_OF_OUTLIER = 1.5, 2.5
_BACK = 1.0 / 3.0  # of a step: a pose that differs by less has returned
_RETURN_S = 60.0  # longest excursion whose return is known
_FLIP_DEG = 60.0  # smallest rotation of a flip: corrections of a heading are smaller
_FLIP_M = 0.15  # a marker that flips moves its centre less
_SMOOTH = 0.34  # innovation as a fraction of a step, of a side whose position did not jump
_LEAST_LATER_M = 0.09  # motion after a flip that shows whether the body is another
_BETTER = 0.7  # of the error against earlier pairs, after a correction
_MEMORY_S = 70.0


@dataclass
class _Step:
    """A step that is not yet known to stay or to return."""

    begin: Pair  # the last good pair
    size: Difference  # the largest so far
    first: Difference
    limits: tuple[float, float]
    gap_s: float  # time from the last good pair to the first pair after the step
    last_s: float  # time of the last unusual motion
    pairs: list[Pair] = field(default_factory=list)  # the last good one, and those since
    unusual: int = 1
    clock_is_tested: bool = False

    @property
    def after(self) -> Pair:
        return self.pairs[1]

    @property
    def ratio(self) -> float:
        return max(self.size.m / self.limits[0], self.size.deg / self.limits[1])

    @property
    def by_parts(self) -> tuple[bool, bool]:
        return _by_parts(self.size, self.limits)


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
        self._motion = RelativeMotion(oriented=oriented)
        self._zero_ns: int | None = None
        self._periods: tuple[float, float] | None = None  # seconds, of both sides
        self._begin_s = 0.0
        self._base = 1  # index of the slower side
        self._next = 0  # row of the next pose of the slower side to pair
        self._burn_in: list[Pair] | None = []
        self._first: Pair | None = None
        self._previous: Pair | None = None
        self._cell = 0
        self._ring: deque[Pair | None] = deque(maxlen=LAGS[-1] + 1)  # good pairs, one per cell
        self._calm: deque[tuple[Pair, Pair]] = deque(maxlen=200)
        self._calm_count = 0
        self._marks: deque[Pair] = deque(maxlen=40)  # good pairs of the present part
        self._open: _Step | None = None
        # Steps that may return: begin, end, event, and the body's rotation before them.
        self._stayed: deque[tuple[Pair, Pair, Event, BodyState]] = deque(maxlen=8)
        self._frozen = FrozenParts(self._streams)

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
        if self._periods is None and not self._begin(at_end=at_end):
            return
        assert self._periods is not None
        again = True
        while again:
            again = False
            shifts = [stream.clock.shift_s for stream in self._streams]
            for pair in self._new_pairs():
                self._take(pair)
                if [stream.clock.shift_s for stream in self._streams] != shifts:
                    again = True  # a clock step was corrected: pair again
                    break
        self.events += self._frozen.advance(self._motion.scale, self._ns)
        self._drop_old()

    def _begin(self, *, at_end: bool) -> bool:
        """Determine the rates and the slower side; return whether they are known."""
        groundtruth, estimate = self._streams
        if len(groundtruth) < _LEAST_POSES[0] or len(estimate) < _LEAST_POSES[1]:
            return False
        begin_s = max(groundtruth.stamps[0], estimate.stamps[0])
        overlap_s = min(groundtruth.stamps[-1], estimate.stamps[-1]) - begin_s
        if overlap_s < _LEAST_OVERLAP_S and not at_end:
            return False
        until_s = begin_s + _LEAST_OVERLAP_S  # the same poses for batches of any size
        first, second = (
            float(np.median(np.diff(each.stamps[: max(bisect.bisect(each.stamps, until_s), 2)])))
            for each in self._streams
        )
        self._periods, self._base = (first, second), 0 if first > 1.5 * second else 1
        self._begin_s = begin_s
        self._usual = UsualDifferences(self._period_s)
        return True

    @property
    def _period_s(self) -> float:
        assert self._periods is not None
        return self._periods[self._base]

    def _new_pairs(self) -> list[Pair]:
        """Interpolate the faster side at the timestamps of the slower one."""
        assert self._periods is not None
        base, other = self._streams[self._base], self._streams[1 - self._base]
        if len(other) < 2:
            return []
        begin, end = self._next, bisect.bisect_right(base.stamps, other.stamps[-1])
        if end <= begin:
            return []
        self._next = end
        start = max(bisect.bisect_right(other.stamps, base.stamps[begin]) - 1, 0)
        times = np.array(other.stamps[start:])
        if len(times) < 2:
            return []
        at = np.array(base.stamps[begin:end])
        rows = np.clip(np.searchsorted(times, at, "right") - 1, 0, len(times) - 2)
        width = times[rows + 1] - times[rows]
        fraction = (at - times[rows]) / width
        longest_s = max(GAP_PERIODS * self._periods[1 - self._base], _LEAST_GAP_S)
        is_known = (fraction >= -1e-9) & (fraction <= 1.0 + 1e-9) & (width <= longest_s)
        positions = np.array(other.positions[start:])
        quaternions = np.array(other.quaternions[start:])
        between, one, two = fraction[:, None], quaternions[rows], quaternions[rows + 1]
        moved = positions[rows] + between * (positions[rows + 1] - positions[rows])
        two = np.where(np.sum(one * two, axis=1, keepdims=True) < 0.0, -two, two)
        turned = lie.normalized((1.0 - between) * one + between * two)
        columns = list(map(tuple, moved.tolist())), list(map(tuple, turned.tolist()))
        sides = [columns, columns]
        sides[self._base] = base.positions[begin:end], base.quaternions[begin:end]
        seconds = at.tolist()
        return [
            Pair(seconds[row], *(column[row] for side in sides for column in side))
            for row in np.flatnonzero(is_known).tolist()
        ]

    def _drop_old(self) -> None:
        newest_s = min(stream.newest_s for stream in self._streams)
        if self._open is not None:
            newest_s = min(newest_s, self._open.begin.t + _MEMORY_S)
        newest_s = max(newest_s, max(stream.newest_s for stream in self._streams) - _MEMORY_S)
        for number, stream in enumerate(self._streams):
            if len(stream) and newest_s - stream.stamps[0] > 1.5 * _MEMORY_S:
                dropped = stream.drop_before(newest_s - _MEMORY_S)
                if number == self._base:
                    self._next = max(self._next - dropped, 0)

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
            self._first, self._cell = pair, self._cell_of(pair)
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
            self._open = _Step(previous, difference, difference, limits, seconds, pair.t, pairs)
            return
        if seconds < 2.5 * self._period_s:
            self._calm.append((previous, pair))
            self._calm_count += 1
            every = max(1, int(CELL_S / self._period_s) // 3)
            if self._calm_count % every == 0 or len(self._usual) < 60:
                self._usual.add(0, difference)
        self._good(pair)

    def _continue(
        self, step: _Step, pair: Pair, difference: Difference, *, is_unusual: bool
    ) -> None:
        step.pairs.append(pair)
        if len(step.pairs) > 400:
            del step.pairs[200:300]
        total = self._motion.between(step.begin, pair)
        limits = self._usual.limit(pair.t - step.begin.t)
        by_m, by_deg = step.by_parts
        is_back = not by_m or total.m < max(step.size.m * _BACK, min(limits[0], step.size.m / 2))
        is_back &= not by_deg or total.deg < max(
            step.size.deg * _BACK, min(limits[1], step.size.deg / 2)
        )
        if is_unusual:
            m, deg = max(step.size.m, total.m), max(step.size.deg, total.deg)
            step.size, step.last_s = Difference(m, deg, total.groundtruth_m), pair.t
            step.unusual += 1
        # A difference that only crosses zero is no return.
        has_edge = (by_m and difference.m > step.first.m / 2) or (
            by_deg and difference.deg > step.first.deg / 2
        )
        since_s = pair.t - step.after.t
        assert self._periods is not None
        in_gap = step.gap_s > 2.5 * min(self._periods)
        if is_back and has_edge:
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

    def _good(self, pair: Pair) -> None:
        self._previous = pair
        cell = self._cell_of(pair)
        if cell == self._cell:
            return
        self._ring.extend([None] * min(cell - self._cell - 1, LAGS[-1] + 1))
        self._cell = cell
        self._learn(pair)
        if cell % 4 == 0:
            self._marks.append(pair)

    def _cell_of(self, pair: Pair) -> int:
        return int((pair.t - self._begin_s) / CELL_S)

    def _learn(self, pair: Pair) -> None:
        """Learn the differences over all lags, once per cell."""
        for lag in LAGS:
            earlier = self._ring[-lag] if len(self._ring) >= lag else None
            if earlier is None or not self._is_lag(lag, pair.t - earlier.t):
                continue
            self._usual.add(lag, self._motion.between(earlier, pair))
            if lag == 2 and self._motion.learn(earlier, pair):
                self._learn_again()
        self._ring.append(pair)

    def _is_lag(self, lag: int, seconds: float) -> bool:
        apart_s = abs(seconds - lag * CELL_S)
        return self._usual.is_learned(lag) and apart_s <= 0.5 * CELL_S + self._period_s

    def _learn_again(self) -> None:
        """Replace differences of lengths by those of vectors, once the rotation is known."""
        self._usual.clear()
        pairs = [pair for pair in self._ring if pair is not None]
        for row, pair in enumerate(pairs):
            for lag in LAGS:
                if row >= lag and self._is_lag(lag, pair.t - pairs[row - lag].t):
                    self._usual.add(lag, self._motion.between(pairs[row - lag], pair))
        for one, other in list(self._calm)[-60:]:
            self._usual.add(0, self._motion.between(one, other))

    # Ends of steps

    def _return(self, step: _Step, pair: Pair) -> None:
        """Close a step after which the poses returned to the former path."""
        self._open = None
        last = step.pairs[-2] if len(step.pairs) > 2 else step.after
        parts = by_m, by_deg = step.by_parts
        out = self._guilty(step.begin, step.after, step.size, parts)
        back = self._guilty(last, pair, self._motion.between(last, pair), parts)
        verdict = _both_edges(out, back)
        if verdict.side and step.ratio >= _LEAST_RATIO_OF_OUTLIER:
            held = verdict.side in SIDES and self._moves_smoothly(verdict.side, step)
            is_flip = by_deg and step.size.deg > _FLIP_DEG
            is_flip &= not by_m or step.size.m < 2.0 * _FLIP_M or held
            event = self._add(kinds.FLIP if is_flip else kinds.OUTLIER, verdict, step, pair)
            event.s, event.poses = last.t - step.after.t, len(step.pairs) - 2
        self._good(pair)

    def _moves_smoothly(self, side: str, step: _Step) -> bool:
        number = SIDES.index(side)
        margin_s = self._margin_s(number)
        innovation = self._streams[number].innovation(step.begin.t, step.after.t, margin_s)
        scale = self._motion.scale if number else 1.0
        return scale * innovation.m < _SMOOTH * step.size.m

    def _stay(self, step: _Step) -> None:
        """Close a step after a calm second."""
        self._open = None
        rows = range(len(step.pairs))
        row = next((row for row in rows if step.pairs[row].t >= step.last_s), len(rows) - 1)
        begin, end = step.begin, step.pairs[row]
        size = self._motion.between(begin, end)
        limits = self._usual.limit(end.t - begin.t)
        parts = by_m, by_deg = _by_parts(size, limits)
        ratio = max(size.m / limits[0], size.deg / limits[1])
        first_ratio = max(step.first.m / step.limits[0], step.first.deg / step.limits[1])
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
            self._marks.clear()
        self._resume(step, row)

    def _kind_of_step(self, begin: Pair, end: Pair, size: Difference, verdict: SideVerdict) -> str:
        """Return whether the estimate restarted, was corrected, or made another step."""
        assert self._first is not None
        scale, origin = self._motion.scale, (0.0, 0.0, 0.0)
        near_m = scale * min(
            math.dist(end.position, self._first.position), math.dist(end.position, origin)
        )
        far_m = scale * math.dist(begin.position, self._first.position)
        marks = [mark for mark in self._marks if begin.t - mark.t > _BURN_IN_S]
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
            is_back = not event.m or (total.m < _BACK * event.m and limit_m < 2.0 * event.m)
            if is_back and (not event.deg or total.deg < _BACK * event.deg):
                is_flip = event.deg > _FLIP_DEG
                event.kind = kinds.FLIP if is_flip else kinds.OUTLIER
                event.end_ns, event.s, event.poses = self._ns(end.t), end.t - start.t, 0
                event.side = verdict.side if event.side == UNDECIDED else event.side
                if is_flip and before[0] is not None:
                    self._motion.state = before
                self._stayed.remove(stayed)
                return True
        return False

    def _body_rotates(self, step: _Step, row: int) -> bool | None:
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
            float(np.median([self._motion.between(end, pair, rows=each).m for pair in later]))
            for each in (None, rows)
        )
        if rotated >= same / 2.0:
            return False
        self._motion.rotate(beyond)
        return True

    def _lose(self, step: _Step, pair: Pair) -> None:
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
        self._ring.clear()
        self._previous, self._cell = pair, self._cell_of(pair)

    def _resume(self, step: _Step, row: int) -> None:
        """Continue with the pairs after a step."""
        pairs = step.pairs[row:]
        self._ring.clear()
        self._cell = self._cell_of(pairs[0]) - 1
        if not self._motion.oriented:
            self._motion.forget_frame()
        for pair in pairs:
            self._good(pair)

    def _correct_clock(self, step: _Step) -> None:
        """Correct a forward clock step in a gap, which only the motion shows, and pair again."""
        assert self._periods is not None
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
            base = self._streams[self._base]
            self._next = bisect.bisect_left(base.stamps, step.begin.t + 1e-9)
            return

    def _guilty(
        self, begin: Pair, end: Pair, size: Difference, parts: tuple[bool, bool]
    ) -> SideVerdict:
        assert self._periods is not None
        innovations = []
        for number, stream in enumerate(self._streams):
            margin_s = self._margin_s(number)
            innovations.append(stream.innovation(begin.t, end.t, margin_s))
        return guilty_side(innovations, self._periods, self._motion.scale, size, parts)

    def _margin_s(self, number: int) -> float:
        assert self._periods is not None
        return 0.0 if number == self._base else 1.01 * self._periods[number]

    def _add(self, kind: str, verdict: SideVerdict, step: _Step, end: Pair) -> Event:
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


def discontinuities(
    groundtruth: Trajectory, estimate: Trajectory, offset_ns: int = 0
) -> list[Event]:
    """Return the events of two recorded trajectories, as a live run finds them, by time.

    If both sides have receive times, their states are taken in that order; else in the given one.
    `offset_ns` is added to the estimate's timestamps.
    """
    if offset_ns:
        estimate = dataclasses.replace(estimate, stamps=estimate.stamps + offset_ns)
    oriented = groundtruth.quaternions is not None and estimate.quaternions is not None
    search, sides, blocks = Discontinuities(oriented=oriented), [], []
    times = [each.reading.receptions for each in (groundtruth, estimate)]
    has_times = all(each is not None for each in times)
    for trajectory, receptions in zip((groundtruth, estimate), times, strict=True):
        received = None
        if has_times and receptions is not None:
            order = np.argsort(receptions.times, kind="stable")
            trajectory, received = trajectory[order], receptions.times[order]
        columns = [trajectory.positions]
        if oriented and trajectory.quaternions is not None:
            columns.append(trajectory.quaternions)
        sides.append((trajectory.stamps, np.hstack(columns), received))
        blocks.append(np.maximum.accumulate(trajectory.stamps if received is None else received))
    first, last = min(int(each[0]) for each in blocks), max(int(each[-1]) for each in blocks)
    block_ns, rows = round(_BLOCK_S * NANOSECONDS), [0, 0]
    ends = range(first, last + block_ns, block_ns)
    for until in ends:
        for number, (stamps, poses, received) in enumerate(sides):
            begin = rows[number]
            end = int(np.searchsorted(blocks[number], until, "right"))
            part = None if received is None else received[begin:end]
            search.add(SIDES[number], stamps[begin:end], poses[begin:end], part)
            rows[number] = end
    return search.finish()


def _by_parts(size: Difference, limits: tuple[float, float]) -> tuple[bool, bool]:
    """Return whether a step is one of position and of rotation; the lesser one may be noise."""
    m, deg = size.m / limits[0], size.deg / limits[1]
    return m > 1.0 and (m > 0.2 * deg or m > 3.0), deg > 1.0 and (deg > 0.2 * m or deg > 3.0)


def _both_edges(out: SideVerdict, back: SideVerdict) -> SideVerdict:
    """Return the verdict on an excursion by its begin and its end."""
    if out.side == back.side:
        return out
    if out.side in ("", UNDECIDED):
        return dataclasses.replace(back, certainty="likely" if back.side else "")
    if back.side in ("", UNDECIDED):
        return dataclasses.replace(out, certainty="likely")
    return dataclasses.replace(out, side=UNDECIDED, certainty=UNDECIDED)
