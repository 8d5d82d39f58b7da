"""The file of a live run's streams as they were received, for the as-available accuracy.

`NAME.received` is next to the pair file and is a file of chunks. A row of the groundtruth is a
timestamp, int64 nanoseconds, and position and quaternion xyzw, seven float64. A row of the
estimate has the time of reception, too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.reading import Reading
from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.json_file import json_text, require_schema
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_chunks

FORMAT = "trajeval-received/1"
SUFFIX = ".received"
_TRUTH = np.dtype([("stamp", "<i8"), ("pose", "<f8", 7)])
_MESSAGE = np.dtype([("stamp", "<i8"), ("time", "<i8"), ("pose", "<f8", 7)])
_KINDS = {b"TERG": _TRUTH, b"TERM": _MESSAGE}


class ReceptionWriter(ChunkWriter):
    """Appends to the file of an estimate."""

    def __init__(self, path: Path) -> None:
        text = json_text({"format": FORMAT}).encode()
        super().__init__(path, b"TERG", np.empty(0, _TRUTH), text)

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Queue groundtruth states: timestamps (N,), nanoseconds, and rows (N, 7 or more)."""
        found = np.empty(len(stamps), _TRUTH)
        found["stamp"], found["pose"] = stamps, rows[:, :7]
        self.add(b"TERG", found)

    def add_estimate(self, stamps: Stamps, times: Stamps, rows: Floats) -> None:
        """Queue messages: timestamps and receptions (N,), nanoseconds, and rows (N, 7 or more)."""
        found = np.empty(len(stamps), _MESSAGE)
        found["stamp"], found["time"], found["pose"] = stamps, times, rows[:, :7]
        self.add(b"TERM", found)


def read_received(path: Path, ups: list[UpAxis]) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth and estimate of a file, with their up axes."""
    chunks, _ = read_chunks(path, _KINDS)
    schema = chunks[0][0].get("format") if chunks else None
    require_schema(path, schema, FORMAT, "file of receptions", "evaluate a recording of the run")
    truth, messages = (
        np.concatenate([np.empty(0, kind), *(rows for _, rows in chunks if rows.dtype == kind)])
        for kind in (_TRUTH, _MESSAGE)
    )
    receptions = Receptions(messages["time"].astype(np.int64), "node")
    sides = ((truth, Reading()), (messages, Reading(receptions=receptions)))
    groundtruth, estimate = (
        received_states(rows["stamp"].astype(np.int64), rows["pose"].astype(float), reading, up)
        for (rows, reading), up in zip(sides, ups, strict=True)
    )
    return groundtruth, estimate


def received_states(stamps: Stamps, rows: Floats, reading: Reading, up: UpAxis) -> Trajectory:
    """Return the states in rows (N, 7 or more); without orientations if these are NaN."""
    turns = rows[:, 3:7]
    quaternions = None if np.isnan(turns).any() else lie.normalized(turns)
    return Trajectory.from_columns(stamps, rows[:, :3], quaternions, reading, up=up)
