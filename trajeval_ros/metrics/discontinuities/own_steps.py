"""Steps and excursions of one stream, from its unusual motions."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.discontinuities import events as kinds
from trajeval_ros.metrics.discontinuities.events import ESTIMATE, UNDECIDED, Event
from trajeval_ros.metrics.discontinuities.open_step import by_parts, is_back, ratio_of
from trajeval_ros.metrics.discontinuities.own_motion import OwnMotion
from trajeval_ros.metrics.discontinuities.relative_motion import Size
from trajeval_ros.metrics.discontinuities.step_kinds import is_at_origin

_CALM_S, _CALM_PERIODS = 1.0, 4.0  # without unusual motion, after which a step stays
_LOST_S, _LOST_MOTIONS = 10.0, 5  # steps without a calm second
_RETURN_S, _MOST_STAYED = 60.0, 8  # longest excursion whose return is known, and steps kept
_FLIP_DEG, _FLIP_M = 60.0, 0.3  # smallest rotation of a flip, and largest motion of its marker
# Smallest events, as multiples of the limit: single poses of heavy-tailed noise exceed 1.5.
_LEAST_RATIO, _LEAST_RATIO_OF_OUTLIER = 1.5, 2.5
_NEARLY = 1.5  # as far from the path as after a return: the next pose alone is less certain
_SLOWEST_S = 0.5  # period of a stream that does not show whether a step is a motion


class _Step:
    """Unusual motions without a calm second among them, and their sum."""

    def __init__(self, motion: OwnMotion, limits: tuple[float, float]) -> None:
        self.first = self.last = motion
        self.count = 1
        self.size, self.limits = motion.size, limits
        self.step_m, self.rotation = motion.step_m, motion.rotation
        self.event: Event | None = None

    def add(self, motion: OwnMotion) -> None:
        """Take the next unusual motion."""
        self.last, self.count = motion, self.count + 1
        self.size = Size(*map(max, self.size, motion.size))
        self.step_m = self.step_m + motion.step_m
        self.rotation = lie.multiply(self.rotation, motion.rotation)

    @property
    def ratio(self) -> float:
        """The size as a multiple of the limits."""
        return ratio_of(self.size, self.limits)

    @property
    def parts(self) -> Size:
        """The size in the parts that jump, and 0 in the other one."""
        by_m, by_deg = by_parts(self.size, self.limits)
        return Size(self.size.m if by_m else 0.0, self.size.deg if by_deg else 0.0)

    @property
    def is_back(self) -> bool:
        """Whether the poses are on the former path again."""
        if self.count == 1:
            return is_back(self.first.over, Size(*(_NEARLY * part for part in self.parts)))
        return is_back(_size(self.step_m, self.rotation), self.parts)

    @property
    def excursion_s(self) -> float:
        """Time between the first and the last pose outside of the path."""
        end_s = self.first.end_s if self.count == 1 else self.last.begin_s
        return end_s - self.first.end_s


class OwnSteps:
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
        self._calm_s = max(_CALM_S, _CALM_PERIODS * period_s)
        self._certainty = UNDECIDED if period_s > _SLOWEST_S else "likely"
        self._events, self._ns = events, nanoseconds
        self._step: _Step | None = None
        self._stayed: deque[_Step] = deque(maxlen=_MOST_STAYED)

    def follow(self, motion: OwnMotion, limits: tuple[float, float]) -> Event | None:
        """Take a motion beyond the limits, metres and deg; return the event that it begins."""
        step = self._step
        if step is not None and motion.begin_s - step.last.end_s < self._calm_s:
            step.add(motion)
        else:
            if step is not None and step.event is not None and not step.is_back:
                self._stayed.append(step)
            step = self._step = _Step(motion, limits)
        if self._ends_excursion(step):
            self._step = None
            return None
        least = _LEAST_RATIO_OF_OUTLIER if step.is_back else _LEAST_RATIO
        if step.event is None and step.ratio < least:
            return None
        is_new, event = step.event is None, self._renewed(step)
        if is_new:
            self._events.append(event)
        return event if is_new else None

    def _renewed(self, step: _Step) -> Event:
        """Return the event of a step by its motions so far."""
        begin, end = self._ns(step.first.begin_s), self._ns(step.last.end_s)
        event = step.event = step.event or Event("", self._side, begin, end)
        event.end_ns, event.ratio, event.certainty = end, step.ratio, self._certainty
        event.m, event.deg = step.parts
        event.kind, event.gap_s = self._kind_of(step), step.first.gap_s
        event.s = step.excursion_s if event.kind in kinds.EXCURSIONS else 0.0
        return event

    def _kind_of(self, step: _Step) -> str:
        size, last = step.parts, step.last
        is_flip = _is_flip(size)
        if step.is_back:
            return kinds.FLIP if is_flip else kinds.OUTLIER
        if last.end_s - step.first.begin_s > _LOST_S and step.count > _LOST_MOTIONS:
            return kinds.LOST
        if is_flip:
            return kinds.FLIP_STAYS
        at_origin = is_at_origin(last.begin[:3], last.end[:3], self._origin, size.m)
        return kinds.RESTART if self._side == ESTIMATE and at_origin else kinds.STEP

    def _ends_excursion(self, step: _Step) -> bool:
        """Return whether the poses return to the path before an earlier step that stayed."""
        step_m, rotation = step.step_m, step.rotation
        for number in reversed(range(len(self._stayed))):
            earlier = self._stayed[number]
            if step.last.end_s - earlier.last.end_s > _RETURN_S:
                break
            step_m = earlier.step_m + step_m
            rotation = lie.multiply(earlier.rotation, rotation)
            event = earlier.event
            if event is None or not is_back(_size(step_m, rotation), earlier.parts):
                continue
            event.kind = kinds.FLIP if _is_flip(earlier.parts) else kinds.OUTLIER
            event.end_ns = self._ns(step.last.end_s)
            event.s = step.last.begin_s - earlier.first.end_s
            inside = [*list(self._stayed)[number + 1 :], step]
            for item in inside:
                self._events[:] = [other for other in self._events if other is not item.event]
            for _ in inside:
                self._stayed.pop()
            return True
        return False


def _is_flip(size: Size) -> bool:
    return size.deg > _FLIP_DEG and size.m < _FLIP_M


def _size(step_m: Floats, rotation: Floats) -> Size:
    return Size(float(np.linalg.norm(step_m)), float(np.degrees(lie.angle(rotation))))
