"""States of a trajectory at other timestamps: linear interpolation, orientations by slerp."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory


def between(trajectory: Trajectory, stamps: Indices, bracket: Bracket) -> Trajectory:
    """Return the states of a trajectory at other timestamps: linear, orientations by slerp.

    Args:
        trajectory: M states in order of time.
        stamps: (N,), nanoseconds; only those with a usable bracket are evaluated.
        bracket: The position of every stamp between the states.
    """
    rows = np.flatnonzero(bracket.usable)
    start, end, fraction = bracket.start, bracket.end, bracket.fraction
    if len(rows) < len(stamps):
        start, end, fraction = start[rows], end[rows], fraction[rows]
        stamps = stamps[rows]
    quaternions = trajectory.quaternions
    positions = mix(trajectory.positions, start, end, fraction)
    assert positions is not None
    return dataclasses.replace(
        trajectory,
        stamps=stamps,
        positions=positions,
        quaternions=None if quaternions is None else _slerp(quaternions, start, end, fraction),
        velocities=mix(trajectory.velocities, start, end, fraction),
        gyroscope_biases=mix(trajectory.gyroscope_biases, start, end, fraction),
        accelerometer_biases=mix(trajectory.accelerometer_biases, start, end, fraction),
        covariances=None,
        frames=None,
        matrices=None,
        fixes=None,
    )


@dataclass(frozen=True, eq=False)
class Bracket:
    """The position of N timestamps between the timestamps of a sorted trajectory.

    Attributes:
        start: (N,) index of the state at or before the timestamp.
        end: (N,) index of the state after it; equal to `start` if they coincide.
        fraction: (N,) position between the two states, in [0, 1].
        early: (N,) whether the timestamp is before all states.
        late: (N,) whether it is after all states.
        gap: (N,) whether it is in a gap.
    """

    start: Indices
    end: Indices
    fraction: Floats
    early: Booleans
    late: Booleans
    gap: Booleans

    @property
    def usable(self) -> Booleans:
        """Whether the trajectory has a state at the timestamp, or one on both sides, (N,)."""
        usable: Booleans = ~(self.early | self.late | self.gap)
        return usable

    @property
    def is_between(self) -> bool:
        """Whether a usable timestamp is between two states."""
        return bool((self.usable & (self.start != self.end)).any())

    def until(self, count: int) -> Bracket:
        """Return the bracket of the first `count` timestamps."""
        columns = (getattr(self, field.name) for field in dataclasses.fields(self))
        return Bracket(*(column[:count] for column in columns))

    @staticmethod
    def reasons(side: str) -> tuple[str, str, str]:
        """Return the reasons why timestamps are not usable, in the order early, late, gap.

        Args:
            side: The interpolated side, `groundtruth` or `estimate`.
        """
        return f"before_{side}", f"after_{side}", f"in_{side}_gap"

    def dropped(self, side: str) -> dict[str, int]:
        """Return how many timestamps are not usable, by reason."""
        counts = (int(np.count_nonzero(mask)) for mask in (self.early, self.late, self.gap))
        return dict(zip(self.reasons(side), counts, strict=True))


def bracket_stamps(times: Indices, stamps: Indices, max_gap_s: float) -> Bracket:
    """Return where stamps (N,) are between sorted, distinct times (M,), M > 0, nanoseconds."""

    def at(stamps: Indices) -> tuple[NDArray[Any], ...]:
        end = np.minimum(times.searchsorted(stamps), len(times) - 1)
        at_end = times[end]
        # A timestamp that coincides with a state uses that state alone, also the first one.
        start = np.where(at_end == stamps, end, np.maximum(end - 1, 0))
        at_start = times[start]
        step = at_end - at_start
        early, late = stamps < times[0], stamps > times[-1]
        gap = (step > round(max_gap_s * NANOSECONDS)) & ~late
        fraction = np.where(early | late, 0.0, (stamps - at_start) / np.maximum(step, 1))
        return start, end, fraction, early, late, gap

    return Bracket(*lie.by_blocks(at, stamps))


def mix(
    column: Floats | None,
    start: Indices,
    end: Indices,
    fraction: Floats,
) -> Floats | None:
    """Return a column (M, k) linearly interpolated between rows `start` and `end`, (N, k)."""
    if column is None:
        return None

    def at(start: Indices, end: Indices, fraction: Floats) -> tuple[Floats]:
        first = column.take(start, axis=0)
        return (first + fraction[:, None] * (column.take(end, axis=0) - first),)

    return lie.by_blocks(at, start, end, fraction)[0]


def _slerp(quaternions: Floats, start: Indices, end: Indices, fraction: Floats) -> Floats:
    """Return quaternions (M, 4) interpolated between rows `start` and `end`, (N, 4)."""

    def at(start: Indices, end: Indices, fraction: Floats) -> tuple[Floats]:
        first, last = quaternions.take(start, axis=0), quaternions.take(end, axis=0)
        return (lie.normalized(lie.slerp(first, last, fraction)),)

    return lie.by_blocks(at, start, end, fraction)[0]
