"""Losses of tracking in pairs of both sides: frozen and diverging estimates, as events.

Live and recorded evaluations share this code, so that they report the same times.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH, AssociationRule
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.metrics.discontinuities.divergence import Divergence
from trajeval_ros.metrics.discontinuities.events import ESTIMATE, SIDES, Event, Loss
from trajeval_ros.metrics.discontinuities.frozen_parts import (
    MOVED_M,
    MOVED_OF_FIXES_M,
    FrozenParts,
)
from trajeval_ros.metrics.discontinuities.pose_stream import ALL, POSE, POSITION, SidePoses

_BATCH = 8192  # pairs that are copied at a time


class TrackingLosses:
    """Takes pairs in order of time, in batches of any size; the memory is that of seconds.

    A repeated pose of the estimate is a loss. If only its position is repeated, its rotation may
    be right; the time is not tracked, too.
    """

    def __init__(self, rule: AssociationRule, *, diverging: bool = True) -> None:
        """Create it before the first pair.

        Args:
            rule: The association's, whose gaps are not in `frozen_ns`. Fixes or points of the
                groundtruth are too few or too noisy to show a divergence.
            diverging: Whether to search for divergence, too.
        """
        of_fixes = rule.method == AT_GROUNDTRUTH
        self._rule = rule
        self._divergence = Divergence() if diverging and not of_fixes else None
        self._losses: list[Loss] = []  # frozen poses, in order of detection
        self._moved_m = MOVED_OF_FIXES_M if of_fixes else MOVED_M
        self._streams: dict[str, SidePoses] = {}
        self._zero_ns = self._newest_ns = 0
        self._is_settled = True  # whether no position is repeated that may become a loss
        self._gaps: list[tuple[int, int]] = []  # long steps, while a position is repeated
        self._frozen: list[Event] = []  # poses and positions that overlap one that lasts
        self._closed_ns = 0  # time of the other ones

    def add(self, stamps: Stamps, groundtruth: Floats, estimate: Floats) -> None:
        """Take N pairs in order: stamps (N,), ns, and poses (N, 7 or more), NaN if unknown."""
        if not len(stamps):
            return
        sides = groundtruth[:, :7], estimate[:, :7]
        if self._divergence is not None:
            self._divergence.add(stamps, *sides)
        if not self._streams:
            self._zero_ns = self._newest_ns = int(stamps[0])
            for side, poses in zip(SIDES, sides, strict=True):
                oriented = not np.isnan(poses[0, 3])
                parts = (POSE, POSITION) if side == ESTIMATE else ()
                self._streams[side] = SidePoses(oriented=oriented, parts=parts, stored=ALL)
            self._parts = FrozenParts(self._streams, self._moved_m)
        seconds = (stamps - self._zero_ns) / NANOSECONDS
        of_estimate = self._streams[ESTIMATE]
        is_usual = not of_estimate.repeats and (np.diff(estimate[:, 0]) != 0.0).all()
        rows = slice(-1 if is_usual else 0, None)  # nothing is repeated
        for stream, poses in zip(self._streams.values(), sides, strict=True):
            stream.store(seconds[rows], poses[rows])
        new = [event for event, _ in self._parts.advance(self._ns)]
        for stream in self._streams.values():
            stream.drop_before(stream.newest_s)
        self._frozen += new
        self._losses += [event for event in new if isinstance(event, Loss)]
        before = np.append(self._newest_ns, stamps[:-1])
        is_gap = self._rule.is_gap(stamps - before)
        self._gaps += zip(before[is_gap].tolist(), stamps[is_gap].tolist(), strict=True)
        self._newest_ns = int(stamps[-1])
        self._is_settled = bool(self._parts.settled_until_s(ESTIMATE) >= seconds[-1])
        if self._is_settled:
            self._closed_ns += self._lasted_ns()
            self._frozen, self._gaps = [], []

    @property
    def events(self) -> list[Loss]:
        """All losses so far, in order of their begin: copies, since a loss is extended."""
        diverged = [] if self._divergence is None else self._divergence.events
        events = map(dataclasses.replace, (*self._losses, *diverged))
        return sorted(events, key=lambda event: event.t_ns)

    @property
    def present(self) -> Loss | None:
        """The loss that is not over, the earlier one of two; None if there is none."""
        return next((event for event in self.events if not event.is_over), None)

    @property
    def is_clear(self) -> bool:
        """Whether a loss detected later will begin at most 0.5 s before the newest pair."""
        return self._is_settled and (self._divergence is None or self._divergence.is_clear)

    @property
    def frozen_ns(self) -> int:
        """The time of frozen poses and positions so far, nanoseconds, without longer steps."""
        return self._closed_ns + self._lasted_ns()

    def _lasted_ns(self) -> int:
        """Return the time that is in any of the frozen poses and positions."""
        time_ns, until_ns = 0, 0
        for event in sorted(self._frozen, key=lambda event: event.t_ns):
            begin_ns, end_ns = max(event.t_ns, until_ns), max(event.end_ns, until_ns)
            inside = [gap for gap in self._gaps if begin_ns <= gap[0] and gap[1] <= end_ns]
            time_ns += end_ns - begin_ns - sum(end - begin for begin, end in inside)
            until_ns = end_ns
        return time_ns

    def _ns(self, seconds: float) -> int:
        return self._zero_ns + round(seconds * NANOSECONDS)


def frozen_in(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule
) -> tuple[tuple[Loss, ...], int]:
    """Return the frozen poses in N pairs, and `frozen_ns`; see `TrackingLosses`."""
    losses = TrackingLosses(rule, diverging=False)
    _give(losses, groundtruth, estimate)
    return tuple(losses.events), losses.frozen_ns


def divergences_in(groundtruth: Trajectory, estimate: Trajectory) -> list[Loss]:
    """Return the divergences in N pairs."""
    divergence = Divergence()
    _give(divergence, groundtruth, estimate)
    return divergence.events


def _give(
    search: TrackingLosses | Divergence, groundtruth: Trajectory, estimate: Trajectory
) -> None:
    order = np.argsort(estimate.stamps, kind="stable")
    for begin in range(0, len(order), _BATCH):
        rows = order[begin : begin + _BATCH]
        poses = (StampedPoses.of(side, rows).poses for side in (groundtruth, estimate))
        search.add(estimate.stamps[rows], *poses)
