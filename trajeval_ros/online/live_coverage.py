"""Coverage of a running evaluation, measured as pairs arrive."""

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
    """Sums the steps between pairs at a constant cost; equal to the offline coverage."""

    def __init__(self, buffer: Pairing, record: Callable[[StampedPoses], object] | None) -> None:
        """Create it without a pair.

        Args:
            buffer: The pairing, which also has the groundtruth's waypoints.
            record: Called with the waypoints, at most one second after their pairs.
        """
        self._buffer, self._record = buffer, record
        self._meter = StepMeter(round(buffer.max_gap_s * NANOSECONDS))
        self._sums = CoverageSums(buffer.max_gap_s)
        self._waiting: list[StampedPoses] = []
        self._newest: int | None = None  # stamp of the newest pair that has been measured

    def add(self, pairs: Pairs, *, at_end: bool) -> None:
        """Take new pairs (N,), in order.

        Pairs of about one second are measured together, since a call has a high fixed cost.
        """
        if len(pairs.stamps):
            self._waiting.append(StampedPoses(pairs.stamps, pairs.groundtruth[:, POSE]))
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
        return self._sums.coverage(self._buffer.groundtruth_time, self._buffer.groundtruth_count)


class LiveCompleteness:
    """Counts the groundtruth states in pairs; equal to the offline completeness."""

    def __init__(self, buffer: Pairing, record: Callable[[StampedPoses], object] | None) -> None:
        """Create it without a state.

        Args:
            buffer: The pairing, which also has the groundtruth states without a pair.
            record: Called with the groundtruth states without a pair.
        """
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
