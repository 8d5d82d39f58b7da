"""The likelihood against groundtruth whose errors are shared by neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from flights import fly
from hypothesis import given, settings
from strategies import as_matrix, make_element, seeds

from trajeval_ros import AssociationRule, Protocol, Trajectory, assess_likelihood, evaluate
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


@pytest.mark.slow
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
        joint_log_likelihood(groundtruth, item, gauge, alignment(item, gauge))
        for item in (estimate, moved)
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


@pytest.mark.parametrize("order", [2, 3])
def test_timestamps_close_to_each_other(order: int) -> None:
    """Arrival times at 400 Hz, and near-repeats, against groundtruth at 2 Hz."""
    generator = np.random.default_rng(3)
    model = MarkovPoses.fit(SAMPLES, order)
    arrived = 5.0 + np.arange(0.0, 4.0, 1 / 400) + generator.exponential(2e-3, 1600)
    regular = TIMES[10:60]
    for times in (np.sort(arrived), np.sort(np.concatenate([regular, regular[::5] + 5e-6]))):
        poses = model.at(times).poses
        estimate = poses @ se3.exp(generator.normal(scale=0.005, size=(len(times), 6)))
        groundtruth = CorrelatedGroundtruth.of(model, times, Noise(0.005, 0.0035))
        score = joint_log_likelihood(groundtruth, estimate, Gauge.SE3, np.eye(4))
        # As of independent poses near their expected density.
        assert 0.0 < score < 40.0 * len(times)


def test_positions_alone_have_a_joint_likelihood() -> None:
    groundtruth = CorrelatedGroundtruth.of(MarkovPoses(MODEL.positions, None), TIMES, Noise())
    assert groundtruth.rotations is None
    scores = [
        joint_log_likelihood(groundtruth, item, Gauge.SE3, alignment(item, Gauge.SE3))
        for item in map(poses_of, range(3))
    ]
    assert scores == sorted(scores, reverse=True)


def test_rest_has_no_scale() -> None:
    groundtruth = CorrelatedGroundtruth.of(MODEL, TIMES, Noise())
    resting = np.tile(np.eye(4), (len(TIMES), 1, 1))
    with pytest.raises(DegenerateGeometryError, match="such as the scale of a body at rest"):
        joint_log_likelihood(groundtruth, resting, Gauge.SIM3, np.eye(4))


@pytest.mark.slow
def test_without_a_scale_the_reason_is_stated() -> None:
    """A constant rotation of the body, as of a marker: the most likely scale is zero."""

    def moving(rate_hz: float, turn_rad: float, noise_m: float) -> Trajectory:
        times = np.arange(0.0, 60.0, 1.0 / rate_hz)
        path = np.stack(
            [3 * np.sin(0.5 * times), 2 * np.cos(0.7 * times), 0.5 * np.sin(0.9 * times)]
        )
        noise = noise_m * np.random.default_rng(1).normal(size=(len(times), 3))
        half = 0.1 * times + 0.5 * turn_rad
        rotations = np.stack([0.0 * times, 0.0 * times, np.sin(half), np.cos(half)], axis=1)
        return Trajectory((1e9 * times).astype(np.int64), path.T + noise, rotations)

    groundtruth, estimate = moving(2.0, 2.2, 0.0), moving(10.0, 0.0, 0.01)
    rule = AssociationRule("continuous")
    for gauge in ("yaw", "se3"):
        protocol = Protocol(gauge=gauge, association=rule, lengths=())
        result = assess_likelihood(evaluate(groundtruth, estimate, protocol))
        assert result.gauge_scores is not None
        assert result.gauge_scores.sim3 is None
        [text] = [statement for statement in result.statements if "sim3" in statement]
        assert text.startswith("no likelihood in gauge sim3: the most likely scale is zero")
        has_ate = result.ate.supported_m is not None
        assert has_ate is not any(
            "no ATE of supported" in statement for statement in result.statements
        )
    protocol = Protocol(gauge="sim3", association=rule, lengths=())
    with pytest.raises(DegenerateGeometryError, match="--hand-eye auto"):
        assess_likelihood(evaluate(groundtruth, estimate, protocol))
