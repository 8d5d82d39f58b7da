"""States between the states of a trajectory: linear interpolation, orientations by slerp.

All interpolation of poses in the package, live and recorded, has this arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices


@dataclass(frozen=True, eq=False)
class Bracket:
    """The position of N timestamps between the timestamps of a sorted trajectory."""

    start: Indices  # (N,) index of the state at or before the timestamp
    end: Indices  # (N,) index of the state after it; equal to `start` if they coincide
    fraction: Floats  # (N,) position between the two states, in [0, 1]
    early: Booleans  # (N,) whether the timestamp is before all states
    late: Booleans  # (N,) whether it is after all states
    gap: Booleans  # (N,) whether it is in a gap

    @cached_property
    def usable(self) -> Booleans:
        """Whether the trajectory has a state at the timestamp, or one on both sides, (N,)."""
        usable: Booleans = ~(self.early | self.late | self.gap)
        return usable

    @property
    def is_between(self) -> bool:
        """Whether a usable timestamp is between two states."""
        return bool((self.usable & (self.start != self.end)).any())

    @staticmethod
    def reasons(side: str) -> tuple[str, str, str]:
        """Return the reasons why timestamps are not usable, in the order early, late, gap."""
        return f"before_{side}", f"after_{side}", f"in_{side}_gap"

    def dropped(self, side: str) -> dict[str, int]:
        """Return how many timestamps are not usable, by reason."""
        counts = (int(np.count_nonzero(mask)) for mask in (self.early, self.late, self.gap))
        return dict(zip(self.reasons(side), counts, strict=True))


def bracket_stamps(times: Indices, stamps: Indices, max_gap_s: float) -> Bracket:
    """Return where stamps (N,) are between sorted, distinct times (M,), M > 0, nanoseconds."""
    max_gap = round(max_gap_s * 1e9)

    def at(stamps: Indices) -> tuple[NDArray[Any], ...]:
        end = np.minimum(times.searchsorted(stamps), len(times) - 1)
        at_end = times[end]
        # A timestamp that coincides with a state uses that state alone, also the first one.
        start = np.where(at_end == stamps, end, np.maximum(end - 1, 0))
        at_start = times[start]
        step = at_end - at_start
        early, late = stamps < times[0], stamps > times[-1]
        gap = (step > max_gap) & ~late
        fraction = np.where(early | late, 0.0, (stamps - at_start) / np.maximum(step, 1))
        return start, end, fraction, early, late, gap

    return Bracket(*lie.by_blocks(at, stamps))


def steps_at(times: Floats, at: Floats) -> tuple[Indices, Floats]:
    """Return the state (N,) before times `at`, and the position (N,) in the step that follows it.

    The last state starts no step. Outside of the states, the position is negative or above 1.
    `times`: (M,) seconds, increasing, M > 1. `at`: (N,) seconds.
    """
    before = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    start = times[before]
    return before, (at - start) / (times[before + 1] - start)


def mix(column: Floats, start: Indices, end: Indices, fraction: Floats) -> Floats:
    """Return a column (M, k) linearly interpolated between rows `start` and `end`, (N, k)."""

    def at(start: Indices, end: Indices, fraction: Floats) -> tuple[Floats]:
        first = column.take(start, axis=0)
        return (first + fraction[:, None] * (column.take(end, axis=0) - first),)

    return lie.by_blocks(at, start, end, fraction)[0]


def columns_at(times: Floats, columns: Floats, at: Floats) -> Floats:
    """Interpolate columns (N, k) linearly at increasing times (N,) to other times (M,): (M, k).

    Before the first time and after the last one, columns are constant.
    """
    return np.stack([np.interp(at, times, item) for item in columns.T], axis=1)


def slerp(quaternions: Floats, start: Indices, end: Indices, fraction: Floats) -> Floats:
    """Return quaternions (M, 4) interpolated between rows `start` and `end`, (N, 4)."""

    def at(start: Indices, end: Indices, fraction: Floats) -> tuple[Floats]:
        first, last = quaternions.take(start, axis=0), quaternions.take(end, axis=0)
        return (lie.normalized(lie.slerp(first, last, fraction)),)

    return lie.by_blocks(at, start, end, fraction)[0]


def slerp_at(times: Floats, quaternions: Floats, at: Floats) -> Floats:
    """Interpolate orientations (N, 4) at increasing times (N,) to other times (M,): (M, 4)."""
    start, fraction = steps_at(times, at)
    return slerp(quaternions, start, start + 1, np.clip(fraction, 0.0, 1.0))
