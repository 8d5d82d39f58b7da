"""Trajectories that an estimator revises: paths that are published again with every pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.online.state_rows import QUATERNION, WIDTH, Pairs, on_plane


class RevisedPath:
    """Keeps the newest version of a path and the groundtruth of its poses.

    The first version of a pose is what the robot used: the causal error. A loop closure changes
    poses afterwards: the revised error. All poses are stored, as in the path itself.

    Attributes:
        stamps: (M,) of the newest path's poses, nanoseconds, by the estimator's clock.
        states: (M, 10) of the newest path, projected if the gauge is planar.
        version: Number of changes so far, of the path or of its groundtruth.
    """

    def __init__(self, gauge: Gauge, up: UpAxis = Z_UP) -> None:
        """Create it without a path; `up` is the up axis of the path's frame."""
        self.stamps: Stamps = np.empty(0, dtype=np.int64)
        self.states: Floats = np.empty((0, WIDTH))
        self.version = 0
        self._gauge, self._up = gauge, up
        self._known: Stamps = np.empty(0, dtype=np.int64)
        self._truth: list[tuple[Stamps, Floats]] = []

    def renew(self, stamps: Stamps, states: Floats) -> NDArray[np.int64]:
        """Take a path (M,), (M, 10); returns the rows of poses that no earlier path had."""
        self.version += 1
        poses = np.isfinite(states[:, : QUATERNION.stop]).all(axis=1)
        self.stamps, self.states = stamps[poses], states[poses]
        if self._gauge is Gauge.PLANAR:
            self.states = on_plane(self.states, self._up)
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
        self._truth.append((pairs.stamps, pairs.groundtruth))

    def pairs(self) -> Pairs:
        """Return the poses of the newest path that have groundtruth, in order of time."""
        if not self._truth:
            return Pairs(np.empty(0, np.int64), np.empty((0, WIDTH)), np.empty((0, WIDTH)))
        stamps = np.concatenate([part[0] for part in self._truth])
        truth = np.concatenate([part[1] for part in self._truth])
        self._truth = [(stamps, truth)]
        common, rows, places = np.intersect1d(stamps, self.stamps, return_indices=True)
        return Pairs(common, truth[rows], self.states[places])
