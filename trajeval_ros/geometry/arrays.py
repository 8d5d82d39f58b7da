"""Type aliases of arrays, rows of columns, and runs of flags. Docstrings give shapes, units."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

_T = TypeVar("_T")
Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]  # nanoseconds
Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]


def at_rows(item: _T, names: Iterable[str], rows: Any, **changed: Any) -> _T:
    """Return a dataclass with some rows of its columns, those that it has, and changed values."""
    columns = {name: getattr(item, name) for name in names}
    changed |= {name: column[rows] for name, column in columns.items() if column is not None}
    if not changed:
        return item
    replaced: _T = dataclasses.replace(item, **changed)  # type: ignore[type-var]
    return replaced


def extents(points: Floats) -> Floats:
    """Return the difference of maximum and minimum of each column of points (N, k), (k,).

    By columns: along the first axis numpy is ten times slower.
    """
    return np.array([np.ptp(column) for column in points.T])


def lengths(vectors: Floats) -> Floats:
    """Return the lengths (...) of vectors (..., k)."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


def runs_of(flags: Booleans) -> Indices:
    """Return the begin and the end (excluded) of every run of true flags (N,), (K, 2)."""
    return np.flatnonzero(np.diff(np.pad(flags.astype(np.int8), 1))).reshape(-1, 2)
