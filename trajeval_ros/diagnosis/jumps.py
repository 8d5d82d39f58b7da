"""Places where an estimate moves as its robot can't have: a restart, or a large correction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import step_angles, step_lengths

LEAST_JUMP_M = 1.0
LEAST_JUMP_DEG = 30.0
_TIMES_TYPICAL = 10.0


@dataclass(frozen=True, eq=False)
class Steps:
    """How the motion from each of N + 1 pairs to the next differs between estimate and truth.

    Only lengths and angles of steps are compared, which no alignment changes, and neither does a
    groundtruth of another body whose rotation against the estimate's is constant.

    Attributes:
        true_m: (N,) distances that the groundtruth moved.
        position_m: (N,) differences of the distances moved.
        rotation_deg: (N,) differences of the angles turned; zeros without rotations.
    """

    true_m: Floats
    position_m: Floats
    rotation_deg: Floats

    @classmethod
    def between(
        cls,
        truth_positions: Floats,
        positions: Floats,
        truth_quaternions: Floats | None,
        quaternions: Floats | None,
        scale: float,
    ) -> Steps:
        """Compare the steps of pairs of states, (N + 1, 3) and (N + 1, 4) xyzw.

        Args:
            truth_positions: Of the groundtruth, metres.
            positions: Of the estimate.
            truth_quaternions: Of the groundtruth; None without rotations.
            quaternions: Of the estimate; None without rotations.
            scale: Metres per unit of the estimate's positions.
        """
        true_m = step_lengths(truth_positions)
        position_m = np.abs(true_m - scale * step_lengths(positions))
        rotation_deg = np.zeros(len(true_m))
        if truth_quaternions is not None and quaternions is not None:
            turned = step_angles(truth_quaternions) - step_angles(quaternions)
            rotation_deg = np.degrees(np.abs(turned))
        return cls(true_m, position_m, rotation_deg)

    def jumps(self, typical_m: float, typical_deg: float) -> NDArray[np.int64]:
        """Return the steps, by index, that are no motion of the robot.

        Args:
            typical_m: A usual difference of the distances moved.
            typical_deg: A usual difference of the angles turned.
        """
        # Across a hole in the estimate the robot moves far, and drift may be large.
        limit_m = np.maximum(self.true_m, max(LEAST_JUMP_M, _TIMES_TYPICAL * typical_m))
        limit_deg = max(LEAST_JUMP_DEG, _TIMES_TYPICAL * typical_deg)
        found: NDArray[np.int64] = np.flatnonzero(
            (self.position_m > limit_m) | (self.rotation_deg > limit_deg)
        )
        return found
