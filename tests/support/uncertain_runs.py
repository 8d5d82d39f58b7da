"""Runs whose messages have covariances."""

from __future__ import annotations

import dataclasses

import numpy as np
from live_runs import COUNT
from strategies import make_pair

from trajeval_ros import CovarianceRequest, Trajectory

MESSAGE = CovarianceRequest("message", groundtruth_noise=(0.01, 0.2))
OPTIONS = ("--covariance", "message", "--groundtruth-noise", "0.01,0.2")


def sides(seed: int) -> tuple[Trajectory, Trajectory]:
    """Return a flight and an estimate with covariances that grow, and no two alike."""
    pair = make_pair(seed, COUNT, smooth=True)
    random = np.random.default_rng(seed)
    roots = random.normal(scale=0.05, size=(len(pair.estimate), 6, 6)) + 0.2 * np.eye(6)
    sizes = np.linspace(0.5, 2.0, len(pair.estimate))[:, None, None]
    covariances = sizes * roots @ np.swapaxes(roots, 1, 2)
    return pair.groundtruth, dataclasses.replace(pair.estimate, covariances=covariances)
