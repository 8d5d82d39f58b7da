"""Equations (16) and (17) of the probabilistic paper to the letter, to compare with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.geometry import se3
from trajeval_ros.likelihood.relative_density import (
    RelativeErrorDensity,
    decomposed,
    relative_poses,
)

Array = NDArray[np.float64]


def relative_errors(poses: Array, estimate: Array) -> Array:
    """Return e_i (M - 1, 6) of groundtruth and estimated poses (M, 4, 4): eq. (16)."""
    return se3.log(se3.inverse(relative_poses(poses)) @ relative_poses(estimate))


def generalised_relative_error(belief: Belief, estimate: Array) -> RelativeErrorDensity:
    """Return P_RE of M poses, eq. (17)."""
    return decomposed(belief, relative_errors(belief.poses, estimate))
