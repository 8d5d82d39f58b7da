"""What is kept of a whole live run: a limited number of pairs, and the newest path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.frame_axes import upright
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association import Association, Tracking
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.evaluation import Evaluation, evaluate_pairs
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.live_frames import in_plane
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.state_buffer import NEVER, NO_STATES, Tail, joined

MOST_POSES = 2000


class ThinnedRun:
    """Every k-th pair of a run; k doubles when the memory is full.

    The newest pair is always included, so that the plotted path reaches the robot.
    """

    def __init__(self) -> None:
        self._every, self._seen = 1, 0
        self._sides = Tail(), Tail()
        self._newest: PairedStates | None = None  # the newest pairs that were added

    def __len__(self) -> int:
        """Return the number of stored pairs, without the newest one."""
        return len(self._sides[0])

    @property
    def span_s(self) -> float:
        """Time from the first to the newest pair, seconds; 0 without pairs."""
        if self._newest is None:
            return 0.0
        return int(self._newest.stamps[-1] - self._sides[0].stamps[0]) / NANOSECONDS

    def add(self, pairs: PairedStates) -> None:
        """Take new pairs."""
        if not len(pairs):
            return
        first = -self._seen % self._every
        self._seen += len(pairs)
        self._newest = pairs
        if first < len(pairs):
            self._add(pairs.part(slice(first, None, self._every)))
        while len(self) > MOST_POSES:
            self._every *= 2
            picked = self._stored(np.arange(0, len(self), 2))
            self._sides = Tail(), Tail()
            self._add(picked)

    def pairs(self) -> PairedStates:
        """Return copies of the pairs in order of time, including the newest one."""
        stored = self._stored(np.arange(len(self)))
        if self._newest is None or self._newest.stamps[-1] <= self._sides[0].newest:
            return stored
        newest = self._newest.part(slice(-1, None))
        return PairedStates(
            joined(stored.groundtruth, newest.groundtruth),
            joined(stored.estimate, newest.estimate),
        )

    def _add(self, pairs: PairedStates) -> None:
        for side, states in zip(self._sides, (pairs.groundtruth, pairs.estimate), strict=True):
            side.add(states)

    def _stored(self, rows: Indices) -> PairedStates:
        return PairedStates(*(side.trajectory(rows) for side in self._sides))


class RevisedPath:
    """Keeps the newest version of a path and the groundtruth of its poses.

    The first version of a pose is what the robot used: the causal error. A loop closure changes
    poses afterwards: the revised error. All poses are stored, as in the path itself.
    """

    def __init__(self, gauge: Gauge) -> None:
        # The newest path by the estimator's clock, projected if the gauge is planar.
        self.path = NO_STATES
        self.version = 0  # number of changes so far, of the path or of its groundtruth
        self._gauge = gauge
        self._known: Stamps = np.empty(0, dtype=np.int64)
        self._groundtruth = Tail()

    def renew(self, path: Trajectory) -> Indices:
        """Take a path; return the rows of the poses that no earlier path had."""
        self.version += 1
        stamps = path.stamps
        self.path = in_plane(path) if self._gauge is Gauge.PLANAR else path
        newest = self._known[-1] if len(self._known) else NEVER
        is_new = stamps > newest
        if not np.array_equal(stamps[~is_new], self._known):  # poses were inserted or removed
            is_new = ~np.isin(stamps, self._known)
        new: Indices = np.flatnonzero(is_new)
        self._known = np.union1d(self._known, stamps[new])
        return new

    def record(self, pairs: PairedStates, offset_ns: int = 0) -> None:
        """Take the groundtruth of poses, to whose timestamps an offset was added."""
        self.version += 1
        groundtruth = pairs.groundtruth
        self._groundtruth.add(replace(groundtruth, stamps=groundtruth.stamps - offset_ns))

    def pairs(self) -> PairedStates:
        """Return the poses of the newest path that have groundtruth, in order of time."""
        known = self._groundtruth
        _, rows, places = np.intersect1d(known.stamps, self.path.stamps, return_indices=True)
        return PairedStates(known.trajectory(rows), self.path[places])


def evaluation_of(pairs: PairedStates, protocol: Protocol) -> Evaluation | None:
    """Return the evaluation of pairs, with a placeholder as coverage; None if not possible."""
    if not len(pairs):
        return None
    association = association_of(pairs, protocol)
    try:
        return evaluate_pairs(association, association.groundtruth, association.estimate, protocol)
    except TrajevalError:
        return None


def association_of(pairs: PairedStates, protocol: Protocol) -> Association:
    """Return at least one pair as an association, in the axes of the protocol."""
    groundtruth, estimate = pairs.groundtruth, pairs.estimate
    if protocol.is_upright:
        groundtruth, estimate = upright(groundtruth), upright(estimate)
    return Association(
        rule=protocol.association,
        groundtruth=groundtruth,
        estimate=estimate,
        estimate_coverage=1.0,
        compute_tracking=lambda: Tracking(Coverage(1.0, 1.0)),
        dropped={},
    )
