"""The file of a live run's streams as they were received, for the as-available accuracy.

`NAME.received` is next to the pair file and is a file of chunks. A row of the groundtruth is a
timestamp, int64 nanoseconds, and position and quaternion xyzw, seven float64. A row of the
estimate has the times of its reception and of that of its correction, which may be `UNKNOWN`, and
also velocity and angular velocity; NaN if not measured.
"""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_tables
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.online.live_availability import (
    GROUNDTRUTH,
    MESSAGE,
    LiveAvailability,
    Rows,
    received_poses,
)
from trajeval_ros.online.state_rows import trajectory

FORMAT = "trajeval-received/1"
SUFFIX = ".received"
_KINDS = {b"TERG": GROUNDTRUTH, b"TERM": MESSAGE}


class RecordedAvailability(LiveAvailability):
    """The as-available errors of an estimate, whose streams are recorded."""

    def __init__(
        self, path: Path, rule: AvailabilityRule, max_gap_s: float, max_delay_s: float
    ) -> None:
        """Create the file."""
        super().__init__(rule, max_gap_s, max_delay_s)
        self._file = ChunkWriter(path, _KINDS, {"format": FORMAT})

    def record(self, groundtruth: Rows, messages: Rows) -> None:
        """Queue usable states for writing."""
        for magic, rows in zip(_KINDS, (groundtruth, messages), strict=True):
            self._file.add(magic, *(rows[name] for name in rows.dtype.names or ()))

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
    truth, messages = read_tables(path, _KINDS, FORMAT, "file of receptions").values()
    return trajectory(truth["stamp"], truth["pose"], ups[0]), received_poses(messages, ups[1])
