"""What an evaluated run leaves on disk: a file each, so that a kill loses what is in flight.

A file is a line of JSON, and then the numbers of all columns, float64, little-endian. An archive
of numpy's would do, but costs a millisecond each way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.json_file import json_text, mapping_in
from trajeval_ros.io.writing import write_whole

SCHEMA = "trajeval-run/1"
_END_OF_HEAD = b"\n"


@dataclass(frozen=True, eq=False)
class Record:
    """An evaluated run.

    Attributes:
        key: Hash of what it was evaluated from, and how.
        result: As in result.json, of this run alone.
        lengths: Of sub-trajectories, as asked for: "8m", "10%".
        span_ns: Stamps of the first and the last pair, in the groundtruth's clock.
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
        """Which axis of the groundtruth's frame points up."""
        return UpAxis(**self.result["groundtruth"]["up"])


def encode(record: Record) -> bytes:
    """Return a record as the bytes of its file, which workers make."""
    shapes = {name: column.shape for name, column in record.columns.items()}
    head = {
        "schema": SCHEMA,
        "result": record.result,
        "lengths": record.lengths,
        "span_ns": record.span_ns,
        "shapes": shapes,
    }
    text = json_text(head).encode()
    columns = (np.asarray(each, dtype="<f8").tobytes() for each in record.columns.values())
    return b"".join([text, _END_OF_HEAD, *columns])


def write_record(folder: Path, key: str, encoded: bytes) -> None:
    """Write an encoded record, whole or not at all.

    Raises:
        InputError: It can't be written.
    """
    write_whole(_path(folder, key), lambda temporary: temporary.write_bytes(encoded))


def has_record(folder: Path, key: str) -> bool:
    """Return whether a run was finished."""
    return _path(folder, key).is_file()


def read_record(folder: Path, key: str) -> Record | None:
    """Return a record; None if there is none that can be read."""
    try:
        text, _, values = _path(folder, key).read_bytes().partition(_END_OF_HEAD)
        head = mapping_in(text)
        if head is None or head["schema"] != SCHEMA:
            return None
        sizes = [math.prod(shape) for shape in head["shapes"].values()]
        parts = np.split(np.frombuffer(values, dtype="<f8"), np.cumsum(sizes))
        columns = {
            name: part.reshape(shape)
            for (name, shape), part in zip(head["shapes"].items(), parts[:-1], strict=True)
        }
        span_ns = tuple(map(int, head["span_ns"]))
        if len(parts[-1]) or len(span_ns) != 2 or not isinstance(head["result"]["runs"][0], dict):
            return None  # more than there should be, or something else
        return Record(key, head["result"], tuple(head["lengths"]), span_ns, columns)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError):
        return None


def _path(folder: Path, key: str) -> Path:
    return folder / f"{key}.run"
