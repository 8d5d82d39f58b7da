"""The file of a live run's streams as they were received, for the as-available accuracy.

`NAME.received` is next to the pair file and is a file of chunks. A row of the groundtruth is a
timestamp, int64 nanoseconds, and position and quaternion xyzw, seven float64. A row of the
estimate has the times of its reception and of that of its correction, which may be `UNKNOWN`, and
also velocity and angular velocity; NaN if not measured.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_tables
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.online.live_availability import (
    Columns,
    LiveAvailability,
    received_groundtruth,
    received_poses,
)

FORMAT = "trajeval-received/2"
SUFFIX = ".received"
_KINDS = {
    b"TERG": np.dtype([("stamp", "<i8"), ("pose", "<f8", 7)]),
    b"TERM": np.dtype(
        [("stamp", "<i8"), ("time", "<i8"), ("corrected", "<i8"), ("state", "<f8", 13)]
    ),
}
_TRUTH, _MESSAGE = _KINDS


class RecordedAvailability(LiveAvailability):
    """The as-available errors of an estimate, whose streams are recorded."""

    def __init__(
        self, path: Path, rule: AvailabilityRule, max_gap_s: float, max_delay_s: float
    ) -> None:
        """Create the file."""
        super().__init__(rule, max_gap_s, max_delay_s)
        self._file = ChunkWriter(path, _KINDS, {"format": FORMAT})

    def record(self, groundtruth: Columns, messages: Columns) -> None:
        """Queue usable states for writing."""
        self._file.add(_TRUTH, *groundtruth)
        self._file.add(_MESSAGE, *messages)

    def write(self) -> None:
        """Write everything so far."""
        self.store()
        self._file.write()

    def close(self) -> None:
        """Write everything to disk."""
        self.store()
        self._file.close()


def read_received(path: Path, ups: list[UpAxis]) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth and estimate of a file, with their up axes."""
    groundtruth, messages = read_tables(path, _KINDS, FORMAT, "file of receptions").values()
    return received_groundtruth(groundtruth, ups[0]), received_poses(messages, ups[1])
