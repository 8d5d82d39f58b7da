"""Knots of queries and their joint covariance, in cases worked out by hand and dense."""

from __future__ import annotations

import numpy as np
import pytest
from dense_joint import dense_covariance
from hypothesis import given, settings
from scipy.stats import multivariate_normal
from solved_process import solved
from strategies import seeds

from trajeval_ros.continuous_time.manifolds import Positions
from trajeval_ros.geometry import se3
from trajeval_ros.likelihood.correlated_groundtruth import JointPosterior


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
