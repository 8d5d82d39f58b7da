"""The IMU of a simulated flight, with the noise of a consumer sensor."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import Trajectory

_GRAVITY = 9.81
# Densities of white noise and bias random walk, and the standard deviation of the initial bias, of
# an ADIS16448 (EuRoC's IMU), in rad/s and m/s^2 per sqrt(Hz) and per sqrt(s).
_GYRO = (1.7e-4, 2e-5, 0.01)
_ACCELEROMETER = (2e-3, 3e-3, 0.03)


def readings_of(groundtruth: Trajectory, seed: int) -> InertialReadings:
    """Return the readings of an IMU on the body between the states of a smooth groundtruth.

    Args:
        groundtruth: N states with orientations and velocities, without noise, in a world whose z
            is up.
        seed: Seed of noise and biases.

    Returns:
        N - 1 readings, at the middle times of consecutive states.
    """
    quaternions, velocities = groundtruth.quaternions, groundtruth.velocities
    assert quaternions is not None
    assert velocities is not None
    generator = np.random.default_rng([seed, 1])
    steps = np.diff(groundtruth.stamps)
    dt = steps[:, None] / 1e9
    turned = lie.rotation_vector(lie.multiply(lie.conjugate(quaternions[:-1]), quaternions[1:]))
    middle = lie.multiply(quaternions[:-1], lie.from_rotation_vector(0.5 * turned))
    force = np.diff(velocities, axis=0) / dt + [0.0, 0.0, _GRAVITY]
    rates = _noisy(turned / dt, dt, generator, _GYRO)
    accelerations = _noisy(lie.rotate(lie.conjugate(middle), force), dt, generator, _ACCELEROMETER)
    return InertialReadings(
        groundtruth.stamps[:-1] + steps // 2,
        rates,
        accelerations,
        frame=groundtruth.child_frame,
    )


def _noisy(
    exact: Floats, dt: Floats, generator: np.random.Generator, noise: tuple[float, float, float]
) -> Floats:
    """Return readings (N, 3) with white noise, a bias, and its random walk."""
    white, walk, spread = noise
    bias = generator.normal(0.0, spread, 3)
    bias = bias + np.cumsum(generator.normal(size=exact.shape) * walk * np.sqrt(dt), axis=0)
    noisy: Floats = exact + bias + generator.normal(size=exact.shape) * white / np.sqrt(dt)
    return noisy
