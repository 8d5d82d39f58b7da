"""Good groundtruth made poor: fewer samples, dropouts and noise; the good one is the truth."""

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

# From an end of a stretch that has one dropout, so that neither two meet nor an end is lost.
_MARGIN_S = 1.0


@dataclass(frozen=True)
class Degradation:
    """What is done to a groundtruth.

    Attributes:
        rate_hz: Samples a second that are kept.
        dropouts: Times at which some seconds are lost, one in each of as many equal stretches.
        shortest_s: Of a dropout.
        longest_s: Of a dropout.
        noise: Added to what is kept.
        seed: Of all that is random.
    """

    rate_hz: float = 2.0
    dropouts: int = 3
    shortest_s: float = 1.0
    longest_s: float = 2.5
    noise: Noise = dataclasses.field(default_factory=Noise)
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what can't be done."""
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
        """Return the poor groundtruth.

        Raises:
            InputError: It is too short for so many dropouts.
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
