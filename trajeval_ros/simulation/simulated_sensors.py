"""The simulated sensors of a flight: GNSS receivers, and an IMU of consumer grade.

Errors of the receivers are correlated over minutes, like those of real ones. RTK has errors of a
centimetre, except for periods of float solutions, which its covariance states. A consumer's
receiver has errors of one or two metres, and much larger ones during multipath; its covariance
states only half of these periods. Both have two gaps, as under bridges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.fix_selection import fix_trajectory
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.geodesy import Datum, places_at
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.simulation.drifting_odometry import GRAVITY, wandering

ANTENNA_M = (0.4, 0.2, 1.0)  # in the body
SITE = Datum(47.376, 8.548, 460.0)
_WHITE = 0.2  # share of the variance that is white noise
_UPWARDS = np.array([1.0, 1.0, 2.0])
_PERIODS, _OUTAGES = 3, 2


@dataclass(frozen=True)
class Receiver:
    """Error model of a receiver."""

    status: int  # status of its fixes, as in sensor_msgs/NavSatStatus
    sigma_m: float  # standard deviation along a horizontal axis; vertically twice as much
    correlation_s: float  # correlation time of the errors, to 1/e
    bad_sigma_m: float  # stated standard deviation in bad periods, if the receiver reports them
    bad_s: tuple[float, float]  # duration of bad periods
    # Standard deviation of the offset in a bad period (multipath); 0: errors of `bad_sigma_m`
    # instead.
    echo_m: float


RECEIVERS = {
    "rtk": Receiver(2, 0.01, 100.0, 0.35, (15.0, 30.0), 0.0),
    "consumer": Receiver(0, 1.2, 60.0, 9.0, (4.0, 10.0), 8.0),
}


def receiver_named(name: str) -> Receiver:
    """Return a receiver by name."""
    require_one_of(name, RECEIVERS, "GNSS receiver")
    return RECEIVERS[name]


def receiver_errors(
    receiver: Receiver, generator: np.random.Generator, times: Floats
) -> tuple[Floats, Floats, Booleans]:
    """Return the errors of a receiver's fixes at times (N,), about a second apart.

    Errors are (N, 3), the stated standard deviations along a horizontal axis (N,), both in metres.
    The mask (N,) has the fixes that arrive.
    """
    count = len(times)
    lasting = wandering(generator, count, 3, receiver.correlation_s)
    noise = np.sqrt(1.0 - _WHITE) * lasting
    noise += np.sqrt(_WHITE) * generator.standard_normal((count, 3))
    sigma = np.full(count, receiver.sigma_m)
    offsets = np.zeros((count, 3))
    for number in range(_PERIODS):
        inside = _period(generator, times, receiver.bad_s)
        if receiver.echo_m:
            offsets[inside] += receiver.echo_m * generator.standard_normal(3)
            # The stated covariance reports every other multipath period.
            sigma[inside] = receiver.bad_sigma_m if number % 2 else receiver.sigma_m
        else:
            sigma[inside] = receiver.bad_sigma_m
    actual = np.full(count, receiver.sigma_m) if receiver.echo_m else sigma
    arrives = np.ones(count, dtype=bool)
    for _ in range(_OUTAGES):
        arrives &= ~_period(generator, times, (times[-1] / 40.0, times[-1] / 15.0))
    return actual[:, None] * _UPWARDS * noise + offsets, sigma, arrives


def _period(
    generator: np.random.Generator, times: Floats, lengths_s: tuple[float, float]
) -> Booleans:
    length_s = generator.uniform(*lengths_s)
    begin = generator.uniform(0.0, max(times[-1] - length_s, 0.0))
    inside: Booleans = (times > begin) & (times < begin + length_s)
    return inside


def gnss_fixes(groundtruth: Trajectory, name: str, seed: int) -> Trajectory:
    """Return the fixes of an antenna on a body, once a second, in the groundtruth's world.

    The axes of this world are east, north and up. The receiver is named by a key of `RECEIVERS`.
    """
    receiver, generator = receiver_named(name), np.random.default_rng([seed, 1])
    first = groundtruth.stamps[0] + round(generator.uniform(0.3, 1.0) * NANOSECONDS)
    stamps = np.arange(first, groundtruth.stamps[-1], NANOSECONDS)
    rows = np.minimum(groundtruth.stamps.searchsorted(stamps), len(groundtruth) - 1)
    states = groundtruth[rows]
    assert states.rotations is not None
    times = (states.stamps - groundtruth.stamps[0]) / NANOSECONDS
    errors, sigma, arrives = receiver_errors(receiver, generator, times)
    antenna = states.positions + states.rotations.apply(ANTENNA_M) + errors
    fixes = Fixes(
        places=places_at(antenna, SITE),
        status=np.full(len(times), receiver.status),
        covariance_types=np.full(len(times), 2),
        covariances=np.square(sigma[:, None] * _UPWARDS)[:, :, None] * np.eye(3),
    )
    return fix_trajectory(
        states.stamps[arrives], fixes[arrives], child_frame="gnss_antenna", name="fix"
    )


# Densities of white noise and bias random walk, and the standard deviation of the initial bias, of
# an ADIS16448 (EuRoC's IMU), in rad/s and m/s^2 per sqrt(Hz) and per sqrt(s).
_GYRO = (1.7e-4, 2e-5, 0.01)
_ACCELEROMETER = (2e-3, 3e-3, 0.03)


def imu_readings(groundtruth: Trajectory, seed: int) -> InertialReadings:
    """Return the readings of an IMU on the body between the N states of a smooth groundtruth.

    The states have orientations and velocities, without noise, in a world whose z is up. The N - 1
    readings are at the middle times of consecutive states.
    """
    quaternions, velocities = groundtruth.quaternions, groundtruth.velocities
    assert quaternions is not None
    assert velocities is not None
    generator = np.random.default_rng([seed, 1])
    steps = np.diff(groundtruth.stamps)
    dt = steps[:, None] / 1e9
    rotated = lie.rotation_vector(lie.multiply(lie.conjugate(quaternions[:-1]), quaternions[1:]))
    middle = lie.multiply(quaternions[:-1], lie.from_rotation_vector(0.5 * rotated))
    force = np.diff(velocities, axis=0) / dt + [0.0, 0.0, GRAVITY]
    rates = _noisy(rotated / dt, dt, generator, _GYRO)
    accelerations = _noisy(lie.rotate(lie.conjugate(middle), force), dt, generator, _ACCELEROMETER)
    return InertialReadings(
        groundtruth.stamps[:-1] + steps // 2, rates, accelerations, frame=groundtruth.child_frame
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
