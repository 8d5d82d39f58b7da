"""Measurements of an IMU or a gyroscope, and the orientations that they give.

Preintegration makes the samples between two keyframes one measurement with covariance. Samples
are held (zero order), and biases are known (gauge paper, section II). An acceleration is rotated
by the attitude in the middle of its step. With the attitude at the start of the step (Forster's
scheme), the error of about 1/2 w dt |a| exceeds the noise of a good IMU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats, Stamps

_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True, eq=False)
class InertialReadings:
    """Measurements of an IMU in its own axes."""

    stamps: Stamps  # (N,) int64, nanoseconds, in order of arrival
    rates: Floats  # (N, 3), rad/s, angular velocities
    accelerations: Floats | None  # (N, 3), m/s^2, specific force; None for a gyroscope
    frame: str = ""  # name of the sensor's frame, "" if unknown
    source: str = ""
    undecodable: int = 0  # number of messages that could not be used
    damage: tuple[str, ...] = ()  # unreadable parts of the source, one sentence each

    def __len__(self) -> int:
        return len(self.stamps)


def rotations_by_gyro(seconds: Floats, rates: Floats, first: Floats = _IDENTITY) -> Floats:
    """Return orientations (N, 4) by angular velocities (N, 3), rad/s, from the first one (4,)."""
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(seconds)[:, None]
    rotations = lie.running_products(first, lie.from_rotation_vector(steps))
    return np.concatenate([first[None], rotations])


@dataclass(frozen=True)
class ImuNoise:
    """Noise densities of an IMU."""

    gyroscope: float  # rad/s/sqrt(Hz)
    accelerometer: float  # m/s^2/sqrt(Hz)


@dataclass(frozen=True, eq=False)
class Preintegrated:
    """The motion between keyframes i and i + 1 as measured by the IMU, for I intervals."""

    durations_s: Floats  # (I,)
    rotations: Floats  # (I, 3, 3), of body i + 1 in body i
    velocities: Floats  # (I, 3), change of velocity in body i without gravity's, m/s
    positions: Floats  # (I, 3), change of position in body i without gravity's and v_i's, metres
    covariances: Floats  # (I, 9, 9) of (rotation about the body's axes, velocity, position)
    # (I, 9, 6), derivative by the biases of gyroscope (rad/s) and accelerometer (m/s^2) that are
    # subtracted from the samples.
    by_biases: Floats


def preintegrate(
    angular_velocities: Floats,
    accelerations: Floats,
    steps_s: float | Floats,
    noise: ImuNoise,
    scheme: str = "middle",
) -> Preintegrated:
    """Integrate the samples of I intervals side by side.

    Args:
        angular_velocities: (I, m, 3), rad/s, in the body.
        accelerations: (I, m, 3), specific force, m/s^2, in the body.
        steps_s: Duration of every sample, (I, m), or one for all. Intervals with fewer than m
            samples are padded with samples of duration 0 s.
        noise: Densities; a sample's standard deviation is the density / sqrt(step).
        scheme: `middle`, or `start` to turn accelerations by the attitude before the sample.
    """
    intervals, samples, _ = angular_velocities.shape
    held = np.broadcast_to(np.asarray(steps_s, dtype=np.float64), (intervals, samples))
    turns = angular_velocities * held[:, :, None]
    steps = so3.exp(turns)
    jacobians = so3.left_jacobian(-turns) * held[:, :, None, None]
    if scheme == "middle":
        halves = so3.exp(turns / 2.0)
        half_jacobians = so3.left_jacobian(-turns / 2.0) * (held[:, :, None, None] / 2.0)
    else:
        halves = np.broadcast_to(np.eye(3), steps.shape)
        half_jacobians = np.zeros_like(steps)
    # d(R_half a) by the right perturbation of the attitude before, and by the gyroscope's noise.
    forces = np.einsum("nkij,nkj->nki", halves, accelerations)
    by_attitude = -so3.skew(forces)
    by_gyroscope = -halves @ so3.skew(accelerations) @ half_jacobians

    rotations, velocities, positions = integrated(steps, forces, held)
    covariance, by_biases = np.zeros((intervals, 9, 9)), np.zeros((intervals, 9, 6))
    transition = np.broadcast_to(np.eye(9), covariance.shape).copy()
    input_ = np.zeros((intervals, 9, 6))
    densities = np.repeat([noise.gyroscope**2, noise.accelerometer**2], 3)
    for k in range(samples):
        step_s = held[:, k, None, None]
        variances = np.divide(
            densities, step_s, out=np.zeros_like(input_[:, :1]), where=step_s > 0
        )
        transition[:, 6:9, 3:6] = np.eye(3) * step_s
        transition[:, 0:3, 0:3] = np.swapaxes(steps[:, k], 1, 2)
        input_[:, 0:3, 0:3] = jacobians[:, k]
        gain = rotations[:, k] @ by_attitude[:, k]
        noise_gain = rotations[:, k] @ by_gyroscope[:, k]
        middle_rotations = rotations[:, k] @ halves[:, k]
        for rows, factor in ((slice(3, 6), step_s), (slice(6, 9), step_s**2 / 2.0)):
            transition[:, rows, 0:3] = gain * factor
            input_[:, rows, 0:3] = noise_gain * factor
            input_[:, rows, 3:6] = middle_rotations * factor
        covariance = transition @ covariance @ np.swapaxes(transition, 1, 2)
        covariance += (input_ * variances) @ np.swapaxes(input_, 1, 2)
        by_biases = transition @ by_biases - input_
    last = rotations[:, -1], velocities[:, -1], positions[:, -1]
    return Preintegrated(held.sum(axis=1), *last, covariance, by_biases)


def integrated(steps: Floats, forces: Floats, held: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the motion before each of m samples and after the last one, for I intervals.

    Args:
        steps: (I, m, 3, 3), rotations during the samples.
        forces: (I, m, 3), accelerations in the axes before the sample, m/s^2.
        held: (I, m), durations of the samples, s.

    Returns:
        Rotations (I, m + 1, 3, 3), and velocities and positions (I, m + 1, 3) without those of
        gravity and of the first velocity.
    """
    intervals, samples, _ = forces.shape
    rotations = np.empty((intervals, samples + 1, 3, 3))
    rotations[:, 0] = np.eye(3)
    for k in range(samples):
        rotations[:, k + 1] = rotations[:, k] @ steps[:, k]
    velocities, positions = np.zeros((2, intervals, samples + 1, 3))
    time_s = held[:, :, None]
    world_forces = np.einsum("nkij,nkj->nki", rotations[:, :-1], forces)
    np.cumsum(world_forces * time_s, axis=1, out=velocities[:, 1:])
    moved = velocities[:, :-1] * time_s + world_forces * (time_s**2 / 2.0)
    np.cumsum(moved, axis=1, out=positions[:, 1:])
    return rotations, velocities, positions
