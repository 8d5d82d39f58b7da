"""What is kept of a whole live run: a limited number of pairs, and the newest path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.frame_axes import upright
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.evaluation import Evaluation, evaluate_pairs
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.live_frames import in_plane
from trajeval_ros.online.state_rows import QUATERNION, WIDTH, Pairs, rows_of, trajectory

MOST_POSES = 2000


class ThinnedRun:
    """Every k-th pair of a run; k doubles when the memory is full.

    The newest pair is always included, so that the plotted path reaches the robot.
    """

    def __init__(self) -> None:
        self._every = 1
        self._seen = self._count = 0
        self._stamps: Stamps = np.empty(MOST_POSES, dtype=np.int64)
        self._rows: Floats = np.empty((MOST_POSES, 2 * WIDTH))
        self._newest: Pairs | None = None

    def __len__(self) -> int:
        """Return the number of stored pairs, without the newest one."""
        return self._count

    @property
    def span_s(self) -> float:
        """Time from the first to the newest pair, seconds; 0 without pairs."""
        newest = self._newest
        return 0.0 if newest is None else int(newest.stamps[0] - self._stamps[0]) / NANOSECONDS

    def add(self, pairs: Pairs) -> None:
        """Take new pairs."""
        if not len(pairs.stamps):
            return
        first = -self._seen % self._every
        self._seen += len(pairs.stamps)
        self._newest = pairs.picked(slice(-1, None))
        picked = slice(first, None, self._every)
        stamps = pairs.stamps[picked]
        rows = np.hstack([pairs.groundtruth[picked], pairs.estimate[picked]])
        while self._count + len(stamps) > MOST_POSES:
            kept = (self._count + 1) // 2
            self._stamps[:kept] = self._stamps[: self._count : 2]
            self._rows[:kept] = self._rows[: self._count : 2]
            # New pairs continue the spacing of the stored ones.
            skip = self._count % 2
            stamps, rows = stamps[skip::2], rows[skip::2]
            self._count, self._every = kept, 2 * self._every
        end = self._count + len(stamps)
        self._stamps[self._count : end], self._rows[self._count : end] = stamps, rows
        self._count = end

    def columns(self) -> tuple[Stamps, Floats, Floats]:
        """Return stamps (N,), groundtruth and estimate (N, 10), including the newest pair."""
        stamps, rows = self._stamps[: self._count], self._rows[: self._count]
        newest = self._newest
        if newest is not None and self._count and newest.stamps[0] > stamps[-1]:
            stamps = np.concatenate([stamps, newest.stamps])
            rows = np.vstack([rows, np.hstack([newest.groundtruth, newest.estimate])])
        return stamps, rows[:, :WIDTH], rows[:, WIDTH:]


class RevisedPath:
    """Keeps the newest version of a path and the groundtruth of its poses.

    The first version of a pose is what the robot used: the causal error. A loop closure changes
    poses afterwards: the revised error. All poses are stored, as in the path itself.
    """

    def __init__(self, gauge: Gauge, up: UpAxis = Z_UP) -> None:
        # Of the newest path: (M,), nanoseconds, by the estimator's clock; and (M, 10), projected
        # if the gauge is planar.
        self.stamps: Stamps = np.empty(0, dtype=np.int64)
        self.states: Floats = np.empty((0, WIDTH))
        self.version = 0  # number of changes so far, of the path or of its groundtruth
        self._gauge, self._up = gauge, up
        self._known: Stamps = np.empty(0, dtype=np.int64)
        self._groundtruth: list[tuple[Stamps, Floats]] = []

    def renew(self, stamps: Stamps, states: Floats) -> NDArray[np.int64]:
        """Take a path (M,), (M, 10); returns the rows of poses that no earlier path had."""
        self.version += 1
        poses = np.isfinite(states[:, : QUATERNION.stop]).all(axis=1)
        self.stamps, self.states = stamps[poses], states[poses]
        if self._gauge is Gauge.PLANAR:
            self.states = rows_of(in_plane(trajectory(self.stamps, self.states, self._up)))
        newest = self._known[-1] if len(self._known) else np.iinfo(np.int64).min
        is_new = stamps > newest
        if not np.array_equal(stamps[~is_new], self._known):  # poses were inserted or removed
            is_new = ~np.isin(stamps, self._known)
        new: NDArray[np.int64] = np.flatnonzero(is_new)
        self._known = np.union1d(self._known, stamps[new])
        return new

    def record(self, pairs: Pairs) -> None:
        """Take the groundtruth of poses, with timestamps by the estimator's clock."""
        self.version += 1
        self._groundtruth.append((pairs.stamps, pairs.groundtruth))

    def pairs(self) -> Pairs:
        """Return the poses of the newest path that have groundtruth, in order of time."""
        if not self._groundtruth:
            return Pairs.none()
        stamps = np.concatenate([part[0] for part in self._groundtruth])
        groundtruth = np.concatenate([part[1] for part in self._groundtruth])
        self._groundtruth = [(stamps, groundtruth)]
        common, rows, places = np.intersect1d(stamps, self.stamps, return_indices=True)
        return Pairs(common, groundtruth[rows], self.states[places])


def evaluate_rows(
    pairs: Pairs, protocol: Protocol, ups: tuple[UpAxis, UpAxis]
) -> Evaluation | None:
    """Return the evaluation of pairs, with a placeholder as coverage; None if not possible."""
    if not len(pairs.stamps):
        return None
    association = association_of(pairs, protocol, ups)
    try:
        return evaluate_pairs(association, association.groundtruth, association.estimate, protocol)
    except TrajevalError:
        return None


def association_of(pairs: Pairs, protocol: Protocol, ups: tuple[UpAxis, UpAxis]) -> Association:
    """Return at least one pair of rows as an association, in the axes of the protocol."""
    groundtruth = trajectory(pairs.stamps, pairs.groundtruth, ups[0])
    estimate = trajectory(pairs.stamps, pairs.estimate, ups[1])
    if protocol.is_upright:
        groundtruth, estimate = upright(groundtruth), upright(estimate)
    return Association(
        rule=protocol.association,
        groundtruth=groundtruth,
        estimate=estimate,
        estimate_coverage=1.0,
        coverage=Coverage(1.0, 1.0),
        dropped={},
    )
