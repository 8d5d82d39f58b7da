"""The record of an evaluated run, an entry in a file of records.

An entry is a head of fixed size, a line of JSON with the columns to draw, and the errors of all
sub-trajectories, which only statistics over trials need. Columns are float64, little-endian.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.json_file import json_text, mapping_in

SCHEMA = "trajeval-run/1"
DRAWN = ("errors", "path", "truth")
_END_OF_HEAD = b"\n"
_MARK = b"trajrun1"
# Mark, key, and size and checksum of the two parts.
_HEAD = struct.Struct("<8s32sQIQI")
HEAD_BYTES = _HEAD.size


@dataclass(frozen=True, eq=False)
class Record:
    """An evaluated run.

    Attributes:
        key: Hash of its inputs and settings.
        result: As in result.json, for this run alone.
        lengths: Sub-trajectory lengths as in the request: "8m", "10%".
        span_ns: Timestamps of the first and the last pair, in the groundtruth's clock.
        columns: `LENGTH.position_m`, `LENGTH.rotation_deg` of all sub-trajectories; `truth`
            (M, 3) and `path` (M, 3), positions to draw, height last; `errors` (M, 3): time since
            the first pair (s), position error (m), rotation error (deg, NaN where withheld).
    """

    key: str
    result: dict[str, Any]
    lengths: tuple[str, ...]
    span_ns: tuple[int, int]
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
    pooled = {name: each for name, each in record.columns.items() if name not in drawn}
    head = {
        "schema": SCHEMA,
        "result": record.result,
        "lengths": record.lengths,
        "span_ns": record.span_ns,
        "drawn": {name: column.shape for name, column in drawn.items()},
        "pooled": {name: column.shape for name, column in pooled.items()},
    }
    parts = [json_text(head).encode() + _END_OF_HEAD + _bytes_of(drawn), _bytes_of(pooled)]
    sums = [each for part in parts for each in (len(part), zlib.crc32(part))]
    return b"".join([_HEAD.pack(_MARK, record.key.encode(), *sums), *parts])


def decode(head: EntryHead, drawn: bytes, pooled: bytes | None) -> Record | None:
    """Return the record of an entry; None if it is damaged.

    Args:
        head: Head of the entry.
        drawn: Its first part.
        pooled: Its second part; None to omit its columns.
    """
    if zlib.crc32(drawn) != head.drawn_sum:
        return None
    if pooled is not None and zlib.crc32(pooled) != head.pooled_sum:
        return None
    try:
        text, _, values = drawn.partition(_END_OF_HEAD)
        said = mapping_in(text)
        if said is None or said["schema"] != SCHEMA:
            return None
        columns = _columns(values, said["drawn"])
        if pooled is not None:
            columns |= _columns(pooled, said["pooled"])
        span_ns = tuple(map(int, said["span_ns"]))
        if len(span_ns) != 2 or not isinstance(said["result"]["runs"][0], dict):
            return None
        return Record(head.key, said["result"], tuple(said["lengths"]), span_ns, columns)
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError):
        return None


def _bytes_of(columns: dict[str, Floats]) -> bytes:
    return b"".join(np.asarray(each, dtype="<f8").tobytes() for each in columns.values())


def _columns(values: bytes, shapes: dict[str, list[int]]) -> dict[str, Floats]:
    """Split values into columns by their shapes.

    Raises:
        ValueError: The number of values differs.
    """
    sizes = [math.prod(shape) for shape in shapes.values()]
    parts = np.split(np.frombuffer(values, dtype="<f8"), np.cumsum(sizes))
    if len(parts[-1]):
        raise ValueError("more numbers than the shapes require")
    return {
        name: part.reshape(shape)
        for (name, shape), part in zip(shapes.items(), parts[:-1], strict=True)
    }
