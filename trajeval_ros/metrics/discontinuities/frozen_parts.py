"""Frozen positions and rotations: exact repeats of one side while the other one moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.discontinuities.events import (
    FROZEN_POSITION,
    FROZEN_ROTATION,
    SIDES,
    Event,
)
from trajeval_ros.metrics.discontinuities.pose_stream import FROZEN_S, Repeats, SidePoses

_MOVED_M, _MOVED_DEG = 0.15, 10.0  # motion of the other side that is no noise
_KINDS = {"position": FROZEN_POSITION, "rotation": FROZEN_ROTATION}


@dataclass(eq=False)
class _Followed:
    repeats: Repeats
    until_s: float  # the other side is known until here
    pose: Floats | None = None  # of the other side at the begin
    moved: float = 0.0  # metres or deg
    event: Event | None = None


class FrozenParts:
    """Follows the repeats of both sides, and compares them with the other side's motion."""

    def __init__(self, streams: tuple[SidePoses, SidePoses]) -> None:
        self._streams = streams
        self._followed: list[tuple[int, _Followed]] = []

    @property
    def present(self) -> list[Event]:
        """The events that last."""
        followed = (item for _, item in self._followed)
        return [item.event for item in followed if item.event and not item.repeats.is_over]

    def advance(self, scale: float, nanoseconds: Callable[[float], int]) -> list[Event]:
        """Return new events; those that last are extended.

        `scale` is metres per unit of the estimate.
        """
        new = []
        for number, stream in enumerate(self._streams):
            known = [item.repeats for _, item in self._followed]
            for repeats in stream.repeats:
                if not any(repeats is item for item in known):
                    self._followed.append((number, _Followed(repeats, repeats.begin_s)))
            stream.repeats[:] = [repeat for repeat in stream.repeats if not repeat.is_over]
        for number, followed in list(self._followed):
            event = self._follow(number, followed, scale if number == 0 else 1.0)
            if event is not None:
                new.append(event)
            repeats, other = followed.repeats, self._streams[1 - number]
            if followed.event is not None:
                followed.event.t_ns = nanoseconds(repeats.begin_s)
                followed.event.end_ns = nanoseconds(repeats.end_s)
                followed.event.s = repeats.end_s - repeats.begin_s
            if repeats.is_over and other.newest_s >= repeats.end_s:
                self._followed.remove((number, followed))
        return new

    def _follow(self, number: int, followed: _Followed, scale: float) -> Event | None:
        """Measure the other side's motion; return an event that begins."""
        repeats, other = followed.repeats, self._streams[1 - number]
        begin = other.row_from(followed.until_s)
        end = other.row_after(repeats.end_s)
        if begin >= end:
            return None
        followed.until_s = float(other.stamps[end - 1]) + 1e-9
        if followed.pose is None:
            followed.pose = other.poses[begin].copy()
        # Of two poses in succession: one outlier of the other side is no motion.
        poses = other.poses[max(begin - 1, 0) : end]
        if repeats.part == "position":
            moved = scale * np.linalg.norm(poses[:, :3] - followed.pose[:3], axis=1)
        else:
            rotations = lie.multiply(lie.conjugate(followed.pose[3:]), poses[:, 3:])
            moved = np.degrees(lie.angle(rotations))
        lesser = np.minimum(moved[1:], moved[:-1])
        followed.moved = float(lesser.max(initial=followed.moved))
        is_position = repeats.part == "position"
        has_moved = followed.moved >= (_MOVED_M if is_position else _MOVED_DEG)
        is_long = repeats.end_s - repeats.begin_s >= FROZEN_S
        if followed.event is None and is_long and has_moved:
            followed.event = Event(_KINDS[repeats.part], SIDES[number], 0, 0, certainty="sure")
            self._measure(followed)
            return followed.event
        self._measure(followed)
        return None

    def _measure(self, followed: _Followed) -> None:
        if followed.event is None:
            return
        if followed.repeats.part == "position":
            followed.event.m = followed.moved
        else:
            followed.event.deg = followed.moved
