"""Good groundtruth made poor, with the rest of it as the truth: what the GP tests measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.continuous_time.continuous_trajectory import ContinuousTrajectory
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.papers.association_study import Degradation

Array = NDArray[np.float64]
LIMIT_95 = 12.591587243743977  # chi2.ppf(0.95, 6)


@dataclass(frozen=True, eq=False)
class Decimated:
    """A recording at a few Hz, with noise and dropouts, and what was left out."""

    samples: Trajectory
    truth: Trajectory
    in_gap: NDArray[np.bool_]


@dataclass(frozen=True)
class Score:
    """Of the poses in some part of a recording."""

    rmse_m: float
    coverage: float
    nees_per_dof: float


def decimated(
    recording: Trajectory, rate_hz: float, seed: int, noise: Noise, *, gaps: int = 4
) -> Decimated:
    """Take samples at a rate, take some seconds away here and there, and add noise."""
    noisy = Degradation(rate_hz, gaps, 1.0, 3.0, noise, seed).of(recording)
    random = np.random.default_rng(seed)
    recording = recording.in_order()
    rows = np.searchsorted(recording.stamps, noisy.stamps)
    inside = np.arange(rows[0] + 1, rows[-1])
    truth = recording[np.sort(random.choice(inside, min(2500, len(inside)), replace=False))]
    place = np.searchsorted(noisy.stamps, truth.stamps, side="right") - 1
    place = np.minimum(place, len(noisy) - 2)
    step = np.diff(noisy.stamps)[place]
    long_enough = (step > 1.5 / rate_hz * NANOSECONDS) & (step > 0.9 * NANOSECONDS)
    # The recording's own dropouts have no truth inside; what is left of them would weigh little.
    return Decimated(noisy, truth, long_enough)


def score(fitted: ContinuousTrajectory, truth: Trajectory) -> Score:
    """Compare what is believed with the truth."""
    belief = fitted.at(truth.stamps)
    assert truth.rotations is not None
    true_poses = se3.poses(truth.rotations.as_matrix(), truth.positions)
    missed = se3.log(se3.inverse(belief.poses) @ true_poses)
    nees = np.einsum(
        "ni,ni->n", missed, np.linalg.solve(belief.covariances, missed[..., None])[..., 0]
    )
    apart = belief.poses[:, :3, 3] - truth.positions
    return Score(
        float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))),
        float(np.mean(nees < LIMIT_95)),
        float(nees.mean() / 6.0),
    )
