"""The latest rows of a source, in order of time, windows over them, and pairs of sources."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.interpolation import columns_at
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.watchdog.signals import Signals

# First columns of all rows: seconds since the watch started, and time of the first row after the
# latest gap.
TIME, SINCE = 0, 1
# Further columns of a state: position, quaternion xyzw, and velocity in the body frame, NaN if the
# message has none.
POSITION, QUATERNION, VELOCITY = slice(2, 5), slice(5, 9), slice(9, 12)
POSE_WIDTH, STATE_WIDTH = 9, 12
# Sources wait for each other for at most this time, s. Older data before arming is not used.
REMEMBERED_S = 600.0
# No window contains a longer gap, s.
GAP_S = 2.0
# Half a nanosecond: tolerance with which comparisons of seconds equal those of nanoseconds.
HALF_NS = 0.5 / NANOSECONDS
_FEWEST = 1024


class RowBuffer:
    """Rows of numbers in order of time; the oldest ones can be removed.

    Adding a row takes constant time on average.
    """

    def __init__(self, width: int) -> None:
        """Create it for rows of `width` numbers."""
        self._store = np.empty((_FEWEST, width))
        self._begin = self._end = 0

    @property
    def rows(self) -> Floats:
        """All rows, (N, width); a view that is valid until the next `append`."""
        return self._store[self._begin : self._end]

    def append(self, rows: Floats) -> None:
        """Add rows (N, width), later than the existing ones."""
        if self._end + len(rows) > len(self._store):
            kept = self.rows
            self._store = np.empty((2 * (len(kept) + len(rows)) + _FEWEST, kept.shape[1]))
            self._store[: len(kept)] = kept
            self._begin, self._end = 0, len(kept)
        self._store[self._end : self._end + len(rows)] = rows
        self._end += len(rows)

    def remember(self, rows: Floats) -> None:
        """Add rows (N, width), N > 0, and remove those that no source waits for any longer."""
        self.append(rows)
        self.forget(rows[-1, TIME] - REMEMBERED_S)

    def forget(self, before: float) -> None:
        """Remove the rows before a time, s."""
        self._begin += int(np.searchsorted(self.rows[:, TIME], before))

    def forget_until(self, time: float) -> None:
        """Remove the rows before a time, s, except the last of them, for interpolation."""
        latest = int(np.searchsorted(self.rows[:, TIME], time, side="right")) - 1
        self._begin += max(latest, 0)


class Comparison:
    """Compares states with another source; both may arrive in any order."""

    def __init__(self, width: int) -> None:
        """Create it for rows of `width` numbers of the other source."""
        self.notices: list[str] = []  # findings at the start, one sentence each
        self.usable = True  # whether the source can be compared
        self._states, self._other = RowBuffer(POSE_WIDTH), RowBuffer(width)

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 9 or more); return the signals at states that the source covers."""
        if not self.usable:
            return {}
        self._states.remember(rows[:, :POSE_WIDTH])
        return self._advance()

    def add_other(self, rows: Floats) -> Signals:
        """Add rows of the other source; return the signals at states that it covers."""
        if not self.usable:
            return {}
        self._other.remember(rows)
        return self._advance()

    def _advance(self) -> Signals:
        raise NotImplementedError

    def _refuse(self, why: str) -> bool:
        """Give up the comparison with a notice; return False."""
        self.usable = False
        self.notices.append(why)
        return False


class OrderedFeed:
    """Adds the two columns of time to one source, and drops rows that are out of order."""

    def __init__(self) -> None:
        self.last = -np.inf  # time of the latest row, s
        self.out_of_order = 0  # number of rows dropped, because their times did not increase
        self._since = -np.inf

    def rows(self, seconds: Floats, *columns: Floats) -> Floats:
        """Return rows (M, 2 + width), M <= N, of times (N,), s, and columns (N, k)."""
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
    """Return the starts of the windows of `window_s` that end at the rows from `first` on.

    Returns:
        Indices (N - first,) of the first row in the window, and whether the window is valid: it
        has no gap and does not start before the first row.
    """
    asked = rows[first:]
    starts_ns = asked[:, TIME] - window_s - HALF_NS
    begins = np.searchsorted(rows[:, TIME], starts_ns)
    known = (starts_ns + 2.0 * HALF_NS >= asked[:, SINCE]) & (
        starts_ns + 2.0 * HALF_NS >= rows[0, TIME] if len(rows) else False
    )
    return begins, known


def change_within(rows: Floats, first: int, window_s: float, columns: slice) -> Floats:
    """Return the change of columns over the windows of `window_begins`, (N - first, k).

    Values at the start of a window are interpolated linearly. Windows that are not valid have a
    change, too; mask them.
    """
    asked = rows[first:]
    begin = columns_at(rows[:, TIME], rows[:, columns], asked[:, TIME] - window_s)
    change: Floats = asked[:, columns] - begin
    return change


def only(values: Floats, known: Booleans) -> Floats:
    """Return the values with NaN where they are not known."""
    return np.where(known, values, np.nan)
