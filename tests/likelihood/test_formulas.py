"""Formulas of the likelihoods: charts, gradients, integrals and conditions by differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from strategies import as_matrix, make_element, random_poses

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.exceptions import DegenerateGeometryError, SettingsError
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood import marginal, residuals
from trajeval_ros.likelihood.alignment_chart import Chart, act, scales
from trajeval_ros.likelihood.marginal import generalised_absolute_error
from trajeval_ros.likelihood.observable_directions import (
    _condition,
    _scale_of,
    _tilt_of,
)
from trajeval_ros.likelihood.relative_density import (
    relative_covariance,
    relative_poses,
    stepwise,
    transports,
)
from trajeval_ros.likelihood.residuals import Residuals, find_mode, unit_diagonal

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
def test_elements_move_points_about_the_centre(gauge: Gauge) -> None:
    centre, chart = np.array([1.0, 2.0, 3.0]), Chart(gauge, np.array([1.0, 2.0, 3.0]))
    delta = np.array([0.5, -0.4, 0.3, 0.2, -0.6, 0.7, 0.4])[: chart.dimension]
    [element] = chart.elements(delta[None])
    turn, shift = np.zeros(3), delta[:3] if gauge.has_translation else np.zeros(3)
    turn[3 - len(chart.axes) :] = delta[chart.turns]
    scale = np.exp(0.4) if gauge is Gauge.SIM3 else 1.0
    point = np.array([4.0, 0.0, -2.0])
    expected = centre + scale * so3.exp(turn) @ (point - centre) + shift
    np.testing.assert_allclose(element[:3, :3] @ point + element[:3, 3], expected, atol=1e-12)
    assert scales(element) == pytest.approx(scale)
    # Scaled, positions move and rotations stay rotations.
    moved = act(element, se3.poses(so3.exp(np.array([0.1, 0.2, 0.3])), point))
    np.testing.assert_allclose(moved[:3, 3], expected, atol=1e-12)
    np.testing.assert_allclose(moved[:3, :3] @ moved[:3, :3].T, np.eye(3), atol=1e-12)


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


def test_the_measure_is_that_of_rotations() -> None:
    deltas = np.zeros((2, 6))
    deltas[:, 3:] = [[0.3, -0.5, 0.8], [0.0, 0.0, 3.0]]
    found = Chart(Gauge.SE3, np.zeros(3)).log_measure(deltas)
    expected = [np.linalg.slogdet(so3.left_jacobian(delta[3:]))[1] for delta in deltas]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert not Chart(Gauge.YAW, np.zeros(3)).log_measure(deltas[:, :4]).any()
    chart = Chart(Gauge.YAW, np.zeros(3))
    turns = np.zeros((4, 4))
    turns[:, 3] = [np.pi, -np.pi, np.pi + 1e-9, 0.0]
    assert chart.within(turns).tolist() == [True, True, False, True]
    with pytest.raises(SettingsError, match="planar is not supported"):
        Chart(Gauge.PLANAR, np.zeros(3))


@pytest.mark.parametrize("gauge", CHARTED)
@pytest.mark.parametrize("oriented", [True, False])
def test_first_alignments_of_exact_estimates_are_exact(gauge: Gauge, oriented: bool) -> None:
    belief, element = belief_of(4), as_matrix(make_element(gauge, 5))
    estimate = act(np.linalg.inv(element), belief.poses)
    one = Residuals(belief, estimate, gauge, oriented=oriented)
    np.testing.assert_allclose(residuals._first_alignment(one), element, atol=1e-8)
    np.testing.assert_allclose(one.at(element), 0.0, atol=1e-9)
    mode = find_mode(one)
    np.testing.assert_allclose(mode.element, element, atol=1e-8)


def test_first_alignments_are_weighted_by_variances() -> None:
    belief = belief_of(4)
    covariances = np.tile(1e-4 * np.eye(6), (8, 1, 1))
    covariances[:3] *= 1e8
    poses = belief.poses.copy()
    poses[:3] = random_poses(9, 3)
    one = Residuals(Belief(poses, covariances), belief.poses, Gauge.SE3)
    np.testing.assert_allclose(residuals._first_alignment(one), np.eye(4), atol=1e-4)
    shifted = belief.poses.copy()
    shifted[:3, :3, 3] += 7.0
    two = Residuals(Belief(shifted, covariances), belief.poses, Gauge.TRANSLATION)
    np.testing.assert_allclose(residuals._first_alignment(two), np.eye(4), atol=1e-5)


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


def test_work_in_parts_is_work_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    belief = belief_of(6)
    generator = np.random.default_rng(1)
    estimate = belief.poses @ se3.exp(0.05 * generator.normal(size=(8, 6)))
    one = Residuals(belief, estimate, Gauge.SIM3)
    elements = one.chart.elements(0.1 * generator.normal(size=(5, 7)))
    values, slope = one.log_density(elements), one.slope(elements[0])
    for most, rows in ((17, 3), (8, 8), (1, 1)):
        monkeypatch.setattr(residuals, "_MOST_AT_ONCE", most)
        monkeypatch.setattr(residuals, "_ROWS", rows)
        np.testing.assert_allclose(one.log_density(elements), values, rtol=1e-12)
        again = one.slope(elements[0])
        scale = np.abs(slope.gradient).max()
        np.testing.assert_allclose(again.gradient, slope.gradient, atol=1e-11 * scale)
        np.testing.assert_allclose(again.information, slope.information, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(again.whitened, slope.whitened, rtol=1e-12)


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
    found = marginal.full_information(one, mode)
    size = len(found)
    steps = 0.02 / np.sqrt(np.diag(found))
    for row in range(size):
        for column in range(row + 1):
            first, second = np.zeros((2, size))
            first[row], second[column] = steps[row], steps[column]
            corners = np.array([first + second, first - second, second - first, -first - second])
            values = one.log_density(one.chart.elements(corners) @ mode.element)
            change = (values[0] - values[1] - values[2] + values[3]) / 4.0
            # Charts compose, so that sums of deltas are a chart's to second order.
            expected = found[row, column] * steps[row] * steps[column]
            assert -change == pytest.approx(expected, abs=4e-6)


def test_numbers_of_an_absolute_error_by_hand() -> None:
    generator = np.random.default_rng(3)
    belief = belief_of(8)
    estimate = belief.poses @ se3.exp(0.05 * generator.normal(size=(8, 6)))
    found = generalised_absolute_error(Residuals(belief, estimate, Gauge.YAW))
    assert found.method == "laplace"
    assert found.effective_share is None
    assert found.dof == 48 - 4
    assert found.nll_per_pose == pytest.approx(-found.log_likelihood / 8)
    errors = found.residuals.at(found.mode.element)
    squares = [
        error @ np.linalg.solve(cov, error)
        for error, cov in zip(errors, belief.covariances, strict=True)
    ]
    np.testing.assert_allclose(found.mahalanobis2, squares, rtol=1e-9)
    assert found.chi2_per_dof == pytest.approx(sum(squares) / 44)
    variances = np.einsum("nii->ni", belief.covariances)
    np.testing.assert_allclose(found.per_axis, (errors**2 / variances).mean(axis=0))
    np.testing.assert_allclose(found.covariance @ found.information, np.eye(4), atol=1e-9)
    expected = found.mode.log_density + 2.0 * np.log(2.0 * np.pi)
    expected -= 0.5 * np.linalg.slogdet(found.information)[1]
    assert found.log_likelihood == pytest.approx(expected, rel=1e-12)
    value, share = marginal.importance(found)
    # Gaussian to a good approximation: the draws of a t distribution are nearly as good.
    assert value == pytest.approx(found.log_likelihood, abs=5e-3)
    assert 0.5 < share < 1.0
    points = Residuals(belief, estimate, Gauge.SIM3, oriented=False)
    assert generalised_absolute_error(points).dof == 24 - 7


def test_statements_on_an_absolute_error() -> None:
    generator = np.random.default_rng(3)
    belief = belief_of(8)
    estimate = belief.poses @ se3.exp(0.05 * generator.normal(size=(8, 6)))
    one = generalised_absolute_error(Residuals(belief, estimate, Gauge.SE3))

    def said(error: marginal.AbsoluteErrorDensity, turn: float, share: float | None) -> list[str]:
        return [
            statement.split(",")[0].split(";")[0]
            for statement in marginal._statements(error, turn, share)
        ]

    assert said(one, 0.3, None) == []
    assert len(said(one, 0.301, 0.05)) == 1
    assert len(said(one, 0.301, 0.049)) == 2
    assert "of only 4.9 %" in said(one, 0.301, 0.049)[1]
    scaled = generalised_absolute_error(Residuals(belief, estimate, Gauge.SIM3))
    assert "with a free scale" in said(scaled, 0.1, None)[0]
    points = generalised_absolute_error(Residuals(belief, estimate, Gauge.SIM3, oriented=False))
    assert said(points, 0.1, None) == []
    for angle, number in ((2.4, 0), (2.6, 1)):
        turned = estimate.copy()
        turned[0] = belief.poses[0] @ se3.exp(np.array([0.0, 0, 0, angle, 0, 0]))
        fixed = generalised_absolute_error(Residuals(belief, turned, Gauge.NONE))
        assert len(said(fixed, 0.0, None)) == number
    assert marginal._turn_uncertainty(fixed) == 0.0


def test_uncertain_turns_are_sampled_and_many_poses_have_no_second_derivatives(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    belief = belief_of(8)
    one = Residuals(belief, belief.poses, Gauge.YAW)
    for turn, method in ((0.3, "laplace"), (0.3001, "importance")):
        monkeypatch.setattr(marginal, "_turn_uncertainty", lambda _, turn=turn: turn)
        found = generalised_absolute_error(one)
        assert found.method == method
        assert (found.effective_share is None) == (method == "laplace")
        assert len(found.statements) == (method == "importance")
    gauss_newton = find_mode(one).slope.information
    for most, exact in ((8, True), (7, False)):
        monkeypatch.setattr(marginal, "_MOST_FOR_FULL", most)
        found = generalised_absolute_error(one)
        assert np.array_equal(found.information, gauss_newton) != exact


def test_the_uncertainty_of_a_turn_is_that_of_its_worst_axis() -> None:
    belief = belief_of(8)
    found = generalised_absolute_error(Residuals(belief, belief.poses, Gauge.SIM3))
    block = np.linalg.inv(found.information)[3:6, 3:6]
    expected = np.sqrt(np.linalg.eigvalsh(block).max())
    assert marginal._turn_uncertainty(found) == pytest.approx(expected, rel=1e-9)


def test_a_scale_of_nothing_is_an_error() -> None:
    belief = belief_of(8)
    tiny = belief.poses.copy()
    tiny[:, :3, 3] *= 1e7
    one = Residuals(belief, tiny, Gauge.SIM3)
    assert scales(find_mode(one).element) == pytest.approx(1e-7, rel=1e-6)
    tiny[:, :3, 3] *= 1e3
    with pytest.raises(DegenerateGeometryError):
        find_mode(Residuals(belief, tiny, Gauge.SIM3))


def test_logarithms_of_sums_do_not_overflow() -> None:
    values = np.array([1000.0, 1001.0, 999.0, -np.inf])
    expected = 1000.0 + np.log(np.exp([0.0, 1.0, -1.0]).sum())
    assert marginal._log_sum(values) == pytest.approx(expected, rel=1e-14)


def test_conditions_are_gaussian_densities_at_zero() -> None:
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    found = _condition(np.array([0.3, -0.2]), covariance)
    expected = multivariate_normal.logpdf([0.3, -0.2], cov=covariance)
    assert found.log_density == pytest.approx(float(expected))
    np.testing.assert_allclose(found.z, [1.5, -0.2 / 0.3])
    assert found.sigmas == pytest.approx((0.2, 0.3))


def test_conditions_have_the_scale_and_the_tilt_of_the_alignment() -> None:
    belief = belief_of(8, 30)
    turn = so3.exp(np.array([0.0, 0.0, 0.9])) @ so3.exp(np.array([0.02, -0.03, 0.0]))
    element = se3.poses(1.05 * turn, np.array([1.0, 2.0, 3.0]))
    estimate = act(np.linalg.inv(element), belief.poses)
    error = generalised_absolute_error(Residuals(belief, estimate, Gauge.SIM3))
    scale = _scale_of(error)
    assert scale.values[0] == pytest.approx(np.log(1.05), abs=1e-7)
    assert scale.sigmas[0] == pytest.approx(np.sqrt(error.covariance[6, 6]))
    rigid = act(np.linalg.inv(se3.poses(turn, np.ones(3))), belief.poses)
    error = generalised_absolute_error(Residuals(belief, rigid, Gauge.SE3))
    tilt = _tilt_of(error)
    # The yaw is taken away on the right.
    level = turn @ so3.rot_z(-float(so3.yaw_of_matrix(turn)))
    np.testing.assert_allclose(tilt.values, so3.log(level)[:2], atol=1e-7)
    np.testing.assert_allclose(tilt.sigmas, np.sqrt(np.diag(error.covariance))[3:5])


def test_relative_poses_are_linear_in_perturbations() -> None:
    poses = random_poses(2)
    generator = np.random.default_rng(0)
    xi = 1e-6 * generator.normal(size=(8, 6))
    carriers = transports(poses)
    found = stepwise(carriers, xi)
    moved = relative_poses(poses @ se3.exp(xi))
    np.testing.assert_allclose(
        found, se3.log(se3.inverse(relative_poses(poses)) @ moved), atol=1e-10
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


def test_a_unit_diagonal_or_an_error() -> None:
    information = np.array([[4.0, 1.0], [1.0, 9.0]])
    np.testing.assert_allclose(unit_diagonal(information), [0.5, 1.0 / 3.0])
    nearly = np.array([[1.0, 1.0 - 2e-11], [1.0 - 2e-11, 1.0]])
    unit_diagonal(nearly)
    for singular in (
        np.array([[1.0, 1.0 - 0.5e-11], [1.0 - 0.5e-11, 1.0]]),
        np.diag([1.0, 0.0]),
        np.diag([1.0, -1.0]),
    ):
        with pytest.raises(DegenerateGeometryError, match="do not determine all directions"):
            unit_diagonal(singular)
