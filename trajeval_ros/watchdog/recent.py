"""Rows that a watchdog still needs: one source's latest states, in order of time."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS

# Columns of every row: seconds since the watch began, and since when there was no gap.
TIME, SINCE = 0, 1
# Columns of a state behind them: position, quaternion xyzw, and the twist in the body, NaN where
# the message has none.
POSITION, QUATERNION, VELOCITY, RATE = slice(2, 5), slice(5, 9), slice(9, 12), slice(12, 15)
POSE_WIDTH, STATE_WIDTH = 9, 15
# Sources wait for each other for at most this time, s. Older data before arming is not used.
REMEMBERED_S = 600.0
# Longer silences, s, end all windows: nothing is compared across them.
GAP_S = 2.0
# Half a nanosecond, so that comparisons of seconds decide as those of whole nanoseconds do.
HALF_NS = 0.5 / NANOSECONDS
_FEWEST = 1024


class Recent:
    """Rows of numbers in order of time, of which the oldest may be forgotten.

    A row is added in constant time on average, whatever is kept.
    """

    def __init__(self, width: int) -> None:
        """Create it without rows of that many numbers each."""
        self._store = np.empty((_FEWEST, width))
        self._begin = self._end = 0

    @property
    def rows(self) -> Floats:
        """All rows that are kept, (N, width); a view that the next `append` ends."""
        return self._store[self._begin : self._end]

    def append(self, rows: Floats) -> None:
        """Add rows (N, width), later than those before."""
        if self._end + len(rows) > len(self._store):
            kept = self.rows
            self._store = np.empty((2 * (len(kept) + len(rows)) + _FEWEST, kept.shape[1]))
            self._store[: len(kept)] = kept
            self._begin, self._end = 0, len(kept)
        self._store[self._end : self._end + len(rows)] = rows
        self._end += len(rows)

    def forget(self, before: float) -> None:
        """Forget the rows before a time, s."""
        self._begin += int(np.searchsorted(self.rows[:, TIME], before))

    def forget_until(self, time: float) -> None:
        """Forget the rows before the latest one that is not after a time, s."""
        latest = int(np.searchsorted(self.rows[:, TIME], time, side="right")) - 1
        self._begin += max(latest, 0)


class Feed:
    """Adds the two columns of time to one source, and drops rows that are out of order.

    Attributes:
        last: Time of the latest row, s.
        out_of_order: Number of rows dropped, since they were not later than those before.
    """

    def __init__(self) -> None:
        """Create it before the first row."""
        self.last = -np.inf
        self.out_of_order = 0
        self._since = -np.inf

    def rows(self, seconds: Floats, *columns: Floats) -> Floats:
        """Return the rows (M, 2 + width) of columns (N, ...), M <= N."""
        latest = np.maximum.accumulate(np.concatenate([[self.last], seconds]))
        kept = seconds > latest[:-1]
        self.out_of_order += int(np.count_nonzero(~kept))
        times = seconds[kept]
        if not len(times):
            return np.empty((0, 2 + sum(column.shape[1] for column in columns)))
        begins = np.diff(times, prepend=self.last) > GAP_S
        since = np.maximum.accumulate(np.where(begins, times, self._since))
        self.last, self._since = float(times[-1]), float(since[-1])
        return np.column_stack([times, since, *(column[kept] for column in columns)])


def window_begins(rows: Floats, first: int, window_s: float) -> tuple[Indices, Booleans]:
    """Return where windows begin that end at each of the rows from `first` on.

    Args:
        rows: (N, ...), the first two columns as above.
        first: Index of the first row asked about.
        window_s: Length of the windows.

    Returns:
        For each of the N - first rows the first row within its window, and whether the window
        lies within the recording, without a gap.
    """
    asked = rows[first:]
    wanted = asked[:, TIME] - window_s - HALF_NS
    begins = np.searchsorted(rows[:, TIME], wanted)
    known = (wanted + 2.0 * HALF_NS >= asked[:, SINCE]) & (
        wanted + 2.0 * HALF_NS >= rows[0, TIME] if len(rows) else False
    )
    return begins, known


def change_within(rows: Floats, first: int, window_s: float, columns: slice) -> Floats:
    """Return how columns (N, k) changed within windows that end at the rows from `first` on.

    Between rows they are linear; see `window_begins` for which windows are known.
    """
    asked = rows[first:]
    begin = interpolated(rows[:, TIME], rows[:, columns], asked[:, TIME] - window_s)
    change: Floats = asked[:, columns] - begin
    return change


def only(values: Floats, known: Booleans) -> Floats:
    """Return the values where they are known, and NaN elsewhere."""
    return np.where(known, values, np.nan)


def lengths(vectors: Floats) -> Floats:
    """Return the lengths (N,) of vectors (N, 3)."""
    found: Floats = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
    return found


def interpolated(times: Floats, values: Floats, at: Floats) -> Floats:
    """Return columns (N, k) at other times (M,), linearly, (M, k)."""
    return np.stack([np.interp(at, times, column) for column in values.T], axis=-1)
