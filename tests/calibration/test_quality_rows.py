"""Normal equations, noise and repair of the groundtruth quality check, on a few knots."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from examined_rigs import START_NS
from numpy.typing import NDArray
from small_rigs import Small, small_rig

from trajeval_ros.calibration.groundtruth_quality.joint_fit import JointFit
from trajeval_ros.calibration.groundtruth_quality.repair import repaired
from trajeval_ros.calibration.groundtruth_quality.rig import LEVER
from trajeval_ros.calibration.groundtruth_quality.sample_checks import PoseSpan
from trajeval_ros.calibration.groundtruth_quality.sample_rows import rig_at
from trajeval_ros.geometry.trajectory import Trajectory

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def small() -> Small:
    return small_rig()


def dense(fit: JointFit) -> tuple[Array, Array]:
    """Return the information (85, 85) of five states and the calibration, and the gradient."""
    (_, before, after, by_rig), samples = fit._rows()
    assert after is not None
    width = 5 * 15 + 10
    information, gradient = np.zeros((width, width)), np.zeros(width)

    def add(jacobian: Array, residual: Array) -> None:
        nonlocal information, gradient
        information += jacobian.T @ jacobian
        gradient += jacobian.T @ residual

    for knot in range(4):
        jacobian = np.zeros((15, width))
        jacobian[:, 15 * knot : 15 * knot + 15] = before[knot]
        jacobian[:, 15 * knot + 15 : 15 * knot + 30] = after[knot]
        jacobian[:, 75:] = by_rig[knot, :, :-1]
        add(jacobian, by_rig[knot, :, -1])
    for knot, by_state, _, columns in zip(*samples[:2], samples[0], samples[3], strict=True):
        jacobian = np.zeros((6, width))
        jacobian[:, 15 * knot : 15 * knot + 15] = by_state
        jacobian[:, 75:] = columns[:, :-1]
        add(jacobian, columns[:, -1])
    for column, sigma in zip(range(9, 15), np.repeat([0.2, 1.0], 3), strict=True):
        jacobian = np.eye(width)[[column]] / sigma
        add(jacobian, fit.rig.biases[0, [column - 9]] / sigma)
    for axis in range(3):
        add(np.eye(width)[[78 + axis]] / 0.5, fit.rig.lever[[axis]] / 0.5)
    information[:75, :75] += np.diag(np.tile(np.repeat([1e-6, 1e-9], [9, 6]), 5))
    return information, gradient


def test_normal_equations_are_dense_ones(small: Small) -> None:
    fit = small.fit()
    information, gradient = dense(fit)
    inverse = np.linalg.inv(information)
    step = -inverse @ gradient
    model = inverse[75:, 75:]
    scale = np.sqrt(np.outer(np.diag(model), np.diag(model)))
    np.testing.assert_allclose(fit.covariance_of_model / scale, model / scale, atol=1e-6)
    calibration = -fit._step_inverse @ fit._gradient
    sigma = np.sqrt(np.diag(model))
    np.testing.assert_allclose(calibration / sigma, step[75:] / sigma, atol=1e-4)
    states = -fit._by_gradient - fit._by_calibration @ calibration
    sigmas = np.sqrt(np.diag(inverse)[:75].reshape(5, 15))
    np.testing.assert_allclose(states / sigmas, step[:75].reshape(5, 15) / sigmas, atol=1e-4)
    pose = np.r_[6:9, 0:3]
    for knot, result in enumerate(fit.pose_covariances()):
        rows = 15 * knot + pose
        unit = np.outer(sigmas[knot, pose], sigmas[knot, pose])
        np.testing.assert_allclose(result / unit, inverse[np.ix_(rows, rows)] / unit, atol=1e-6)


def test_a_fixed_direction_of_the_lever_arm_does_not_move(small: Small) -> None:
    axis = np.array([0.6, 0.0, 0.8])
    fit = small.fit(fixed=(axis,))
    step = -(fit._step_inverse @ fit._gradient)[LEVER]
    across = np.array([-0.8, 0.0, 0.6])
    # Its prior draws it to zero, with a standard deviation of 0.1 mm.
    assert axis @ (small.rig.lever + step) == pytest.approx(0.0, abs=1e-3)
    variances = [item @ fit.covariance_of_model[LEVER, LEVER] @ item for item in (axis, across)]
    assert variances[0] == pytest.approx(1e-8, rel=1e-3)
    assert variances[1] > 1e-6


def test_rows_are_over_their_standard_deviations(small: Small) -> None:
    rows = small.fit().rows
    sigmas = np.arange(1.0, 7.0)
    [(knots, by_state, by_rig)] = rows.weighted(sigmas)
    weights = np.sqrt(rows.shares) / sigmas
    np.testing.assert_array_equal(knots, rows.knots)
    np.testing.assert_allclose(by_rig[..., -1], rows.residuals * weights)
    np.testing.assert_allclose(by_state[:, :, 4], rows.by_state[:, :, 4] * weights)
    np.testing.assert_allclose(by_rig[:, :, 9], rows.by_rig[:, :, 9] * weights)
    # Four samples of 40 Hz are usual, and an interval of three has less information.
    assert rows.knots.tolist() == [0, 1, 2, 3]
    counts = np.bincount(small.fit().predicted.knots)
    expected = np.minimum(counts / np.median(counts), 1.0)
    np.testing.assert_allclose(rows.shares, np.repeat(expected[:, None], 6, axis=1))


def test_positions_of_a_car_are_not_trusted_more_than_its_imu_over_a_knot() -> None:
    """Otherwise its clock is wrong by 10 ms, since its turns hardly determine it."""
    result = []
    for axes in (3, 1):
        made = small_rig()
        made.steps.rates[..., : 3 - axes] = 0.0
        fit = made.fit(sigmas=(1e-4, 0.02))
        fit._estimate_noise(np.full(2, 1e9))
        result.append(fit.sigmas)
    # White noise of 2e-2 m/s^2/sqrt(Hz), integrated twice over 0.1 s.
    drift_m = 2e-2 * np.sqrt(0.1**3 / 3.0)
    np.testing.assert_allclose(result[0], np.repeat([3e-5, 6e-3], 3))
    np.testing.assert_allclose(result[1], np.repeat([drift_m, 6e-3], 3))


def test_repaired_states_are_those_of_the_imu(small: Small) -> None:
    fit: JointFit = small.fit()
    fit.rig = dataclasses.replace(fit.rig, shift_s=0.005)
    own_ns = START_NS + np.rint(1e9 * (small.samples.seconds - 0.1)).astype(np.int64)
    truth = Trajectory(own_ns, small.samples.positions, small.samples.quaternions, frame="map")
    result = repaired(fit, truth, (), 4.0)
    inside = fit.predicted.rows
    seconds = small.samples.seconds[inside]
    later = 0.02 + 1e-3 * (seconds - small.samples.middle_s)
    expected = own_ns[inside] + 5_000_000 + np.rint(1e9 * later).astype(np.int64)
    np.testing.assert_array_equal(result.stamps, expected)
    states = rig_at(seconds + later, fit.steps, fit.motions, fit.rig)
    np.testing.assert_allclose(result.positions, states.positions, atol=1e-6)
    np.testing.assert_allclose(result.velocities, states.velocities, atol=1e-6)
    assert result.rotations is not None
    np.testing.assert_allclose(result.rotations.as_matrix(), states.rotations, atol=1e-6)
    np.testing.assert_array_equal(result.gyroscope_biases, fit.rig.biases[states.knots, :3])
    assert result.frame == "map"
    ratio = np.median(np.diag(fit.covariance_of_blocks) / np.diag(fit.covariance_of_model))
    scale = 4.0 * max(1.0, float(ratio))
    knot = fit.pose_covariances()[states.knots[0]]
    assert result.covariances is not None
    np.testing.assert_allclose(result.covariances[0, :3, :3], scale * knot[:3, :3], rtol=1e-6)
    rotation = states.rotations[0]
    np.testing.assert_allclose(
        result.covariances[0, 3:, 3:],
        scale * rotation @ knot[3:, 3:] @ rotation.T,
        rtol=1e-6,
        atol=1e-12,
    )
    np.testing.assert_allclose(
        result.covariances[0, :3, 3:], scale * knot[:3, 3:] @ rotation.T, rtol=1e-5, atol=1e-9
    )
    # A gap is bridged by states at the usual distance.
    kept = np.r_[0:4, 10 : len(own_ns)]
    gap = PoseSpan(int(own_ns[3]), (int(own_ns[10]) - int(own_ns[3])) / 1e9)
    again = repaired(fit, truth[kept], (gap,), 4.0)
    np.testing.assert_allclose(again.stamps, result.stamps, atol=1)
