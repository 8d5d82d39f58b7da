"""Waypoints of the groundtruth, which coverage needs after states are dropped."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.metrics.pair_steps import POSE, StampedPoses, waypoints


class WaypointStream:
    """Selects the waypoints among states in order of time; every state is examined once."""

    def __init__(self, max_gap_ns: int) -> None:
        """Create it before the first state.

        Args:
            max_gap_ns: A longer step of the groundtruth is a gap, nanoseconds.
        """
        self._max_gap_ns = max_gap_ns
        self._newest: Stamps = np.empty(0, dtype=np.int64)
        self._picked: list[StampedPoses] = []

    @property
    def newest(self) -> int:
        """Timestamp of the newest examined state; the least int64 before the first."""
        return int(self._newest[0]) if len(self._newest) else int(np.iinfo(np.int64).min)

    def pass_by(self, stamps: Stamps, rows: Floats, end: int) -> None:
        """Examine the states before row `end` of stamps (N,) and rows (N, k) that are new.

        The newest state waits for its successor, which determines whether it is a waypoint.
        """
        begin = int(stamps.searchsorted(self.newest, side="right"))
        end = min(end, len(stamps) - 1)
        if end <= begin:
            return
        around = np.concatenate([self._newest, stamps[begin : end + 1]])
        picked = begin + np.flatnonzero(
            waypoints(around, self._max_gap_ns)[len(self._newest) : -1]
        )
        self._picked.append(StampedPoses(stamps[picked], rows[picked, POSE]))
        self._newest = stamps[end - 1 : end].copy()

    def take(self) -> StampedPoses:
        """Return the waypoints selected since the last call."""
        picked, self._picked = self._picked, []
        return StampedPoses.joined(picked)
