"""The files of a live run's states, written as they arrive; a killed process loses none of them.

The folder has a file of the groundtruth and one per estimate. A file is a sequence of chunks
(`chunk_file.py`). The first text describes the stream. Later texts have the run's settings and
counts, which do not follow from the states. A row is a timestamp and a time of reception, int64
nanoseconds, and ten float64 as decoded: position, quaternion xyzw, velocity; NaN if not measured.
Other magic numbers mark other rows: states followed by the covariance, 36 float64 as in the
message; and the poses as received, if they are not the states themselves: with the reception of
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
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.io.json_file import require_schema
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_chunks
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.live_availability import MESSAGE

FORMAT = "trajeval-states/1"
SUFFIX = ".states"
GROUNDTRUTH = f"groundtruth{SUFFIX}"
REVISED_SUFFIX = ".revised"  # the newest path, a file of the same format
_OF_03 = ".pairs"  # files of version 0.3

_ROW = np.dtype([("stamp", "<i8"), ("arrived", "<i8"), ("state", "<f8", 10)])
_WIDE_ROW = np.dtype([*_ROW.descr, ("covariance", "<f8", 36)])
# Types of rows by magic number.
_KINDS = {b"TESN": _ROW, b"TESC": _WIDE_ROW, b"TESR": MESSAGE}
_STATES, _WIDE_STATES, _AS_RECEIVED = _KINDS


class StateWriter(ChunkWriter):
    """Appends to a file of states."""

    def __init__(self, path: Path, description: Mapping[str, Any]) -> None:
        self.lost = 0  # number of states that could not be written
        self.why_lost = ""  # why the last of them could not
        self._told: Mapping[str, Any] = {}
        super().__init__(path, _KINDS, {"format": FORMAT, **description})

    def append(self, stamps: Stamps, states: Floats, arrived: Stamps | None = None) -> None:
        """Add states (N, 10), or (N, 46) with covariances, and their receptions (N,) if known."""
        covariances = states[:, 10:]
        is_wide = bool(covariances.any())  # zeros mean unknown
        times = np.full(len(stamps), UNKNOWN) if arrived is None else arrived
        columns = [stamps, times, states[:, :10], *([covariances] if is_wide else [])]
        if not self.add(_WIDE_STATES if is_wide else _STATES, *columns):
            self.lost += len(stamps)
            self.why_lost = self.trouble
        self.write()

    def append_received(self, messages: NDArray[np.void]) -> None:
        """Add poses as received, rows of type `MESSAGE`."""
        self.add(_AS_RECEIVED, *(messages[name] for name in MESSAGE.names or ()))

    def tell(self, state: Mapping[str, Any]) -> None:
        """Write the newest settings and counts, if they have changed."""
        if state != self._told:
            self._told = state
            none = np.empty(0, np.int64)
            self.add(_STATES, none, none, np.empty((0, 10)), text=state)
        self.write()


@dataclass(frozen=True, eq=False)
class RecordedStates:
    """The content of a file of states, in order of arrival."""

    description: dict[str, Any]  # description of the stream
    state: dict[str, Any]  # the newest settings and counts; empty if none were written
    later: int  # number of states after these counts
    stamps: Stamps  # (N,) nanoseconds
    arrived: Stamps  # (N,) receptions, nanoseconds; may be `UNKNOWN`
    states: Floats  # (N, 10)
    covariances: Floats | None  # (N, 6, 6), zeros if unknown; None if all are unknown
    received: NDArray[np.void]  # poses as received; empty if they are the states
    torn: int  # number of bytes after the last valid chunk

    def part(self, rows: Booleans) -> RecordedStates:
        """Return the states of a mask."""
        covariances = None if self.covariances is None else self.covariances[rows]
        columns = self.stamps[rows], self.arrived[rows], self.states[rows], covariances
        return RecordedStates(
            self.description, self.state, self.later, *columns, self.received, self.torn
        )

    @property
    def wide(self) -> Floats:
        """The states as `StateWriter.append` takes them."""
        if self.covariances is None:
            return self.states
        return np.hstack([self.states, self.covariances.reshape(-1, 36)])


def read_states(path: Path) -> RecordedStates:
    """Read a file of states, up to its first damage.

    Raises:
        InputError: It can't be read, is no such file, or is of another version.
    """
    chunks, torn = read_chunks(path, _KINDS)
    description = chunks[0][0] if chunks else {}
    advice = "evaluate a recording of the run"
    require_schema(path, description.get("format"), FORMAT, "file of states", advice)
    texts = [row for row, (text, _) in enumerate(chunks) if text]
    parts = [rows for _, rows in chunks if rows.dtype in (_ROW, _WIDE_ROW)]
    after = [rows for _, rows in chunks[texts[-1] + 1 :] if rows.dtype != MESSAGE]
    covariances = None
    if any(rows.dtype == _WIDE_ROW for rows in parts):
        covariances = np.concatenate(
            [
                rows["covariance"] if rows.dtype == _WIDE_ROW else np.zeros((len(rows), 36))
                for rows in parts
            ]
        ).reshape(-1, 6, 6)
    received = [rows for _, rows in chunks if rows.dtype == MESSAGE]
    stamps, arrived, states = (
        np.concatenate([rows[name] for rows in parts]) for name in ("stamp", "arrived", "state")
    )
    return RecordedStates(
        description=description,
        state=chunks[texts[-1]][0] if len(texts) > 1 else {},
        later=sum(map(len, after)),
        stamps=stamps.astype(np.int64),
        arrived=arrived.astype(np.int64),
        states=states.astype(np.float64),
        covariances=None if covariances is None else covariances.astype(np.float64),
        received=np.concatenate([np.empty(0, MESSAGE), *received]),
        torn=torn,
    )


def file_of_estimate(name: str) -> str:
    """Return the name of an estimate's file, which differs from the groundtruth's."""
    return f"{name}{SUFFIX}" if name + SUFFIX != GROUNDTRUTH else f"{name}_estimate{SUFFIX}"


def copy_states(before: Path, writer: StateWriter, stamps: Stamps) -> None:
    """Write the states of another file that have one of the timestamps (N,)."""
    recorded = read_states(before)
    taken = recorded.part(np.isin(recorded.stamps, stamps))
    writer.append(taken.stamps, taken.wide, taken.arrived)


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
