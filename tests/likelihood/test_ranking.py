"""Three estimators against a 2 Hz groundtruth with dropouts: who can tell which one is best?"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from flights import DRIFTS_M, Flight, fly, plain_ate_m
from numpy.typing import NDArray

from trajeval_ros.continuous_time.continuous_trajectory import MarkovPoses, fit_trajectory
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.covariance_frames import world_from_body_twists
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.correlated_groundtruth import (
    CorrelatedGroundtruth,
    joint_log_likelihood,
)
from trajeval_ros.likelihood.marginal import generalised_absolute_error
from trajeval_ros.likelihood.residuals import Residuals
from trajeval_ros.likelihood.uncertain_ate import UncertainAte, uncertain_ate

Array = NDArray[np.float64]


@cache
def scored(seed: int) -> tuple[Array, Array, list[UncertainAte]]:
    """Return the true ATE and that by nearest samples (3,), and the uncertain ones."""
    flight = fly(seed)
    stamps = flight.truth.stamps
    fitted = fit_trajectory(flight.groundtruth)
    belief = fitted.at(stamps)
    covariances = world_from_body_twists(belief.covariances, belief.poses[:, :3, :3])[:, :3, :3]
    times = fitted.samples.seconds(stamps)
    nearest = fit_trajectory(flight.groundtruth, "nearest").at(stamps).poses[:, :3, 3]
    estimates = [estimate.positions for estimate in flight.estimates]
    return (
        np.array([plain_ate_m(flight.truth.positions, estimate) for estimate in estimates]),
        np.array([plain_ate_m(nearest, estimate) for estimate in estimates]),
        [
            uncertain_ate(
                times, belief.poses[:, :3, 3], covariances, estimate, Gauge.SE3, fitted.samples
            )
            for estimate in estimates
        ],
    )


@pytest.mark.slow
def test_ranking_and_interval_over_forty_flights() -> None:
    flights = [scored(seed) for seed in range(40)]
    weighted = np.array([[item.weighted_m for item in ates] for _, _, ates in flights])
    nearest = np.array([item for _, item, _ in flights])
    true = np.array([item for item, _, _ in flights])
    assert np.mean((np.diff(weighted, axis=1) > 0.0).all(axis=1)) >= 0.97
    assert np.mean((np.diff(nearest, axis=1) > 0.0).all(axis=1)) <= 0.80
    assert np.median(weighted / true, axis=0) == pytest.approx([1.2, 1.06, 1.03], abs=0.15)
    supported = np.array([[item.supported_m or np.nan for item in ates] for _, _, ates in flights])
    assert np.median(supported / true, axis=0) == pytest.approx([1.0, 1.0, 1.0], abs=0.1)
    covered = [
        [
            item.interval_m is not None and item.interval_m[0] <= ate <= item.interval_m[1]
            for ate, item in zip(flight[0], flight[2], strict=True)
        ]
        for flight in flights
    ]
    assert np.mean(covered) >= 0.95


def test_a_fair_ate_where_nearest_groundtruth_is_useless() -> None:
    true, nearest, ates = scored(0)
    assert nearest[0] > 4.0 * true[0]
    for ate, item in zip(true, ates, strict=True):
        assert item.supported_m == pytest.approx(ate, rel=0.2)
        assert item.interval_m is not None
        assert item.interval_m[0] < ate < item.interval_m[1]
    assert 0.5 < ates[2].supported_share < 1.0
    assert len(DRIFTS_M) == len(ates)


def bayes_factors(flight: Flight) -> tuple[float, float]:
    """Return the log Bayes factor of the best estimate against the next: jointly, and not."""
    samples = fit_trajectory(flight.groundtruth).samples
    times = samples.seconds(flight.truth.stamps)
    model = MarkovPoses.fit(samples, 2)
    belief = model.at(times)
    tolerance = Noise(0.005, np.radians(0.2))
    groundtruth = CorrelatedGroundtruth.of(model, times, tolerance)
    diagonal = np.square([0.005] * 3 + [tolerance.rotation_rad] * 3)
    belief.covariances[:] += np.diag(diagonal)
    joint, single = [], []
    for estimate in flight.estimates[:2]:
        assert estimate.rotations is not None
        poses = se3.poses(estimate.rotations.as_matrix(), estimate.positions)
        error = generalised_absolute_error(Residuals(belief, poses, Gauge.SE3))
        single.append(error.log_likelihood)
        joint.append(joint_log_likelihood(groundtruth, poses, Gauge.SE3, error.mode.element))
    return joint[0] - joint[1], single[0] - single[1]


@pytest.mark.slow
def test_evidence_does_not_grow_with_the_estimates_rate() -> None:
    slow = bayes_factors(fly(5, estimate_hz=5.0))
    fast = bayes_factors(fly(5, estimate_hz=40.0))
    assert slow[0] > 0.0
    assert fast[1] > 6.0 * slow[1]
    assert fast[0] < 4.0 * slow[0]
