"""Frozen positions and rotations of one stream: exact repeats after an abrupt stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.metrics.discontinuities.events import FROZEN_POSITION, FROZEN_ROTATION, Event
from trajeval_ros.metrics.discontinuities.pose_stream import Repeats, SidePoses

FROZEN_S = 0.5  # shortest time
_LATELY_S = 1.0  # before a stop, with the usual speed
_LAST_S, _LAST_STEPS = 0.1, 2  # with the last speed: wheels do not move in every period
_ABRUPT = 0.5  # of the usual speed: a robot brakes before it stops
# Motion that the speed before the stop predicts: a slow wheel repeats its pose for a time.
_MOVED_M, _MOVED_DEG = 0.05, 10.0
_REST_MPS, _REST_DEGPS = 0.05, 10.0  # slower robots stop abruptly


@dataclass(eq=False)
class _Followed:
    repeats: Repeats
    least_s: float  # time after which it is frozen; infinite if the robot stopped
    event: Event | None = None


class OwnFreezes:
    """Follows the repeats of one stream."""

    def __init__(self, stream: SidePoses, side: str) -> None:
        self._stream, self._side = stream, side
        self._followed: list[_Followed] = []
        self._rests = False  # whether the rotation has rested: wheels hold it while they drive

    @property
    def present(self) -> list[Event]:
        """The events that last."""
        return [item.event for item in self._followed if item.event and not item.repeats.is_over]

    def advance(self, nanoseconds: Callable[[float], int]) -> Iterator[tuple[Event, float]]:
        """Yield new events and the times at which they are known; those that last are extended."""
        for item in self._followed:
            self._see_rest(item)
        known = [item.repeats for item in self._followed]
        for repeats in self._stream.repeats:
            if not any(repeats is item for item in known):
                self._followed.append(_Followed(repeats, self._least_s(repeats)))
                self._see_rest(self._followed[-1])
        self._stream.repeats[:] = [item for item in self._stream.repeats if not item.is_over]
        for item in self._followed:
            begin_s, end_s = item.repeats.begin_s, item.repeats.end_s
            if end_s - begin_s < item.least_s:
                continue
            if item.event is None:
                is_position = item.repeats.part == "position"
                kind = FROZEN_POSITION if is_position else FROZEN_ROTATION
                begin = nanoseconds(begin_s)
                item.event = Event(kind, self._side, begin, begin)
                yield item.event, begin_s + item.least_s
            item.event.end_ns, item.event.s = nanoseconds(end_s), end_s - begin_s
            item.event.ratio = item.event.s / item.least_s
        self._followed = [item for item in self._followed if not item.repeats.is_over]

    def _see_rest(self, item: _Followed) -> None:
        """See a rotation that repeated for a time: later ones may be rests, too."""
        lasts_s = item.repeats.end_s - item.repeats.begin_s
        is_rotation = item.repeats.part == "rotation"
        self._rests |= is_rotation and item.repeats.is_over and lasts_s >= FROZEN_S

    def _least_s(self, repeats: Repeats) -> float:
        """Return the time after which repeats are no rest of the robot."""
        stream = self._stream
        begin = max(stream.row_from(repeats.begin_s - _LATELY_S) - 1, 0)
        end = stream.row_after(repeats.begin_s + 1e-9)
        stamps, poses = stream.stamps[begin:end], stream.poses[begin:end]
        if len(stamps) < 3 or (repeats.part == "rotation" and self._rests):
            return np.inf
        moved, rest = _MOVED_M, _REST_MPS
        if repeats.part == "position":
            lengths = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
        else:
            rotations = lie.multiply(lie.conjugate(poses[:-1, 3:]), poses[1:, 3:])
            lengths = np.degrees(lie.angle(rotations))
            moved, rest = _MOVED_DEG, _REST_DEGPS
        first = min(int(stamps.searchsorted(stamps[-1] - _LAST_S)), len(stamps) - 1 - _LAST_STEPS)
        usual = float(lengths.sum() / (stamps[-1] - stamps[0]))
        last = float(lengths[first:].sum() / (stamps[-1] - stamps[first]))
        is_abrupt = last > max(_ABRUPT * usual, rest)
        return max(FROZEN_S, moved / last) if is_abrupt else np.inf
