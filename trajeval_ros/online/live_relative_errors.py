"""Live relative errors: a sub-trajectory is measured when its end has arrived."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.absolute_errors import lengths
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.relative_errors import PoseArrays, differences_at_ends
from trajeval_ros.metrics.relative_evaluation import position_percent
from trajeval_ros.metrics.sub_trajectories import Length, nearest_ends
from trajeval_ros.online.state_rows import POSITION, QUATERNION
from trajeval_ros.online.window import PairStore

# Units of lengths that are measured live.
LIVE_UNITS = ("m", "s", "f")
# A robot at rest completes no sub-trajectory; older starts are given up to bound the memory.
MOST_OPEN_STARTS = 200_000


class RelativeEnd(NamedTuple):
    """The end of a sub-trajectory."""

    length: str  # the length as configured, such as 8m
    stamp: int  # timestamp of its last state, nanoseconds
    position_m: float  # position error at its end
    rotation_deg: float  # rotation error at its end
    # Position error in percent of the length, the largest among those of this length that ended in
    # the same update; None if the length is a duration.
    drift_percent: float | None


@dataclass(frozen=True)
class RunningErrors:
    """Mean errors of the sub-trajectories of one length so far."""

    count: int = 0  # number of sub-trajectories
    position_m: float = 0.0  # mean of their position errors
    rotation_deg: float = 0.0  # mean of their rotation errors
    given_up: int = 0  # number of starts that were given up before their ends arrived


class RelativeTracker:
    """Finds the ends of sub-trajectories of several lengths; every pair is used once."""

    def __init__(self, protocol: Protocol) -> None:
        self._protocol = protocol
        # One entry per length, grouped by unit.
        chosen: list[Length] = []
        self._by_unit: dict[str, slice] = {}
        for unit in LIVE_UNITS:
            begin = len(chosen)
            chosen += [length for length in dict.fromkeys(protocol.lengths) if length.unit == unit]
            self._by_unit[unit] = slice(begin, len(chosen))
        total = len(chosen)
        self._names = [str(length) for length in chosen]
        units = np.array([NANOSECONDS if length.unit == "s" else 1 for length in chosen])
        self._values = np.array([length.value for length in chosen]) * units
        self._next, self._given_up, self._count = np.zeros((3, total), dtype=np.int64)
        self._position_sum, self._rotation_sum = np.zeros((2, total))

    @property
    def running(self) -> dict[str, RunningErrors]:
        """Errors so far by length."""
        counted = np.maximum(self._count, 1)
        position_m, rotation_deg = self._position_sum / counted, self._rotation_sum / counted
        columns = (self._count, position_m, rotation_deg, self._given_up)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return {name: RunningErrors(*row) for name, row in zip(self._names, rows, strict=True)}

    def with_lengths(self, protocol: Protocol, begin: int) -> RelativeTracker:
        """Return a tracker of other lengths; new ones start at the pair of number `begin`."""
        tracker = RelativeTracker(protocol)
        tracker._next[:] = begin
        for new, name in enumerate(tracker._names):
            if name in self._names:
                old = self._names.index(name)
                for mine, yours in zip(tracker._columns, self._columns, strict=True):
                    mine[new] = yours[old]
        return tracker

    @property
    def _columns(self) -> tuple[NDArray[Any], ...]:
        return (self._next, self._given_up, self._count, self._position_sum, self._rotation_sum)

    def update(
        self, store: PairStore, scale: float, *, at_end: bool = False
    ) -> tuple[RelativeEnd, ...]:
        """Measure the sub-trajectories whose ends have arrived.

        `at_end`: no pair will follow, so that the last pair may be the nearest to the length.
        """
        return tuple(
            end for unit in LIVE_UNITS for end in self._measure(store, unit, scale, at_end)
        )

    def oldest_needed(self, store: PairStore) -> int:
        """Return the number of the oldest pair that can still start a sub-trajectory."""
        oldest = int(self._next.min(initial=store.end))
        limit = store.end - MOST_OPEN_STARTS
        if oldest < limit:
            self._given_up += np.maximum(limit - self._next, 0)
            np.maximum(self._next, limit, out=self._next)
        return max(oldest, limit)

    def _measure(
        self, store: PairStore, unit: str, scale: float, at_end: bool
    ) -> Iterator[RelativeEnd]:
        """Measure the sub-trajectories of the lengths in one unit; yield the newest per length."""
        group = self._by_unit[unit]
        names, values, begin = self._names[group], self._values[group], self._next[group]
        if not names:
            return
        first = int(begin.min())
        if first == store.end:
            return
        along = _along(store, first, unit)
        # An end is decided when a pair is at or beyond the length.
        decided = first + along.searchsorted(along[-1] - values, side="right")
        if at_end:
            decided[:] = store.end
        count = np.maximum(decided - begin, 0)
        if not count.any():
            return
        which = np.repeat(np.arange(len(names)), count)
        starts = np.arange(len(which)) + (begin - first - np.cumsum(count) + count)[which]
        self._next[group] += count
        ends, accepted = nearest_ends(along, starts, values[which])
        which, starts, ends = which[accepted], starts[accepted], ends[accepted]
        position_m, rotation_deg = self._errors(store, starts + first, ends + first, scale)
        count = np.bincount(which, minlength=len(names))
        self._count[group] += count
        self._position_sum[group] += np.bincount(which, position_m, len(names))
        self._rotation_sum[group] += np.bincount(which, rotation_deg, len(names))
        stamps = store.stamps(first)
        newest = np.cumsum(count) - 1
        for place, (ended, row) in enumerate(zip(count.tolist(), newest.tolist(), strict=True)):
            if not ended:
                continue
            drift = None
            if unit == "m":
                largest = position_m[row + 1 - ended : row + 1].max(keepdims=True)
                drift = float(position_percent(largest, float(values[place]))[0])
            errors = float(position_m[row]), float(rotation_deg[row]), drift
            yield RelativeEnd(names[place], int(stamps[ends[row]]), *errors)

    def _errors(
        self, store: PairStore, starts: Indices, ends: Indices, scale: float
    ) -> list[Floats]:
        """Return position errors, m, and rotation errors, deg, (K,) each, at the ends."""
        groundtruth, other = store.groundtruth(), store.estimate()

        def at_ends(s: Indices, e: Indices) -> tuple[Floats, Floats]:
            rows = np.array([s, e]) - store.begin
            difference, between, _ = differences_at_ends(
                _poses(groundtruth[rows]),
                _poses(other[rows]),
                self._protocol.gauge,
                scale,
                self._protocol.re_form,
            )
            return lengths(difference), np.degrees(lie.angle(between))

        return lie.by_blocks(at_ends, starts, ends)


def _poses(rows: Floats) -> PoseArrays:
    return PoseArrays(rows[..., POSITION], rows[..., QUATERNION])


def _along(store: PairStore, first: int, unit: str) -> Floats:
    """Return path (m), time (ns) or number of states up to the pairs from `first` on, (N,)."""
    if unit == "m":
        return store.along(first)
    stamps = store.stamps(first)
    if unit == "f":
        return np.arange(len(stamps), dtype=np.float64)
    since: Floats = (stamps - stamps[0]).astype(np.float64)
    return since
