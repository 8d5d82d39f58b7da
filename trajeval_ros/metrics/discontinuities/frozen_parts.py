"""Frozen poses, positions and rotations: exact repeats of one side while the other one moves."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.discontinuities.events import (
    FROZEN,
    FROZEN_POSITION,
    FROZEN_ROTATION,
    SIDES,
    Event,
    Loss,
)
from trajeval_ros.metrics.discontinuities.pose_stream import FROZEN_S, Repeats, SidePoses

# Motion of the other side that is no noise; the noise of fixes is metres.
MOVED_M, MOVED_OF_FIXES_M, _MOVED_DEG = 0.15, 10.0, 10.0
_STILL = 0.15  # of this motion: the other side has not started to move
_KINDS = {"pose": FROZEN, "position": FROZEN_POSITION, "rotation": FROZEN_ROTATION}


@dataclass(eq=False)
class _Followed:
    repeats: Repeats
    until_s: float  # the other side is known until here
    begin_s: float  # the other side is still until here
    pose: Floats | None = None  # of the other side at the begin
    m: float = 0.0  # motion of the other side
    deg: float = 0.0
    event: Event | None = None


class FrozenParts:
    """Follows the repeats of both sides, and compares them with the other side's motion."""

    def __init__(self, streams: tuple[SidePoses, SidePoses], moved_m: float = MOVED_M) -> None:
        self._streams, self._moved_m = streams, moved_m
        self._followed: list[tuple[int, _Followed]] = []

    @property
    def present(self) -> list[Event]:
        """The events that last."""
        followed = (item for _, item in self._followed)
        return [item.event for item in followed if item.event and not item.repeats.is_over]

    def settled_until_s(self, side: str) -> float:
        """Return the time until which no later event of a side begins, seconds."""
        open_s = (item.begin_s for number, item in self._followed if SIDES[number] == side)
        return min(open_s, default=math.inf)

    def advance(self, scale: float, nanoseconds: Callable[[float], int]) -> list[Event]:
        """Return new events; those that last are extended.

        `scale` is metres per unit of the estimate.
        """
        new = []
        for number, stream in enumerate(self._streams):
            known = [item.repeats for _, item in self._followed]
            for repeats in stream.repeats:
                if not any(repeats is item for item in known):
                    at_s = repeats.begin_s
                    self._followed.append((number, _Followed(repeats, at_s, at_s)))
            stream.repeats[:] = [repeat for repeat in stream.repeats if not repeat.is_over]
        for number, followed in list(self._followed):
            event = self._follow(number, followed, scale if number == 0 else 1.0)
            if event is not None:
                new.append(event)
            repeats, other = followed.repeats, self._streams[1 - number]
            is_over = repeats.is_over and other.newest_s >= repeats.end_s
            if followed.event is not None:
                followed.event.t_ns = nanoseconds(followed.begin_s)
                followed.event.end_ns = nanoseconds(repeats.end_s)
                followed.event.s = repeats.end_s - followed.begin_s
                if isinstance(followed.event, Loss):
                    followed.event.is_over = is_over
            if is_over:
                self._followed.remove((number, followed))
        return new

    def _follow(self, number: int, followed: _Followed, scale: float) -> Event | None:
        """Measure the other side's motion; return an event that begins."""
        repeats, other = followed.repeats, self._streams[1 - number]
        begin, end = other.row_from(followed.until_s), other.row_after(repeats.end_s)
        if begin >= end:
            return None
        followed.until_s = float(other.stamps[end - 1]) + 1e-9
        if followed.pose is None:
            followed.pose = other.poses[begin].copy()
        first = max(begin - 1, 0)
        poses, stamps = other.poses[first:end], other.stamps[first:end]
        m, deg = np.zeros((2, len(poses)))
        if repeats.part != "rotation":
            m = scale * np.linalg.norm(poses[:, :3] - followed.pose[:3], axis=1)
        if repeats.part != "position":
            rotations = lie.multiply(lie.conjugate(followed.pose[3:]), poses[:, 3:])
            deg = np.degrees(lie.angle(rotations))
        moved = np.maximum(m / self._moved_m, deg / _MOVED_DEG)
        # Of two poses in succession: one outlier of the other side is no motion.
        lesser_m, lesser_deg, lesser = (np.minimum(v[1:], v[:-1]) for v in (m, deg, moved))
        if max(followed.m / self._moved_m, followed.deg / _MOVED_DEG) < 1.0:
            begins = np.flatnonzero(lesser >= 1.0)
            still = np.flatnonzero(moved[: begins[0] + 1 if len(begins) else None] < _STILL)
            if len(still):
                followed.begin_s = max(followed.begin_s, float(stamps[still[-1]]))
        followed.m = float(lesser_m.max(initial=followed.m))
        followed.deg = float(lesser_deg.max(initial=followed.deg))
        has_moved = max(followed.m / self._moved_m, followed.deg / _MOVED_DEG) >= 1.0
        is_new = followed.event is None and has_moved
        if is_new and repeats.end_s - repeats.begin_s >= FROZEN_S:
            of_kind = Loss if repeats.part == "pose" else Event
            followed.event = of_kind(_KINDS[repeats.part], SIDES[number], 0, 0, certainty="sure")
        if followed.event is not None:
            followed.event.m, followed.event.deg = followed.m, followed.deg
        return followed.event if is_new else None
