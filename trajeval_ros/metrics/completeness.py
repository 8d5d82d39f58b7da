"""Completeness: the share of the groundtruth's states that have an estimate.

This is the coverage of pairs at the timestamps of fixes and points. These are too sparse to
measure coverage by time.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.coverage import Coverage, Gap


class CompletenessSums:
    """Running sums for completeness.

    A gap starts at a state with an estimate, or at the first state, and ends at the next state
    with an estimate. Live and offline evaluation share this code, so that their coverage is equal.
    """

    def __init__(self) -> None:
        """Create sums without a state."""
        self._states = self._found = 0
        self._first_ns = self._newest_ns = 0
        self._found_ns: tuple[int, int] | None = None  # first and last stamp with an estimate
        # The open gap: its start, the farthest distance from there, whether a state is missing.
        self._begin, self._begin_ns = np.empty((0, 3)), 0
        self._reach_m, self._is_missing = 0.0, False
        self._longest: Gap | None = None

    def add(self, stamps: Stamps, positions: Floats, found: Booleans) -> None:
        """Add states in order of their timestamps.

        States older than those of earlier calls are only counted.

        Args:
            stamps: (N,), nanoseconds.
            positions: (N, 3), metres.
            found: (N,) whether the state has an estimate.
        """
        self._states += len(stamps)
        self._found += int(np.count_nonzero(found))
        if len(self._begin):
            new = stamps > self._newest_ns
            stamps, positions, found = stamps[new], positions[new], found[new]
        if not len(stamps):
            return
        if not len(self._begin):
            self._begin, self._first_ns = positions[:1], int(stamps[0])
            self._begin_ns = self._first_ns
        self._newest_ns = int(stamps[-1])
        ends = np.flatnonzero(found)
        begins = np.concatenate([self._begin, positions[ends]])
        begins_ns = np.append(self._begin_ns, stamps[ends])
        stretch: Indices = np.cumsum(found) - found
        reach_m = np.zeros(len(begins))
        reach_m[0] = self._reach_m
        np.maximum.at(reach_m, stretch, np.linalg.norm(positions - begins[stretch], axis=1))
        is_missing = np.bincount(stretch[~found], minlength=len(begins)) > 0
        is_missing[0] |= self._is_missing
        lasted_ns = np.where(is_missing[:-1], np.diff(begins_ns), 0)
        if lasted_ns.any():
            longest = int(lasted_ns.argmax())
            self._longest = self._longer(int(lasted_ns[longest]), float(reach_m[longest]))
        if len(ends):
            first_ns = int(stamps[ends[0]]) if self._found_ns is None else self._found_ns[0]
            self._found_ns = first_ns, int(stamps[ends[-1]])
        self._begin, self._begin_ns = begins[-1:], int(begins_ns[-1])
        self._reach_m, self._is_missing = float(reach_m[-1]), bool(is_missing[-1])

    def coverage(self) -> Coverage | None:
        """Return the share of states with an estimate; None if there is no such state."""
        if self._found_ns is None:
            return None
        gap = self._longest
        if self._is_missing:
            gap = self._longer(self._newest_ns - self._begin_ns, self._reach_m)
        whole_ns = self._newest_ns - self._first_ns
        span = (self._found_ns[1] - self._found_ns[0]) / whole_ns if whole_ns else 1.0
        return Coverage(self._found / self._states, span, longest_gap=gap)

    def _longer(self, lasted_ns: int, reach_m: float) -> Gap:
        """Return the longest gap so far, or a longer one."""
        lasted_s = float(lasted_ns / NANOSECONDS)
        if self._longest is not None and self._longest.duration_s >= lasted_s:
            return self._longest
        return Gap(lasted_s, reach_m, turn_deg=None)


def completeness(groundtruth: Trajectory, rows: Indices) -> Coverage:
    """Return the coverage of pairs at the groundtruth's timestamps: the share of its states.

    Args:
        groundtruth: M states, in order.
        rows: (N,) indices of the states that are in a pair, N > 0.
    """
    found = np.zeros(len(groundtruth), dtype=bool)
    found[rows] = True
    sums = CompletenessSums()
    sums.add(groundtruth.stamps, groundtruth.positions, found)
    coverage = sums.coverage()
    assert coverage is not None
    return coverage
