"""Steps and excursions of one stream, from its unusual motions."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.discontinuities import events as kinds
from trajeval_ros.metrics.discontinuities.events import ESTIMATE, UNDECIDED, Event
from trajeval_ros.metrics.discontinuities.exoneration import SLOWEST_S
from trajeval_ros.metrics.discontinuities.open_step import (
    LEAST_RATIO,
    LEAST_RATIO_OF_OUTLIER,
    MOST_STAYED,
    RETURN_S,
    OpenStep,
    calm_s,
    is_back,
    is_flip,
    is_lost,
)
from trajeval_ros.metrics.discontinuities.relative_motion import Size
from trajeval_ros.metrics.discontinuities.step_kinds import is_at_origin
from trajeval_ros.metrics.discontinuities.stream_motion import StreamMotion

_NEARLY = 1.5  # as far from the path as after a return: the next pose alone is less certain


class _MotionStep(OpenStep):
    """Unusual motions of one stream, and their sum."""

    def __init__(self, motion: StreamMotion, limits: tuple[float, float]) -> None:
        super().__init__(motion.size, limits, motion.end_s, motion.gap_s)
        self.first = self.last = motion
        self.step_m, self.rotation = motion.step_m, motion.rotation
        self.event: Event | None = None

    def add(self, motion: StreamMotion) -> None:
        """Take the next unusual motion."""
        self.grow(motion.size, motion.end_s)
        self.last = motion
        self.step_m = self.step_m + motion.step_m
        self.rotation = lie.multiply(self.rotation, motion.rotation)

    @property
    def is_back(self) -> bool:
        """Whether the poses are on the former path again."""
        if self.unusual == 1:
            return is_back(self.first.over, Size(*(_NEARLY * part for part in self.parts)))
        return is_back(_size(self.step_m, self.rotation), self.parts)

    @property
    def excursion_s(self) -> float:
        """Time between the first and the last pose outside of the path."""
        end_s = self.first.end_s if self.unusual == 1 else self.last.begin_s
        return end_s - self.first.end_s


class StreamSteps:
    """Takes unusual motions in order of time, and finds steps and excursions."""

    def __init__(
        self,
        side: str,
        origin: Floats,
        period_s: float,
        events: list[Event],
        nanoseconds: Callable[[float], int],
    ) -> None:
        """Create it once the rate is known.

        Args:
            side: `groundtruth` or `estimate`.
            origin: The first position (3,), metres.
            period_s: Usual time between poses.
            events: Where it appends events, and removes those that become part of another one.
            nanoseconds: Returns the timestamp of a time, seconds.
        """
        self._side, self._origin = side, origin
        self._calm_s = calm_s(period_s)
        self._certainty = UNDECIDED if period_s > SLOWEST_S else "likely"
        self._events, self._ns = events, nanoseconds
        self._step: _MotionStep | None = None
        self._stayed: deque[_MotionStep] = deque(maxlen=MOST_STAYED)

    def follow(self, motion: StreamMotion, limits: tuple[float, float]) -> Event | None:
        """Take a motion beyond the limits, metres and deg; return the event that it begins."""
        step = self._step
        if step is not None and motion.begin_s - step.last_s < self._calm_s:
            step.add(motion)
        else:
            if step is not None and step.event is not None and not step.is_back:
                self._stayed.append(step)
            step = self._step = _MotionStep(motion, limits)
        if self._ends_excursion(step):
            self._step = None
            return None
        least = LEAST_RATIO_OF_OUTLIER if step.is_back else LEAST_RATIO
        if step.event is None and step.ratio < least:
            return None
        is_new, event = step.event is None, self._renewed(step)
        if is_new:
            self._events.append(event)
        return event if is_new else None

    def _renewed(self, step: _MotionStep) -> Event:
        """Return the event of a step by its motions so far."""
        begin, end = self._ns(step.first.begin_s), self._ns(step.last.end_s)
        event = step.event = step.event or Event("", self._side, begin, end)
        event.end_ns, event.ratio, event.certainty = end, step.ratio, self._certainty
        event.m, event.deg = step.parts
        event.kind, event.gap_s = self._kind_of(step), step.gap_s
        event.s = step.excursion_s if event.kind in kinds.EXCURSIONS else 0.0
        return event

    def _kind_of(self, step: _MotionStep) -> str:
        size, last = step.parts, step.last
        if step.is_back:
            return kinds.FLIP if is_flip(size) else kinds.OUTLIER
        if is_lost(step.last_s - step.first.begin_s, step.unusual):
            return kinds.LOST
        if is_flip(size):
            return kinds.FLIP_STAYS
        at_origin = is_at_origin(last.begin[:3], last.end[:3], self._origin, size.m)
        return kinds.RESTART if self._side == ESTIMATE and at_origin else kinds.STEP

    def _ends_excursion(self, step: _MotionStep) -> bool:
        """Return whether the poses return to the path before an earlier step that stayed."""
        step_m, rotation = step.step_m, step.rotation
        for number in reversed(range(len(self._stayed))):
            earlier = self._stayed[number]
            if step.last.end_s - earlier.last.end_s > RETURN_S:
                break
            step_m = earlier.step_m + step_m
            rotation = lie.multiply(earlier.rotation, rotation)
            event = earlier.event
            if event is None or not is_back(_size(step_m, rotation), earlier.parts):
                continue
            event.kind = kinds.FLIP if is_flip(earlier.parts) else kinds.OUTLIER
            event.end_ns = self._ns(step.last.end_s)
            event.s = step.last.begin_s - earlier.first.end_s
            inside = [*list(self._stayed)[number + 1 :], step]
            for item in inside:
                self._events[:] = [other for other in self._events if other is not item.event]
            for _ in inside:
                self._stayed.pop()
            return True
        return False


def _size(step_m: Floats, rotation: Floats) -> Size:
    return Size(float(np.linalg.norm(step_m)), float(np.degrees(lie.angle(rotation))))
