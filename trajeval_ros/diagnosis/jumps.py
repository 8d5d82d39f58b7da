"""Detection of jumps of the estimate: a restart, or a large correction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.travelled import step_angles, step_lengths

LEAST_JUMP_M = 1.0
LEAST_JUMP_DEG = 30.0
_TIMES_TYPICAL = 10.0


@dataclass(frozen=True, eq=False)
class Steps:
    """Differences of the steps of estimate and groundtruth between N + 1 consecutive pairs.

    Lengths and angles of steps do not depend on the alignment or on a constant rotation between
    the bodies.

    Attributes:
        true_m: (N,) distances moved by the groundtruth, metres.
        position_m: (N,) differences of the distances moved, metres.
        rotation_deg: (N,) differences of the rotation angles, deg; zeros without rotations.
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
        """Return the indices of steps that are not a motion of the robot.

        Args:
            typical_m: Typical difference of the distances moved, metres.
            typical_deg: Typical difference of the rotation angles, deg.
        """
        # Distance and drift are large across a gap of the estimate.
        limit_m = np.maximum(self.true_m, max(LEAST_JUMP_M, _TIMES_TYPICAL * typical_m))
        limit_deg = max(LEAST_JUMP_DEG, _TIMES_TYPICAL * typical_deg)
        found: NDArray[np.int64] = np.flatnonzero(
            (self.position_m > limit_m) | (self.rotation_deg > limit_deg)
        )
        return found
