"""Type aliases of arrays, and runs of flags. Docstrings give shapes and units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]  # nanoseconds
Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]


def extents(points: Floats) -> Floats:
    """Return the difference of maximum and minimum of each column of points (N, k), (k,).

    By columns: along the first axis numpy is ten times slower.
    """
    return np.array([np.ptp(column) for column in points.T])


def runs_of(flags: Booleans) -> Indices:
    """Return the begin and the end (excluded) of every run of true flags (N,), (K, 2)."""
    return np.flatnonzero(np.diff(np.pad(flags.astype(np.int8), 1))).reshape(-1, 2)
