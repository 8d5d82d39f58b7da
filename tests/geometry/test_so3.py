"""The exponential of SO(3) and its Jacobians."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation
from strategies import Array, seeds

from trajeval_ros.geometry import lie, so3


def _vectors(seed: int, longest: float = 3.1, count: int = 20) -> Array:
    """Return rotation vectors of all lengths, tiny ones among them."""
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(count, 3))
    lengths = longest * generator.uniform(size=(count, 1)) ** 8
    return lengths * directions / np.linalg.norm(directions, axis=1, keepdims=True)


@given(seeds)
def test_exponential_and_logarithm_are_scipys(seed: int) -> None:
    vectors = _vectors(seed)
    expected = Rotation.from_rotvec(vectors)
    np.testing.assert_allclose(so3.exp(vectors), expected.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(so3.log(so3.exp(vectors)), vectors, atol=1e-13)
    yaw = lie.yaw(np.asarray(expected.as_quat()))
    np.testing.assert_allclose(so3.yaw_of_matrix(so3.exp(vectors)), yaw, atol=1e-12)


@given(seeds)
def test_left_jacobian_is_the_derivative_of_the_exponential(seed: int) -> None:
    vectors, step = _vectors(seed), 1e-6
    directions = np.random.default_rng(seed + 1).normal(size=vectors.shape)
    ahead, behind = (so3.exp(vectors + sign * step * directions) for sign in (1.0, -1.0))
    numeric = so3.log(ahead @ np.swapaxes(behind, 1, 2)) / (2.0 * step)
    analytic = np.einsum("nij,nj->ni", so3.left_jacobian(vectors), directions)
    np.testing.assert_allclose(analytic, numeric, atol=1e-8)
    product = so3.left_jacobian(vectors) @ so3.inverse_left_jacobian(vectors)
    np.testing.assert_allclose(product, np.tile(np.eye(3), (len(vectors), 1, 1)), atol=1e-12)


@pytest.mark.parametrize("angle", [0.1, np.sqrt(1e-3)])
def test_series_join_the_closed_forms(angle: float) -> None:
    direction = np.array([0.48, -0.6, 0.64])
    below, above = (direction * (angle + step) for step in (-1e-12, 1e-12))
    for function in (so3.exp, so3.left_jacobian, so3.inverse_left_jacobian):
        np.testing.assert_allclose(function(below), function(above), atol=1e-11)


@given(seeds)
def test_skew_is_the_cross_product(seed: int) -> None:
    left, right = _vectors(seed), _vectors(seed + 1)
    product = np.einsum("nij,nj->ni", so3.skew(left), right)
    np.testing.assert_allclose(product, np.cross(left, right), atol=1e-14)


@pytest.mark.parametrize("short_of_half_a_turn", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_logarithms_near_half_a_turn(short_of_half_a_turn: float) -> None:
    directions = np.array([[0.48, -0.6, 0.64], [1.0, 0.0, 0.0], [0.0, -0.6, 0.8]])
    vectors = (np.pi - short_of_half_a_turn) * directions
    result = so3.log(so3.exp(vectors))
    signs = np.sign(np.sum(result * vectors, axis=1, keepdims=True))  # at half a turn, either
    np.testing.assert_allclose(signs * result, vectors, atol=1e-9)
