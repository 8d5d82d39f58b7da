"""The steps of an IMU between knots of equal distance, and the motion that they measure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, runs_of
from trajeval_ros.geometry.inertial import ImuNoise, integrated, preintegrate
from trajeval_ros.geometry.interpolation import columns_at

_AT_REST_RADPS, _SECOND_AXIS_RADPS = 0.05, 0.1
_LONGEST_S = 0.05  # a longer step of the IMU is a gap
_FEWEST_SATURATED = 4  # readings in a row at the extreme of an axis
_DOUBTFUL = 1e4  # factor on the covariance of an interval with a gap or saturated readings
# Variances that keep the covariance of an exact interval regular: rad^2, m^2/s^2, m^2.
_LEAST = np.diag(np.repeat([1e-14, 1e-14, 1e-16], 3))


@dataclass(frozen=True, eq=False)
class ImuSeconds:
    """Readings of an IMU by seconds, in order."""

    seconds: Floats  # (N,)
    rates: Floats  # (N, 3), rad/s
    accelerations: Floats  # (N, 3), m/s^2; zeros without an accelerometer
    origin: int = 0  # timestamp of second 0, ns

    @property
    def turns(self) -> bool:
        """Whether the rig turns at all."""
        rates = self.rates - np.median(self.rates, axis=0)
        return bool(np.square(rates).sum(axis=1).mean() > _AT_REST_RADPS**2)

    @property
    def gaps(self) -> Booleans:
        """Whether there are no readings in a step (N - 1,)."""
        return np.asarray(np.diff(self.seconds) > _LONGEST_S)

    @property
    def saturated(self) -> Booleans:
        """Whether an end of a step (N - 1,) is in a row of readings at an axis's extreme."""
        saturated = np.zeros(len(self.seconds), dtype=bool)
        for column in np.column_stack([self.rates, self.accelerations]).T:
            is_extreme = (np.abs(column) == np.abs(column).max()) & (column != 0.0)
            for begin, end in runs_of(is_extreme):
                saturated[begin:end] |= end - begin >= _FEWEST_SATURATED
        return np.asarray(saturated[1:] | saturated[:-1])


def turns_about_one_axis(rates: Floats) -> bool:
    """Return whether angular velocities (N, 3), rad/s, are about one axis."""
    return float(np.linalg.eigvalsh(np.cov(rates.T))[1]) < _SECOND_AXIS_RADPS**2


class Motions(NamedTuple):
    """The motion of K intervals before each of their m steps, and after the last one."""

    rotations: Floats  # (K, m + 1, 3, 3), in the axes of the interval's knot
    velocities: Floats  # (K, m + 1, 3), without gravity
    positions: Floats  # (K, m + 1, 3), without gravity and first velocity


class InertialSteps:
    """The readings between K + 1 knots, linearly interpolated at the knots, in m padded steps."""

    def __init__(self, knots: Floats, imu: ImuSeconds) -> None:
        """Cut the readings at the knots (K + 1,), which are within the readings."""
        within = (imu.seconds > knots[0]) & (imu.seconds < knots[-1])
        self.times = np.union1d(knots, imu.seconds[within])
        self.first: Indices = np.searchsorted(self.times, knots)
        self.knots, self.durations_s = knots, np.diff(knots)
        rows = self.first[:-1, None] + np.arange(int(np.diff(self.first).max()))
        real = rows < self.first[1:, None]
        rows = np.minimum(rows, self.first[1:, None] - 1)
        self.held = np.where(real, np.diff(self.times)[rows], 0.0)
        self.starts = np.pad(np.cumsum(self.held, axis=1), [(0, 0), (1, 0)])
        both = np.hstack([imu.rates, imu.accelerations])
        result = columns_at(imu.seconds, both, self.times)
        middles = (0.5 * (result[1:] + result[:-1]))[rows]
        self.rates, self.accelerations = middles[..., :3], middles[..., 3:]
        places = np.searchsorted(imu.seconds, self.times[:-1], side="right") - 1
        doubtful = (imu.gaps | imu.saturated)[np.clip(places, 0, len(imu.seconds) - 2)]
        self.doubtful = (doubtful[rows] & real).any(axis=1)

    def motions(self, biases: Floats) -> Motions:
        """Integrate the readings minus the biases (K, 6) of the intervals."""

        def motions(rates: Floats, forces: Floats, held: Floats, biases: Floats) -> Motions:
            halves = so3.exp((rates - biases[:, None, :3]) * held[:, :, None] / 2.0)
            rotated = np.einsum("nkij,nkj->nki", halves, forces - biases[:, None, 3:])
            return Motions(*integrated(halves @ halves, rotated, held))

        return Motions(*lie.by_blocks(motions, self.rates, self.accelerations, self.held, biases))

    def uncertainty(self, bias: Floats, noise: ImuNoise) -> tuple[Floats, Floats]:
        """Return covariances (K, 9, 9) and derivatives by the biases (K, 9, 6) at a bias (3,)."""
        result = preintegrate(self.rates - bias, self.accelerations, self.held, noise)
        factor = np.where(self.doubtful, _DOUBTFUL, 1.0)[:, None, None]
        return result.covariances * factor + _LEAST, result.by_biases
