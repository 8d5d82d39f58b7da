"""What a pairing is given of one side, and what it holds at the most."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import LARGEST, NANOSECONDS, count_up
from trajeval_ros.online.state_buffer import NEVER
from trajeval_ros.online.state_rows import POSITION, QUATERNION, VELOCITY


@dataclass
class Intake:
    """Poses of one side that a pairing was given.

    Attributes:
        poses: Number of them, repeated stamps included.
        first: The earliest stamp, nanoseconds; None before the first pose.
        last: The latest one.
        dropped: Number of states that could not be used, by reason.
    """

    poses: int = 0
    first: int | None = None
    last: int | None = None
    dropped: dict[str, int] = field(default_factory=dict)

    def take(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats]:
        """Count states (N,), (N, k), and return those that are poses; others as the readers do.

        A velocity that can't be one is left out alone.
        """
        wild = np.abs(rows[:, VELOCITY]) > LARGEST
        if wild.any():
            rows = rows.copy()
            rows[wild.any(axis=1), VELOCITY] = np.nan
        # `states` writes it into all four columns.
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
        """Leave out so many poses, so that another one is the last."""
        self.poses -= poses
        if poses:
            self.last = last

    def drop(self, reason: str, count: int) -> None:
        """Count what could not be used."""
        count_up(self.dropped, reason, count)

    @property
    def duration_s(self) -> float:
        """Time from the earliest to the latest stamp, seconds."""
        if self.first is None or self.last is None:
            return 0.0
        return (self.last - self.first) / NANOSECONDS


@dataclass(frozen=True)
class Limits:
    """What a pairing holds at the most; beyond, the oldest is dropped and counted.

    A state takes 88 bytes, 376 with a covariance: 500 000 of each side are 88 MB, or 232 MB, and
    up to twice that while they grow.

    Attributes:
        past_s: What is kept of the side that is interpolated behind its newest state, for late
            states of the other, seconds; infinite for as much as `past_states` allows.
        past_states: The same as a number of states, whatever the rate.
        waiting_states: States of the other side that wait.
    """

    past_s: float = 10.0
    past_states: int = 500_000
    waiting_states: int = 500_000

    def horizon(self, newest: int) -> int:
        """Return the stamp from which on states are kept, of a side's newest one, nanoseconds."""
        if math.isinf(self.past_s):
            return NEVER
        return newest - round(self.past_s * NANOSECONDS)
