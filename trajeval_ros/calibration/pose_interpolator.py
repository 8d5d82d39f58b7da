"""Interpolation of a trajectory's pose at arbitrary times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.bracket import bracket_stamps, mix

GAP_S = 0.5
_USUAL_STEPS = 4.0  # sparse keyframes: a gap is longer than this number of median steps


@dataclass(frozen=True, eq=False)
class InterpolatedPoses:
    """Poses at N stamps.

    Attributes:
        positions: (N, 3), metres.
        quaternions: (N, 4), xyzw; None for a position-only sensor.
        usable: (N,) whether the stamp is between two states without a gap.
    """

    positions: Floats
    quaternions: Floats | None
    usable: Booleans


@dataclass(frozen=True, eq=False)
class Track:
    """The columns of a trajectory in order of time, and its gaps.

    Attributes:
        stamps: (N,) int64, nanoseconds, increasing.
        positions: (N, 3), metres.
        quaternions: (N, 4), xyzw, or None.
        step_s: Median time between states.
        gap_s: Longest time between states that is no gap.
    """

    stamps: Stamps
    positions: Floats
    quaternions: Floats | None
    step_s: float
    gap_s: float

    @classmethod
    def of(cls, trajectory: Trajectory, *, with_rotations: bool, sparse: bool = False) -> Track:
        """Return the columns of a trajectory.

        Args:
            trajectory: At least two states; they are sorted.
            with_rotations: Whether to include orientations.
            sparse: Whether the states can be keyframes; then gaps are relative to their steps.
        """
        ordered = trajectory.in_order()
        step_s = float(np.median(np.diff(ordered.stamps))) / NANOSECONDS
        return cls(
            ordered.stamps,
            ordered.positions,
            ordered.quaternions if with_rotations else None,
            step_s,
            max(GAP_S, _USUAL_STEPS * step_s) if sparse else GAP_S,
        )

    def at(self, stamps: Stamps) -> InterpolatedPoses:
        """Return the poses at N stamps, interpolated linearly and by slerp."""
        bracket = bracket_stamps(self.stamps, stamps, self.gap_s)
        start, end, fraction = bracket.start, bracket.end, bracket.fraction
        positions = mix(self.positions, start, end, fraction)
        assert positions is not None
        quaternions = None
        if self.quaternions is not None:
            quaternions = lie.slerp(self.quaternions[start], self.quaternions[end], fraction)
        return InterpolatedPoses(positions, quaternions, bracket.usable)


def nearest_rows(stamps: Stamps, wanted: Stamps) -> NDArray[np.int64]:
    """Return the row of the stamp nearest to every wanted one (N,); the stamps are sorted."""
    after = np.minimum(np.searchsorted(stamps, wanted), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(
        np.abs(stamps[before] - wanted) < np.abs(stamps[after] - wanted), before, after
    )


def nanoseconds(seconds: float) -> int:
    """Return a duration in whole nanoseconds."""
    return round(seconds * NANOSECONDS)
