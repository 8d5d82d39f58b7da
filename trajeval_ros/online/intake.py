"""Counts of the states that a pairing receives, and the limits of its memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.dropped_counts import count_up
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.valid_poses import LARGEST
from trajeval_ros.online.state_buffer import NEVER
from trajeval_ros.online.state_rows import POSITION, QUATERNION, VELOCITY


@dataclass
class Intake:
    """Counts of the poses of one side.

    Attributes:
        poses: Number of poses, repeated timestamps included.
        first: The earliest timestamp, nanoseconds; None before the first pose.
        last: The latest timestamp, nanoseconds.
        dropped: Number of unusable states by reason.
    """

    poses: int = 0
    first: int | None = None
    last: int | None = None
    dropped: dict[str, int] = field(default_factory=dict)

    def take(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats]:
        """Count states (N,), (N, k), and return the valid ones, by the same rules as the readers.

        An invalid velocity is replaced by NaN.
        """
        wild = np.abs(rows[:, VELOCITY]) > LARGEST
        if wild.any():
            rows = rows.copy()
            rows[wild.any(axis=1), VELOCITY] = np.nan
        # `states` sets all four columns to infinity.
        no_length = rows[:, QUATERNION.start] == np.inf
        finite = np.isfinite(rows[:, POSITION]).all(axis=1)
        keep = finite & ~no_length
        if not keep.all():
            self.drop("not_finite", int(np.count_nonzero(~finite)))
            self.drop("zero_quaternion", int(np.count_nonzero(finite & no_length)))
            stamps, rows = stamps[keep], rows[keep]
        if len(stamps):
            self.poses += len(stamps)
            earliest, latest = int(stamps.min()), int(stamps.max())
            self.first = earliest if self.first is None else min(self.first, earliest)
            self.last = latest if self.last is None else max(self.last, latest)
        return stamps, rows

    def take_back(self, poses: int, last: int) -> None:
        """Subtract poses from the count, after which `last` is the latest timestamp."""
        self.poses -= poses
        if poses:
            self.last = last

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
class Limits:
    """Limits of a pairing's memory; beyond them the oldest states are dropped and counted.

    A state takes 88 bytes, 376 with a covariance. 500 000 states per side take 88 MB, or 232 MB,
    and up to twice that while the arrays grow.

    Attributes:
        past_s: Time before the newest state of the interpolated side that is kept for late states
            of the other side, seconds; infinite for a limit by `past_states` only.
        past_states: Number of kept states of the interpolated side.
        waiting_states: Number of waiting states of the other side.
    """

    past_s: float = 10.0
    past_states: int = 500_000
    waiting_states: int = 500_000

    def horizon(self, newest: int) -> int:
        """Return the timestamp from which on states are kept, nanoseconds."""
        if math.isinf(self.past_s):
            return NEVER
        return newest - round(self.past_s * NANOSECONDS)
