"""Drift: relative errors per length of the sub-trajectories.

Position in percent of the length, rotation in degrees per metre (tutorial, section IV-B; KITTI).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.relative_errors import RelativeErrors
from trajeval_ros.metrics.statistics import Statistics, statistics_in_place

PERCENT = 100.0
# Error to the name of its drift, and to the drift's units per error and metre.
PER_LENGTH = {
    "position_m": ("position_percent", PERCENT),
    "rotation_deg": ("rotation_deg_per_m", 1.0),
}


@dataclass(frozen=True)
class Drift:
    """The drift of an estimate over sub-trajectories of one length.

    Attributes:
        percent: Statistics of the position error in percent of the length.
        length_m: The length, metres.
    """

    percent: Statistics
    length_m: float


def position_percent(errors_m: Floats, length_m: float) -> Floats:
    """Return position errors (K,), metres, in percent of the sub-trajectory length."""
    percent: Floats = errors_m * (PERCENT / length_m)
    return percent


def statistics_per_length(
    position: Statistics | None, rotation: Statistics | None, length_m: float | None
) -> dict[str, Statistics | None]:
    """Return the statistics of drift by metric; None without errors or without a length in metres.

    Args:
        position: Statistics of errors in metres.
        rotation: Statistics of errors in degrees.
        length_m: Length of the sub-trajectories, metres; None if the length is a duration.
    """
    percent = per_metre = None
    if length_m is not None and position is not None:
        percent = position.scaled(PERCENT / length_m)
        per_metre = None if rotation is None else rotation.scaled(1.0 / length_m)
    return {"position_percent": percent, "rotation_deg_per_m": per_metre}


class PooledDrift:
    """Drift over sub-trajectories of several lengths together, as in the KITTI ranking."""

    def __init__(self, most: int) -> None:
        """Create it empty, with space for `most` sub-trajectories."""
        self._shares = {name: np.empty(most) for name in PER_LENGTH}
        self._counts = dict.fromkeys(PER_LENGTH, 0)

    def add(self, errors: RelativeErrors, length_m: float) -> None:
        """Add the relative errors of sub-trajectories of a length, metres."""
        for name, (_, units) in PER_LENGTH.items():
            column = getattr(errors, name)
            if column is not None:
                end = self._counts[name] + len(column)
                np.multiply(
                    column, units / length_m, out=self._shares[name][self._counts[name] : end]
                )
                self._counts[name] = end

    def statistics(self) -> dict[str, Statistics | None]:
        """Return the statistics by metric, None without errors, and release the memory."""
        return {
            share: statistics_in_place(self._shares.pop(name)[: self._counts[name]])
            for name, (share, _) in PER_LENGTH.items()
        }
