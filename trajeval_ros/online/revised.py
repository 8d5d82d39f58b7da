"""The trajectory as an estimator sees it now: a path that is published anew with each pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.online.state_rows import QUATERNION, WIDTH, Pairs, on_plane


class RevisedPath:
    """Keeps the newest version of a path, and the groundtruth of its poses.

    What was published first is what the robot steered by: the causal error. A loop closure moves
    poses afterwards: the revised error. It needs all poses, as the path itself does.

    Attributes:
        stamps: (M,) of the newest path's poses, nanoseconds, by the estimator's clock.
        states: (M, 10) of these, as the gauge compares them.
        version: Number of changes so far, of the path or of its groundtruth.
    """

    def __init__(self, gauge: Gauge, up: UpAxis = Z_UP) -> None:
        """Create it without a path, for one whose frame has this axis up."""
        self.stamps: Stamps = np.empty(0, dtype=np.int64)
        self.states: Floats = np.empty((0, WIDTH))
        self.version = 0
        self._gauge, self._up = gauge, up
        self._known: Stamps = np.empty(0, dtype=np.int64)
        self._truth: list[tuple[Stamps, Floats]] = []

    def renew(self, stamps: Stamps, states: Floats) -> NDArray[np.int64]:
        """Take a path (M,), (M, 10); returns the rows of poses that it is the first to have."""
        self.version += 1
        poses = np.isfinite(states[:, : QUATERNION.stop]).all(axis=1)
        self.stamps, self.states = stamps[poses], states[poses]
        if self._gauge is Gauge.PLANAR:
            self.states = on_plane(self.states, self._up)
        newest = self._known[-1] if len(self._known) else np.iinfo(np.int64).min
        is_new = stamps > newest
        if not np.array_equal(stamps[~is_new], self._known):  # some came in between, or are gone
            is_new = ~np.isin(stamps, self._known)
        new: NDArray[np.int64] = np.flatnonzero(is_new)
        self._known = np.union1d(self._known, stamps[new])
        return new

    def record(self, pairs: Pairs) -> None:
        """Take the groundtruth of poses, with stamps by the estimator's clock."""
        self.version += 1
        self._truth.append((pairs.stamps, pairs.groundtruth))

    def pairs(self) -> Pairs:
        """Return the poses of the newest path that have groundtruth, in order of their stamps."""
        if not self._truth:
            return Pairs(np.empty(0, np.int64), np.empty((0, WIDTH)), np.empty((0, WIDTH)))
        stamps = np.concatenate([each[0] for each in self._truth])
        truth = np.concatenate([each[1] for each in self._truth])
        self._truth = [(stamps, truth)]
        common, rows, places = np.intersect1d(stamps, self.stamps, return_indices=True)
        return Pairs(common, truth[rows], self.states[places])
