"""Derivatives of preintegrated motion by the biases of the IMU."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.inertial import ImuNoise, preintegrate


def test_preintegrated_motion_follows_the_biases_to_first_order() -> None:
    generator = np.random.default_rng(3)
    rates, forces = generator.normal(size=(2, 3, 8, 3))
    steps = np.full((3, 8), 0.005)
    steps[1, 6:] = 0.0

    def integrated(biases: np.ndarray) -> tuple[np.ndarray, ...]:
        moved = preintegrate(rates - biases[:3], forces - biases[3:], steps, ImuNoise(1.0, 1.0))
        return moved.rotations, moved.velocities, moved.positions

    computed = preintegrate(rates, forces, steps, ImuNoise(1.0, 1.0))
    for place, unit in enumerate(1e-5 * np.eye(6)):
        ahead, behind = integrated(unit), integrated(-unit)
        rotation = so3.log(np.swapaxes(behind[0], 1, 2) @ ahead[0])
        differences = np.concatenate(
            [rotation, ahead[1] - behind[1], ahead[2] - behind[2]], axis=1
        )
        np.testing.assert_allclose(
            computed.by_biases[:, :, place], differences / 2e-5, rtol=1e-6, atol=1e-10
        )
