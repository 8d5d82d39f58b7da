"""The streams of one estimate as they were received: to its file, and to as-available errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.io.live.reception_file import SUFFIX, ReceptionWriter
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.live_availability import LiveAvailability
from trajeval_ros.online.live_settings import OnlineSettings


class ReceivedStreams:
    """Writes what was received to a file, and computes the errors of the newest pose."""

    def __init__(self, settings: OnlineSettings, path: Path) -> None:
        """Create the file, whose name starts with that of the estimate."""
        self.file = ReceptionWriter(path.with_name(path.name + SUFFIX))
        self.errors = LiveAvailability(
            settings.available, settings.protocol.association.max_gap_s, settings.limits.past_s
        )

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states: timestamps (N,), nanoseconds, and rows (N, 10)."""
        usable = np.isfinite(rows[:, :3]).all(axis=1)
        self.file.add_groundtruth(stamps[usable], rows[usable])
        self.errors.add_groundtruth(stamps[usable], rows[usable])

    def add_estimate(self, stamps: Stamps, times: Stamps, rows: Floats, offset_ns: int) -> None:
        """Take messages: timestamps and receptions (N,), nanoseconds, and rows (N, 10 or more).

        `offset_ns` is added to the timestamps, not to the receptions.
        """
        usable = np.isfinite(rows[:, :3]).all(axis=1) & (times != UNKNOWN)
        stamps, times, rows = stamps[usable], times[usable], rows[usable]
        self.file.add_estimate(stamps, times, rows)
        self.errors.add_estimate(stamps + offset_ns, times, rows)
