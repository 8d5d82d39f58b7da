"""A writer of PX4's logs (ULog, version 1), for tests."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Column = NDArray[np.generic]
_CODES = {"u8": "uint64_t", "f4": "float", "f8": "double", "u1": "uint8_t", "i1": "int8_t"}


def write_ulog(path: Path, topics: Sequence[tuple[str, int, Mapping[str, Column]]]) -> None:
    """Write topics (name, instance, columns by field) in order of their first columns."""
    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), _message("B", bytes(40))]
    rows: list[tuple[int, int, bytes]] = []
    for name, columns in {name: columns for name, _, columns in topics}.items():
        fields = "".join(f"{_kind(column)} {field};" for field, column in columns.items())
        parts.append(_message("F", f"{name}:{fields}".encode()))
    for number, (name, instance, columns) in enumerate(topics):
        parts.append(_message("A", struct.pack("<BH", instance, number) + name.encode()))
        kind = np.dtype(
            [(field, column.dtype, column.shape[1:]) for field, column in columns.items()]
        )
        table = np.zeros(len(columns["timestamp"]), kind)
        for field, column in columns.items():
            table[field] = column
        rows += [(int(row["timestamp"]), number, row.tobytes()) for row in table]
    parts += [_message("D", struct.pack("<H", at) + row) for _, at, row in sorted(rows)]
    path.write_bytes(b"".join(parts))


def _kind(column: Column) -> str:
    kind = _CODES[column.dtype.str[1:]]
    return f"{kind}[{column.shape[1]}]" if column.ndim > 1 else kind


def _message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body
