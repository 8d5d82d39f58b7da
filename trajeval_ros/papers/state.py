"""The state of the estimation problem and its perturbation: eq. (2), (5), (8) and (9)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats

# Parameters of a keyframe: position, rotation, velocity.
MOTION_WIDTH = 9


@dataclass(frozen=True, eq=False)
class State:
    """Keyframes and landmarks; eq. (2) of the gauge paper.

    A step is (9N + 3K,): position, rotation and velocity of all keyframes, then the landmarks.
    Rotations are perturbed on the left, R <- Exp(dphi) R (eq. 8), except for the first one. This
    is Exp(Dphi) R_ref with steps added to the vector Dphi (eq. 9), so that its yaw can be fixed.
    """

    positions: Floats  # (N, 3), metres
    rotations: Floats  # (N, 3, 3), body to world
    velocities: Floats  # (N, 3), m/s, in the world
    landmarks: Floats  # (K, 3), metres
    first_turn: Floats  # (3,), Dphi of eq. (9), rad
    reference_rotation: Floats  # (3, 3), R_ref, the first rotation's initial value
    reference_position: Floats  # (3,), the first position's initial value

    @classmethod
    def at(
        cls, positions: Floats, rotations: Floats, velocities: Floats, landmarks: Floats
    ) -> State:
        """Return a state that is its own reference."""
        references = np.zeros(3), rotations[0], positions[0]
        return cls(positions, rotations, velocities, landmarks, *references)

    def moved(self, step: Floats) -> State:
        """Return the state after a step (9N + 3K,)."""
        count = len(self.positions)
        motion = step[: MOTION_WIDTH * count].reshape(count, MOTION_WIDTH)
        rotations = so3.exp(motion[:, 3:6]) @ self.rotations
        first_turn = self.first_turn + motion[0, 3:6]
        rotations[0] = so3.exp(first_turn) @ self.reference_rotation
        return State(
            self.positions + motion[:, :3],
            rotations,
            self.velocities + motion[:, 6:9],
            self.landmarks + step[motion.size :].reshape(-1, 3),
            first_turn,
            self.reference_rotation,
            self.reference_position,
        )

    def transformed(self, rotation: Floats, translation: Floats) -> State:
        """Return the state transformed by g, eq. (5), with unchanged references."""
        return State(
            self.positions @ rotation.T + translation,
            rotation @ self.rotations,
            self.velocities @ rotation.T,
            self.landmarks @ rotation.T + translation,
            self.first_turn,
            self.reference_rotation,
            self.reference_position,
        ).referred_to(self.reference_rotation, self.reference_position)

    def referred_to(self, rotation: Floats, position: Floats) -> State:
        """Return the same state with other references."""
        return dataclasses.replace(
            self,
            first_turn=so3.log(self.rotations[0] @ rotation.T),
            reference_rotation=rotation,
            reference_position=position,
        )

    @property
    def gauge_basis(self) -> Floats:
        """U of eq. (15), (9N + 3K, 4): derivatives by yaw about the origin and translation."""
        count = len(self.positions)
        rows = 3 * count
        basis = np.zeros((rows + len(self.landmarks), 3, 4))
        motion, landmarks = basis[:rows].reshape(count, MOTION_WIDTH, 4), basis[rows:]
        motion[:, 0:3, 0] = _gravity_cross(self.positions)
        motion[:, 3:6, 0] = [0.0, 0.0, 1.0]
        motion[0, 3:6, 0] = so3.inverse_left_jacobian(self.first_turn)[:, 2]
        motion[:, 6:9, 0] = _gravity_cross(self.velocities)
        landmarks[:, :, 0] = _gravity_cross(self.landmarks)
        motion[:, 0:3, 1:] = np.eye(3)
        landmarks[:, :, 1:] = np.eye(3)
        return basis.reshape(-1, 4)


def _gravity_cross(vectors: Floats) -> Floats:
    """Return e_z x v."""
    return np.stack([-vectors[:, 1], vectors[:, 0], np.zeros(len(vectors))], axis=1)


_POSITION_M, _ROTATION_DEG = 0.05, 6.0
_VELOCITY_MPS, _LANDMARK_M = 0.05, 0.075


def initial_state(groundtruth: State, generator: np.random.Generator) -> State:
    """Return keyframes and landmarks with the paper's initial errors."""
    count = len(groundtruth.positions)
    turns = np.radians(_ROTATION_DEG) * _directions(generator, count)
    rotations = so3.exp(turns) @ groundtruth.rotations
    positions = groundtruth.positions + _POSITION_M * _directions(generator, count)
    velocities = groundtruth.velocities + generator.uniform(
        -_VELOCITY_MPS, _VELOCITY_MPS, (count, 3)
    )
    landmarks = groundtruth.landmarks + generator.uniform(
        -_LANDMARK_M, _LANDMARK_M, groundtruth.landmarks.shape
    )
    return State.at(positions, rotations, velocities, landmarks)


def _directions(generator: np.random.Generator, count: int) -> Floats:
    vectors = generator.standard_normal((count, 3))
    directions: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return directions
