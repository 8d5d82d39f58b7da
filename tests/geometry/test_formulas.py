"""Formulas of rigid motions, IMUs, gauges and banded matrices, each by another computation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation
from strategies import make_groundtruth, seeds

from trajeval_ros.exceptions import DegenerateGeometryError, SettingsError
from trajeval_ros.geometry import covariance_frames, lie, se3, so3
from trajeval_ros.geometry.banded_matrices import BandedGaussian, Factor, add_blocks, bandwidth
from trajeval_ros.geometry.gauge import (
    Gauge,
    dimension,
    first_state_normals,
    least_squares_normals,
    orbit_basis,
)
from trajeval_ros.geometry.inertial import ImuNoise, preintegrate, rotations_by_gyro
from trajeval_ros.geometry.marker import HandEye, at_arms

Array = NDArray[np.float64]
# On both sides of the angles at which series replace closed forms: sqrt(1e-3), 0.1 and 0.2 rad.
ANGLES = [0.0, 1e-8, 0.0316, 0.0317, 0.0999, 0.1001, 0.1999, 0.2001, 1.0, 2.5, 3.1]
DIRECTION = np.array([0.48, -0.6, 0.64])
EXACT = 1e-13


def integral(matrix: Array) -> Array:
    """Return the integral of expm(s A) over s from 0 to 1."""
    size = len(matrix)
    both = np.block([[matrix, np.eye(size)], [np.zeros((size, 2 * size))]])
    return np.asarray(expm(both)[:size, size:])


def twist_matrix(twist: Array) -> Array:
    """Return ad of a twist (6,), (6, 6)."""
    rotation, shift = so3.skew(twist[3:]), so3.skew(twist[:3])
    return np.block([[rotation, shift], [np.zeros((3, 3)), rotation]])


@pytest.mark.parametrize("angle", ANGLES)
def test_so3_is_the_matrix_exponential(angle: float) -> None:
    vector = angle * DIRECTION
    skew = so3.skew(vector)
    np.testing.assert_allclose(so3.exp(vector), expm(skew), atol=EXACT)
    jacobian = integral(skew)
    np.testing.assert_allclose(so3.left_jacobian(vector), jacobian, atol=EXACT)
    inverse = np.linalg.inv(jacobian)
    # The closed form divides a difference of nearly equal numbers by s = 1e-3.
    np.testing.assert_allclose(so3.inverse_left_jacobian(vector), inverse, atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES)
def test_se3_is_the_matrix_exponential(angle: float) -> None:
    twist = np.concatenate([[0.7, -1.1, 2.0], angle * DIRECTION])
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = so3.skew(twist[3:]), twist[:3]
    pose = expm(generator)
    np.testing.assert_allclose(se3.exp(twist), pose, atol=EXACT)
    np.testing.assert_allclose(se3.log(pose), twist, atol=1e-12)
    np.testing.assert_allclose(se3.inverse(pose), np.linalg.inv(pose), atol=EXACT)
    np.testing.assert_allclose(se3.adjoint(pose), expm(twist_matrix(twist)), atol=EXACT)
    jacobian = integral(twist_matrix(twist))
    np.testing.assert_allclose(se3.left_jacobian(twist), jacobian, atol=1e-12)
    np.testing.assert_allclose(
        se3.inverse_left_jacobian(twist), np.linalg.inv(jacobian), atol=1e-11
    )
    determinant = np.linalg.slogdet(integral(so3.skew(twist[3:])))[1]
    assert se3.log_determinant(twist[3:]) == pytest.approx(determinant, abs=1e-13)


@pytest.mark.parametrize("angle", [1e-4, 0.05, 0.0999, 0.1001, 0.5, 2.0, 3.1])
def test_gradient_of_the_volume(angle: float) -> None:
    vector, step = angle * DIRECTION, 1e-4
    gradient = se3.log_determinant_gradient(vector)
    for axis in range(3):
        # Five points: the error is of the fourth order of the step.
        near, far = (
            se3.log_determinant(vector + size * step * np.eye(3)[axis])
            - se3.log_determinant(vector - size * step * np.eye(3)[axis])
            for size in (1.0, 2.0)
        )
        change = (8.0 * near - far) / (12.0 * step)
        assert gradient[axis] == pytest.approx(change, rel=1e-8, abs=1e-11)
    # Radially, log (2 sin(t / 2) / t)^2 has the derivative cot(t / 2) - 2 / t.
    radial = 1.0 / np.tan(angle / 2.0) - 2.0 / angle
    assert gradient @ DIRECTION == pytest.approx(radial, rel=1e-10, abs=1e-11)


def test_congruence_is_symmetric() -> None:
    generator = np.random.default_rng(0)
    matrices, roots = generator.normal(size=(2, 5, 4, 4))
    covariances = roots @ se3.transposed(roots)
    result = se3.congruent(matrices, covariances)
    for one, matrix, covariance in zip(result, matrices, covariances, strict=True):
        np.testing.assert_allclose(one, matrix @ covariance @ matrix.T, atol=1e-13)
        np.testing.assert_array_equal(one, one.T)


@given(seed=seeds)
@settings(max_examples=10)
def test_covariances_in_other_axes_are_those_of_turned_errors(seed: int) -> None:
    generator = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec(generator.normal(size=3)).as_matrix()
    root = generator.normal(size=(6, 6))
    covariance, rotations = (root @ root.T)[None], rotation[None]

    def moved(first: Array, second: Array) -> Array:
        errors = np.concatenate([first @ root[:3], second @ root[3:]])
        return errors @ errors.T

    unmoved = np.eye(3)
    twists = covariance_frames.world_from_body_twists(covariance, rotations)
    np.testing.assert_allclose(twists[0], moved(rotation, rotation), atol=1e-12)
    only = covariance_frames.world_from_body_rotations(covariance, rotations)
    np.testing.assert_allclose(only[0], moved(unmoved, rotation), atol=1e-12)
    places = covariance_frames.body_from_world_positions(covariance[:, :3, :3], rotations)
    np.testing.assert_allclose(places[0], moved(rotation.T, unmoved)[:3, :3], atol=1e-12)
    size = 8
    large = generator.normal(size=(2 * size, 2 * size))
    both = np.stack([rotation, rotation.T])
    result, information = covariance_frames.world_from_body_rotations_jointly(
        large @ large.T, csr_matrix(large @ large.T), both, size
    )
    change = np.eye(2 * size)
    change[3:6, 3:6], change[11:14, 11:14] = rotation, rotation.T
    expected = change @ large @ large.T @ change.T
    assert result is not None
    assert information is not None
    np.testing.assert_allclose(result, expected, atol=1e-12)
    np.testing.assert_allclose(information.toarray(), expected, atol=1e-12)
    other = np.eye(5)
    kept, none = covariance_frames.world_from_body_rotations_jointly(other, None, both, size)
    assert kept is other
    assert none is None


@pytest.mark.parametrize("scheme", ["middle", "start"])
def test_covariances_of_preintegration_are_those_of_noisy_samples(scheme: str) -> None:
    generator = np.random.default_rng(7)
    rates, forces = generator.normal(size=(2, 2, 5, 3))
    steps = generator.uniform(0.1, 0.2, size=(2, 5))
    steps[1, 3:] = 0.0
    noise = ImuNoise(0.3, 0.7)
    result = preintegrate(rates, forces, steps, noise, scheme)
    np.testing.assert_allclose(result.durations_s, steps.sum(axis=1))
    expected = np.zeros((2, 9, 9))
    for sensor, density in ((0, noise.gyroscope), (1, noise.accelerometer)):
        for sample in range(5):
            change = np.zeros((2, 9, 3))
            for axis in range(3):
                step = np.zeros((2, 2, 5, 3))
                step[sensor, :, sample, axis] = 1e-6
                ahead, behind = (
                    preintegrate(
                        rates + sign * step[0], forces + sign * step[1], steps, noise, scheme
                    )
                    for sign in (1.0, -1.0)
                )
                rotation = so3.log(se3.transposed(behind.rotations) @ ahead.rotations)
                moved = [ahead.velocities - behind.velocities, ahead.positions - behind.positions]
                change[:, :, axis] = np.concatenate([rotation, *moved], axis=1) / 2e-6
            for interval in range(2):
                if steps[interval, sample] > 0.0:
                    variance = density**2 / steps[interval, sample]
                    expected[interval] += variance * change[interval] @ change[interval].T
    np.testing.assert_allclose(result.covariances, expected, rtol=1e-5, atol=1e-9)


@given(seed=seeds)
@settings(max_examples=10)
def test_arms_move_covariances_to_first_order(seed: int) -> None:
    generator = np.random.default_rng(seed)
    arm, root = generator.normal(size=3), generator.normal(size=(6, 6))
    change = np.eye(6)
    for axis, step in enumerate(1e-6 * np.eye(3)):
        ahead, behind = (so3.exp(sign * step) @ arm for sign in (1.0, -1.0))
        change[:3, 3 + axis] = (ahead - behind) / 2e-6
    expected = change @ root @ root.T @ change.T
    result = at_arms((root @ root.T)[None], arm[None])[0]
    np.testing.assert_allclose(result, expected, rtol=1e-6, atol=1e-6)


def test_a_marker_of_an_estimate_in_other_units() -> None:
    estimate = make_groundtruth(3, 20)
    assert estimate.rotations is not None
    hand_eye = HandEye(np.array([0.0, 0.0, 0.6, 0.8]), np.array([0.4, -0.2, 0.6]))
    moved = hand_eye.of_marker(estimate, 2.0, "marker")
    arms = estimate.rotations.apply([0.2, -0.1, 0.3])
    np.testing.assert_allclose(moved.positions, estimate.positions + arms, atol=1e-12)
    assert moved.velocities is None
    assert moved.child_frame == "marker"
    np.testing.assert_array_equal(moved.quaternions, estimate.quaternions)
    body = hand_eye.of_body(estimate, "body")
    rotated = estimate.rotations * Rotation.from_quat(hand_eye.rotation_xyzw).inv()
    assert body.rotations is not None
    assert (rotated.inv() * body.rotations).magnitude().max() < 1e-14
    np.testing.assert_allclose(
        body.positions + rotated.apply(hand_eye.lever_m), estimate.positions, atol=1e-12
    )
    assert body.gyroscope_biases is not None
    assert estimate.gyroscope_biases is not None
    expected = Rotation.from_quat(hand_eye.rotation_xyzw).apply(estimate.gyroscope_biases)
    np.testing.assert_allclose(body.gyroscope_biases, expected, atol=1e-15)
    inverse = hand_eye.inverse()
    product = Rotation.from_quat(hand_eye.rotation_xyzw).apply(inverse.lever_m) + hand_eye.lever_m
    np.testing.assert_allclose(product, 0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("gauge", "size"), [(Gauge.NONE, 0), (Gauge.YAW, 4), (Gauge.SE3, 6), (Gauge.SIM3, 7)]
)
def test_orbits_are_derivatives_of_moved_poses(gauge: Gauge, size: int) -> None:
    assert dimension(gauge) == size
    positions = np.random.default_rng(0).normal(size=(4, 3))
    basis = orbit_basis(gauge, positions)
    assert basis.shape == (4, 6, size)
    axes = {0: 0, 4: 1}.get(size, 3)
    for column, step in enumerate(1e-6 * np.eye(size)):
        rotation = np.zeros(3)
        rotation[3 - axes :] = step[:axes]
        shift = step[axes : axes + 3]
        scale = 1.0 + (step[-1] if gauge is Gauge.SIM3 else 0.0)
        moved = scale * positions @ so3.exp(rotation).T + shift
        change = np.concatenate([moved - positions, np.tile(rotation, (4, 1))], axis=1) / 1e-6
        np.testing.assert_allclose(basis[..., column], change, atol=1e-5)


@pytest.mark.parametrize("gauge", [Gauge.TRANSLATION, Gauge.PLANAR])
def test_other_gauges_have_no_orbits(gauge: Gauge) -> None:
    with pytest.raises(SettingsError, match="use yaw, se3 or sim3"):
        orbit_basis(gauge, np.zeros((2, 3)))


@pytest.mark.parametrize(("gauge", "axes"), [(Gauge.YAW, 1), (Gauge.SE3, 3)])
def test_normals_of_the_first_state_are_gradients_of_its_error(gauge: Gauge, axes: int) -> None:
    rotation = np.array([0.3, -0.2, 0.5])
    normals = first_state_normals(gauge, 3, rotation)
    assert not normals[1:].any()
    np.testing.assert_array_equal(normals[0, :3, axes:], np.eye(3))
    assert not normals[0, :3, :axes].any()
    assert not normals[0, 3:, axes:].any()
    for axis, step in enumerate(1e-6 * np.eye(3)):
        ahead, behind = (so3.log(so3.exp(sign * step) @ so3.exp(rotation)) for sign in (1.0, -1.0))
        change = (ahead - behind) / 2e-6
        np.testing.assert_allclose(normals[0, 3 + axis, :axes], change[3 - axes :], atol=1e-8)


@pytest.mark.parametrize("gauge", [Gauge.NONE, Gauge.YAW, Gauge.SE3, Gauge.SIM3])
def test_normals_of_least_squares_are_gradients_of_its_conditions(gauge: Gauge) -> None:
    """At the optimum, sums of w q x p, of w q and of w q (p - q) are zero, q and p centred."""
    generator = np.random.default_rng(0)
    p, q = generator.normal(size=(2, 5, 3))
    weights = generator.uniform(size=5)
    weights[3] = 0.0
    weights /= weights.sum()
    axes = {Gauge.NONE: 3, Gauge.YAW: 2}.get(gauge, 0)

    def conditions(aligned: Array) -> Array:
        one, other = p - weights @ p, aligned - weights @ aligned
        rotations = weights @ np.cross(other, one)
        scale = weights @ (other * (one - other)).sum(axis=1)
        both = [rotations[axes:], weights @ aligned, [scale]]
        return np.concatenate(both)[: dimension(gauge)]

    normals = least_squares_normals(gauge, p, q, weights)
    assert not normals[:, 3:].any()
    for row, axis in np.ndindex(5, 3):
        step = np.zeros((5, 3))
        step[row, axis] = 1e-6
        change = (conditions(q + step) - conditions(q - step)) / 2e-6
        np.testing.assert_allclose(normals[row, axis], change, atol=1e-8)


@pytest.mark.parametrize("count", [255, 256, 257, 290])
def test_factors_of_many_states_are_one_matrix(count: int) -> None:
    """States are processed by 256, which changes nothing."""
    generator = np.random.default_rng(count)
    diagonal = np.tile(np.diag([3.0, 400.0]), (count, 1, 1))
    diagonal[:, 0, 1] = diagonal[:, 1, 0] = generator.uniform(-10.0, 10.0, count)
    lower = generator.uniform(-1.0, 1.0, (count - 1, 2, 2)) * [[1.0, 5.0], [5.0, 100.0]]
    dense = np.zeros((2 * count, 2 * count))
    for row in range(count):
        here = slice(2 * row, 2 * row + 2)
        dense[here, here] = diagonal[row]
        if row:
            before = slice(2 * row - 2, 2 * row)
            dense[here, before], dense[before, here] = lower[row - 1], lower[row - 1].T
    inverse = np.linalg.inv(dense).reshape(count, 2, count, 2)
    factor = Factor.of(diagonal, lower)
    estimated, beside = factor.inverse_blocks()
    item = np.arange(count)
    np.testing.assert_allclose(estimated, inverse[item, :, item], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(beside, inverse[item[:-1], :, item[1:]], rtol=1e-8, atol=1e-9)
    # Blocks are added up, with and without those below them.
    band = np.zeros((count, 2, 4))
    add_blocks(band[:7], 0.25 * diagonal[:7], lower[:6])
    add_blocks(band[6:], diagonal[6:], lower[6:])
    add_blocks(band[:6], 0.75 * diagonal[:6])
    band[6] -= 0.25 * np.array(
        [[*diagonal[6, :, 0], 0.0, 0.0], [diagonal[6, 1, 1], 0.0, 0.0, 0.0]]
    )
    np.testing.assert_allclose(Factor.of_band(band).band, factor.band, rtol=1e-12, atol=1e-12)
    columns = generator.normal(size=(count, 2, 3))
    expected = np.linalg.solve(dense, columns.reshape(-1, 3)).reshape(columns.shape)
    np.testing.assert_allclose(factor.solve(columns), expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(
        factor.solve(columns[..., 0]), expected[..., 0], rtol=1e-8, atol=1e-9
    )
    whitened = factor.whitened(columns[..., 0])
    assert np.sum(whitened**2) == pytest.approx(np.sum(columns[..., 0] * expected[..., 0]))
    assert factor.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1])
    diagonals = np.log(np.diag(np.linalg.cholesky(dense)))
    np.testing.assert_allclose(factor.log_diagonal.ravel(), diagonals, rtol=1e-9, atol=1e-9)
    with pytest.raises(np.linalg.LinAlgError):
        Factor.of(diagonal * [[0.0, 1.0], [1.0, 1.0]], lower)


@given(seed=seeds, size=st.integers(3, 40), reach=st.integers(1, 6))
@settings(max_examples=15)
def test_a_banded_gaussian_is_its_dense_one(seed: int, size: int, reach: int) -> None:
    generator = np.random.default_rng(seed)
    root = np.tril(np.triu(generator.normal(size=(size, size)), -min(reach, size - 1)))
    information = root @ root.T + np.eye(size)
    sparse = csr_matrix(information)
    assert bandwidth(sparse) == min(reach, size - 1)
    gaussian = BandedGaussian(sparse)
    covariance = np.linalg.inv(information)
    columns = generator.normal(size=(size, 2))
    np.testing.assert_allclose(gaussian.solved(columns), covariance @ columns, atol=1e-9)
    factor = gaussian.sampled(np.eye(size))
    np.testing.assert_allclose(factor @ factor.T, covariance, atol=1e-9)
    starts = np.arange(size - 1)
    blocks = gaussian.marginals(starts, 2)
    for start, block in zip(starts, blocks, strict=True):
        rows = slice(start, start + 2)
        np.testing.assert_allclose(block, covariance[rows, rows], atol=1e-9)


def test_a_singular_information_is_an_error() -> None:
    with pytest.raises(DegenerateGeometryError, match="do not determine all directions"):
        BandedGaussian(csr_matrix(np.diag([1.0, 1.0, 0.0])))
    assert bandwidth(csr_matrix((3, 3))) == 0


def test_a_gyroscope_of_linear_rates_turns_by_their_integral() -> None:
    seconds = np.array([0.0, 0.3, 0.4, 1.0])
    rates = np.outer(1.0 + 2.0 * seconds, [0.0, 0.6, 0.8])
    first = lie.from_rotation_vector(np.array([0.5, 0.0, 0.0]))
    result = rotations_by_gyro(seconds, rates, first)
    rotations = np.outer(seconds + seconds**2, [0.0, 0.6, 0.8])
    expected = Rotation.from_quat(first) * Rotation.from_rotvec(rotations)
    assert (expected.inv() * Rotation.from_quat(result)).magnitude().max() < 1e-12
    np.testing.assert_array_equal(rotations_by_gyro(seconds, rates)[0], [0.0, 0.0, 0.0, 1.0])
