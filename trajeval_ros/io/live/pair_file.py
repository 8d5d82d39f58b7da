"""The file of a live run's pairs, written as they arrive; a killed process loses none of them.

A file is a sequence of chunks (`chunk_file.py`). The first text describes the run. Later texts
have the newest counts, which do not follow from pairs; most are empty. A row is a timestamp, int64
nanoseconds, and the states of groundtruth and estimate, ten float64 each: position, quaternion
xyzw, velocity; NaN if not measured. Other magic numbers mark other rows: pairs followed by the
estimate's covariance, 36 float64 as in its message; and groundtruth waypoints between pairs, or
fixes and points without a pair: a timestamp and seven float64, position and quaternion. Version 2
had no covariances, and sentences up to version 3 had no level and code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.valid_poses import judge_poses
from trajeval_ros.io.json_file import require_schema
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_chunks
from trajeval_ros.io.npz_file import read_arrays, write_arrays
from trajeval_ros.metrics.coverage import StampedPoses

FORMAT = "trajeval-pairs/4"
_BEFORE = ("trajeval-pairs/2", "trajeval-pairs/3")
SUFFIX = ".pairs"

_ROW = np.dtype([("stamp", "<i8"), ("groundtruth", "<f8", 10), ("estimate", "<f8", 10)])
_WIDE_ROW = np.dtype([*_ROW.descr, ("covariance", "<f8", 36)])
_WAYPOINT = np.dtype([("stamp", "<i8"), ("pose", "<f8", 7)])
# Types of rows by magic number.
_KINDS = {b"TEPC": _ROW, b"TEVC": _WIDE_ROW, b"TEWC": _WAYPOINT}
_PAIRS, _WIDE_PAIRS, _WAYPOINTS = _KINDS


class PairWriter(ChunkWriter):
    """Appends to a pair file."""

    def __init__(self, path: Path, description: Mapping[str, Any]) -> None:
        self.lost = 0  # number of pairs that could not be written
        self.why_lost = ""  # why the last of them could not
        super().__init__(path, _KINDS, {"format": FORMAT, **description})

    def append(
        self,
        stamps: Stamps,
        groundtruth: Floats,
        estimate: Floats,
        state: Mapping[str, Any] | None = None,
    ) -> None:
        """Add pairs (N,), (N, 10), (N, 10) or (N, 46), and the newest counts if given."""
        columns, covariances = [stamps, groundtruth, estimate[:, :10]], estimate[:, 10:]
        is_wide = bool(covariances.any())  # zeros mean unknown
        columns += [covariances] if is_wide else []
        if not self.add(_WIDE_PAIRS if is_wide else _PAIRS, *columns, text=state):
            self.lost += len(stamps)
            self.why_lost = self.trouble
        self.write()

    def append_waypoints(self, waypoints: StampedPoses) -> None:
        """Add waypoints of the groundtruth; they are written together with the next pairs."""
        self.add(_WAYPOINTS, *waypoints)


@dataclass(frozen=True, eq=False)
class RecordedPairs:
    """The content of a pair file."""

    description: dict[str, Any]  # description of the run
    state: dict[str, Any]  # the newest counts; empty if none were written
    pairs_at_state: int  # number of pairs when these counts were written
    stamps: Stamps  # (N,) nanoseconds, in order of arrival
    groundtruth: Floats  # (N, 10) states
    estimate: Floats  # (N, 10) states, in the estimate's own frame
    # (N, 6, 6) of the estimate, zeros if unknown; None if all are unknown.
    covariances: Floats | None
    waypoints: StampedPoses  # (M,) of the groundtruth between pairs, in order of time
    torn: int  # number of bytes after the last valid chunk


def read_pairs(path: Path) -> RecordedPairs:
    """Read a pair file up to its end or to its first damage."""
    chunks, torn = read_chunks(path, _KINDS)
    texts: list[dict[str, Any]] = []
    rows: list[NDArray[Any]] = []
    waypoints = [np.empty(0, _WAYPOINT)]
    count = pairs_at_state = 0
    for text, chunk_rows in chunks:
        if chunk_rows.dtype == _WAYPOINT:
            waypoints.append(chunk_rows)
            continue
        rows.append(chunk_rows)
        count += len(chunk_rows)
        if text:
            texts.append(text)
            pairs_at_state = count
    schema = texts[0].get("format") if texts else None
    if schema not in _BEFORE:
        require_schema(
            path, schema, FORMAT, "pair file of a live run", "evaluate a recording of the run"
        )
    passed = np.concatenate(waypoints)
    stamps, groundtruth, estimate = (
        np.concatenate([block[name] for block in rows])
        for name in ("stamp", "groundtruth", "estimate")
    )
    covariances = None
    if any(block.dtype == _WIDE_ROW for block in rows):
        known = [
            block["covariance"] if block.dtype == _WIDE_ROW else np.zeros((len(block), 36))
            for block in rows
        ]
        covariances = np.concatenate(known).astype(np.float64).reshape(-1, 6, 6)
    passed_stamps, passed_poses = (passed[name].copy() for name in ("stamp", "pose"))
    return RecordedPairs(
        description=texts[0],
        state=texts[-1] if len(texts) > 1 else {},
        pairs_at_state=pairs_at_state,
        stamps=stamps.astype(np.int64),
        groundtruth=groundtruth.astype(np.float64),
        estimate=estimate.astype(np.float64),
        covariances=covariances,
        waypoints=StampedPoses(passed_stamps, passed_poses),
        torn=torn,
    )


REVISED_SUFFIX = ".revised.npz"


def write_revised(path: Path, stamps: Stamps, positions: Floats, quaternions: Floats) -> None:
    """Write the poses of a path, stamps (N,), positions (N, 3), quaternions (N, 4), to a file."""
    columns = {"stamps": stamps, "positions": positions, "quaternions": quaternions}
    write_arrays(path, columns, compressed=False)


def read_revised(path: Path) -> Trajectory:
    """Return the trajectory in a file of `write_revised`."""
    arrays = read_arrays(path, ("stamps", "positions", "quaternions"))
    kinds = [(name, array.dtype.kind, array.shape) for name, array in arrays.items()]
    count = len(arrays["stamps"]) if arrays.get("stamps", np.zeros(())).ndim else 0
    if not count or kinds != [
        ("stamps", "i", (count,)),
        ("positions", "f", (count, 3)),
        ("quaternions", "f", (count, 4)),
    ]:
        raise InputError(
            f"{path} must have equal numbers of timestamps, positions and quaternions"
        )
    if not np.logical_and(*judge_poses(arrays["positions"], arrays["quaternions"])).all():
        raise InputError(f"{path} has poses that are not finite")
    return Trajectory(arrays["stamps"], arrays["positions"], lie.normalized(arrays["quaternions"]))
