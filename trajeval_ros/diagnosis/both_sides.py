"""Groundtruth, estimate and the settings of their comparison, as input of the tests."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.motion_track import MotionTrack
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.association import INTERPOLATING

if TYPE_CHECKING:
    from trajeval_ros.metrics.protocol import Protocol


@dataclass(frozen=True, eq=False)
class Recording:
    """Groundtruth, an estimate and the settings of their comparison.

    Attributes:
        groundtruth: As it was read.
        estimate: As it was read.
        truth: Columns of the groundtruth, in the order of the source.
        track: Columns of the estimate; the applied time offset is added to the timestamps.
        gauge: Of the alignment.
        max_gap_s: Longest step of the groundtruth to interpolate across.
        time_offset_s: Offset that is added to the timestamps of the estimate, seconds.
        by_time: Whether states are paired by timestamps; otherwise by row index.
    """

    groundtruth: Trajectory
    estimate: Trajectory
    truth: MotionTrack
    track: MotionTrack
    gauge: Gauge
    max_gap_s: float
    time_offset_s: float
    by_time: bool

    @classmethod
    def of(
        cls,
        groundtruth: Trajectory,
        estimate: Trajectory,
        protocol: Protocol,
        *,
        time_offset_s: float | None = None,
    ) -> Recording:
        """Return two trajectories with the settings of a protocol.

        Args:
            groundtruth: One state at least.
            estimate: One state at least.
            protocol: The settings.
            time_offset_s: Offset to add to the timestamps of the estimate, seconds; None for
                the offset of the protocol.
        """
        rule = protocol.association
        offset_s = rule.time_offset_s if time_offset_s is None else time_offset_s
        epoch_ns = int(groundtruth.stamps.min())
        interpolates = rule.method in INTERPOLATING
        return cls(
            groundtruth,
            estimate,
            MotionTrack.of(groundtruth, epoch_ns),
            MotionTrack.of(estimate, epoch_ns, offset_s),
            protocol.gauge,
            rule.max_gap_s if interpolates else 2.0 * rule.max_time_difference_s,
            rule.time_offset_s,
            rule.method != "index" and groundtruth.stamped and estimate.stamped,
        )

    @cached_property
    def in_order(self) -> tuple[MotionTrack, MotionTrack]:
        """Groundtruth and estimate sorted by time, of equal times the first pose."""
        return self.truth.in_order(), self.track.in_order()
