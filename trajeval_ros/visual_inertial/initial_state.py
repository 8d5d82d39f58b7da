"""Initial state of an estimator: truth with noise (gauge paper, section V-B)."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.visual_inertial.state import State

_POSITION_M, _ROTATION_DEG = 0.05, 6.0
_VELOCITY_MPS, _LANDMARK_M = 0.05, 0.075


def initial_state(truth: State, generator: np.random.Generator) -> State:
    """Return keyframes and landmarks with the paper's initial errors, and with true biases."""
    count = len(truth.positions)
    turns = np.radians(_ROTATION_DEG) * _directions(generator, count)
    rotations = so3.exp(turns) @ truth.rotations
    positions = truth.positions + _POSITION_M * _directions(generator, count)
    velocities = truth.velocities + generator.uniform(-_VELOCITY_MPS, _VELOCITY_MPS, (count, 3))
    landmarks = truth.landmarks + generator.uniform(
        -_LANDMARK_M, _LANDMARK_M, truth.landmarks.shape
    )
    return State.at(positions, rotations, velocities, landmarks, truth.biases)


def _directions(generator: np.random.Generator, count: int) -> Floats:
    vectors = generator.standard_normal((count, 3))
    directions: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return directions
