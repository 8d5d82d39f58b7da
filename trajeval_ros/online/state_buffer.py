"""The states of a stream that are still needed, its counts, and the limits of its memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import Z_UP
from trajeval_ros.geometry.valid_poses import count_up
from trajeval_ros.metrics.coverage import ALL_ROWS, POSE, StampedPoses

NEVER = int(np.iinfo(np.int64).min)  # before all timestamps
_STATE = ("positions", "quaternions", "velocities", "covariances")  # columns of a trajectory
_FEWEST_ROWS = 1024  # of the arrays, so that a short stream is copied a few times only
_NONE = np.empty(0, dtype=np.int64)
NO_STATES = Trajectory(
    _NONE, np.empty((0, 3)), reading=SourceInfo(receive_times=ReceiveTimes(_NONE))
)


class Tail:
    """The newest states of a stream, in order of time and with distinct timestamps.

    Each column is one contiguous array, because `take` copies strided ones. The arrays grow by
    doubling. Rows that are dropped are freed when the arrays are copied. Rows count from the
    oldest one that is stored.
    """

    def __init__(self) -> None:
        self.dropped = 0  # number of the states that were dropped
        self.up = Z_UP  # up axis of the newest block's frame
        self._columns: dict[str, NDArray[Any]] = {"stamps": np.empty(0, dtype=np.int64)}
        self._incomplete: set[str] = set()  # columns that some of the blocks did not have
        self._begin = self._end = 0

    def __len__(self) -> int:
        """Return the number of stored states."""
        return self._end - self._begin

    @property
    def stamps(self) -> Stamps:
        """The timestamps (N,), nanoseconds: a view."""
        return self._columns["stamps"][self._begin : self._end]

    @property
    def newest(self) -> int:
        """The newest timestamp, nanoseconds; `NEVER` without states."""
        return int(self._columns["stamps"][self._end - 1]) if self._end > self._begin else NEVER

    def column(self, name: str) -> NDArray[Any]:
        """Return a column, which some block must have had: a view of N rows."""
        return self._columns[name][self._begin : self._end]

    def trajectory(self, rows: slice | Indices = ALL_ROWS) -> Trajectory:
        """Return some states, with the columns that all of them have.

        A slice gives views, which are valid until the next `add`. Indices give copies.
        """
        columns: dict[str, Any] = {}
        for name in _STATE:
            if name in self._columns:
                part = self.column(name)[rows]
                is_known = name not in self._incomplete or (
                    part.any() if name == "covariances" else not np.isnan(part).any()
                )
                columns[name] = part if is_known else None
        if not columns:
            columns["positions"] = np.empty((0, 3))
        return Trajectory(self.stamps[rows], up=self.up, **columns)

    def poses(self, rows: slice | Indices = ALL_ROWS) -> StampedPoses:
        """Return copies of the poses of some states."""
        stamps = self.stamps[rows]
        poses = np.full((len(stamps), POSE.stop), np.nan)
        if len(stamps):
            poses[:, :3] = self.column("positions")[rows]
            if "quaternions" in self._columns:
                poses[:, 3:] = self.column("quaternions")[rows]
        return StampedPoses(stamps.copy(), poses)

    def add(self, block: Trajectory, **more: NDArray[Any]) -> tuple[int, int]:
        """Add states in any order, with more columns by name; see `add_columns`."""
        self.up = block.up
        known = {name: value for name in _STATE if (value := getattr(block, name)) is not None}
        return self.add_columns(block.stamps, **known, **more)

    def add_columns(self, stamps: Stamps, **given: NDArray[Any]) -> tuple[int, int]:
        """Add N rows in any order; of equal timestamps, the first that arrived is kept.

        Returns:
            The first row behind which rows are new, and the number of new rows.
        """
        row, count = len(self), len(stamps)
        if not count:
            return row, 0
        given = self._completed({"stamps": stamps, **given})
        if not (stamps[0] > self.newest and (stamps[1:] > stamps[:-1]).all()):
            row = int(self.stamps.searchsorted(stamps.min()))
            both = np.concatenate([self.stamps[row:], stamps])
            order = np.unique(both, return_index=True)[1]
            count = len(order) - (len(self) - row)
            given = {
                name: np.concatenate([self.column(name)[row:], column])[order]
                for name, column in given.items()
            }
            self.cut(row)
        self._append(given)
        return row, count

    def drop_before(self, row: int) -> None:
        """Drop the oldest states."""
        self._begin += row
        self.dropped += row

    def cut(self, row: int) -> None:
        """Remove the states from a row on."""
        self._end = self._begin + row

    def _completed(self, given: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return N rows with all columns; unknown covariances are zeros, other values NaN."""
        count = len(given["stamps"])
        if given.keys() != self._columns.keys():
            for name in given.keys() - self._columns.keys():
                size = (len(self._columns["stamps"]), *given[name].shape[1:])
                self._columns[name] = _unknown(name, size, given[name].dtype)
                if len(self):
                    self._incomplete.add(name)
            for name in self._columns.keys() - given.keys():
                column = self._columns[name]
                given[name] = _unknown(name, (count, *column.shape[1:]), column.dtype)
                self._incomplete.add(name)
        return {name: given[name] for name in self._columns}

    def _append(self, given: dict[str, NDArray[Any]]) -> None:
        count = len(given["stamps"])
        if self._end + count > len(self._columns["stamps"]):
            size = max(_FEWEST_ROWS, 2 * (len(self) + count))
            for name, column in self._columns.items():
                larger = np.empty((size, *column.shape[1:]), column.dtype)
                larger[: len(self)] = column[self._begin : self._end]
                self._columns[name] = larger
            self._begin, self._end = 0, len(self)
        for name, column in given.items():
            self._columns[name][self._end : self._end + count] = column
        self._end += count


def joined(before: Trajectory, after: Trajectory) -> Trajectory:
    """Return states in order of arrival followed by others, with what both have."""

    def column(of: Any, other: Any, name: str) -> Any:
        pair = getattr(of, name), getattr(other, name)
        return None if any(part is None for part in pair) else np.concatenate(pair)

    received, others = before.reading.receive_times, after.reading.receive_times
    receive_times = None
    if received is not None and others is not None:
        names = ("times", "body_rates", "corrected")
        columns = {name: column(received, others, name) for name in names}
        receive_times = replace(others, **columns)
    columns = {name: column(before, after, name) for name in ("stamps", *_STATE)}
    return replace(after, **columns, reading=SourceInfo(receive_times=receive_times))


def _unknown(name: str, shape: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
    return np.full(shape, 0.0 if name == "covariances" else np.nan, kind)


@dataclass
class StateCounts:
    """Counts of the poses of one side."""

    poses: int = 0  # number of poses, repeated timestamps included
    first: int | None = None  # the earliest timestamp, nanoseconds; None before the first pose
    last: int | None = None  # the latest timestamp, nanoseconds
    dropped: dict[str, int] = field(default_factory=dict)  # number of unusable states by reason

    def count(self, stamps: Stamps) -> None:
        """Count usable poses with timestamps (N,), nanoseconds."""
        if len(stamps):
            self.poses += len(stamps)
            earliest, latest = int(stamps.min()), int(stamps.max())
            self.first = earliest if self.first is None else min(self.first, earliest)
            self.last = latest if self.last is None else max(self.last, latest)

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
