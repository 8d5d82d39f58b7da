"""A column of numbers that grows row by row while a file is read."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FEWEST = 8192  # rows


class GrowingRows:
    """Rows that grow in place. Concatenating parts at the end takes twice the memory."""

    def __init__(self) -> None:
        self._rows: NDArray[Any] = np.empty(0)
        self._count = 0

    def extend(self, rows: NDArray[Any]) -> None:
        """Add rows, all of the shape and type of the first ones."""
        if not len(self._rows):
            self._rows = np.empty((_FEWEST, *rows.shape[1:]), rows.dtype)
        end = self._count + len(rows)
        if end > len(self._rows):
            self._resize(max(end, len(self._rows) * 9 // 8))
        self._rows[self._count : end] = rows
        self._count = end

    def done(self) -> NDArray[Any]:
        """Return all rows."""
        self._resize(self._count)
        return self._rows

    def _resize(self, count: int) -> None:
        # Large arrays are not copied, only the page table changes. No other view exists.
        self._rows.resize((count, *self._rows.shape[1:]), refcheck=False)
