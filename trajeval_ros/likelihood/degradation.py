"""Degradation of groundtruth: fewer samples, dropouts and noise."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.trajectory import Trajectory

# Distance of dropouts from the ends of their intervals, so that they do not meet.
_MARGIN_S = 1.0


@dataclass(frozen=True)
class Degradation:
    """The settings of a degradation.

    Attributes:
        rate_hz: Rate of the kept samples.
        dropouts: Number of dropouts, one in every one of as many equal intervals.
        shortest_s: Shortest dropout, seconds.
        longest_s: Longest dropout, seconds.
        noise: Noise added to the samples.
        seed: Seed of the random numbers.

    Raises:
        SettingsError: A value is out of range.
    """

    rate_hz: float = 2.0
    dropouts: int = 3
    shortest_s: float = 1.0
    longest_s: float = 2.5
    noise: Noise = dataclasses.field(default_factory=Noise)
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        if not 0.0 < self.rate_hz < 1e6:
            raise SettingsError(f"the rate must be greater than 0 Hz, not {self.rate_hz:g}")
        if self.dropouts < 0:
            raise SettingsError(f"the number of dropouts must be at least 0, not {self.dropouts}")
        if not 0.0 < self.shortest_s <= self.longest_s:
            raise SettingsError(
                "the shortest and longest duration of a dropout must be greater than 0 and in "
                f"ascending order, not {self.shortest_s:g},{self.longest_s:g}"
            )

    def of(self, groundtruth: Trajectory) -> Trajectory:
        """Return the degraded groundtruth.

        Raises:
            InputError: The groundtruth is too short for the dropouts.
        """
        random = np.random.default_rng(self.seed)
        groundtruth = groundtruth.in_order()
        seconds = groundtruth.seconds
        step = 1.0 / self.rate_hz
        wanted = np.arange(random.uniform(0.0, step), seconds[-1], step)
        rows = np.unique(np.clip(np.searchsorted(seconds, wanted), 0, len(seconds) - 1))
        rows = rows[~self._lost(seconds[rows], float(seconds[-1]), random)]
        kept = groundtruth[rows]
        shape = (len(rows), 3)
        positions = kept.positions + random.normal(scale=self.noise.position_m, size=shape)
        turns = random.normal(scale=self.noise.rotation_rad, size=shape)
        turned = None if kept.rotations is None else kept.rotations * Rotation.from_rotvec(turns)
        return dataclasses.replace(
            kept,
            positions=positions,
            quaternions=None if turned is None else turned.as_quat(),
            velocities=None,
            gyroscope_biases=None,
            accelerometer_biases=None,
            covariances=None,
            matrices=None,
        )

    def _lost(self, times: Floats, end: float, random: np.random.Generator) -> Booleans:
        """Return which times (N,), seconds, are in a dropout."""
        lost = np.zeros(len(times), dtype=bool)
        if not self.dropouts:
            return lost
        room = end / self.dropouts - 2.0 * _MARGIN_S - self.longest_s
        if room < 0.0:
            raise InputError(
                f"{counted(self.dropouts, 'dropout')} of up to {self.longest_s:g} s, "
                f"{2 * _MARGIN_S:g} s apart, do not fit into {end:.1f} s of groundtruth; use "
                "fewer or shorter dropouts"
            )
        for begin in np.arange(self.dropouts) * end / self.dropouts:
            start = begin + _MARGIN_S + random.uniform(0.0, room)
            length = random.uniform(self.shortest_s, self.longest_s)
            lost |= (times > start) & (times < start + length)
        return lost
