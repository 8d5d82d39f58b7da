"""The file of a live run's streams as they were received, for the as-available accuracy.

`NAME.received` is next to the pair file and is a file of chunks. A row of the groundtruth is a
timestamp, int64 nanoseconds, and position and quaternion xyzw, seven float64. A row of the
estimate has the time of reception, too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.reading import NOT_READ, Reading
from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_tables
from trajeval_ros.online.live_availability import received_states

FORMAT = "trajeval-received/1"
SUFFIX = ".received"
_KINDS = {
    b"TERG": np.dtype([("stamp", "<i8"), ("pose", "<f8", 7)]),
    b"TERM": np.dtype([("stamp", "<i8"), ("time", "<i8"), ("pose", "<f8", 7)]),
}
_TRUTH, _MESSAGE = _KINDS


class ReceptionWriter(ChunkWriter):
    """Appends to the file of an estimate."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, _KINDS, {"format": FORMAT})

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Queue groundtruth states: timestamps (N,), nanoseconds, and rows (N, 7)."""
        self.add(_TRUTH, stamps, rows)

    def add_estimate(self, stamps: Stamps, times: Stamps, rows: Floats) -> None:
        """Queue messages: timestamps and receptions (N,), nanoseconds, and rows (N, 7)."""
        self.add(_MESSAGE, stamps, times, rows)


def read_received(path: Path, ups: list[UpAxis]) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth and estimate of a file, with their up axes."""
    tables = read_tables(path, _KINDS, FORMAT, "file of receptions")
    (truth_stamps, truth_rows), (stamps, times, rows) = tables.values()
    reading = Reading(receptions=Receptions(times, "node"))
    groundtruth = received_states(truth_stamps, truth_rows, NOT_READ, ups[0])
    return groundtruth, received_states(stamps, rows, reading, ups[1])
