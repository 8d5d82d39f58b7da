"""Thinning of lines for plots without a visible difference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS

MOST_POINTS = 20_000


def thinned(
    columns: Floats, stamps: NDArray[np.int64], max_gap_s: float, most: int = MOST_POINTS
) -> Floats:
    """Return rows (M, K) that look the same as the N rows when drawn as lines.

    The rows are divided into intervals of equal size. The rows with the least and the largest
    value of a column in an interval are kept. A row of NaN interrupts the line where a time step
    exceeds the gap and five median steps (steps between keyframes are long without being gaps).

    Args:
        columns: (N, K).
        stamps: (N,), nanoseconds, in order.
        max_gap_s: Longest step that is no gap, seconds.
        most: Approximate number of rows above which they are thinned.
    """
    count, width = columns.shape
    rows = np.arange(count)
    if count > most:
        runs = most // (2 * width)
        size = -(-count // runs)
        padded = np.pad(columns, ((0, size * runs - count), (0, 0)), mode="edge")
        by_run = padded.reshape(runs, size, width)
        extremes = np.stack([by_run.argmin(axis=1), by_run.argmax(axis=1)], axis=2)
        in_all = extremes + (size * np.arange(runs))[:, None, None]
        rows = np.concatenate([[0], in_all.ravel(), [count - 1]])
    steps = np.diff(stamps)
    usual = float(np.median(steps)) if len(steps) else 0.0
    before = np.flatnonzero(steps > max(max_gap_s * NANOSECONDS, 5.0 * usual))
    rows = np.unique(np.minimum(np.concatenate([rows, before, before + 1]), count - 1))
    return np.insert(columns[rows], np.searchsorted(rows, before + 1), np.nan, axis=0)
