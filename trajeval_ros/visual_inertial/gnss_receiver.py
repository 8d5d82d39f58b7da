"""Simulated GNSS receivers, whose errors are correlated over minutes like those of real ones.

RTK has errors of a centimetre, except for periods of float solutions, which its covariance
states. A consumer's receiver has errors of one or two metres, and much larger ones during
multipath; its covariance states only half of these periods. Both have two gaps, as under bridges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import require_one_of
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.fix_selection import fix_trajectory
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.geodesy import Datum, places_at
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.visual_inertial.drifting_odometry import wandering

ANTENNA_M = (0.4, 0.2, 1.0)  # in the body
SITE = Datum(47.376, 8.548, 460.0)
_WHITE = 0.2  # share of the variance that is white noise
_UPWARDS = np.array([1.0, 1.0, 2.0])
_PERIODS, _OUTAGES = 3, 2


@dataclass(frozen=True)
class Receiver:
    """Error model of a receiver.

    Attributes:
        status: Status of its fixes, as in sensor_msgs/NavSatStatus.
        sigma_m: Standard deviation along a horizontal axis; vertically twice as much.
        correlation_s: Correlation time of the errors, to 1/e.
        bad_sigma_m: Stated standard deviation in bad periods, if the receiver reports them.
        bad_s: Duration of bad periods.
        echo_m: Standard deviation of the offset in a bad period (multipath); 0: errors of
            `bad_sigma_m` instead.
    """

    status: int
    sigma_m: float
    correlation_s: float
    bad_sigma_m: float
    bad_s: tuple[float, float]
    echo_m: float


RECEIVERS = {
    "rtk": Receiver(2, 0.01, 100.0, 0.35, (15.0, 30.0), 0.0),
    "consumer": Receiver(0, 1.2, 60.0, 9.0, (4.0, 10.0), 8.0),
}


def receiver_named(name: str) -> Receiver:
    """Return a receiver by name.

    Raises:
        SettingsError: There is none of that name.
    """
    require_one_of(name, RECEIVERS, "GNSS receiver")
    return RECEIVERS[name]


def errors_of(
    receiver: Receiver, generator: np.random.Generator, times: Floats
) -> tuple[Floats, Floats, Booleans]:
    """Return the errors of a receiver's fixes, once a second.

    Args:
        receiver: The error model.
        generator: Random number generator.
        times: (N,), about a second apart.

    Returns:
        The errors (N, 3), the stated standard deviations along a horizontal axis (N,), both in
        metres, and a mask of the fixes that arrive (N,).
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


def receive(groundtruth: Trajectory, name: str, seed: int) -> Trajectory:
    """Return the fixes of an antenna on a body, once a second, in the groundtruth's world.

    Args:
        groundtruth: Poses of the body in a world whose axes are east, north and up.
        name: Name of the receiver, a key of `RECEIVERS`.
        seed: Seed of its errors.

    Raises:
        SettingsError: There is no such receiver.
    """
    receiver, generator = receiver_named(name), np.random.default_rng([seed, 1])
    first = groundtruth.stamps[0] + round(generator.uniform(0.3, 1.0) * NANOSECONDS)
    wanted = np.arange(first, groundtruth.stamps[-1], NANOSECONDS)
    rows = np.minimum(groundtruth.stamps.searchsorted(wanted), len(groundtruth) - 1)
    states = groundtruth[rows]
    assert states.rotations is not None
    times = (states.stamps - groundtruth.stamps[0]) / NANOSECONDS
    errors, sigma, arrives = errors_of(receiver, generator, times)
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
