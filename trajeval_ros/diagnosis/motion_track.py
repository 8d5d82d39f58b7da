"""Columns of one side of a recording, in seconds of a common clock."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.thinning import evenly
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.travelled import step_lengths
from trajeval_ros.metrics.statistics import median

_ENOUGH = 2000  # steps, for a median


class Between(NamedTuple):
    """Interpolated poses of a track, row by row.

    Attributes:
        positions: (N, 3).
        quaternions: (N, 4); None without orientations.
        known: (N,) whether both neighbours exist and are close enough in time.
    """

    positions: Floats
    quaternions: Floats | None
    known: Booleans


@dataclass(frozen=True, eq=False)
class MotionTrack:
    """Poses over seconds.

    Attributes:
        seconds: (N,) timestamps since an epoch that both sides share.
        positions: (N, 3), in the unit of the source.
        quaternions: (N, 4), xyzw; None without orientations.
        velocities: (N, 3), units of the source per second; None without velocities.
    """

    seconds: Floats
    positions: Floats
    quaternions: Floats | None = None
    velocities: Floats | None = None

    @classmethod
    def of(cls, trajectory: Trajectory, epoch_ns: int, offset_s: float = 0.0) -> MotionTrack:
        """Return the columns of a trajectory, `offset_s` added to its timestamps."""
        return cls(
            (trajectory.stamps - epoch_ns) / NANOSECONDS + offset_s,
            trajectory.positions,
            trajectory.quaternions,
            trajectory.velocities,
        )

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.seconds)

    def __getitem__(self, rows: slice | Indices | Booleans) -> MotionTrack:
        """Return some of the poses."""
        return MotionTrack(
            self.seconds[rows],
            self.positions[rows],
            None if self.quaternions is None else self.quaternions[rows],
            None if self.velocities is None else self.velocities[rows],
        )

    def in_order(self) -> MotionTrack:
        """Return the poses sorted by time, and the first one of equal times."""
        steps = np.diff(self.seconds)
        if (steps > 0.0).all():
            return self
        order = np.argsort(self.seconds, kind="stable")
        first = np.concatenate([[True], np.diff(self.seconds[order]) > 0.0])
        return self[order[first]]

    def shifted(self, offset_s: float, rate: float = 0.0) -> MotionTrack:
        """Return a track in order with an offset (s) and a rate of the clock corrected."""
        if not (offset_s or rate):
            return self
        seconds = self.seconds + offset_s + rate * (self.seconds - self.seconds[0])
        return MotionTrack(seconds, self.positions, self.quaternions, self.velocities)

    @property
    def span_s(self) -> float:
        """Time from the first to the last pose of a track in order, seconds."""
        return float(self.seconds[-1] - self.seconds[0]) if len(self) else 0.0

    @cached_property
    def usual_step_s(self) -> float:
        """Median time step of a track in order, seconds."""
        if len(self) < 2:
            return 1.0
        some = evenly(len(self) - 1, _ENOUGH)
        return median(self.seconds[some + 1] - self.seconds[some])

    @cached_property
    def moved(self) -> Floats:
        """Lengths (N - 1,) of the steps between consecutive poses."""
        return step_lengths(self.positions)

    @property
    def extent(self) -> float:
        """Standard deviation of the positions about their mean, units of the source."""
        return float(np.linalg.norm(np.std(self.positions, axis=0))) if len(self) else 0.0

    def at(self, seconds: Floats, max_gap_s: float = np.inf) -> Between:
        """Return the poses at times (N,), of a track in order with at least two poses."""
        after = np.clip(np.searchsorted(self.seconds, seconds, side="right"), 1, len(self) - 1)
        before = after - 1
        gap = self.seconds[after] - self.seconds[before]
        fraction = (seconds - self.seconds[before]) / gap
        known = (fraction > -1e-9) & (fraction < 1.0 + 1e-9) & (gap <= max_gap_s)
        fraction = np.clip(fraction, 0.0, 1.0)
        start, end = self.positions[before], self.positions[after]
        quaternions = None
        if self.quaternions is not None:
            quaternions = lie.slerp(self.quaternions[before], self.quaternions[after], fraction)
        return Between(start + fraction[:, None] * (end - start), quaternions, known)


def lengths(vectors: Floats) -> Floats:
    """Return the lengths (...) of vectors (..., k)."""
    found: Floats = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return found
