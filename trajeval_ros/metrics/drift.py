"""Drift: relative errors as shares of the length of the sub-trajectories that they grew over.

Positions in percent of the length, rotations in degrees per metre (tutorial, sec. IV-B; KITTI).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.errors import RelativeErrors
from trajeval_ros.metrics.statistics import Statistics, statistics_of

PERCENT = 100.0
# Of each error, the name of its share of the length, and the share's units in an error per metre.
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
    """Return position errors (K,), metres, in percent of the length that they grew over."""
    percent: Floats = errors_m * (PERCENT / length_m)
    return percent


def statistics_per_length(
    position: Statistics | None, rotation: Statistics | None, length_m: float | None
) -> dict[str, Statistics | None]:
    """Return the statistics of drift by metric; None without errors or a length in metres.

    Args:
        position: Of errors in metres.
        rotation: Of errors in degrees.
        length_m: That they grew over, metres; None where the length is a duration.
    """
    percent = per_metre = None
    if length_m is not None and position is not None and rotation is not None:
        percent, per_metre = position.scaled(PERCENT / length_m), rotation.scaled(1.0 / length_m)
    return {"position_percent": percent, "rotation_deg_per_m": per_metre}


def pooled_drift(
    by_length: Sequence[tuple[RelativeErrors, float]],
) -> dict[str, Statistics | None]:
    """Return the statistics of drift over the sub-trajectories of all lengths, as KITTI ranks by.

    Args:
        by_length: Relative errors, and the length in metres that they grew over.
    """
    if not by_length:
        return {"position_percent": None, "rotation_deg_per_m": None}
    percent = [position_percent(errors.position_m, length) for errors, length in by_length]
    per_metre = [errors.rotation_deg / length for errors, length in by_length]
    return {
        "position_percent": statistics_of(np.concatenate(percent)),
        "rotation_deg_per_m": statistics_of(np.concatenate(per_metre)),
    }
