"""Knots of queries and their joint covariance, in cases worked out by hand and dense."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dense_joint import dense_covariance
from hypothesis import given, settings
from scipy.stats import multivariate_normal
from solved_process import solved
from strategies import seeds

from trajeval_ros.continuous_time.joint_groundtruth import _SAME_SHARE, JointPosterior, _knots
from trajeval_ros.continuous_time.manifolds import Positions
from trajeval_ros.geometry import se3


def test_queries_alone_are_knots() -> None:
    own = np.arange(6.0)
    asked = np.array([0.3, 1.5, 2.0, 4.75])
    for order in (1, 2, 3):
        np.testing.assert_array_equal(_knots(own, asked, order), asked)


@pytest.mark.parametrize("order", [2, 3])
def test_close_queries_share_a_knot_of_a_grid(order: int) -> None:
    own = np.array([0.0, 1.0, 2.0, 3.0, 5.0])
    cells = math.floor(_SAME_SHARE ** (-1.0 / (2 * order - 1)))
    # A billionth of the variance of a step, which grows by t^3 and t^5.
    assert cells == pytest.approx({2: 1e3, 3: 63.1}[order], abs=1.0)
    cell = 1.0 / cells
    asked = np.array([1.3, 1.3 + 0.2 * cell, 2.0 + 0.3 * cell, 3.0 - 0.3 * cell, 2.6])
    result = _knots(own, asked, order)
    on_grid = np.rint(0.3 * cells) / cells
    np.testing.assert_allclose(result[0], 1.0 + on_grid, atol=1e-14)
    assert abs(result[1] - result[0]) < 1.01 * cell
    assert result[2:].tolist() == [2.0, 3.0, 2.6]
    # A step twice as long has cells twice as long; shorter steps have fewer cells.
    long = _knots(own, np.array([4.0, 4.0 + 1.9 * cell]), order)
    np.testing.assert_allclose(long[0], 3.0 + 2.0 * np.rint(0.5 * cells) / cells, atol=1e-14)
    apart = np.array([4.0, 4.0 + 2.1 * cell])
    np.testing.assert_array_equal(_knots(own, apart, order), apart)


@given(seed=seeds)
@settings(max_examples=5)
def test_observed_queries_are_a_dense_gaussian(seed: int) -> None:
    generator = np.random.default_rng(seed)
    times = np.cumsum(generator.uniform(0.5, 1.5, size=8))
    process = solved(Positions(), 2, times, generator.normal(size=(8, 3)), 0.2, 0.5)
    asked = np.sort(generator.uniform(times[0], times[-1], size=5))
    joint = JointPosterior.of(process, asked)
    roots = generator.normal(size=(5, 3, 3))
    tolerance = roots @ se3.transposed(roots) + 0.1 * np.eye(3)
    dense = dense_covariance(joint)
    for place in range(5):
        rows = slice(3 * place, 3 * place + 3)
        dense[rows, rows] += tolerance[place]
    errors = generator.normal(size=(5, 3))
    observed = joint.observed(tolerance)
    expected = multivariate_normal.logpdf(errors.ravel(), cov=dense)
    assert observed.log_density(errors) == pytest.approx(expected, rel=1e-8)
    assert observed.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-7)
