"""Values at any positions of a buffer, gathered without a Python object per value."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Indices

Buffer = NDArray[np.uint8]


def gather(buffer: Buffer, places: Indices, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the values (N,) at the places (N,), which need no alignment.

    Args:
        buffer: (B,) bytes.
        places: Where the values start; all of them end within the buffer.
        dtype: Of a value.
    """
    if not len(places):
        return np.zeros(0, dtype=dtype)
    # Cells of a value's size from every byte on: they overlap, only the requested ones are copied.
    size = dtype.itemsize
    cells: NDArray[Any] = np.ndarray(len(buffer) - size + 1, bytes_type(size), buffer, 0, (1,))
    values: NDArray[Any] = cells[places].view(dtype)
    return values


@functools.lru_cache(maxsize=256)
def bytes_type(size: int) -> np.dtype[np.void]:
    """Return the type of `size` bytes."""
    return np.dtype(f"V{size}")


def are_same(values: NDArray[Any]) -> bool:
    """Return whether all values (N,) have the same bytes; N is at least 1."""
    content = values.tobytes()
    return content == content[: values.itemsize] * len(values)
