"""Markov processes whose density is known, not found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.continuous_time.manifolds import Manifold
from trajeval_ros.continuous_time.markov import Process

Array = NDArray[np.float64]


def solved(
    manifold: Manifold, order: int, times: Array, measured: Array, noise: float, density: float
) -> Process:
    """Return the process of one density on all axes, at the mode."""
    start = Process.unsolved(manifold, order, times, measured, noise)
    return replace(start, density=np.full_like(start.density, density)).solved()
