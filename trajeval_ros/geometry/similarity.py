"""Similarity transformations x -> s R x + t, the elements of all gauges."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Similarity:
    """x -> scale * rotation x + translation, from the estimate's frame to the groundtruth's.

    Attributes:
        rotation: (3, 3) rotation matrix.
        translation: (3,), metres.
        scale: Positive factor; 1 for rigid transformations.

    Example:
        >>> import numpy as np
        >>> from trajeval_ros import Similarity, simulate
        >>> estimate = simulate(seed=1, duration_s=30.0).estimate
        >>> similarity = Similarity(np.eye(3), np.array([1.0, 0.0, 0.0]), scale=2.0)
        >>> moved = similarity.trajectory(estimate)
        >>> bool(np.allclose(moved.positions, 2.0 * estimate.positions + [1.0, 0.0, 0.0]))
        True
    """

    rotation: Floats
    translation: Floats
    scale: float = 1.0

    @classmethod
    def identity(cls) -> Similarity:
        """Return the identity transformation."""
        return cls(np.eye(3), np.zeros(3))

    @cached_property
    def linear(self) -> Floats:
        """The scaled rotation, (3, 3)."""
        return self.scale * self.rotation

    def positions(self, points: Floats) -> Floats:
        """Return transformed points, (N, 3) or (3,)."""
        moved: Floats = points @ self.linear.T
        moved += self.translation
        return moved

    def quaternions(self, quaternions: Floats) -> Floats:
        """Return transformed orientations, (N, 4) xyzw: R_i -> R R_i."""
        turn = lie.from_matrix(self.rotation)
        return lie.by_blocks(lambda rows: (lie.multiply(turn, rows),), quaternions)[0]

    def trajectory(self, trajectory: Trajectory) -> Trajectory:
        """Return transformed states, eq. (14); biases are in the body frame and do not change."""
        quaternions, velocities = trajectory.quaternions, trajectory.velocities
        return replace(
            trajectory,
            positions=self.positions(trajectory.positions),
            quaternions=None
            if quaternions is None
            else lie.normalized(self.quaternions(quaternions)),
            velocities=None if velocities is None else self.vectors(velocities),
            covariances=None,
            matrices=None,
            fixes=None,
        )

    def vectors(self, vectors: Floats) -> Floats:
        """Return free vectors (N, 3), such as velocities, scaled and rotated."""
        turned: Floats = vectors @ self.linear.T
        return turned

    @property
    def rotation_xyzw(self) -> Floats:
        """The rotation as a quaternion with w >= 0, (4,)."""
        return lie.from_matrix(self.rotation)
