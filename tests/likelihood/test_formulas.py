"""Formulas of the likelihoods: charts, gradients, integrals and conditions by differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from strategies import as_matrix, make_element, random_poses

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood import marginal
from trajeval_ros.likelihood.alignment_chart import Chart, act
from trajeval_ros.likelihood.relative_density import (
    relative_covariance,
    relative_poses,
    stepwise,
    transports,
)
from trajeval_ros.likelihood.residuals import Residuals, find_mode

CHARTED = [Gauge.NONE, Gauge.TRANSLATION, Gauge.YAW, Gauge.SE3, Gauge.SIM3]


def belief_of(seed: int, count: int = 8, size: float = 0.05) -> Belief:
    generator = np.random.default_rng(seed + 1)
    roots = size * generator.normal(size=(count, 6, 8))
    return Belief(random_poses(seed, count), roots @ se3.transposed(roots))


@pytest.mark.parametrize(
    ("gauge", "size", "turns"),
    [
        (Gauge.NONE, 0, (0, 0)), (Gauge.TRANSLATION, 3, (3, 3)), (Gauge.YAW, 4, (3, 4)),
        (Gauge.SE3, 6, (3, 6)), (Gauge.SIM3, 7, (3, 6)),
    ],
)  # fmt: skip
def test_charts_have_the_dimension_of_their_gauge(
    gauge: Gauge, size: int, turns: tuple[int, int]
) -> None:
    chart = Chart(gauge, np.array([1.0, 2.0, 3.0]))
    assert chart.dimension == size
    assert (chart.turns.start, chart.turns.stop) == turns
    np.testing.assert_array_equal(chart.elements(np.zeros((1, size)))[0], np.eye(4))


@pytest.mark.parametrize("gauge", CHARTED)
def test_twists_are_derivatives_of_moved_poses(gauge: Gauge) -> None:
    chart, poses = Chart(gauge, np.array([1.0, 2.0, 3.0])), random_poses(3)
    twists = chart.twists(poses[:, :3, 3])
    for axis in range(chart.dimension):
        step = np.zeros((1, chart.dimension))
        step[0, axis] = 1e-6
        ahead, behind = (act(chart.elements(sign * step)[0], poses) for sign in (1.0, -1.0))
        change = se3.log(ahead @ se3.inverse(behind)) / 2e-6  # on the left
        np.testing.assert_allclose(twists[:, :, axis], change, atol=1e-7)


@pytest.mark.parametrize("gauge", CHARTED)
@pytest.mark.parametrize("oriented", [True, False])
def test_alignments_of_exact_estimates_are_exact(gauge: Gauge, oriented: bool) -> None:
    belief, element = belief_of(4), as_matrix(make_element(gauge, 5))
    estimate = act(np.linalg.inv(element), belief.poses)
    one = Residuals(belief, estimate, gauge, oriented=oriented)
    np.testing.assert_allclose(one.at(element), 0.0, atol=1e-9)
    mode = find_mode(one)
    np.testing.assert_allclose(mode.element, element, atol=1e-8)


@pytest.mark.parametrize("gauge", CHARTED[1:])
@pytest.mark.parametrize("oriented", [True, False])
def test_densities_have_exact_slopes(gauge: Gauge, oriented: bool) -> None:
    generator = np.random.default_rng(0)
    belief = belief_of(6, size=0.3)
    estimate = belief.poses @ se3.exp(0.2 * generator.normal(size=(8, 6)))
    one = Residuals(belief, estimate, gauge, oriented=oriented)
    size = one.chart.dimension
    element = one.chart.elements(0.1 * generator.normal(size=(1, size)))[0]
    slope = one.slope(element)
    axes = 6 if oriented else 3
    assert slope.whitened.shape == (8, axes)
    np.testing.assert_allclose(
        np.square(slope.whitened).sum(axis=1),
        [
            item @ np.linalg.solve(cov[:axes, :axes], item)
            for item, cov in zip(one.at(element), belief.covariances, strict=True)
        ],
        rtol=1e-9,
    )
    jacobian = np.empty((8, axes, size))
    for axis in range(size):
        step = np.zeros((1, size))
        step[0, axis] = 1e-5
        both = [one.chart.elements(sign * step)[0] @ element for sign in (1.0, -1.0)]
        values = one.log_density(np.stack(both))
        assert slope.gradient[axis] == pytest.approx((values[0] - values[1]) / 2e-5, rel=1e-5)
        jacobian[..., axis] = (one.at(both[0]) - one.at(both[1])) / 2e-5
    inverses = np.linalg.inv(belief.covariances[:, :axes, :axes])
    information = np.einsum("nia,nij,njb->ab", jacobian, inverses, jacobian)
    np.testing.assert_allclose(slope.information, information, rtol=1e-5, atol=1e-4)


def test_densities_of_points_are_gaussian() -> None:
    belief = belief_of(6)
    generator = np.random.default_rng(1)
    estimate = belief.poses @ se3.exp(0.05 * generator.normal(size=(8, 6)))
    one = Residuals(belief, estimate, Gauge.SE3, oriented=False)
    [value] = one.log_density(np.eye(4)[None])
    expected = sum(
        multivariate_normal.logpdf(pose[:3, :3].T @ (other[:3, 3] - pose[:3, 3]), cov=cov[:3, :3])
        for pose, other, cov in zip(belief.poses, estimate, belief.covariances, strict=True)
    )
    assert value == pytest.approx(float(expected), rel=1e-9)
    oriented = Residuals(belief, estimate, Gauge.SE3)
    errors = se3.log(se3.inverse(belief.poses) @ estimate)
    expected = sum(
        multivariate_normal.logpdf(error, cov=cov)
        for error, cov in zip(errors, belief.covariances, strict=True)
    ) - 2.0 * sum(np.linalg.slogdet(so3.left_jacobian(item[3:]))[1] for item in errors)
    [value] = oriented.log_density(np.eye(4)[None])
    assert value == pytest.approx(float(expected), rel=1e-9)


@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.SIM3])
def test_second_derivatives_are_those_of_the_density(gauge: Gauge) -> None:
    generator = np.random.default_rng(2)
    belief = belief_of(7)
    estimate = belief.poses @ se3.exp(0.05 * generator.normal(size=(8, 6)))
    one = Residuals(belief, estimate, gauge)
    mode = find_mode(one)
    np.testing.assert_allclose(mode.slope.gradient, 0.0, atol=1e-4)
    result = marginal.full_information(one, mode)
    size = len(result)
    steps = 0.02 / np.sqrt(np.diag(result))
    for row in range(size):
        for column in range(row + 1):
            first, second = np.zeros((2, size))
            first[row], second[column] = steps[row], steps[column]
            corners = np.array([first + second, first - second, second - first, -first - second])
            values = one.log_density(one.chart.elements(corners) @ mode.element)
            change = (values[0] - values[1] - values[2] + values[3]) / 4.0
            # Charts compose, so that sums of deltas are a chart's to second order.
            expected = result[row, column] * steps[row] * steps[column]
            assert -change == pytest.approx(expected, abs=4e-6)


def test_relative_poses_are_linear_in_perturbations() -> None:
    poses = random_poses(2)
    generator = np.random.default_rng(0)
    xi = 1e-6 * generator.normal(size=(8, 6))
    carriers = transports(poses)
    result = stepwise(carriers, xi)
    moved = relative_poses(poses @ se3.exp(xi))
    np.testing.assert_allclose(
        result, se3.log(se3.inverse(relative_poses(poses)) @ moved), atol=1e-10
    )
    belief = belief_of(2)
    diagonal, below = relative_covariance(carriers, belief.covariances)
    matrix = np.zeros((42, 48))
    for edge in range(7):
        matrix[6 * edge : 6 * edge + 6, 6 * edge + 6 : 6 * edge + 12] = np.eye(6)
        matrix[6 * edge : 6 * edge + 6, 6 * edge : 6 * edge + 6] = -carriers[edge]
    everything = np.zeros((48, 48))
    for place, covariance in enumerate(belief.covariances):
        everything[6 * place : 6 * place + 6, 6 * place : 6 * place + 6] = covariance
    dense = matrix @ everything @ matrix.T
    for edge in range(7):
        rows = slice(6 * edge, 6 * edge + 6)
        np.testing.assert_allclose(diagonal[edge], dense[rows, rows], atol=1e-12)
        if edge:
            before = slice(6 * edge - 6, 6 * edge)
            np.testing.assert_allclose(below[edge - 1], dense[rows, before], atol=1e-12)
