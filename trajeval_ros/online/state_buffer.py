"""Buffer of the states of a stream that are still needed, in order of time."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.online.state_rows import WIDTH, as_wide

NEVER = int(np.iinfo(np.int64).min)


class StateBuffer:
    """States with distinct timestamps in order, in rows as wide as the widest so far."""

    def __init__(self) -> None:
        """Create it empty."""
        self.stamps: Stamps = np.empty(256, dtype=np.int64)
        self.rows: Floats = np.empty((256, WIDTH))
        self.begin = self.end = 0

    def __len__(self) -> int:
        """Return the number of stored states."""
        return self.end - self.begin

    @property
    def held(self) -> tuple[Stamps, Floats]:
        """The stored states: views of stamps (N,) and rows (N, 10) or (N, 46)."""
        return self.stamps[self.begin : self.end], self.rows[self.begin : self.end]

    @property
    def newest(self) -> int:
        """The newest timestamp, nanoseconds; `NEVER` if the buffer is empty."""
        return int(self.stamps[self.end - 1]) if self.end > self.begin else NEVER

    def append(self, stamps: Stamps, rows: Floats) -> None:
        """Add states in order of time that are newer than all stored ones."""
        self._make_room(len(stamps), rows.shape[1])
        self.stamps[self.end : self.end + len(stamps)] = stamps
        self.rows[self.end : self.end + len(stamps)] = as_wide(rows, self.rows.shape[1])
        self.end += len(stamps)

    def merge(self, stamps: Stamps, rows: Floats) -> int:
        """Add states in any order; returns the number of repeated timestamps."""
        self._make_room(0, rows.shape[1])
        held_stamps, held_rows = self.held
        rows = as_wide(rows, held_rows.shape[1])
        # Stored states come first, so that of equal timestamps the first that arrived is kept.
        all_stamps = np.concatenate([held_stamps, stamps])
        unique, first = np.unique(all_stamps, return_index=True)
        all_rows = np.concatenate([held_rows, rows])[first]
        self.begin = self.end = 0
        self.append(unique, all_rows)
        return len(all_stamps) - len(unique)

    def drop(self, count: int) -> None:
        """Drop the oldest states."""
        self.begin += count

    def _make_room(self, count: int, width: int) -> None:
        """Enlarge the arrays for `count` more states of `width` columns, if necessary."""
        if self.end + count <= len(self.stamps) and width <= self.rows.shape[1]:
            return
        stamps, rows = self.held
        size = max(len(self.stamps), 2 * (len(stamps) + count))
        width = max(width, self.rows.shape[1])
        self.stamps, self.rows = np.empty(size, np.int64), np.empty((size, width))
        self.begin, self.end = 0, len(stamps)
        self.stamps[: self.end], self.rows[: self.end] = stamps, as_wide(rows, width)
