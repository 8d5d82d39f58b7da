"""The file of a live run's GNSS fixes, as in their messages.

`groundtruth.fixes` is next to `groundtruth.states`, which has their positions in metres. It
is a file of chunks. A row is a timestamp, int64 nanoseconds, and 14 float64: latitude and
longitude in degrees, height in metres, status, covariance type, and the covariance about east,
north and up, m^2.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trajeval_ros.formatting.remarks import Remark
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_chunks

FORMAT = "trajeval-fixes/1"
NAME = "groundtruth.fixes"

_FIXES = b"TEFX"
_KINDS = {_FIXES: np.dtype([("stamp", "<i8"), ("fix", "<f8", 14)])}


class FixWriter(ChunkWriter):
    """Appends to the file of fixes in a run's folder."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / NAME, _KINDS, {"format": FORMAT})

    def append(self, stamps: Stamps, fixes: Fixes) -> None:
        """Add N fixes with their timestamps (N,), nanoseconds."""
        kinds, covariances = fixes.covariance_types, fixes.covariances.reshape(-1, 9)
        self.add(_FIXES, stamps, np.column_stack([fixes.places, fixes.status, kinds, covariances]))
        self.write()


def read_fix_rows(folder: Path) -> tuple[Stamps, Floats, list[Remark]]:
    """Return stamps (N,), nanoseconds, and rows (N, 14) of the file of fixes, as written.

    The remarks are about damage of the file.
    """
    chunks = read_chunks(folder / NAME, _KINDS, FORMAT, "file of fixes")
    rows = np.concatenate(chunks.rows_of(_KINDS[_FIXES]))
    return rows["stamp"].astype(np.int64), rows["fix"].astype(np.float64), chunks.remarks()
