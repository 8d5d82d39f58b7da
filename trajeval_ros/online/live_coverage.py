"""What a live run covers so far: steps between pairs are measured as they come."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.completeness import CompletenessSums
from trajeval_ros.metrics.coverage import Coverage, CoverageSums
from trajeval_ros.metrics.pair_steps import POSE, StampedPoses, StepMeter
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.state_rows import POSITION, Pairs


class LiveCoverage:
    """Adds up the steps between pairs at a constant cost, equal to the offline coverage."""

    def __init__(self, buffer: Pairing, record: Callable[[StampedPoses], object] | None) -> None:
        """Create it without a pair.

        Args:
            buffer: What makes the pairs, and holds their groundtruth.
            record: Is given the groundtruth's waypoints, a second behind the pairs at the most.
        """
        self._buffer, self._record = buffer, record
        self._meter = StepMeter(round(buffer.max_gap_s * NANOSECONDS))
        self._sums = CoverageSums(buffer.max_gap_s)
        self._waiting: list[StampedPoses] = []
        self._newest: int | None = None  # stamp of the newest pair that has been measured

    def add(self, pairs: Pairs, *, at_end: bool) -> None:
        """Take new pairs (N,), in order; those of about a second are measured together.

        That is because a call costs more than the steps of many pairs.
        """
        if len(pairs.stamps):
            self._waiting.append(StampedPoses(pairs.stamps, pairs.groundtruth[:, POSE]))
        elif not at_end:
            return
        if at_end or self._newest is None or pairs.stamps[-1] - self._newest >= NANOSECONDS:
            self._measure()

    def _measure(self) -> None:
        """Measure all steps up to the newest pair, and record the waypoints between them."""
        pairs, waypoints = StampedPoses.joined(self._waiting), self._buffer.take_waypoints()
        if self._record is not None and len(waypoints.stamps):
            self._record(waypoints)
        self._sums.add(self._meter.measure(waypoints, pairs))
        if len(pairs.stamps):
            self._newest = int(pairs.stamps[-1])
        self._waiting = []

    def coverage(self) -> Coverage | None:
        """Return what the pairs of the whole run cover; None while there is none."""
        if self._newest is None:
            return None
        self._measure()
        return self._sums.coverage(self._buffer.groundtruth_time, self._buffer.groundtruth_count)


class LiveCompleteness:
    """Tells how many of the groundtruth's own states are in pairs, equal to the offline share."""

    def __init__(self, buffer: Pairing, record: Callable[[StampedPoses], object] | None) -> None:
        """Create it without a state.

        Args:
            buffer: What makes the pairs, and knows what is in none.
            record: Is given the groundtruth's states that are in none.
        """
        self._buffer, self._record = buffer, record
        self._sums = CompletenessSums()

    def add(self, pairs: Pairs, *, at_end: bool) -> None:
        """Take new pairs (N,), in order, and the groundtruth's states between them."""
        del at_end  # nothing waits
        missing = self._buffer.take_waypoints()
        if self._record is not None and len(missing.stamps):
            self._record(missing)
        stamps = np.concatenate([pairs.stamps, missing.stamps])
        positions = np.concatenate([pairs.groundtruth[:, POSITION], missing.poses[:, POSITION]])
        order = np.argsort(stamps, kind="stable")
        self._sums.add(stamps[order], positions[order], order < len(pairs.stamps))

    def coverage(self) -> Coverage | None:
        """Return the completeness of the whole run; None while there is no pair."""
        return self._sums.coverage()
