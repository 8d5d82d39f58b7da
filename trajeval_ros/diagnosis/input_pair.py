"""The two inputs of a comparison: trajectories, their columns over seconds, and the settings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.interpolation import mix, slerp, steps_at
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.trajectory_edits import every_nth
from trajeval_ros.metrics.discontinuities.events import FREEZES, FROZEN, Event, Loss
from trajeval_ros.metrics.statistics import median

if TYPE_CHECKING:
    from trajeval_ros.metrics.protocol import Protocol

FEWEST = 12  # poses, motions or repetitions: fewer are no evidence
SHORTEST_S = 8.0  # of a side and in common: less motion has no evidence
SAMPLE = 400  # rows or motions in a statistic, which bounds its cost


class Between(NamedTuple):
    """Interpolated poses, row by row."""

    positions: Floats  # (N, 3)
    quaternions: Floats | None  # (N, 4); None without orientations
    known: Booleans  # (N,) whether both neighbours exist and are close enough in time


@dataclass(frozen=True, eq=False)
class TimedPoses:
    """Poses over seconds."""

    seconds: Floats  # (N,) timestamps since an epoch that both sides share
    positions: Floats  # (N, 3), in the unit of the source
    quaternions: Floats | None = None  # (N, 4), xyzw; None without orientations
    # (N, 3), units of the source per second; None without velocities.
    velocities: Floats | None = None

    @classmethod
    def of(cls, trajectory: Trajectory, epoch_ns: int, offset_s: float = 0.0) -> TimedPoses:
        """Return the columns of a trajectory, `offset_s` added to its timestamps."""
        return cls(
            (trajectory.stamps - epoch_ns) / NANOSECONDS + offset_s,
            trajectory.positions,
            trajectory.quaternions,
            trajectory.velocities,
        )

    def __len__(self) -> int:
        return len(self.seconds)

    def __getitem__(self, rows: slice | Indices | Booleans) -> TimedPoses:
        columns = self.seconds, self.positions, self.quaternions, self.velocities
        return TimedPoses(*(None if one is None else one[rows] for one in columns))  # type: ignore[arg-type]

    def in_order(self) -> TimedPoses:
        """Return the poses sorted by time, and the first one of equal times."""
        steps = np.diff(self.seconds)
        if (steps > 0.0).all():
            return self
        order = np.argsort(self.seconds, kind="stable")
        first = np.concatenate([[True], np.diff(self.seconds[order]) > 0.0])
        return self[order[first]]

    def shifted(self, offset_s: float, rate: float = 0.0) -> TimedPoses:
        """Return poses in order with an offset (s) and a rate of the clock corrected."""
        if not (offset_s or rate):
            return self
        seconds = self.seconds + offset_s + rate * (self.seconds - self.seconds[0])
        return TimedPoses(seconds, self.positions, self.quaternions, self.velocities)

    @property
    def span_s(self) -> float:
        """Time from the first to the last of poses in order, seconds."""
        return float(self.seconds[-1] - self.seconds[0]) if len(self) else 0.0

    @cached_property
    def usual_step_s(self) -> float:
        """Median time step of poses in order, seconds."""
        if len(self) < 2:
            return 1.0
        return median(np.diff(self.seconds)[every_nth(len(self) - 1, SAMPLE)])

    @cached_property
    def extent(self) -> float:
        """Standard deviation of the positions about their mean, units of the source."""
        return math.hypot(*map(np.std, self.positions.T)) if len(self) else 0.0

    def at(self, seconds: Floats, longest_step_s: float = np.inf) -> Between:
        """Return the poses at times (N,), of a track in order with at least two poses."""
        start, fraction = steps_at(self.seconds, seconds)
        end = start + 1
        gap = self.seconds[end] - self.seconds[start]
        known = (fraction > -1e-9) & (fraction < 1.0 + 1e-9) & (gap <= longest_step_s)
        fraction = np.clip(fraction, 0.0, 1.0)
        quaternions = None
        if self.quaternions is not None:
            quaternions = slerp(self.quaternions, start, end, fraction)
        return Between(mix(self.positions, start, end, fraction), quaternions, known)


def other_side(side: str) -> str:
    """Return the side that is not the given one."""
    return "groundtruth" if side == "estimate" else "estimate"


@dataclass(frozen=True, eq=False)
class InputPair:
    """Groundtruth, an estimate, with at least one state each, and the settings of a comparison."""

    groundtruth: Trajectory  # as it was read
    estimate: Trajectory  # as it was read
    protocol: Protocol
    offset_s: float  # to add to the estimate's timestamps; 0 if it is applied already

    @cached_property
    def poses(self) -> dict[str, TimedPoses]:
        """Columns by side, in the order of the sources, since the groundtruth's begin."""
        epoch_ns = int(self.groundtruth.stamps.min())
        return {
            "estimate": TimedPoses.of(self.estimate, epoch_ns, self.offset_s),
            "groundtruth": TimedPoses.of(self.groundtruth, epoch_ns),
        }

    @cached_property
    def in_order(self) -> tuple[TimedPoses, TimedPoses]:
        """Groundtruth and estimate sorted by time, of equal times the first pose."""
        return self.poses["groundtruth"].in_order(), self.poses["estimate"].in_order()

    @property
    def has_enough(self) -> bool:
        """Whether both sides have enough poses for a test."""
        return min(map(len, self.poses.values())) >= FEWEST

    @property
    def gauge(self) -> Gauge:
        """The gauge of the alignment."""
        return self.protocol.gauge

    @property
    def by_time(self) -> bool:
        """Whether states are paired by timestamps; otherwise by row index."""
        is_stamped = self.groundtruth.reading.stamped and self.estimate.reading.stamped
        return self.protocol.association.method != "index" and is_stamped

    def tracked(self, losses: Sequence[Event]) -> InputPair:
        """Return both sides until a divergence or the end, the estimate without frozen parts."""
        stamps = self.estimate.stamps + round(self.offset_s * NANOSECONDS)
        true_stamps = self.groundtruth.stamps
        kept, true_kept = np.ones(len(stamps), dtype=bool), np.ones(len(true_stamps), dtype=bool)
        for loss in losses:
            is_over = isinstance(loss, Loss) and loss.is_over and loss.kind == FROZEN
            goes_on = is_over or loss.kind in FREEZES
            kept &= (stamps <= loss.t_ns) | (goes_on & (stamps > loss.end_ns))
            true_kept &= (true_stamps <= loss.t_ns) | goes_on
        sides = self.groundtruth[true_kept], self.estimate[kept]
        return InputPair(*sides, self.protocol, self.offset_s)
