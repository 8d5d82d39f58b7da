"""The likelihood against groundtruth whose errors are shared by neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from flights import fly
from hypothesis import given, settings
from strategies import as_matrix, make_element, seeds

from trajeval_ros.continuous_time.continuous_trajectory import MarkovPoses, fit_trajectory
from trajeval_ros.continuous_time.samples import Belief, Noise
from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.alignment_chart import act
from trajeval_ros.likelihood.correlated_groundtruth import (
    CorrelatedGroundtruth,
    joint_log_likelihood,
)
from trajeval_ros.likelihood.marginal import generalised_absolute_error
from trajeval_ros.likelihood.residuals import Residuals

FLIGHT = fly(2, duration_s=30.0, estimate_hz=4.0)
SAMPLES = fit_trajectory(FLIGHT.groundtruth).samples
TIMES = SAMPLES.seconds(FLIGHT.truth.stamps)
MODEL = MarkovPoses.fit(SAMPLES, 2)


def poses_of(place: int) -> np.ndarray:
    estimate = FLIGHT.estimates[place]
    assert estimate.rotations is not None
    return se3.poses(estimate.rotations.as_matrix(), estimate.positions)


def alignment(estimate: np.ndarray, gauge: Gauge) -> np.ndarray:
    belief = Belief(MODEL.at(TIMES).poses, np.tile(0.01 * np.eye(6), (len(TIMES), 1, 1)))
    return generalised_absolute_error(Residuals(belief, estimate, gauge)).mode.element


@pytest.mark.parametrize(
    "gauge", [Gauge.YAW, Gauge.SE3, Gauge.SIM3, Gauge.TRANSLATION, Gauge.NONE]
)
@given(seed=seeds)
@settings(max_examples=3)
def test_no_frame_matters(gauge: Gauge, seed: int) -> None:
    groundtruth = CorrelatedGroundtruth.of(MODEL, TIMES, Noise(0.005, 0.003))
    estimate = poses_of(1)
    moved = act(as_matrix(make_element(gauge, seed)), estimate)
    here, there = (
        joint_log_likelihood(groundtruth, each, gauge, alignment(each, gauge))
        for each in (estimate, moved)
    )
    assert there == pytest.approx(here, abs=1e-5)


def test_what_hides_the_groundtruths_errors_makes_poses_independent() -> None:
    """At the samples, with a tolerance far above their noise, correlations don't matter."""
    times, truth = SAMPLES.times[1:-1], SAMPLES.poses[1:-1]
    errors = np.random.default_rng(0).normal(scale=0.05, size=(len(times), 6))
    estimate = truth @ se3.exp(errors)
    covariances = np.tile(np.diag([0.25] * 3 + [0.09] * 3), (len(times), 1, 1))
    belief = Belief(MODEL.at(times).poses, covariances)
    single = generalised_absolute_error(Residuals(belief, estimate, Gauge.YAW))
    groundtruth = CorrelatedGroundtruth.of(MODEL, times, Noise(0.5, 0.3))
    joint = joint_log_likelihood(groundtruth, estimate, Gauge.YAW, single.mode.element)
    assert joint == pytest.approx(single.log_likelihood, abs=0.05)


def test_positions_alone_have_a_joint_likelihood() -> None:
    groundtruth = CorrelatedGroundtruth.of(MarkovPoses(MODEL.positions, None), TIMES, Noise())
    assert groundtruth.rotations is None
    scores = [
        joint_log_likelihood(groundtruth, each, Gauge.SE3, alignment(each, Gauge.SE3))
        for each in map(poses_of, range(3))
    ]
    assert scores == sorted(scores, reverse=True)


def test_rest_has_no_scale() -> None:
    groundtruth = CorrelatedGroundtruth.of(MODEL, TIMES, Noise())
    resting = np.tile(np.eye(4), (len(TIMES), 1, 1))
    with pytest.raises(DegenerateGeometryError, match="such as the scale of a body at rest"):
        joint_log_likelihood(groundtruth, resting, Gauge.SIM3, np.eye(4))
