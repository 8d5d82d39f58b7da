"""The search for steps in pairs of both sides.

Pairs at the slower side's timestamps are compared by their motions (`relative_motion`). A motion
that differs by more than usual begins a step. It returns, or it stays; the side whose own
velocity changes little there is exonerated, and the other one is guilty.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities import events as kinds
from trajeval_ros.metrics.discontinuities.clock_steps import ClockSteps
from trajeval_ros.metrics.discontinuities.events import SIDES, UNDECIDED, Event
from trajeval_ros.metrics.discontinuities.exoneration import (
    EXONERATES,
    SideVerdict,
    guilty_side,
)
from trajeval_ros.metrics.discontinuities.motion_history import MotionHistory
from trajeval_ros.metrics.discontinuities.open_step import (
    FLIP_DEG,
    GAP,
    LEAST_RATIO,
    LEAST_RATIO_OF_OUTLIER,
    MOST_STAYED,
    RETURN_S,
    PairStep,
    both_edges,
    by_parts,
    calm_s,
    is_back,
    is_flip,
    is_lost,
    ratio_of,
)
from trajeval_ros.metrics.discontinuities.pairs import PairSource
from trajeval_ros.metrics.discontinuities.relative_motion import (
    PAIR_WIDTH,
    BodyState,
    Difference,
    RelativeMotion,
    Size,
    rotation_beyond,
)
from trajeval_ros.metrics.discontinuities.step_kinds import kind_of_step, rotates_body
from trajeval_ros.metrics.discontinuities.usual_differences import UsualDifferences

_BURN_IN_S, _BURN_IN_PAIRS = 4.0, 12  # the first pairs are judged in retrospect
LEARN_S = 20.0  # time between updates of the limits of usual motion: a shorter one costs time
# Intervals about an unusual motion that are examined: what is usual is learned before, and the
# poses may return after it (`RETURN_S`).
_EXAMINED = range(-1, 4)
_CALM_PAIRS = 5  # after a step that stays
_AFTER_GAP_S = 3.2  # motion after a gap that determines a clock step
_LEAST_ROTATED_DEG = 10.0  # of a step whose body may have rotated: less is an error of a heading
# Inside a flip, directions in the body are those of another body: lengths are compared.
_OTHER_BODY_DEG = 25.0
_FOLLOWED = 64  # pairs that are compared at a time after a step, which mostly ends among them


def examined_intervals(seconds: Floats) -> set[int]:
    """Return the numbers of the intervals about unusual motions, at times (K,) since the begin."""
    numbers = np.floor(seconds / LEARN_S).astype(np.int64)
    return {number + near for number in set(numbers.tolist()) for near in _EXAMINED}


class StepSearch:
    """Takes pairs in order of time, and finds steps and excursions."""

    def __init__(
        self,
        source: PairSource,
        motion: RelativeMotion,
        events: list[Event],
        clocks: ClockSteps,
        unusual_s: Floats | None = None,
    ) -> None:
        """Create it once the rates are known.

        Args:
            source: The pairs and their streams.
            motion: The relative motion, which it learns.
            events: Where it appends events.
            clocks: Corrects clock steps in gaps.
            unusual_s: Times (K,) of the only motions that can be steps; None if they are unknown.
        """
        self.open: PairStep | None = None
        self.previous: Floats | None = None  # the last judged pair (15,)
        self._source, self._motion, self._events = source, motion, events
        self._clocks = clocks
        self._history = MotionHistory(motion, source.begin_s, source.period_s)
        self._burn_in: Floats | None = np.empty((0, PAIR_WIDTH))
        self._interval = 0  # number of the interval whose pairs have the same limits
        # Numbers of the intervals that are examined; None for all. That before them is learned.
        self._examined: set[int] | None = None
        if unusual_s is not None:
            self._examined = examined_intervals(unusual_s - source.begin_s)
        # Steps that may return: begin, end, event, and the body's rotation before them.
        self._stayed: deque[tuple[Floats, Floats, Event, BodyState]] = deque(maxlen=MOST_STAYED)

    def take(self, pairs: Floats) -> bool:
        """Take N pairs (N, 15); return whether a clock was corrected, to pair again.

        The events are equal for any N, but for rounding.
        """
        if self._burn_in is not None:
            count = len(self._burn_in)
            pairs = np.concatenate([self._burn_in, pairs])
            is_long = pairs[:, 0] - pairs[:1, 0] >= _BURN_IN_S
            is_long[: _BURN_IN_PAIRS - 1] = False
            if not is_long[count:].any():
                self._burn_in = pairs
                return False
            self._end_burn_in(pairs[: count + int(is_long[count:].argmax()) + 1])
        return self._judge(pairs)

    def finish(self) -> None:
        """Judge what waits at the end of the run."""
        if self._burn_in is not None and len(self._burn_in) > _CALM_PAIRS:
            pairs = self._burn_in
            self._end_burn_in(pairs)
            self._judge(pairs)
        step = self.open
        if step is not None and step.ratio >= LEAST_RATIO_OF_OUTLIER:
            verdict = self._guilty(step.begin, step.after, step.size, (True, True))
            if verdict.side:
                verdict = dataclasses.replace(verdict, certainty=UNDECIDED)
                last = step.pairs[-1]
                if last[0] - step.after[0] < calm_s(self._source.period_s):
                    event = self._add_excursion(verdict, step, step.begin, last)
                    truth = self._source.streams[0]
                    last_s = truth.stamps[min(truth.row_from(last[0]), len(truth) - 1)]
                    event.end_ns, event.poses = self._clocks.ns(last_s), len(step.pairs) - 1
                else:  # the recording ends before it is known whether the step stays
                    self._add(kinds.STEP, verdict, step, last)

    def _end_burn_in(self, pairs: Floats) -> None:
        self._burn_in = None
        calm = np.diff(pairs[:, 0]) < GAP * self._source.period_s
        difference = self._motion.between(pairs[:-1][calm], pairs[1:][calm])
        self._usual.add(0, difference.m, difference.deg)
        self._history.begin_at(pairs[0], is_learned=False)

    def _judge(self, pairs: Floats) -> bool:
        while len(pairs):
            if self.previous is None:
                self.previous, pairs = pairs[0], pairs[1:]
            elif self.open is None:
                pairs = self._pass(self.previous, pairs)
            else:
                pairs, is_corrected = self._follow(self.open, self.previous, pairs)
                if is_corrected:
                    return True
        return False

    def _pass(self, previous: Floats, pairs: Floats) -> Floats:
        """Learn pairs of usual motion until a step begins; return the pairs after it."""
        begin_s = self._source.begin_s
        interval = int((pairs[0, 0] - begin_s) / LEARN_S)
        count = max(1, int(pairs[:, 0].searchsorted(begin_s + (interval + 1) * LEARN_S)))
        is_examined = self._examined is None or interval in self._examined
        if self._examined is not None and not {interval, interval + 1} & self._examined:
            self._good(pairs[:count])
            return pairs[count:]
        if interval != self._interval:
            self._history.learn(of_lags=False)
            self._interval = interval
        both = np.concatenate([previous[None], pairs[:count]])
        begin, end = both[:-1], both[1:]
        seconds = end[:, 0] - begin[:, 0]
        difference = self._motion.among(both, slice(-1), slice(1, None))
        limit_m, limit_deg = self._usual.limit(seconds)
        unusual = (difference.m > limit_m) | (difference.deg > limit_deg)
        if self._history.waiting:
            unusual |= seconds > GAP * self._source.period_s
        unusual &= is_examined
        row = int(unusual.argmax()) if unusual.any() else count
        if row:
            calm = np.flatnonzero(seconds[:row] < GAP * self._source.period_s)
            steps = Difference(*(values[calm] for values in difference))
            self._history.add_calm(begin[calm], end[calm], steps)
            self._good(end[:row])
        if row == count:
            return pairs[count:]
        if self._history.learn():
            return pairs[row:]  # judge it again by all pairs before it
        self.previous = end[row]
        size, limits = difference.size(row), (float(limit_m[row]), float(limit_deg[row]))
        self.open = PairStep(begin[row], end[row], size, limits)
        return pairs[row + 1 :]

    def _follow(self, step: PairStep, previous: Floats, pairs: Floats) -> tuple[Floats, bool]:
        """Take pairs until a step ends; return the pairs after it, and whether a clock stepped."""
        both = np.concatenate([previous[None], pairs[:_FOLLOWED]])
        new, seconds = both[1:], both[1:, 0]
        motions = self._motion.among(both, slice(-1), slice(1, None))
        totals = self._motion.between(step.begin, new)
        if step.size.deg > _OTHER_BODY_DEG:
            motions = motions._replace(m=motions.lengths_m)
        limit_m, limit_deg = self._usual.limit(np.diff(both[:, 0]))
        is_unusual = (motions.m > limit_m) | (motions.deg > limit_deg)
        # The step before and after each of them.
        sizes = [
            np.maximum.accumulate(np.append(size, np.where(is_unusual, total, 0.0)))
            for size, total in zip(step.size, totals[:2], strict=True)
        ]
        last_s = np.maximum.accumulate(np.where(is_unusual, seconds, step.last_s))
        unusual = step.unusual + np.cumsum(is_unusual)
        numbers = len(step.pairs) + 1 + np.arange(len(new))
        in_gap, lasted_s = self._in_gap(step), seconds - step.after[0]
        before = [values[:-1] for values in sizes]
        since_begin = self._usual.limit(seconds - step.begin[0])
        is_back = step.are_back(before, totals, since_begin, motions)
        tests_clock = in_gap & (not step.clock_is_tested) & (lasted_s >= _AFTER_GAP_S)
        is_calm = (numbers >= _CALM_PAIRS + 2) & (
            seconds - last_s >= calm_s(self._source.period_s)
        )
        is_calm &= step.clock_is_tested or not in_gap
        ends = is_back | tests_clock | is_calm | is_lost(lasted_s, unusual)
        if step.size.deg <= _OTHER_BODY_DEG:
            ends |= sizes[1][1:] > _OTHER_BODY_DEG  # what is unusual changes
        row = int(ends.argmax()) if ends.any() else len(new) - 1
        step.add(new[: row + 1])
        step.size = Size(*(float(values[row + 1]) for values in sizes))
        step.last_s, step.unusual = float(last_s[row]), int(unusual[row])
        pair = self.previous = new[row]
        if is_back[row]:
            self._return(step, pair)
        elif tests_clock[row]:
            step.clock_is_tested = True
            if self._clocks.correct(step, float(self._usual.limit(2.0)[0])):
                self.previous, self.open = step.begin, None
                return pairs[:0], True
        elif is_calm[row]:
            self._stay(step)
        elif is_lost(float(lasted_s[row]), step.unusual):
            self._lose(step, pair)
        return pairs[row + 1 :], False

    def _in_gap(self, step: PairStep) -> bool:
        return step.gap_s > GAP * min(self._periods)

    # Ends of steps

    def _return(self, step: PairStep, pair: Floats) -> None:
        """Close a step after which the poses returned to the former path."""
        self.open = None
        last = step.pairs[-2] if len(step.pairs) > 2 else step.after
        out = self._guilty(step.begin, step.after, step.size, step.by_parts)
        back = self._guilty(last, pair, self._motion.size(last, pair), step.by_parts)
        verdict = both_edges(out, back)
        if verdict.side and step.ratio >= LEAST_RATIO_OF_OUTLIER:
            event = self._add_excursion(verdict, step, step.begin, pair)
            event.s, event.poses = float(last[0] - step.after[0]), len(step.pairs) - 2
        self._good(pair[None])

    def _add_excursion(
        self, verdict: SideVerdict, step: PairStep, good: Floats, end: Floats
    ) -> Event:
        """Add an outlier or a flip until `end`, with its largest difference to a good pair.

        Pairs at the other side's timestamps interpolate a single pose, which has more.
        """
        held = False
        if verdict.side in SIDES:
            number = SIDES.index(verdict.side)
            # A good pair after the excursion follows first poses that are outside.
            begin_s = good[0] if good[0] < end[0] else -math.inf
            pairs = self._source.within(number, begin_s, end[0])
            difference = self._motion.between(good, pairs)
            innovation = self._source.innovation(number, step.begin[0], step.after[0])
            moved_m = innovation.m * (self._motion.scale if number else 1.0)
            # Without the rotation between the frames, only lengths are compared.
            least_m = moved_m if self._motion.rotation is None else step.size.m
            step.size = Size(
                float(difference.m.max(initial=max(least_m, step.size.m))),
                float(difference.deg.max(initial=step.size.deg)),
            )
            held = moved_m < EXONERATES * step.size.m
        flips = is_flip(step.parts, holds_position=held)
        return self._add(kinds.FLIP if flips else kinds.OUTLIER, verdict, step, end)

    def _stay(self, step: PairStep) -> None:
        """Close a step after a calm second."""
        self.open = None
        begin, row, is_rotated = step.begin, step.end_of_motion(), None
        size, limits = self._sized(begin, step.pairs[row])
        if by_parts(size, limits)[1] and size.deg > _LEAST_ROTATED_DEG:
            # After a flip, usual motions are unusual by the former body. It is the first motion,
            # or the first two: a pose between two of the faster side is a part of it.
            for at in sorted({1, 2, row}):
                is_rotated = rotates_body(self._motion, self._usual, step, at)
                if is_rotated:
                    row = at
                    break
        end = step.pairs[row]
        size, limits = self._sized(begin, end)
        parts = by_m, by_deg = by_parts(size, limits)
        ratio, first_ratio = ratio_of(size, limits), ratio_of(step.first_size, step.limits)
        if ratio < LEAST_RATIO and first_ratio > 2.0 * LEAST_RATIO and row > 1:
            rest, step.pairs = step.pairs[row:], step.pairs[: row + 1]
            self._return(step, rest[0])  # in small steps
            if len(rest) > 1:
                self._good(np.array(rest[1:]))
            return
        verdict = self._guilty(begin, end, size, parts)
        # If both sides move smoothly, it is a divergence and no discontinuity.
        if ratio < LEAST_RATIO or not verdict.side or self._ends_excursion(verdict, end):
            self._resume(step, row)
            return
        before_s = begin[0] - self._source.begin_s
        if before_s < calm_s(self._source.period_s):  # the first poses are outside of the path
            event = self._add_excursion(verdict, step, end, end)
            truth = self._source.streams[0]
            first_s = truth.stamps[max(truth.row_after(self._source.begin_s) - 1, 0)]
            event.t_ns, event.s = self._clocks.ns(first_s), before_s
            event.poses = round(before_s / self._source.period_s) + 1
            self._history.begin_part()
            self._resume(step, row)
            return
        before = self._motion.state
        if is_rotated:
            self._motion.rotate(rotation_beyond(self._motion, begin, end))
        kind = kinds.STEP
        if by_deg and size.deg > FLIP_DEG and (is_rotated or (is_rotated is None and not by_m)):
            kind = kinds.FLIP_STAYS
        elif verdict.side in (kinds.ESTIMATE, UNDECIDED):
            origin = self._source.streams[1].first[:3]
            kind = kind_of_step(self._motion, self._history, origin, (begin, end), size, verdict)
        step.size, step.limits = size, limits
        event = self._add(kind, verdict, step, end)
        event.poses = row
        self._stayed.append((begin, end, event, before))
        if kind != kinds.CORRECTION:
            self._history.begin_part()
        self._resume(step, row)

    def _ends_excursion(self, verdict: SideVerdict, end: Floats) -> bool:
        """Return whether the poses return to the path before an earlier step that stayed."""
        for number, (begin, start, event, before) in reversed(list(enumerate(self._stayed))):
            sides = {event.side, verdict.side}
            if end[0] - start[0] > RETURN_S or (len(sides) > 1 and UNDECIDED not in sides):
                continue
            flips = event.kind == kinds.FLIP_STAYS
            rotation = before[0] if flips else None
            total = self._motion.between(begin, end[None], rotation=rotation).size(0)
            size = Size(0.0 if flips else event.m, event.deg)
            is_known = not size.m or self._limits(begin, end)[0] < 2.0 * size.m
            if is_known and is_back(total, size):
                was_flip = event.deg > FLIP_DEG
                event.kind = kinds.FLIP if was_flip else kinds.OUTLIER
                event.end_ns, event.s = self._clocks.ns(end[0]), float(end[0] - start[0])
                event.poses = 0
                event.side = verdict.side if event.side == UNDECIDED else event.side
                if was_flip and before[0] is not None:
                    self._motion.state = before
                del self._stayed[number]
                return True
        return False

    def _lose(self, step: PairStep, pair: Floats) -> None:
        """Close a step whose poses neither return nor calm down."""
        self.open = None
        verdict = self._guilty(step.begin, step.after, step.size, step.by_parts)
        last = self._events[-1] if self._events else None
        if (
            last is not None
            and last.kind == kinds.LOST
            and (self._clocks.ns(step.begin[0]) - last.end_ns < 2 * NANOSECONDS)
        ):
            last.end_ns = self._clocks.ns(pair[0])
        elif verdict.side:
            self._add(kinds.LOST, verdict, step, pair).poses = step.unusual
        self._history.begin_at(pair, is_learned=False)

    def _resume(self, step: PairStep, row: int) -> None:
        """Continue with the pairs after a step."""
        self._history.begin_at(step.pairs[row])
        if not self._motion.oriented:
            self._motion.forget_frame()
        self._good(np.array(step.pairs[row:]))

    def _good(self, pairs: Floats) -> None:
        self.previous = pairs[-1]
        self._history.add(pairs)

    @property
    def _usual(self) -> UsualDifferences:
        return self._history.usual

    @property
    def _periods(self) -> tuple[float, float]:
        assert self._source.periods is not None
        return self._source.periods

    def _sized(self, begin: Floats, end: Floats) -> tuple[Size, tuple[float, float]]:
        """Return the size of a step and the limits over its time."""
        return self._motion.size(begin, end), self._limits(begin, end)

    def _limits(self, begin: Floats, end: Floats) -> tuple[float, float]:
        limit_m, limit_deg = self._usual.limit(float(end[0] - begin[0]))
        return float(limit_m), float(limit_deg)

    def _guilty(
        self, begin: Floats, end: Floats, size: Size, parts: tuple[bool, bool]
    ) -> SideVerdict:
        innovations = [self._source.innovation(side, begin[0], end[0]) for side in (0, 1)]
        return guilty_side(innovations, self._motion.scale, size, parts)

    def _add(self, kind: str, verdict: SideVerdict, step: PairStep, end: Floats) -> Event:
        event = Event(
            kind,
            verdict.side,
            self._clocks.ns(step.begin[0]),
            self._clocks.ns(end[0]),
            m=step.parts.m,
            deg=step.parts.deg,
            certainty=verdict.certainty,
            ratio=step.ratio,
            gap_s=verdict.gap_s,
            innovations=verdict.innovations,
        )
        self._events.append(event)
        return event
