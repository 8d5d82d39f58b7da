"""Pairs at the estimate's timestamps; the groundtruth is interpolated."""

from __future__ import annotations

from typing import ClassVar

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.travelled import travelled_distance
from trajeval_ros.metrics.coverage import time_without_gaps
from trajeval_ros.metrics.pair_steps import StampedPoses
from trajeval_ros.online.intake import Intake, Limits
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.state_rows import POSITION, Pairs
from trajeval_ros.online.waypoint_stream import WaypointStream


class DensePairing(Pairing):
    """Pairs estimated states with interpolated groundtruth: association `linear`."""

    interpolated: ClassVar[str] = "groundtruth"
    waits: ClassVar[tuple[str, str]] = "pose", "poses"

    def __init__(self, max_gap_s: float = 0.5, limits: Limits | None = None) -> None:
        """Create it empty; see `Pairing`."""
        super().__init__(max_gap_s, limits)
        self._max_gap_ns = round(max_gap_s * NANOSECONDS)
        self._forgotten_time, self._forgotten_path_m = 0, 0.0
        self._waypoints = WaypointStream(self._max_gap_ns)

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states, (N,) and (N, 10), in any order."""
        self._interpolate(stamps, rows)

    def add_estimate(self, stamps: Stamps, rows: Floats) -> None:
        """Take estimated states, (N,) and (N, 10) or (N, 46), in any order."""
        self._let_wait(stamps, rows)

    def take_waypoints(self) -> StampedPoses:
        """Return the groundtruth's waypoints since the last call, at least up to the newest pair.

        Coverage needs them for the motion between pairs after the states are forgotten.
        """
        self._pass_by(0)
        return self._waypoints.take()

    @property
    def newest_groundtruth(self) -> tuple[Stamps, Floats]:
        """Copies of the newest groundtruth states that are still stored."""
        stamps, rows = self._track.held
        return stamps.copy(), rows.copy()

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
        intake = self.estimate_intake
        return intake.poses - self.waiting - intake.dropped.get("duplicate_stamp", 0)

    @property
    def _sides(self) -> tuple[Intake, Intake]:
        return self.groundtruth_intake, self.estimate_intake

    def _as_pairs(self, stamps: Stamps, between: Floats, waited: Floats) -> Pairs:
        return Pairs(stamps, between, waited)

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
    """Return the length of the path through states (N, 10), metres."""
    return float(travelled_distance(rows[:, POSITION])[-1]) if len(rows) else 0.0
