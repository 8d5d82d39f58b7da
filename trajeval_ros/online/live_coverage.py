"""Coverage of a running evaluation, by the sums of the offline coverage."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.metrics.completeness import CompletenessSums
from trajeval_ros.metrics.coverage import (
    Coverage,
    CoverageSums,
    StampedPoses,
    StepMeter,
    waypoints,
)
from trajeval_ros.metrics.discontinuities.lost_tracking import TrackingLosses
from trajeval_ros.online.pairing import Pairing


class LiveCoverage:
    """Sums the steps between pairs at a constant cost; equal to the offline coverage.

    Pairs and groundtruth states that arrive after newer ones were measured are left out.
    """

    def __init__(self, buffer: Pairing, losses: TrackingLosses) -> None:
        """Create it without pairs; `losses` are those in the measured pairs."""
        self._buffer, self._losses = buffer, losses
        self._meter, self._sums = StepMeter(buffer.rule), CoverageSums(buffer.rule)
        self._newest: Stamps = np.empty(0, dtype=np.int64)  # examined groundtruth state, if any
        self._has_pairs = False

    def measure(self, groundtruth: StampedPoses, estimate: StampedPoses) -> None:
        """Take the poses of N new pairs, in order, and the groundtruth between them."""
        del estimate
        self._has_pairs |= len(groundtruth.stamps) > 0
        passed = self._pass_by(groundtruth.stamps)
        self._sums.add(self._meter.measure(passed, groundtruth))

    def _pass_by(self, paired: Stamps) -> StampedPoses:
        """Return the new waypoints up to the newest pair, or to what will be forgotten.

        Every state is examined once. The newest one waits for its successor, which determines
        whether it is a waypoint.
        """
        track = self._buffer.groundtruth
        stamps, end = track.stamps, self._buffer.forgettable
        if len(paired):
            end = max(end, int(stamps.searchsorted(paired[-1], side="right")))
        begin = int(stamps.searchsorted(self._newest[0], side="right")) if len(self._newest) else 0
        end = min(end, len(stamps) - 1)
        if end <= begin:
            return StampedPoses.joined([])
        around = np.concatenate([self._newest, stamps[begin : end + 1]])
        needed = waypoints(around, self._buffer.rule)[len(self._newest) : -1]
        self._newest = stamps[end - 1 : end].copy()
        return track.poses(begin + np.flatnonzero(needed))

    def coverage(self) -> Coverage | None:
        """Return the coverage of the measured pairs; None before the first one."""
        if not self._has_pairs:
            return None
        return self._sums.coverage(
            self._buffer.groundtruth_time, self._buffer.groundtruth_count, self._losses.frozen_ns
        )


class LiveCompleteness:
    """Counts the groundtruth states in pairs; equal to the offline completeness."""

    def __init__(self, buffer: Pairing) -> None:
        """Create it without pairs."""
        self._buffer = buffer
        self._sums = CompletenessSums()

    def measure(self, groundtruth: StampedPoses, estimate: StampedPoses) -> None:
        """Count the groundtruth states that were decided since the last call."""
        del groundtruth, estimate  # states without a pair count, too
        decided = self._buffer.take_decided()
        if not decided:
            return
        states = StampedPoses.joined([part.states for part in decided])
        paired = np.concatenate([part.paired for part in decided])
        order = np.argsort(states.stamps, kind="stable")
        self._sums.add(states.stamps[order], states.poses[order, :3], paired[order])

    def coverage(self) -> Coverage | None:
        """Return the completeness of the run so far; None before the first pair."""
        return self._sums.coverage()
