"""The pairs of a live run on disk, written as they come: a killed process loses none.

A file is a sequence of chunks, each of them a head, a JSON text and rows of pairs, all
little-endian. The head holds a magic number, the number of rows, the length of the text and the
CRC-32 of what follows. The first text describes the run, later ones what can't be told from pairs
(the newest counts); most are empty. A row is a stamp, int64 nanoseconds, and the states of
groundtruth and estimate, ten float64 each: position, quaternion xyzw, velocity, NaN where there is
none. Chunks with a magic number of their own hold the groundtruth's waypoints between pairs: a
stamp and seven float64 each, position and quaternion. What a kill or a full disk left behind of a
last chunk is passed over.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.io.json_file import json_text, mapping_in
from trajeval_ros.io.schema import require_schema
from trajeval_ros.metrics.pair_steps import StampedPoses

FORMAT = "trajeval-pairs/2"
SUFFIX = ".pairs"

_HEAD = struct.Struct("<4sIII")
_ROW = np.dtype([("stamp", "<i8"), ("groundtruth", "<f8", 10), ("estimate", "<f8", 10)])
_WAYPOINT = np.dtype([("stamp", "<i8"), ("pose", "<f8", 7)])
_KINDS = {b"TEPC": _ROW, b"TEWC": _WAYPOINT}  # of chunks, by their magic numbers
_PAIRS, _WAYPOINTS = _KINDS
# What waits for a disk that takes no more; beyond it, pairs are lost to the file.
_MOST_WAITING = 64 * 1024 * 1024


class PairWriter:
    """Appends to a pair file; a disk that fails is tried again with the next chunk.

    Attributes:
        path: The file.
        trouble: Why the last chunks are not on disk yet; empty if they are.
        lost: Number of pairs that will never be in the file.
        why_lost: Why the last of these won't.
    """

    def __init__(self, path: Path, description: Mapping[str, Any]) -> None:
        """Make the file, which must not exist.

        Raises:
            InputError: It can't be made.
        """
        self.path = path
        self.trouble = self.why_lost = ""
        self.lost = 0
        self._waiting = bytearray()
        self._length = 0  # of the whole chunks on disk
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as error:
            raise InputError(f"{path} can't be written: {_reason(error)}") from error
        none = np.empty((0, 10))
        self.append(np.empty(0, np.int64), none, none, {"format": FORMAT, **description})
        if self.trouble:
            os.close(self._file)
            raise InputError(f"{path} can't be written: {self.trouble}")

    def append(
        self,
        stamps: Stamps,
        groundtruth: Floats,
        estimate: Floats,
        state: Mapping[str, Any] | None = None,
    ) -> None:
        """Add pairs (N,), (N, 10), (N, 10), and what else is known by now."""
        rows = np.empty(len(stamps), dtype=_ROW)
        rows["stamp"], rows["groundtruth"], rows["estimate"] = stamps, groundtruth, estimate
        text = b"" if state is None else json_text(state).encode()
        if not self._append(_PAIRS, rows, text):
            self.lost += len(stamps)
            self.why_lost = self.trouble
        self.write()

    def append_waypoints(self, waypoints: StampedPoses) -> None:
        """Add the groundtruth's waypoints; they are written with what comes next."""
        rows = np.empty(len(waypoints.stamps), dtype=_WAYPOINT)
        rows["stamp"], rows["pose"] = waypoints
        self._append(_WAYPOINTS, rows)

    def _append(self, magic: bytes, rows: NDArray[Any], text: bytes = b"") -> bool:
        """Let a chunk wait for the disk; returns whether there was room."""
        body = text + rows.tobytes()
        if len(self._waiting) + len(body) > _MOST_WAITING:
            return False
        self._waiting += _HEAD.pack(magic, len(rows), len(text), zlib.crc32(body)) + body
        return True

    def close(self) -> None:
        """Have everything on disk, and end.

        Raises:
            InputError: The disk takes no more.
        """
        self.write()
        try:
            os.fsync(self._file)
        except OSError as error:
            self.trouble = self.trouble or _reason(error)
        finally:
            os.close(self._file)
        if self.trouble:
            raise InputError(f"{self.path} can't be written to its end: {self.trouble}")

    def write(self) -> None:
        """Write what waits, unbuffered: what the kernel has, a kill can't take."""
        try:
            written = os.write(self._file, self._waiting) if self._waiting else 0
            while written < len(self._waiting):
                written += os.write(self._file, memoryview(self._waiting)[written:])
        except OSError as error:
            self.trouble = _reason(error)
            os.ftruncate(self._file, self._length)
            os.lseek(self._file, self._length, os.SEEK_SET)
            return
        self._length += written
        self._waiting = bytearray()
        self.trouble = ""


@dataclass(frozen=True, eq=False)
class RecordedPairs:
    """What a pair file holds.

    Attributes:
        description: What the run was.
        state: The newest counts; empty if none were written.
        pairs_at_state: Number of pairs that these counts are about.
        stamps: (N,) nanoseconds, in order of arrival.
        groundtruth: (N, 10) states.
        estimate: (N, 10) states, in the estimate's own frame.
        waypoints: (M,) of the groundtruth between pairs, in order of their stamps.
        torn: Number of bytes at the end that are no whole chunk.
    """

    description: dict[str, Any]
    state: dict[str, Any]
    pairs_at_state: int
    stamps: Stamps
    groundtruth: Floats
    estimate: Floats
    waypoints: StampedPoses
    torn: int


def read_pairs(path: Path) -> RecordedPairs:
    """Read a pair file, to its end or to its first damage.

    Raises:
        InputError: It can't be read, or is none.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} can't be read: {_reason(error)}") from error
    texts: list[dict[str, Any]] = []
    rows: list[NDArray[Any]] = []
    waypoints = [np.empty(0, _WAYPOINT)]
    place = count = pairs_at_state = 0
    while (chunk := _chunk(content, place)) is not None:
        text, found, place = chunk
        if found.dtype == _WAYPOINT:
            waypoints.append(found)
            continue
        rows.append(found)
        count += len(found)
        if text:
            texts.append(text)
            pairs_at_state = count
    schema = texts[0].get("format") if texts else None
    require_schema(
        path, schema, FORMAT, "pair file of a live run", "evaluate a recording of the run"
    )
    pairs, passed = np.concatenate(rows), np.concatenate(waypoints)
    passed_stamps, passed_poses = (passed[name].copy() for name in ("stamp", "pose"))
    return RecordedPairs(
        description=texts[0],
        state=texts[-1] if len(texts) > 1 else {},
        pairs_at_state=pairs_at_state,
        stamps=pairs["stamp"].astype(np.int64),
        groundtruth=pairs["groundtruth"].astype(np.float64),
        estimate=pairs["estimate"].astype(np.float64),
        waypoints=StampedPoses(passed_stamps, passed_poses),
        torn=len(content) - place,
    )


def _chunk(content: bytes, place: int) -> tuple[dict[str, Any], NDArray[Any], int] | None:
    """Return text, rows and end of the chunk at a place, None if there is no whole one."""
    if place + _HEAD.size > len(content):
        return None
    magic, count, length, checksum = _HEAD.unpack_from(content, place)
    begin = place + _HEAD.size
    if (kind := _KINDS.get(magic)) is None:
        return None
    end = begin + length + count * kind.itemsize
    if end > len(content) or zlib.crc32(content[begin:end]) != checksum:
        return None
    text = mapping_in(content[begin : begin + length]) if length else {}
    if text is None:
        return None
    return text, np.frombuffer(content, kind, count, begin + length), end


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
