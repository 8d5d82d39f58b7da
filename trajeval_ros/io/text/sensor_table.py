"""Tables of samples that are no poses: of an IMU, or of feature tracks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.io.text.names import Layout
from trajeval_ros.io.text.sniff import sniff
from trajeval_ros.io.text.table import read_rows
from trajeval_ros.io.text.times import times_of

_LARGEST = 1 << 30  # bytes of a file
IMU = "t wx wy wz ax ay az"


def read_samples(path: Path, columns: str) -> tuple[Stamps, Floats]:
    """Return timestamps (N,) in nanoseconds and the other of C columns, (N, C - 1).

    `columns`: their names, the time first: `t_ns` for nanoseconds, `t` for a unit that is
    recognised.

    Raises:
        InputError: The file has other columns, or a value that is not finite.
    """
    if path.stat().st_size > _LARGEST:
        raise InputError(f"{path} is too large; use a part of the recording")
    names = tuple(columns.split())
    layout = Layout("samples", names, extra=names[1:])
    try:
        table = sniff(path, names)
        if table.columns != len(names):
            raise InputError(f"{path} has {table.columns} columns")
        rows = read_rows(table, layout)
        times = times_of(path, layout, rows, None, None)
        values = rows.groups["extra"]
        usable: Any = np.isfinite(values).all(axis=1) & (
            True if times.kept is None else times.kept
        )
        if len(usable) < 2:
            raise InputError("empty")
        if not usable.all():
            raise InputError(f"row {int(np.argmin(usable)) + 1} is not finite")
    except InputError as error:
        message = str(error).replace(" as given with {option}", "").replace("{option}", "columns")
        message = message if str(path) in message else f"{path}: {message}"
        raise InputError(f"{message}; use the columns {columns}") from None
    return times.stamps, values
