"""The records of evaluated runs, and the file that stores those of a comparison.

An entry of the file is a head of fixed size, a line of JSON with the columns to draw, and the
errors of all sub-trajectories, which only statistics over trials need. Columns are float64,
little-endian. Every entry is appended by one system call, so a kill loses only the entry in
progress. The next writer removes everything after the last complete entry.
"""

from __future__ import annotations

import contextlib
import math
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.json_file import json_text, mapping_in
from trajeval_ros.io.writing import refused_by_disk

RECORDS, OWN = "runs", "all.records"  # folder in that of a comparison, and its file
SCHEMA = "trajeval-run/2"
DRAWN = ("errors", "groundtruth", "path")
_END_OF_HEAD = b"\n"
_MARK = b"trajrun1"
# Mark, key, and size and checksum of the two parts.
_HEAD = struct.Struct("<8s32sQIQI")
HEAD_BYTES = _HEAD.size


@dataclass(frozen=True, eq=False)
class Record:
    """An evaluated run."""

    key: str  # hash of its inputs and settings
    result: dict[str, Any]  # as in result.json, for this run alone
    lengths: tuple[str, ...]  # sub-trajectory lengths as in the request: "8m", "10%"
    # Timestamps of the first and the last pair, in the groundtruth's clock.
    span_ns: tuple[int, int]
    # `LENGTH.position_m`, `LENGTH.rotation_deg` of all sub-trajectories; `groundtruth` (M, 3) and
    # `path` (M, 3), positions to draw, height last; `errors` (M, 3): time since the first pair
    # (s), position error (m), rotation error (deg, NaN where withheld).
    columns: dict[str, Floats] = field(default_factory=dict)

    @property
    def run(self) -> dict[str, Any]:
        """The run in the result."""
        run: dict[str, Any] = self.result["runs"][0]
        return run

    @property
    def groundtruth_up(self) -> UpAxis:
        """The up axis of the groundtruth's frame."""
        return UpAxis(**self.result["groundtruth"]["up"])


class EntryHead(NamedTuple):
    """The head of an entry: its key, and sizes and checksums of its two parts."""

    key: str
    drawn_bytes: int
    drawn_sum: int
    pooled_bytes: int
    pooled_sum: int

    @property
    def size(self) -> int:
        """Bytes of the whole entry."""
        return HEAD_BYTES + self.drawn_bytes + self.pooled_bytes


def entry_head(data: bytes) -> EntryHead | None:
    """Parse a head (`HEAD_BYTES`); None if it is not valid."""
    if len(data) < HEAD_BYTES:
        return None
    mark, key, *rest = _HEAD.unpack_from(data)
    if mark != _MARK or not key.isalnum():
        return None
    return EntryHead(key.decode(), *rest)


def encode(record: Record) -> bytes:
    """Return the entry of a record."""
    drawn = {name: record.columns[name] for name in DRAWN if name in record.columns}
    pooled = {name: item for name, item in record.columns.items() if name not in drawn}
    head = {
        "schema": SCHEMA,
        "result": record.result,
        "lengths": record.lengths,
        "span_ns": record.span_ns,
        "drawn": {name: column.shape for name, column in drawn.items()},
        "pooled": {name: column.shape for name, column in pooled.items()},
    }
    parts = [json_text(head).encode() + _END_OF_HEAD + _bytes_of(drawn), _bytes_of(pooled)]
    sums = [item for part in parts for item in (len(part), zlib.crc32(part))]
    return b"".join([_HEAD.pack(_MARK, record.key.encode(), *sums), *parts])


def decode(head: EntryHead, drawn: bytes, pooled: bytes | None) -> Record | None:
    """Return the record of an entry; None if it is damaged.

    `pooled`: its second part; None to omit its columns.
    """
    if zlib.crc32(drawn) != head.drawn_sum:
        return None
    if pooled is not None and zlib.crc32(pooled) != head.pooled_sum:
        return None
    try:
        text, _, values = drawn.partition(_END_OF_HEAD)
        content = mapping_in(text)
        if content is None or content["schema"] != SCHEMA:
            return None
        columns = _columns(values, content["drawn"])
        if pooled is not None:
            columns |= _columns(pooled, content["pooled"])
        span_ns = tuple(map(int, content["span_ns"]))
        if len(span_ns) != 2 or not isinstance(content["result"]["runs"][0], dict):
            return None
        return Record(head.key, content["result"], tuple(content["lengths"]), span_ns, columns)
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError):
        return None


def _bytes_of(columns: dict[str, Floats]) -> bytes:
    return b"".join(np.asarray(column, dtype="<f8").tobytes() for column in columns.values())


def _columns(values: bytes, shapes: dict[str, list[int]]) -> dict[str, Floats]:
    """Split values into columns by their shapes."""
    sizes = [math.prod(shape) for shape in shapes.values()]
    parts = np.split(np.frombuffer(values, dtype="<f8"), np.cumsum(sizes))
    if len(parts[-1]):
        raise ValueError("more numbers than the shapes require")
    return {
        name: part.reshape(shape)
        for (name, shape), part in zip(shapes.items(), parts[:-1], strict=True)
    }


class RecordStore:
    """All records in a folder, by key; of several with the same key, the last one counts."""

    def __init__(self, folder: Path) -> None:
        """Index all entries of the file of records in a folder; it may not exist yet."""
        self._own = folder / OWN
        self._end = 0  # of the last complete entry
        self._begins: dict[str, int] = {}
        for key, begin, end in _entries(self._own):
            self._begins[key] = begin
            self._end = end

    def __contains__(self, key: str) -> bool:
        return key in self._begins

    def __len__(self) -> int:
        return len(self._begins)

    def add(self, entry: bytes) -> None:
        """Append an encoded record."""
        head = entry_head(entry)
        assert head is not None
        flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        with refused_by_disk(str(self._own)):
            file = os.open(self._own, flags, 0o666)
            try:
                os.ftruncate(file, self._end)
                _write_all(file, entry, self._end)
            except OSError:
                with contextlib.suppress(OSError):
                    os.ftruncate(file, self._end)
                raise
            finally:
                os.close(file)
        self._begins[head.key] = self._end
        self._end += len(entry)

    def read(self, key: str, *, with_pooled: bool = True) -> Record | None:
        """Return a record; None if there is none or it is damaged."""
        if key not in self._begins:
            return None
        try:
            with self._own.open("rb", buffering=0) as file:
                file.seek(self._begins[key])
                head = entry_head(file.read(HEAD_BYTES))
                if head is None or head.key != key:
                    return None
                drawn = file.read(head.drawn_bytes)
                pooled = file.read(head.pooled_bytes) if with_pooled else None
        except OSError:
            return None
        return decode(head, drawn, pooled)

    def forget(self, key: str) -> None:
        """Remove a damaged record from the index."""
        self._begins.pop(key, None)


def _entries(path: Path) -> Iterator[tuple[str, int, int]]:
    """Yield key, start and end of the entries of a file, up to the first incomplete one."""
    try:
        with path.open("rb", buffering=0) as file:
            size, begin = os.fstat(file.fileno()).st_size, 0
            while (
                head := entry_head(os.pread(file.fileno(), HEAD_BYTES, begin))
            ) and begin + head.size <= size:
                yield head.key, begin, begin + head.size
                begin += head.size
    except OSError:
        return


def _write_all(file: int, data: bytes, begin: int) -> None:
    rest = memoryview(data)
    while rest:
        written = os.pwrite(file, rest, begin)
        rest, begin = rest[written:], begin + written
