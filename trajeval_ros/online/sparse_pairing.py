"""Pairs at the timestamps of fixes and points; the estimate is interpolated."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import ClassVar

import numpy as np

from trajeval_ros.geometry.travelled import travelled_distance
from trajeval_ros.geometry.valid_poses import add_counts
from trajeval_ros.metrics.completeness import CompletenessSums, Interpolation, InterpolationMeter
from trajeval_ros.metrics.coverage import POSE, Coverage, StampedPoses
from trajeval_ros.online.pairing import Decided, Pairing
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.online.state_rows import POSITION, Pairs


class SparsePairing(Pairing):
    """Pairs groundtruth states with the interpolated estimate: association `groundtruth-stamps`.

    A fix or a point waits for estimated states beyond it.
    """

    interpolated: ClassVar[str] = "estimate"
    waits: ClassVar[tuple[str, str]] = "fix or point", "fixes or points"

    def __init__(self, max_gap_s: float = 0.5, limits: BufferLimits | None = None) -> None:
        super().__init__(max_gap_s, limits)
        self._missing: list[StampedPoses] = []
        self._passed = 0
        self._first_ns, self._newest_ns = 0, 0
        self._newest = np.empty((0, 3))  # position of the newest state that has passed
        self._path_m = 0.0
        self._forgotten = InterpolationMeter()
        self._is_between = False  # whether a pair lies between two estimated states

    @classmethod
    def after(cls, before: Pairing) -> SparsePairing:
        """Return a pairing with the estimated states that another one had before groundtruth."""
        sparse = cls(before.max_gap_s, before.limits)
        stamps, rows = before._waiting.held
        sparse.add_estimate(stamps.copy(), rows.copy())
        sparse.estimate_counts = before.estimate_counts
        sparse.estimate_counts.dropped = add_counts(before.dropped)
        return sparse

    def take_waypoints(self) -> StampedPoses:
        """Return the groundtruth states without a pair that were decided since the last call."""
        missing, self._missing = StampedPoses.joined(self._missing), []
        return missing

    @property
    def groundtruth_count(self) -> int:
        """Number of groundtruth states so far, without waiting ones."""
        return self._passed

    @property
    def groundtruth_time(self) -> int:
        """Time from the first to the newest groundtruth state, nanoseconds; no step is a gap."""
        return self._newest_ns - self._first_ns

    @property
    def groundtruth_path_m(self) -> float:
        """Length of the path through the groundtruth states, metres."""
        return self._path_m

    @property
    def interpolation(self) -> Interpolation | None:
        """How far interpolation of the estimate may be off; None if no pair needed any."""
        if not self._is_between:
            return None
        whole = deepcopy(self._forgotten)
        stamps, rows = self._track.held
        whole.add(stamps, rows[:, POSITION])
        return whole.found

    @property
    def estimate_count(self) -> int:
        """Number of estimated states so far."""
        return self._track_count

    def _leave(self, count: int) -> None:
        """Measure the oldest estimated states, which will be forgotten."""
        stamps, rows = self._track.held
        self._forgotten.add(stamps[:count], rows[:count, POSITION])

    def _pass(self, decided: Decided) -> None:
        """Count the decided groundtruth states, and keep those without a pair."""
        super()._pass(decided)
        self._is_between |= decided.bracket.is_between
        stamps, rows = decided.stamps, decided.rows
        missing = ~decided.bracket.usable
        if missing.any():
            self._missing.append(StampedPoses(stamps[missing], rows[missing, POSE]))
        if not self._passed:
            self._first_ns = self._newest_ns = int(stamps[0])
        self._passed += len(stamps)
        new = stamps >= self._newest_ns  # late states do not extend the path
        if new.any():
            path = np.concatenate([self._newest, rows[new, POSITION]])
            self._path_m += float(travelled_distance(path)[-1])
            self._newest, self._newest_ns = path[-1:].copy(), int(stamps[-1])


class LiveCompleteness:
    """Counts the groundtruth states in pairs; equal to the offline completeness."""

    def __init__(self, buffer: Pairing, record: Callable[[StampedPoses], object] | None) -> None:
        self._buffer, self._record = buffer, record
        self._sums = CompletenessSums()

    def add(self, pairs: Pairs, *, at_end: bool) -> None:
        """Take new pairs (N,), in order, and the groundtruth states between them."""
        del at_end  # nothing waits
        missing = self._buffer.take_waypoints()
        if self._record is not None and len(missing.stamps):
            self._record(missing)
        stamps = np.concatenate([pairs.stamps, missing.stamps])
        positions = np.concatenate([pairs.groundtruth[:, POSITION], missing.poses[:, POSITION]])
        order = np.argsort(stamps, kind="stable")
        self._sums.add(stamps[order], positions[order], order < len(pairs.stamps))

    def coverage(self) -> Coverage | None:
        """Return the completeness of the run so far; None before the first pair."""
        return self._sums.coverage()
