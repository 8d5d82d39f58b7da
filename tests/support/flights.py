"""An analytic flight, sampled by a slow groundtruth with dropouts, and three estimators of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.alignment import align

Array = NDArray[np.float64]
START = 1_700_000_000_000_000_000
_POSITION_HZ = [[0.05, 0.09, 0.21, 0.43], [0.06, 0.11, 0.25, 0.39], [0.04, 0.12, 0.3, 0.5]]
_POSITION_M = [[4.0, 2.0, 0.5, 0.12], [3.0, 2.0, 0.5, 0.15], [1.0, 0.4, 0.15, 0.05]]
_EULER_HZ = [[0.17, 0.43, 0.61], [0.19, 0.37, 0.66], [0.05, 0.13, 0.4]]
_EULER_RAD = [[0.18, 0.1, 0.04], [0.18, 0.1, 0.04], [2.2, 0.6, 0.15]]
DRIFTS_M = (0.01, 0.03, 0.1)


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight at 2 m/s.

    Attributes:
        groundtruth: A few samples a second, noisy, with three dropouts.
        truth: The flight itself at the estimates' times.
        estimates: From the best to the worst, in the same frame.
    """

    groundtruth: Trajectory
    truth: Trajectory
    estimates: tuple[Trajectory, ...]

    def true_ate_m(self, place: int) -> float:
        """Return the position rmse of an estimate, aligned with the flight itself."""
        return plain_ate_m(self.truth.positions, self.estimates[place].positions)


def plain_ate_m(groundtruth: Array, estimate: Array) -> float:
    aligned = align(Gauge.SE3, groundtruth, estimate).similarity.positions(estimate)
    return float(np.sqrt(np.mean(np.sum((aligned - groundtruth) ** 2, axis=1))))


def fly(
    seed: int,
    *,
    rate_hz: float = 2.0,
    duration_s: float = 55.0,
    estimate_hz: float = 20.0,
    noise: Noise | None = None,
) -> Flight:
    noise = noise or Noise()
    random = np.random.default_rng(seed)
    phases = random.uniform(0.0, 2.0 * np.pi, size=(2, 3, 4))
    slow = np.arange(0.0, duration_s, 1.0 / rate_hz)
    for begin in np.linspace(4.0, duration_s - 14.0, 3) + random.uniform(0.0, 8.0, size=3):
        length = random.uniform(1.0, 2.5)
        slow = slow[(slow < begin) | (slow > begin + length)]
    samples = _motion(slow, phases)
    assert samples.rotations is not None
    groundtruth = Trajectory(
        samples.stamps,
        samples.positions + random.normal(scale=noise.position_m, size=samples.positions.shape),
        (
            samples.rotations
            * Rotation.from_rotvec(random.normal(scale=noise.rotation_rad, size=(len(slow), 3)))
        ).as_quat(),
    )
    times = np.arange(0.013, slow[-1], 1.0 / estimate_hz)
    truth = _motion(times, phases)
    return Flight(
        groundtruth, truth, tuple(_drifted(truth, times, size, random) for size in DRIFTS_M)
    )


def _motion(times: Array, phases: Array) -> Trajectory:
    angles = 2.0 * np.pi * np.array(_POSITION_HZ) * times[:, None, None] + phases[0]
    positions = (np.array(_POSITION_M) * np.sin(angles)).sum(axis=2)
    angles = 2.0 * np.pi * np.array(_EULER_HZ) * times[:, None, None] + phases[1, :, :3]
    euler = (np.array(_EULER_RAD) * np.sin(angles)).sum(axis=2)
    stamps = START + np.round(1e9 * times).astype(np.int64)
    return Trajectory(stamps, positions, Rotation.from_euler("ZYX", euler[:, ::-1]).as_quat())


def _drifted(
    truth: Trajectory, times: Array, size_m: float, random: np.random.Generator
) -> Trajectory:
    """Return it with errors that come and go within some seconds, of zero mean and no tilt."""
    waves = random.uniform(0.05, 0.4, size=(6, 6))
    angles = 2.0 * np.pi * waves * times[:, None, None]
    errors = np.sin(angles + random.uniform(0.0, 2.0 * np.pi, size=(6, 6))).sum(axis=2)
    errors -= errors.mean(axis=0)
    errors *= np.array([size_m] * 3 + [0.3 * size_m] * 3) / 3.0
    assert truth.rotations is not None
    return Trajectory(
        truth.stamps,
        truth.positions + errors[:, :3],
        (truth.rotations * Rotation.from_rotvec(errors[:, 3:])).as_quat(),
    )
