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
