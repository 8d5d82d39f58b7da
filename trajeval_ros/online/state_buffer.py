"""The states of a stream that are still needed, its counts, and the limits of its memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.valid_poses import LARGEST, add_counts, count_up
from trajeval_ros.online.state_rows import POSITION, QUATERNION, VELOCITY, WIDTH, as_wide

NEVER = int(np.iinfo(np.int64).min)


class StateBuffer:
    """States with distinct timestamps in order, in rows as wide as the widest so far."""

    def __init__(self, width: int = WIDTH) -> None:
        self.stamps: Stamps = np.empty(256, dtype=np.int64)
        self.rows: Floats = np.empty((256, width))
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
        if self.end + count <= len(self.stamps) and width <= self.rows.shape[1]:
            return
        stamps, rows = self.held
        size = max(len(self.stamps), 2 * (len(stamps) + count))
        width = max(width, self.rows.shape[1])
        self.stamps, self.rows = np.empty(size, np.int64), np.empty((size, width))
        self.begin, self.end = 0, len(stamps)
        self.stamps[: self.end], self.rows[: self.end] = stamps, as_wide(rows, width)


def usable_rows(rows: Floats) -> tuple[Booleans, dict[str, int]]:
    """Return which states (N, k) are usable, (N,), and the number of the others by reason."""
    # `states` sets all four columns to infinity.
    no_length = rows[:, QUATERNION.start] == np.inf
    finite = np.isfinite(rows[:, POSITION]).all(axis=1)
    usable = finite & ~no_length
    dropped: dict[str, int] = {}
    if not usable.all():
        count_up(dropped, "not_finite", int(np.count_nonzero(~finite)))
        count_up(dropped, "zero_quaternion", int(np.count_nonzero(finite & no_length)))
    return usable, dropped


@dataclass
class StateCounts:
    """Counts of the poses of one side."""

    poses: int = 0  # number of poses, repeated timestamps included
    first: int | None = None  # the earliest timestamp, nanoseconds; None before the first pose
    last: int | None = None  # the latest timestamp, nanoseconds
    dropped: dict[str, int] = field(default_factory=dict)  # number of unusable states by reason

    def take(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats]:
        """Count states (N,), (N, k), and return the valid ones, by the same rules as the readers.

        An invalid velocity is replaced by NaN.
        """
        wild = np.abs(rows[:, VELOCITY]) > LARGEST
        if wild.any():
            rows = rows.copy()
            rows[wild.any(axis=1), VELOCITY] = np.nan
        keep, dropped = usable_rows(rows)
        if dropped:
            self.dropped = add_counts(self.dropped, dropped)
            stamps, rows = stamps[keep], rows[keep]
        self.count(stamps)
        return stamps, rows

    def count(self, stamps: Stamps) -> None:
        """Count usable poses with timestamps (N,), nanoseconds."""
        if len(stamps):
            self.poses += len(stamps)
            earliest, latest = int(stamps.min()), int(stamps.max())
            self.first = earliest if self.first is None else min(self.first, earliest)
            self.last = latest if self.last is None else max(self.last, latest)

    def take_back(self, poses: int, last: int) -> None:
        """Subtract poses from the count, after which `last` is the latest timestamp."""
        self.poses -= poses
        if poses:
            self.first, self.last = (self.first, last) if self.poses else (None, None)

    def drop(self, reason: str, count: int) -> None:
        """Count unusable states."""
        count_up(self.dropped, reason, count)

    @property
    def duration_s(self) -> float:
        """Time from the earliest to the latest stamp, seconds."""
        if self.first is None or self.last is None:
            return 0.0
        return (self.last - self.first) / NANOSECONDS


@dataclass(frozen=True)
class BufferLimits:
    """Limits of a pairing's memory; beyond them the oldest states are dropped and counted.

    A state takes 88 bytes, 376 with a covariance. 500 000 states per side take 88 MB, or 232 MB,
    and up to twice that while the arrays grow.
    """

    # Time before the newest state of the interpolated side that is kept for late states of the
    # other side, seconds; infinite for a limit by `past_states` only.
    past_s: float = 10.0
    past_states: int = 500_000  # number of kept states of the interpolated side
    waiting_states: int = 500_000  # number of waiting states of the other side

    def horizon(self, newest: int) -> int:
        """Return the timestamp from which on states are kept, nanoseconds."""
        if math.isinf(self.past_s):
            return NEVER
        return newest - round(self.past_s * NANOSECONDS)
