"""Residuals, Jacobians and normal equations of the groundtruth quality check, by differences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from small_rigs import Small, small_rig

from trajeval_ros.calibration.groundtruth_quality.inertial_steps import ImuSeconds, InertialSteps
from trajeval_ros.calibration.groundtruth_quality.joint_fit import JointFit
from trajeval_ros.calibration.groundtruth_quality.rig import (
    BODY,
    GRAVITY,
    LEVER,
    OFFSET,
    SKEW,
    Rig,
    tangents,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_quality.sample_rows import (
    averaged,
    predict,
    rig_at,
)  # fmt: skip
from trajeval_ros.geometry import so3

Array = NDArray[np.float64]
STEP = 1e-6


@pytest.fixture(scope="module")
def small() -> Small:
    return small_rig()


def moved(rig: Rig, knot: int, state: Array, calibration: Array) -> Rig:
    states = np.zeros((len(rig.positions), 15))
    states[knot] = state
    return rig.moved(states, calibration)


def test_a_rig_predicts_its_samples(small: Small) -> None:
    motions = small.steps.motions(small.rig.biases[:-1])
    result = predict(small.samples, small.steps, motions, small.rig)
    own = small.samples.seconds
    seconds = own + 0.02 + 1e-3 * (own - 0.5 * (own[0] + own[-1]))
    inside = np.flatnonzero((seconds >= 0.105) & (seconds < 0.505))
    np.testing.assert_array_equal(result.rows, inside)
    np.testing.assert_allclose(np.linalg.norm(result.position_errors, axis=1), 0.02, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(result.rotation_errors, axis=1), 0.03, rtol=1e-9)
    # The marker's velocity is the derivative of its position.
    ahead, behind = (
        rig_at(seconds[inside] + step, small.steps, motions, small.rig) for step in (STEP, -STEP)
    )
    arm = small.rig.lever
    change = (ahead.positions + ahead.rotations @ arm) - (
        behind.positions + behind.rotations @ arm
    )
    np.testing.assert_allclose(result.marker_velocities, change / (2 * STEP), atol=1e-6)
    rotations = so3.log(np.swapaxes(behind.rotations, 1, 2) @ ahead.rotations) / (2.0 * STEP)
    np.testing.assert_allclose(result.rates, rotations, atol=1e-6)


def test_a_constant_force_without_turns_is_a_parabola() -> None:
    seconds = np.arange(0.0, 1.0, 0.01)
    force = np.array([0.5, -1.0, 9.0])
    imu = ImuSeconds(seconds, np.zeros((100, 3)), np.tile(force, (100, 1)))
    steps = InertialSteps(np.array([0.105, 0.305, 0.505]), imu)
    start = Rotation.from_rotvec([0.2, 0.5, -0.3]).as_matrix()
    rig = Rig(
        np.tile(start, (3, 1, 1)), np.tile([1.0, 2.0, 3.0], (3, 1)), np.tile([4.0, 5, 6], (3, 1)),
        np.tile([0.0, 0.0, 0.0, 0.1, 0.2, 0.3], (3, 1)), np.eye(3), np.zeros(3), 0.0, 0.0,
        np.array([0.0, 0.0, -9.81]),
    )  # fmt: skip
    motions = steps.motions(rig.biases[:-1])
    at = np.array([0.105, 0.2, 0.304, 0.4, 0.5])
    result = rig_at(at, steps, motions, rig)
    assert result.knots.tolist() == [0, 0, 0, 1, 1]
    tau = (at - np.array([0.105, 0.305])[result.knots])[:, None]
    own = force - [0.1, 0.2, 0.3]
    acceleration = start @ own + rig.gravity
    np.testing.assert_allclose(result.since_s, tau, atol=1e-12)
    np.testing.assert_allclose(
        result.velocities, rig.velocities[0] + acceleration * tau, rtol=1e-9
    )
    expected = rig.positions[0] + rig.velocities[0] * tau + 0.5 * acceleration * tau**2
    np.testing.assert_allclose(result.positions, expected, rtol=1e-9)
    np.testing.assert_allclose(result.moved, 0.5 * own * tau**2, atol=1e-12)
    np.testing.assert_allclose(result.rotations, np.tile(start, (5, 1, 1)), atol=1e-12)


def test_rows_of_samples_are_derivatives(small: Small) -> None:
    motions = small.steps.motions(small.rig.biases[:-1])

    def residuals(rig: Rig) -> Array:
        changed = small.steps.motions(rig.biases[:-1])
        result = predict(small.samples, small.steps, changed, rig)
        return averaged(result, rig, small.samples).residuals

    rows = averaged(
        predict(small.samples, small.steps, motions, small.rig), small.rig, small.samples
    )
    assert rows.knots.tolist() == [0, 1, 2, 3]
    nothing = np.zeros(15)
    # A knot is 0.1 s and errors of rotation are 0.03 rad: what the means leave out is smaller.
    rotation = float(np.linalg.norm(small.steps.rates, axis=2).max()) * 0.1
    # The skew is linearised at the first sample of a knot.
    first = small.samples.seconds[[0, 4, 8, 12]] - small.samples.middle_s
    np.testing.assert_allclose(rows.by_rig[..., SKEW], rows.by_rig[..., OFFSET] * first[:, None])
    for column, step in enumerate(STEP * np.eye(10)):
        if column == SKEW:
            continue
        ahead, behind = (
            residuals(moved(small.rig, 0, nothing, sign * step)) for sign in (1.0, -1.0)
        )
        change = (ahead - behind) / (2.0 * STEP)
        np.testing.assert_allclose(
            rows.by_rig[..., column], change, atol=1e-6 + 0.04 * np.abs(change).max()
        )
    for column, step in enumerate(STEP * np.eye(15)):
        for place, knot in enumerate(rows.knots.tolist()):
            ahead, behind = (
                residuals(moved(small.rig, knot, sign * step, np.zeros(10)))
                for sign in (1.0, -1.0)
            )
            change = (ahead - behind)[place] / (2.0 * STEP)
            error = rotation if column in range(9, 15) else 0.04
            np.testing.assert_allclose(
                rows.by_state[place, :, column],
                change,
                atol=1e-6 + 0.5 * error * np.abs(change).max(),
            )


def test_rows_of_intervals_are_derivatives(small: Small) -> None:
    fit = small.fit()

    def rows(rig: Rig) -> Array:
        again = dataclasses.replace(small, rig=rig).fit()
        by_rig = again._rows_of_intervals(np.arange(4))[2]
        # Whitened by the biases of the start, so that the differences are of residuals.
        residuals = np.linalg.solve(again._whiten, by_rig[:, :9, -1:])[..., 0]
        return np.concatenate([residuals, np.diff(rig.biases, axis=0)], axis=1)

    (knots, before, after, by_rig), _ = fit._rows()
    assert knots.tolist() == [0, 1, 2, 3]
    assert after is not None
    walk = np.repeat([2e-5, 1e-3], 3) * np.sqrt(0.1)
    whiten = np.zeros((4, 15, 15))
    whiten[:, :9, :9], whiten[:, 9:, 9:] = fit._whiten, np.diag(1.0 / walk)
    np.testing.assert_allclose(by_rig[..., -1], (whiten @ rows(small.rig)[..., None])[..., 0])
    knot = 2
    for column, step in enumerate(STEP * np.eye(15)):
        ahead, behind = (
            rows(moved(small.rig, knot, sign * step, np.zeros(10))) for sign in (1.0, -1.0)
        )
        change = (whiten @ ((ahead - behind) / (2 * STEP))[..., None])[..., 0]
        expected = np.zeros((4, 15))
        expected[knot], expected[knot - 1] = before[knot, :, column], after[knot - 1, :, column]
        # Derivatives by biases are those of samples that are held, not of their means.
        close = 0.05 if column >= 9 else 1e-5
        np.testing.assert_allclose(change, expected, atol=1e-4 + close * np.abs(expected).max())
    for column, step in enumerate(STEP * np.eye(10)):
        ahead, behind = (
            rows(moved(small.rig, 0, np.zeros(15), sign * step)) for sign in (1.0, -1.0)
        )
        change = (whiten @ ((ahead - behind) / (2 * STEP))[..., None])[..., 0]
        np.testing.assert_allclose(change, by_rig[..., column], atol=1e-3)


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


def test_a_step_of_a_rig_perturbs_rotations_on_the_right(small: Small) -> None:
    rig, generator = small.rig, np.random.default_rng(1)
    states, calibration = generator.normal(size=(5, 15)), 0.1 * generator.normal(size=10)
    result = rig.moved(states, calibration)
    rotations = np.swapaxes(rig.rotations, 1, 2) @ result.rotations
    np.testing.assert_allclose(
        rotations, Rotation.from_rotvec(states[:, :3]).as_matrix(), atol=1e-12
    )
    before = np.hstack([rig.velocities, rig.positions, rig.biases])
    after = np.hstack([result.velocities, result.positions, result.biases])
    np.testing.assert_allclose(after - before, states[:, 3:], atol=1e-12)
    rotation = so3.log((rig.body.T @ result.body)[None])[0]
    np.testing.assert_allclose(rotation, calibration[BODY], atol=1e-12)
    np.testing.assert_allclose(result.lever - rig.lever, calibration[LEVER], atol=1e-12)
    assert result.offset_s - rig.offset_s == pytest.approx(calibration[OFFSET])
    assert result.skew - rig.skew == pytest.approx(calibration[SKEW])
    assert np.linalg.norm(result.gravity) == pytest.approx(np.linalg.norm(rig.gravity))
    # Gravity turns by the two angles about horizontal axes, to first order.
    tiny = rig.moved(np.zeros((5, 15)), 1e-6 * calibration)
    change = (tiny.gravity - rig.gravity) / 1e-6
    np.testing.assert_allclose(change, tangents(rig.gravity) @ calibration[GRAVITY], atol=1e-4)


def test_tangents_of_gravity_keep_its_magnitude_and_change_its_components() -> None:
    for up, gravity in (
        (2, np.array([0.3, -0.5, -9.7])),
        (0, np.array([9.0, 1.0, 2.0])),
        (1, np.array([0.1, -9.8, 0.3])),
    ):
        result = tangents(gravity)
        np.testing.assert_allclose(gravity @ result, 0.0, atol=1e-9)
        components = np.delete(result, up, axis=0) / np.linalg.norm(gravity)
        np.testing.assert_allclose(components, np.eye(2), rtol=1e-12, atol=1e-12)


def test_values_of_a_rig_and_their_changes(small: Small) -> None:
    rig = small.rig
    values = rig.values()
    np.testing.assert_allclose(values[BODY], [0.3, -0.5, 0.4], atol=1e-12)
    np.testing.assert_allclose(values[LEVER], rig.lever)
    assert values[[OFFSET, SKEW]].tolist() == [0.02, 1e-3]
    # Gravity is along z: its parts along x and y, over its magnitude.
    np.testing.assert_allclose(values[GRAVITY], (rig.gravity / 9.81)[:2], rtol=1e-12)
    for step in STEP * np.eye(10)[3:]:
        ahead, behind = (rig.moved(np.zeros((5, 15)), sign * step).values() for sign in (1, -1))
        np.testing.assert_allclose((ahead - behind) / 2.0, step, atol=1e-8 * STEP)
    assert dataclasses.replace(rig, shift_s=0.5).values()[OFFSET] == 0.52


def test_a_rig_without_parameters_keeps_its_marker(small: Small) -> None:
    rig = small.rig
    fixed = np.zeros(10, dtype=bool)
    fixed[[0, 1, 2, 4, OFFSET, SKEW]] = True
    result = dataclasses.replace(rig, shift_s=0.5).without(fixed)
    np.testing.assert_array_equal(result.body, np.eye(3))
    np.testing.assert_array_equal(result.lever, rig.lever * [1.0, 0.0, 1.0])
    assert (result.offset_s, result.skew) == (-0.5, 0.0)
    np.testing.assert_allclose(result.rotations, rig.rotations @ rig.body, atol=1e-12)
    marker = rig.positions + rig.rotations @ rig.lever
    np.testing.assert_allclose(
        result.positions + result.rotations @ result.lever, marker, atol=1e-12
    )
    same = rig.without(np.zeros(10, dtype=bool))
    np.testing.assert_allclose(same.rotations, rig.rotations, atol=1e-12)
    np.testing.assert_allclose(same.positions, rig.positions, atol=1e-12)
    assert (same.offset_s, same.skew) == (rig.offset_s, rig.skew)
    # Parts of the body's rotation are not fixed alone.
    fixed[2] = False
    np.testing.assert_array_equal(rig.without(fixed).body, rig.body)
