"""Pairs at the timestamps of fixes and points: completeness, and the error of interpolation.

Completeness is the share of the groundtruth's states that have an estimate. It is the coverage of
these pairs, because fixes and points are too sparse to measure coverage by time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.coverage import Coverage, Gap
from trajeval_ros.metrics.statistics import LogHistogram


class CompletenessSums:
    """Running sums for completeness.

    A gap starts at a state with an estimate, or at the first state, and ends at the next state
    with an estimate. Live and offline evaluation share this code, so that their coverage is equal.
    """

    def __init__(self) -> None:
        self._states = self._matched = 0
        self._first_ns = self._newest_ns = 0
        self._found_ns: tuple[int, int] | None = None  # first and last stamp with an estimate
        # The open gap: its start, the farthest distance from there, whether a state is missing.
        self._begin, self._begin_ns = np.empty((0, 3)), 0
        self._reach_m, self._is_missing = 0.0, False
        self._longest: Gap | None = None

    def add(self, stamps: Stamps, positions: Floats, matched: Booleans) -> None:
        """Add N states in order of their timestamps (ns); `matched` marks those with an estimate.

        States older than those of earlier calls are only counted.
        """
        self._states += len(stamps)
        self._matched += int(np.count_nonzero(matched))
        if len(self._begin):
            new = stamps > self._newest_ns
            stamps, positions, matched = stamps[new], positions[new], matched[new]
        if not len(stamps):
            return
        if not len(self._begin):
            self._begin, self._first_ns = positions[:1], int(stamps[0])
            self._begin_ns = self._first_ns
        self._newest_ns = int(stamps[-1])
        ends = np.flatnonzero(matched)
        begins = np.concatenate([self._begin, positions[ends]])
        begins_ns = np.append(self._begin_ns, stamps[ends])
        stretch: Indices = np.cumsum(matched) - matched
        reach_m = np.zeros(len(begins))
        reach_m[0] = self._reach_m
        np.maximum.at(reach_m, stretch, np.linalg.norm(positions - begins[stretch], axis=1))
        is_missing = np.bincount(stretch[~matched], minlength=len(begins)) > 0
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
        return Coverage(self._matched / self._states, span, longest_gap=gap)

    def _longer(self, lasted_ns: int, reach_m: float) -> Gap:
        """Return the longest gap so far, or a longer one."""
        lasted_s = float(lasted_ns / NANOSECONDS)
        if self._longest is not None and self._longest.duration_s >= lasted_s:
            return self._longest
        return Gap(lasted_s, reach_m, turn_deg=None)


def completeness(groundtruth: Trajectory, rows: Indices) -> Coverage:
    """Return the coverage of pairs at the groundtruth's timestamps: the share of its states.

    The groundtruth is in order; `rows` (N,) are the states that are in a pair, N > 0.
    """
    matched = np.zeros(len(groundtruth), dtype=bool)
    matched[rows] = True
    sums = CompletenessSums()
    sums.add(groundtruth.stamps, groundtruth.positions, matched)
    coverage = sums.coverage()
    assert coverage is not None
    return coverage


_MOST = 0.99  # of the second differences: a jump of the estimate is no curve
_EIGHTH = 0.125


@dataclass(frozen=True)
class Interpolation:
    """The states between which pairs are interpolated."""

    step_s: float  # mean time from one to the next
    # Upper bound of the error of nearly all interpolated positions, in the estimate's unit of
    # length: an eighth of the second differences.
    off_m: float


class InterpolationMeter:
    """Measures states that come in order, in batches of any size, at a constant cost."""

    def __init__(self) -> None:
        self._curves = LogHistogram()
        self._count = self._first_ns = self._last_ns = 0
        self._newest: Floats = np.empty((0, 3))  # positions, two of them

    def add(self, stamps: Stamps, positions: Floats) -> None:
        """Take states: stamps (N,), nanoseconds, and positions (N, 3)."""
        if not len(stamps):
            return
        if not self._count:
            self._first_ns = int(stamps[0])
        self._count, self._last_ns = self._count + len(stamps), int(stamps[-1])
        path = np.concatenate([self._newest, positions])
        self._curves.add(np.linalg.norm(np.diff(path, n=2, axis=0), axis=1))
        self._newest = path[-2:].copy()

    @property
    def interpolation(self) -> Interpolation | None:
        """The interpolation between the states so far; None for fewer than three."""
        if self._count < 3:
            return None
        step_s = (self._last_ns - self._first_ns) / NANOSECONDS / (self._count - 1)
        return Interpolation(step_s, _EIGHTH * self._curves.quantile(_MOST))
