"""Losses of tracking in pairs of both sides: frozen and diverging estimates, as events.

Live and recorded evaluations share this code, so that they report the same times.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.discontinuities.divergence import Divergence
from trajeval_ros.metrics.discontinuities.events import ESTIMATE, Loss
from trajeval_ros.metrics.discontinuities.frozen_parts import (
    MOVED_M,
    MOVED_OF_FIXES_M,
    FrozenParts,
)
from trajeval_ros.metrics.discontinuities.pose_stream import SidePoses

_BATCH = 8192  # pairs that are copied at a time


class TrackingLosses:
    """Takes pairs in order of time, in batches of any size; the memory is that of seconds."""

    def __init__(
        self, *, of_fixes: bool = False, diverging: bool = True, max_gap_s: float = math.inf
    ) -> None:
        """Create it before the first pair.

        Args:
            of_fixes: The groundtruth has fixes or points, which are too few or too noisy to show
                a divergence.
            diverging: Whether to search for divergence, too.
            max_gap_s: Longer steps between pairs are not in `frozen_ns`.
        """
        self._divergence = Divergence() if diverging and not of_fixes else None
        self._max_gap_ns = math.inf if math.isinf(max_gap_s) else round(max_gap_s * NANOSECONDS)
        self._moved_m = MOVED_OF_FIXES_M if of_fixes else MOVED_M
        self._frozen: list[Loss] = []
        self._streams: tuple[SidePoses, SidePoses] | None = None
        self._zero_ns = self._newest_ns = 0
        self._gaps: list[tuple[int, int]] = []  # long steps, while a pose is repeated
        self._closed = self._closed_ns = 0  # number of frozen events that are over, their time

    def add(self, stamps: Stamps, groundtruth: Floats, estimate: Floats) -> None:
        """Take N pairs in order: stamps (N,), ns, and poses (N, 7 or more), NaN if unknown."""
        if not len(stamps):
            return
        sides = groundtruth[:, :7], estimate[:, :7]
        if self._divergence is not None:
            self._divergence.add(stamps, *sides)
        if self._streams is None:
            self._zero_ns = self._newest_ns = int(stamps[0])
            first, second = (
                SidePoses(oriented=not np.isnan(poses[0, 3]), of_pose=True) for poses in sides
            )
            self._streams = first, second
            self._parts = FrozenParts(self._streams, self._moved_m)
        seconds = (stamps - self._zero_ns) / NANOSECONDS
        is_usual = not self._streams[1].repeats and (np.diff(estimate[:, 0]) != 0.0).all()
        rows = slice(-1 if is_usual else 0, None)  # nothing is repeated
        for stream, poses in zip(self._streams, sides, strict=True):
            stream.store(seconds[rows], poses[rows])
        new = self._parts.advance(1.0, self._ns)
        for stream in self._streams:
            stream.drop_before(stream.newest_s)
        self._frozen += [
            event for event in new if isinstance(event, Loss) and event.side == ESTIMATE
        ]
        before = np.append(self._newest_ns, stamps[:-1])
        is_gap = stamps - before > self._max_gap_ns
        self._gaps += zip(before[is_gap].tolist(), stamps[is_gap].tolist(), strict=True)
        self._newest_ns = int(stamps[-1])
        while self._closed < len(self._frozen) and self._frozen[self._closed].is_over:
            self._closed_ns += self._lasted_ns(self._frozen[self._closed])
            self._closed += 1
        begin_s = min((item.begin_s for item in self._streams[1].repeats), default=math.inf)
        self._gaps = [gap for gap in self._gaps if gap[1] > self._zero_ns + begin_s * NANOSECONDS]

    @property
    def events(self) -> list[Loss]:
        """All losses so far, in order of their begin: copies, since a loss is extended."""
        diverged = [] if self._divergence is None else self._divergence.events
        events = map(dataclasses.replace, (*self._frozen, *diverged))
        return sorted(events, key=lambda event: event.t_ns)

    @property
    def present(self) -> Loss | None:
        """The loss that is not over, the earlier one of two; None if there is none."""
        return next((event for event in self.events if not event.is_over), None)

    @property
    def is_clear(self) -> bool:
        """Whether a loss that is detected later will begin at the newest pair or after it."""
        newest_s = (self._newest_ns - self._zero_ns) / NANOSECONDS
        is_known = self._streams is None or self._parts.settled_until_s(ESTIMATE) >= newest_s
        return is_known and (self._divergence is None or self._divergence.is_clear)

    @property
    def frozen_ns(self) -> int:
        """The time of frozen estimates so far, nanoseconds, without longer steps."""
        return self._closed_ns + sum(map(self._lasted_ns, self._frozen[self._closed :]))

    def _lasted_ns(self, event: Loss) -> int:
        inside = [gap for gap in self._gaps if event.t_ns <= gap[0] and gap[1] <= event.end_ns]
        return event.end_ns - event.t_ns - sum(end - begin for begin, end in inside)

    def _ns(self, seconds: float) -> int:
        return self._zero_ns + round(seconds * NANOSECONDS)


def losses_of(
    groundtruth: Trajectory,
    estimate: Trajectory,
    *,
    of_fixes: bool = False,
    diverging: bool = True,
    max_gap_s: float = math.inf,
) -> TrackingLosses:
    """Return the losses in N pairs; see `TrackingLosses`."""
    losses = TrackingLosses(of_fixes=of_fixes, diverging=diverging, max_gap_s=max_gap_s)
    order = np.argsort(estimate.stamps, kind="stable")
    for begin in range(0, len(order), _BATCH):
        rows = order[begin : begin + _BATCH]
        losses.add(estimate.stamps[rows], _poses(groundtruth, rows), _poses(estimate, rows))
    return losses


def _poses(trajectory: Trajectory, rows: Indices) -> Floats:
    """Return some poses (n, 7) of a trajectory; without orientations, quaternions are NaN."""
    positions, turns = trajectory.positions[rows], trajectory.quaternions
    turns = np.full((len(positions), 4), np.nan) if turns is None else turns[rows]
    return np.hstack([positions, turns])
