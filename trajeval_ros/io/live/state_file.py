"""The files of a live run's states, written as they arrive; a killed process loses none of them.

The folder has a file of the groundtruth and one per estimate. A file is a sequence of chunks
(`chunk_file.py`). The first text describes the stream. Later texts have the run's settings and
counts, which do not follow from the states. A row is a timestamp and a receive time, int64
nanoseconds, and ten float64: position, unit quaternion xyzw, velocity; NaN if not measured.
Other magic numbers mark other rows: states followed by the covariance, 36 float64 as in the
message; and the poses as received, if they are not the states themselves: with the receive time of
their correction, and with the angular velocity after the velocity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import install_command
from trajeval_ros.formatting.remarks import Remark
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_chunks
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.live_availability import MESSAGE, message_rows

FORMAT = "trajeval-states/1"
SUFFIX = ".states"
GROUNDTRUTH = f"groundtruth{SUFFIX}"
REVISED_SUFFIX = ".revised"  # the newest path, a file of the same format
_OF_03 = ".pairs"  # files of version 0.3

_ROW = np.dtype([("stamp", "<i8"), ("arrived", "<i8"), ("state", "<f8", 10)])
_WIDE_ROW = np.dtype([*_ROW.descr, ("covariance", "<f8", 36)])
_PARTS = slice(0, 3), slice(3, 7), slice(7, 10)  # columns of `state`
# Types of rows by magic number.
_KINDS = {b"TESN": _ROW, b"TESC": _WIDE_ROW, b"TESR": MESSAGE}
_STATES, _WIDE_STATES, _AS_RECEIVED = _KINDS


class StateWriter(ChunkWriter):
    """Appends to a file of states."""

    def __init__(self, path: Path, description: Mapping[str, Any]) -> None:
        self.lost = 0  # number of states that could not be written
        self.why_lost = ""  # why the last of them could not
        self._described: Mapping[str, Any] = {}
        super().__init__(path, _KINDS, {"format": FORMAT, **description})

    def append(self, states: Trajectory) -> None:
        """Add states, with their receive times if known."""
        receive_times, covariances = states.reading.receive_times, states.covariances
        rows = np.full((len(states), 10), np.nan)
        for part, column in zip(_PARTS, _columns(states), strict=True):
            if column is not None:
                rows[:, part] = column
        times = np.full(len(states), UNKNOWN) if receive_times is None else receive_times.times
        columns, magic = [states.stamps, times, rows], _STATES
        if covariances is not None:
            columns, magic = [*columns, covariances.reshape(-1, 36)], _WIDE_STATES
        if not self.add(magic, *columns):
            self.lost += len(states)
            self.why_lost = self.trouble
        self.write()

    def append_received(self, messages: Trajectory) -> None:
        """Add poses as received."""
        rows = message_rows(messages)
        self.add(_AS_RECEIVED, *(rows[name] for name in MESSAGE.names or ()))

    def describe(self, state: Mapping[str, Any]) -> None:
        """Write the newest settings and counts, if they have changed."""
        if state != self._described:
            self._described = state
            none = np.empty(0, np.int64)
            self.add(_STATES, none, none, np.empty((0, 10)), text=state)
        self.write()


@dataclass(frozen=True, eq=False)
class RecordedStates:
    """The content of a file of states, in order of arrival."""

    description: dict[str, Any]  # description of the stream
    state: dict[str, Any]  # the newest settings and counts; empty if none were written
    later: int  # number of states after these counts
    # With receive times, which may be `UNKNOWN`. Unknown covariances among known ones are zeros.
    states: Trajectory
    received: NDArray[np.void]  # poses as received; empty if they are the states
    torn: int  # number of bytes after the last valid chunk
    remarks: list[Remark]  # about damage


def read_states(path: Path) -> RecordedStates:
    """Read a file of states, up to its first damage.

    Raises:
        InputError: It can't be read, is no such file, or is of another version.
    """
    chunks = read_chunks(path, _KINDS, FORMAT, "file of states")
    later = [rows for rows in chunks.rows[chunks.described :] if rows.dtype != MESSAGE]
    return RecordedStates(
        description=chunks.description,
        state=chunks.newest,
        later=sum(map(len, later)),
        states=_states_of(chunks.rows_of(_ROW, _WIDE_ROW)),
        received=np.concatenate(chunks.rows_of(MESSAGE)),
        torn=chunks.torn,
        remarks=chunks.remarks(),
    )


def _columns(states: Trajectory) -> tuple[Floats | None, ...]:
    return states.positions, states.quaternions, states.velocities


def _states_of(parts: list[NDArray[np.void]]) -> Trajectory:
    """Return the rows of chunks as a trajectory, without what some of them lack."""
    stamps, arrived, rows = (
        np.concatenate([part[name] for part in parts]) for name in ("stamp", "arrived", "state")
    )
    positions, quaternions, velocities = (rows[:, part].astype(np.float64) for part in _PARTS)
    covariances = None
    if any(part.dtype == _WIDE_ROW for part in parts):
        covariances = np.concatenate(
            [
                part["covariance"] if part.dtype == _WIDE_ROW else np.zeros((len(part), 36))
                for part in parts
            ]
        ).reshape(-1, 6, 6)
    return Trajectory.from_columns(
        stamps.astype(np.int64),
        positions,
        None if np.isnan(quaternions).any() else quaternions,
        velocities=velocities if np.isfinite(velocities).any() else None,
        covariances=covariances,
        reading=SourceInfo(receive_times=ReceiveTimes(arrived.astype(np.int64), "node")),
    )


def file_of_estimate(name: str) -> str:
    """Return the name of an estimate's file, which differs from the groundtruth's."""
    return f"{name}{SUFFIX}" if name + SUFFIX != GROUNDTRUTH else f"{name}_estimate{SUFFIX}"


def state_files(folder: Path) -> list[Path]:
    """Return the files of the estimates of a live run, sorted by name.

    Raises:
        InputError: It is no folder of a live run, or one of version 0.3.
    """
    paths = [path for path in sorted(folder.glob(f"*{SUFFIX}")) if path.name != GROUNDTRUTH]
    if paths:
        return paths
    if any(folder.glob(f"*{_OF_03}")):
        raise InputError(
            f"{folder} is of version 0.3, which recorded pairs; read it with that version: "
            f"{install_command('trajeval-ros==0.3.*')}"
        )
    raise InputError(
        f"no live run in {folder} (no file *{SUFFIX}); give the output folder of the evaluator"
    )
