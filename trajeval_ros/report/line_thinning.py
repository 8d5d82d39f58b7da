"""Thinning of lines for plots without a visible difference."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps

MOST_POINTS = 20_000
# Returns which time steps (N,), nanoseconds, interrupt a line.
IsGap: TypeAlias = Callable[[Stamps], Booleans]


def thinned(columns: Floats, stamps: Stamps, is_gap: IsGap, most: int = MOST_POINTS) -> Floats:
    """Return rows (M, K) that look the same as the N rows when drawn as lines.

    The rows are divided into intervals of equal size. The rows with the least and the largest
    value of a column in an interval are kept. A row of NaN interrupts the line in gaps that
    exceed five median steps (steps between keyframes are long without being gaps). `columns`:
    (N, K). `stamps`: (N,), nanoseconds, in order.
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
    return _interrupted(columns, rows, _gaps(stamps, is_gap))


def simplified(path: Floats, stamps: Stamps, is_gap: IsGap, tolerance_m: float) -> Floats:
    """Return rows (M, K) of a path (N, K) that stay within a tolerance of it, seen from above.

    As `thinned`, but a vertex is left out if the path is within the tolerance of the line that
    remains (Ramer, Douglas and Peucker). `tolerance_m`: in the first two columns, metres; it is
    doubled until at most `MOST_POINTS` rows remain.
    """
    gaps = _gaps(stamps, is_gap)
    pieces = np.split(path[:, :2], gaps + 1)
    starts = np.concatenate([[0], gaps + 1])
    while True:
        kept = np.concatenate(
            [
                start + simplified_rows(piece, tolerance_m)
                for start, piece in zip(starts, pieces, strict=True)
            ]
        )
        if len(kept) <= max(MOST_POINTS, 2 * len(pieces)):
            return _interrupted(path, kept, gaps)
        tolerance_m = 2.0 * max(tolerance_m, np.finfo(float).eps)


def simplified_rows(line: Floats, tolerance: float) -> NDArray[np.intp]:
    """Return the rows (M,) of a line (N, 2) that are enough to stay within a tolerance of it.

    All segments of one depth of the recursion are split at once at their farthest row.
    """
    kept = np.unique([0, len(line) - 1])
    while len(kept) > 1:
        starts, lengths = line[kept[:-1]], np.diff(kept)
        along = line[kept[1:]] - starts
        segment = np.repeat(np.arange(len(lengths)), lengths)
        rows = np.arange(kept[0], kept[-1])
        offsets = line[rows] - starts[segment]
        share = (offsets * along[segment]).sum(axis=1)
        share /= np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)[segment]
        offsets -= np.clip(share, 0.0, 1.0)[:, None] * along[segment]
        distance = np.hypot(*offsets.T)
        farthest = np.maximum.reduceat(distance, kept[:-1] - kept[0])
        is_farthest = (distance == farthest[segment]) & (distance > tolerance)
        _, first = np.unique(segment[is_farthest], return_index=True)
        if not len(first):
            break
        kept = np.sort(np.concatenate([kept, rows[is_farthest][first]]))
    return kept


def _gaps(stamps: Stamps, is_gap: IsGap) -> NDArray[np.intp]:
    """Return the rows before gaps."""
    steps = np.diff(stamps)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return np.flatnonzero(is_gap(steps) & (steps > 5.0 * usual))


def _interrupted(columns: Floats, rows: NDArray[np.intp], gaps: NDArray[np.intp]) -> Floats:
    """Return rows of columns with a row of NaN after each of the rows before gaps."""
    rows = np.unique(np.minimum(np.concatenate([rows, gaps, gaps + 1]), len(columns) - 1))
    return np.insert(columns[rows], np.searchsorted(rows, gaps + 1), np.nan, axis=0)
