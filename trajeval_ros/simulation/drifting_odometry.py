"""Simulation of a flight and an odometry with the drift of visual-inertial ones, from a seed.

This is a kinematic model of drift, not an estimator; there are no features and no IMU. The true
velocity is rotated by a yaw error (random walk), scaled by a slowly varying scale error, disturbed
by noise, and integrated. Errors of roll and pitch are bounded, since gravity is observed. The data
are for demonstrations and tests. They say nothing about the accuracy of real estimators.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

EPOCH_S = 1_700_000_000
GRAVITY = 9.81
GROUNDTRUTH_RATE_HZ = 200.0
ESTIMATE_RATE_HZ = 20.0
SHORTEST_S, LONGEST_S = 5.0, 86_400.0
_GROUNDTRUTH_JITTER_S = 20e-6
_STAMP_DELAY_S = 100e-6
_LONGEST_STAMP_DELAY_S = 1e-3
_GAP_S = 2.0  # duration without estimates
# Standard deviations of its errors, for a drift of 0.5 to 1 % of the distance.
_YAW_DEG_PER_SQRT_S = 0.1  # after one second, growing with the square root of time
_VELOCITY_SHARE = 0.01  # of speed, per axis
_SCALE = 0.003  # varies slowly
TILT_DEG = 0.3  # of roll and pitch, per axis; never more than twice as much


@dataclass(frozen=True, eq=False)
class Simulation:
    """Groundtruth and estimate of a simulated flight."""

    groundtruth: Trajectory  # about 200 states a second, with velocity, in frame `world`
    estimate: Trajectory  # about 20 states a second with one gap, with velocity, in frame `odom`


def simulate(seed: int, duration_s: float = 120.0, *, drives: bool = False) -> Simulation:
    """Simulate a flight and its odometry; the same arguments give the same arrays.

    Args:
        seed: Chooses the flight, the frames, the clocks' jitter and the drift.
        duration_s: Duration of the flight, 5 s to a day. The odometry has a gap of two seconds
            near its middle.
        drives: True for a drive over hundreds of metres instead of a flight over tens of metres.

    Raises:
        SettingsError: `duration_s` out of range, or a negative seed.

    Example:
        >>> from trajeval_ros import simulate
        >>> simulate(seed=1, duration_s=30.0).groundtruth.frame
        'world'
    """
    if not SHORTEST_S <= duration_s <= LONGEST_S:
        raise SettingsError(
            f"a simulated flight takes {SHORTEST_S:g} to {LONGEST_S:g} s, not {duration_s:g}"
        )
    if seed < 0:
        raise SettingsError(f"the seed must be at least 0, not {seed}")
    generator = np.random.default_rng(seed)
    flight = (_Flight.drive if drives else _Flight.random)(generator)
    return Simulation(
        groundtruth=_groundtruth(generator, flight, duration_s),
        estimate=_odometry(generator, flight, duration_s),
    )


@dataclass(frozen=True, eq=False)
class _Flight:
    """A sum of K sine waves per axis, so that every derivative is exact.

    The first waves of x and y form a figure eight with a speed of at least 1.19 m/s. The others
    add at most 0.92 m/s, so the speed is never zero, and the course and the yaw are smooth.
    """

    centre: Floats  # (3,), metres
    speeds: Floats  # (K, 3) amplitudes of the velocity, m/s
    frequencies: Floats  # (K, 3), rad/s
    phases: Floats  # (K, 3), rad

    @classmethod
    def random(cls, generator: np.random.Generator) -> _Flight:
        speeds = [[1.8, 1.8, 0.05], [0.35, 0.35, 0.2], [0.2, 0.2, 0.25], [0.1, 0.1, 0.1]]
        slowest = [[0.3, 0.6, 0.25], [0.1, 0.1, 0.1], [0.4, 0.4, 0.4], [1.1, 1.1, 1.1]]
        return cls._of_waves(generator, np.array(speeds), np.array(slowest))

    @classmethod
    def drive(cls, generator: np.random.Generator) -> _Flight:
        """Return a wide eight on the ground, of 4 to 12 m/s."""
        speeds = [[6.0, 6.0, 0.1], [1.8, 1.8, 0.1], [0.5, 0.5, 0.05], [0.1, 0.1, 0.02]]
        slowest = [[0.03, 0.06, 0.03], [0.05, 0.05, 0.05], [0.1, 0.1, 0.1], [0.3, 0.3, 0.3]]
        return cls._of_waves(generator, np.array(speeds), np.array(slowest))

    @classmethod
    def _of_waves(cls, generator: np.random.Generator, speeds: Floats, slowest: Floats) -> _Flight:
        frequencies = slowest * generator.uniform(1.0, 1.3, slowest.shape)
        phases = generator.uniform(-np.pi, np.pi, slowest.shape)
        # Twice the frequency and twice the phase give a figure eight for any phase.
        frequencies[0, :2] = slowest[0, :2]
        phases[0, 1] = 2.0 * phases[0, 0]
        centre = np.append(generator.uniform(-2.0, 2.0, 2), 3.5)
        return cls(centre, speeds, frequencies, phases)

    def positions(self, times: Floats) -> Floats:
        """Return the positions at N times, (N, 3), metres."""
        return self.centre + self._sum(times, self.speeds / self.frequencies, 0.0)

    def velocities(self, times: Floats) -> Floats:
        """Return the velocities at N times, (N, 3), m/s."""
        return self._sum(times, self.speeds, np.pi / 2.0)

    def rotations(self, times: Floats) -> Rotation:
        """Return N attitudes: z along the thrust, x along the horizontal velocity."""
        velocities = self.velocities(times)
        thrust = self._sum(times, self.speeds * self.frequencies, np.pi)
        thrust[:, 2] += GRAVITY
        z = thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
        y = np.cross(z, velocities * [1.0, 1.0, 0.0])
        y /= np.linalg.norm(y, axis=1, keepdims=True)
        return Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=2))

    def _sum(self, times: Floats, amplitudes: Floats, ahead: float) -> Floats:
        angles = times[:, None, None] * self.frequencies + self.phases + ahead
        summed: Floats = np.einsum("nki,ki->ni", np.sin(angles), amplitudes)
        return summed


def _groundtruth(generator: np.random.Generator, flight: _Flight, duration_s: float) -> Trajectory:
    count = int(duration_s * GROUNDTRUTH_RATE_HZ) + 1
    jitter = generator.uniform(-_GROUNDTRUTH_JITTER_S, _GROUNDTRUTH_JITTER_S, count)
    stamps = _stamps(np.arange(count) / GROUNDTRUTH_RATE_HZ + jitter)
    times = (stamps - EPOCH_S * NANOSECONDS) / NANOSECONDS
    return Trajectory(
        stamps=stamps,
        positions=flight.positions(times),
        quaternions=flight.rotations(times).as_quat(),
        velocities=flight.velocities(times),
        frame="world",
        child_frame="base_link",
        name="groundtruth",
    )


def _odometry(generator: np.random.Generator, flight: _Flight, duration_s: float) -> Trajectory:
    step_s = 1.0 / ESTIMATE_RATE_HZ
    # The clocks are not synchronised: the phase is random. All estimates are within the
    # groundtruth.
    start_s = generator.uniform(0.01, 0.04)
    times = np.arange(start_s, duration_s - 0.01, step_s)
    velocities = flight.velocities(times)
    speed = np.linalg.norm(velocities, axis=1, keepdims=True)

    yaw_step = np.radians(_YAW_DEG_PER_SQRT_S) * np.sqrt(step_s)
    yaw = np.cumsum(yaw_step * generator.standard_normal(len(times)))
    rotated = _yaw_rotations(yaw - yaw[0])
    stretch = 1.0 + _SCALE * wandering(generator, len(times), 1, 30.0 * ESTIMATE_RATE_HZ)
    disturbance = (
        _VELOCITY_SHARE * speed * wandering(generator, len(times), 3, 2.0 * ESTIMATE_RATE_HZ)
    )
    steps = np.diff(flight.positions(times), axis=0)
    drifting_steps = stretch[1:] * rotated[1:].apply(steps) + disturbance[1:] * step_s
    positions = np.concatenate([np.zeros((1, 3)), np.cumsum(drifting_steps, axis=0)])

    level = wandering(generator, len(times), 2, 2.0 * ESTIMATE_RATE_HZ)
    tilt = np.zeros((len(times), 3))
    tilt[:, :2] = np.radians(TILT_DEG) * 2.0 * np.tanh(level / 2.0)
    rotations = rotated * Rotation.from_rotvec(tilt) * flight.rotations(times)

    # The odometry's world starts where the flight does, at an arbitrary yaw.
    frame = _yaw_rotations(np.array(generator.uniform(-np.pi, np.pi)))
    delay = np.minimum(generator.exponential(_STAMP_DELAY_S, len(times)), _LONGEST_STAMP_DELAY_S)
    gap_start_s = generator.uniform(0.4, 0.6) * duration_s - _GAP_S / 2.0
    tracked = (times < gap_start_s) | (times >= gap_start_s + _GAP_S)
    return Trajectory(
        stamps=_stamps(times + delay),
        positions=frame.apply(positions),
        quaternions=(frame * rotations).as_quat(),
        velocities=frame.apply(stretch * rotated.apply(velocities) + disturbance),
        frame="odom",
        child_frame="base_link",
        name="odometry",
    )[tracked]


def _yaw_rotations(angle: Floats) -> Rotation:
    return Rotation.from_rotvec(angle[..., None] * np.array([0.0, 0.0, 1.0]))


def wandering(
    generator: np.random.Generator, count: int, columns: int, correlation: float
) -> Floats:
    """Return noise (count, columns) of variance 1, correlated over that many rows."""
    from scipy.signal import lfilter

    memory = np.exp(-1.0 / correlation)
    news = generator.standard_normal((count, columns))
    news[1:] *= np.sqrt(1.0 - memory**2)
    return np.asarray(lfilter([1.0], [1.0, -memory], news, axis=0))


def _stamps(times: Floats) -> NDArray[np.int64]:
    return EPOCH_S * NANOSECONDS + np.rint(times * NANOSECONDS).astype(np.int64)
