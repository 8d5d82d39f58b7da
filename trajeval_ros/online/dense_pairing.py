"""Pairs at the estimate's timestamps; the groundtruth is interpolated."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.travelled import travelled_distance
from trajeval_ros.metrics.coverage import (
    POSE,
    Coverage,
    CoverageSums,
    StampedPoses,
    StepMeter,
    time_without_gaps,
    waypoints,
)
from trajeval_ros.metrics.repeated_poses import RepeatedPoses
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.online.state_rows import POSITION, Pairs


class WaypointStream:
    """Selects the waypoints among states in order of time; every state is examined once."""

    def __init__(self, max_gap_ns: int) -> None:
        self._max_gap_ns = max_gap_ns  # a longer step of the groundtruth is a gap
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


class DensePairing(Pairing):
    """Pairs estimated states with interpolated groundtruth: association `linear`."""

    interpolated: ClassVar[str] = "groundtruth"
    waits: ClassVar[tuple[str, str]] = "pose", "poses"

    def __init__(self, max_gap_s: float = 0.5, limits: BufferLimits | None = None) -> None:
        super().__init__(max_gap_s, limits)
        self._max_gap_ns = round(max_gap_s * NANOSECONDS)
        self._forgotten_time, self._forgotten_path_m = 0, 0.0
        self._waypoints = WaypointStream(self._max_gap_ns)

    def take_waypoints(self) -> StampedPoses:
        """Return the groundtruth's waypoints since the last call, at least up to the newest pair.

        Coverage needs them for the motion between pairs after the states are forgotten.
        """
        self._pass_by(0)
        return self._waypoints.take()

    @property
    def groundtruth_count(self) -> int:
        """Number of groundtruth states so far."""
        return self._track_count

    @property
    def groundtruth_time(self) -> int:
        """Sum of the groundtruth's steps that are no gaps, nanoseconds."""
        return self._forgotten_time + time_without_gaps(self._track.held[0], self._max_gap_ns)

    @property
    def groundtruth_path_m(self) -> float:
        """Length of the path through the groundtruth states, metres."""
        return self._forgotten_path_m + _path_m(self._track.held[1])

    @property
    def estimate_count(self) -> int:
        """Number of estimated states so far, without waiting ones."""
        counts = self.estimate_counts
        return counts.poses - self.waiting - counts.dropped.get("duplicate_stamp", 0)

    def _leave(self, count: int) -> None:
        """Record waypoints, time and path of groundtruth states that will be dropped."""
        stamps, rows = self._track.held
        if int(stamps[count - 1]) > self._waypoints.newest:
            self._pass_by(count)
        self._forgotten_time += time_without_gaps(stamps[: count + 1], self._max_gap_ns)
        self._forgotten_path_m += _path_m(rows[: count + 1])

    def _pass_by(self, end: int) -> None:
        """Take the waypoints up to the newest pair, or up to row `end` if that is later."""
        stamps, rows = self._track.held
        paired = int(stamps.searchsorted(self._paired_until, side="right"))
        self._waypoints.pass_by(stamps, rows, max(end, paired))


def _path_m(rows: Floats) -> float:
    return float(travelled_distance(rows[:, POSITION])[-1]) if len(rows) else 0.0


class LiveCoverage:
    """Sums the steps between pairs at a constant cost; equal to the offline coverage."""

    def __init__(self, buffer: Pairing, record: Callable[[StampedPoses], object] | None) -> None:
        self._buffer, self._record = buffer, record
        self._meter = StepMeter(round(buffer.max_gap_s * NANOSECONDS))
        self._sums = CoverageSums(buffer.max_gap_s)
        self._repeats = RepeatedPoses(max_gap_s=buffer.max_gap_s)
        self._waiting: list[StampedPoses] = []
        self._newest: int | None = None  # stamp of the newest pair that has been measured

    def add(self, pairs: Pairs, *, at_end: bool) -> None:
        """Take new pairs (N,), in order.

        Pairs of about one second are measured together, since a call has a high fixed cost.
        """
        if len(pairs.stamps):
            self._waiting.append(StampedPoses(pairs.stamps, pairs.groundtruth[:, POSE]))
            self._repeats.add(pairs.stamps, pairs.groundtruth, pairs.estimate)
        elif not at_end:
            return
        if at_end or self._newest is None or pairs.stamps[-1] - self._newest >= NANOSECONDS:
            self._measure()

    def _measure(self) -> None:
        """Measure all steps up to the newest pair, and record their waypoints."""
        pairs, waypoints = StampedPoses.joined(self._waiting), self._buffer.take_waypoints()
        if self._record is not None and len(waypoints.stamps):
            self._record(waypoints)
        self._sums.add(self._meter.measure(waypoints, pairs))
        if len(pairs.stamps):
            self._newest = int(pairs.stamps[-1])
        self._waiting = []

    def coverage(self) -> Coverage | None:
        """Return the coverage of the run so far; None before the first pair."""
        if self._newest is None:
            return None
        self._measure()
        return self._sums.coverage(
            self._buffer.groundtruth_time, self._buffer.groundtruth_count, self._repeats.time_ns
        )
