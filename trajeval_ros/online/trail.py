"""A bounded number of poses of the whole run, for plots."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.online.state_rows import WIDTH, Pairs

MOST_POSES = 2000


class Trail:
    """Every k-th pair of a run; k doubles when the memory is full.

    The newest pair is always included, so that the plotted path reaches the robot.
    """

    def __init__(self) -> None:
        """Create it empty."""
        self._every = 1
        self._seen = self._count = 0
        self._stamps: Stamps = np.empty(MOST_POSES, dtype=np.int64)
        self._rows: Floats = np.empty((MOST_POSES, 2 * WIDTH))
        self._newest: Pairs | None = None

    def __len__(self) -> int:
        """Return the number of stored pairs, without the newest one."""
        return self._count

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
