"""Columns thinned for drawing as lines, with nothing lost to the eye."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS

MOST_POINTS = 20_000


def thinned(
    columns: Floats, stamps: NDArray[np.int64], max_gap_s: float, most: int = MOST_POINTS
) -> Floats:
    """Return rows (M, K) to draw as a line instead of N rows: few, with nothing lost to the eye.

    Of each of many equal runs of rows, those with the least and largest value of each column are
    kept, so that no peak is lost. A row of NaN breaks the line where time jumps by more than
    the gap and more than five usual steps (keyframes are far apart without being a gap).

    Args:
        columns: (N, K).
        stamps: (N,), nanoseconds, in order.
        max_gap_s: Seconds.
        most: About how many rows are few.
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
