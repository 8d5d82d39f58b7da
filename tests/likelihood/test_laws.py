"""Laws of likelihoods: the two errors are one, no frame matters, and approximations are close."""

from __future__ import annotations

import dataclasses

import first_order_likelihood as first_order
import numpy as np
import pytest
from alignment_integrals import by_laplace, by_quadrature
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from paper_density import DENSITIES, PaperResiduals
from position_likelihood import position_error
from scipy.stats import multivariate_normal
from strategies import as_matrix, make_element, seeds

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.exceptions import DegenerateGeometryError, SettingsError
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood import relative_density
from trajeval_ros.likelihood.alignment_chart import act
from trajeval_ros.likelihood.marginal import (
    generalised_absolute_error,
    importance,
    laplace,
)
from trajeval_ros.likelihood.observable_directions import gauge_scores
from trajeval_ros.likelihood.residuals import Residuals

Array = NDArray[np.float64]
GAUGES = [Gauge.YAW, Gauge.SE3, Gauge.SIM3]


def flight(count: int, seed: int) -> Array:
    """Return poses (count, 4, 4) along a smooth motion some metres wide."""
    random = np.random.default_rng(seed)
    time = np.linspace(0.0, 0.2 * count, count)[:, None]
    phase = random.uniform(0.0, 2.0 * np.pi, size=(2, 3))
    positions = [4.0, 3.0, 1.0] * np.sin(time * [0.31, 0.38, 0.27] + phase[0])
    rotations = [0.2, 0.2, 1.4] * np.sin(time * [1.1, 1.3, 0.3] + phase[1])
    return se3.exp(np.concatenate([positions, rotations], axis=1))


def spread(random: np.random.Generator, count: int, sigma_m: float, sigma_rad: float) -> Array:
    """Return covariances (count, 6, 6) of all shapes."""
    roots = random.normal(size=(count, 6, 9)) / 3.0
    sizes = np.repeat([sigma_m, sigma_rad], 3)
    return roots @ roots.swapaxes(1, 2) * sizes * sizes[:, None]


def drawn(count: int, seed: int, sigma_rad: float, lever_m: float = 1.0) -> tuple[Belief, Array]:
    """Return a groundtruth, and an estimate that is wrong by as much as its covariances say."""
    random = np.random.default_rng(seed)
    poses = flight(count, seed)
    covariances = spread(random, count, lever_m * sigma_rad, sigma_rad)
    roots = np.linalg.cholesky(covariances)
    errors = se3.times(roots, random.normal(size=(count, 6)))
    return Belief(poses, covariances), poses @ se3.exp(errors)


def score(belief: Belief, estimate: Array, gauge: Gauge, density: str = "haar") -> float:
    residuals = DENSITIES[density](belief, estimate, gauge)
    return by_laplace(generalised_absolute_error(residuals))


@given(seed=seeds, count=st.integers(3, 8))
def test_edges_add_up_to_the_dense_density_eq_17(seed: int, count: int) -> None:
    belief, estimate = drawn(count, seed, 0.03)
    result = first_order.generalised_relative_error(belief, estimate)
    carriers = relative_density.transports(belief.poses)
    step = np.zeros((6 * count - 6, 6 * count))
    for row in range(count - 1):
        here = slice(6 * row, 6 * row + 6)
        step[here, 6 * row : 6 * row + 6] = -carriers[row]
        step[here, 6 * row + 6 : 6 * row + 12] = np.eye(6)
    blocks = np.zeros((6 * count, 6 * count))
    for row in range(count):
        here = slice(6 * row, 6 * row + 6)
        blocks[here, here] = belief.covariances[row]
    errors = first_order.relative_errors(belief.poses, estimate)
    dense = multivariate_normal.logpdf(
        errors.ravel(), np.zeros(6 * count - 6), step @ blocks @ step.T
    )
    assert result.log_likelihood == pytest.approx(dense, rel=1e-10, abs=1e-8)
    assert np.sum(result.edges) == pytest.approx(result.log_likelihood, rel=1e-12)
    # Q of eq. (14) is the matrix above.
    stepwise = relative_density.stepwise(carriers, errors[[0, *range(count - 1)]])
    np.testing.assert_allclose(
        stepwise.ravel(), step @ errors[[0, *range(count - 1)]].ravel(), atol=1e-12
    )


@pytest.mark.slow
@pytest.mark.parametrize("gauge", GAUGES)
@given(seed=seeds)
@settings(max_examples=8)
def test_no_frame_and_no_order_matters(gauge: Gauge, seed: int) -> None:
    random = np.random.default_rng(seed)
    belief, estimate = drawn(20, seed, 0.02)
    # Coordinates of some 100 m, 4.5 times as many under a scale, are known to 8 u of that, and a
    # whitened residual to as much over the smallest standard deviation. The score is half the sum
    # of 120 squares of such residuals, each of size one.
    smallest = np.sqrt(np.linalg.eigvalsh(belief.covariances).min())
    rounding = 120.0 * 4.0 * np.finfo(np.float64).eps * 500.0 / smallest
    expected = pytest.approx(score(belief, estimate, gauge), rel=0, abs=rounding)
    element = as_matrix(make_element(gauge, seed))
    assert score(belief, act(element, estimate), gauge) == expected
    rigid = as_matrix(make_element(Gauge.YAW if gauge is Gauge.YAW else Gauge.SE3, seed))
    reframed = Belief(act(rigid, belief.poses), belief.covariances)
    assert score(reframed, estimate, gauge) == expected
    order = random.permutation(20)
    shuffled = Belief(belief.poses[order], belief.covariances[order])
    assert score(shuffled, estimate[order], gauge) == expected
    mounted = se3.exp(random.normal(size=6))
    carried = se3.congruent(se3.adjoint(se3.inverse(mounted)), belief.covariances)
    elsewhere = score(Belief(belief.poses @ mounted, carried), estimate @ mounted, gauge)
    if gauge is not Gauge.SIM3:  # scale doesn't commute with a lever arm
        assert elsewhere == expected


def test_millimetres_change_a_score_by_a_constant() -> None:
    belief, estimate = drawn(12, 4, 0.02)
    unit = np.diag([1000.0] * 3 + [1.0] * 3)
    in_mm = Belief(belief.poses.copy(), se3.congruent(unit, belief.covariances))
    other = estimate.copy()
    in_mm.poses[:, :3, 3] *= 1000.0
    other[:, :3, 3] *= 1000.0
    expected = score(belief, estimate, Gauge.SE3) - 3.0 * 11 * np.log(1000.0)
    assert score(in_mm, other, Gauge.SE3) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("gauge", [Gauge.YAW, pytest.param(Gauge.SE3, marks=pytest.mark.slow)])
def test_laplace_is_close_to_quadrature_and_sampling(gauge: Gauge) -> None:
    belief, estimate = drawn(6, 5, np.radians(3.0))
    error = generalised_absolute_error(Residuals(belief, estimate, gauge))
    assert by_quadrature(error, 7) == pytest.approx(error.log_likelihood, abs=1e-3)
    sampled, share = importance(error)
    assert sampled == pytest.approx(error.log_likelihood, abs=0.02)
    assert 0.3 < share <= 1.0


def test_relinearised_edges_add_up_to_the_exact_error() -> None:
    for sigma_deg, count in ((1.0, 1000), (0.1, 1000)):
        belief, estimate = drawn(count, 2, np.radians(sigma_deg))
        error = generalised_absolute_error(PaperResiduals(belief, estimate, Gauge.SE3))
        residuals = error.residuals.at(error.mode.element)
        steps = relative_density.stepwise(relative_density.transports(belief.poses), residuals)
        result = relative_density.decomposed(belief, steps).log_likelihood
        assert result == pytest.approx(error.log_likelihood, abs=1e-2)
        literal = first_order.generalised_relative_error(belief, estimate).log_likelihood
        assert abs(literal - error.log_likelihood) > 0.3


@pytest.mark.parametrize("seed", range(4))
def test_scores_form_a_chain(seed: int) -> None:
    belief, estimate = drawn(40, seed, np.radians(0.5))
    scores = gauge_scores(Residuals(belief, estimate, Gauge.YAW))
    assert scores.sim3 is not None
    assert scores.scale is not None
    assert scores.se3 == pytest.approx(scores.sim3 + scores.scale.log_density, abs=1e-2)
    assert scores.yaw == pytest.approx(scores.se3 + scores.tilt.log_density, abs=1e-2)
    assert max(map(abs, scores.scale.z + scores.tilt.z)) < 5.0


def test_chain_finds_a_wrong_scale() -> None:
    belief, estimate = drawn(40, 3, np.radians(0.1))
    wrong = estimate.copy()
    wrong[:, :3, 3] /= 1.02
    scores = gauge_scores(Residuals(belief, wrong, Gauge.YAW))
    assert scores.scale is not None
    assert np.exp(scores.scale.values[0]) == pytest.approx(1.02, abs=2e-3)
    assert scores.scale.z[0] > 10.0


def test_chain_finds_a_tilt() -> None:
    belief, estimate = drawn(40, 3, np.radians(0.1))
    tilted = act(se3.exp(np.array([0.0, 0.0, 0.0, 0.02, 0.0, 0.0])), estimate)
    scores = gauge_scores(Residuals(belief, tilted, Gauge.YAW))
    assert scores.tilt.values == pytest.approx((-0.02, 0.0), abs=2e-3)
    assert scores.tilt.z[0] < -10.0
    assert abs(scores.tilt.z[1]) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.SE3])
@given(seed=seeds)
@settings(max_examples=8)
def test_positions_alone_in_closed_form(gauge: Gauge, seed: int) -> None:
    random = np.random.default_rng(seed)
    truth = random.normal(size=(12, 3)) * [3.0, 2.0, 1.0]
    estimate = truth + random.normal(scale=0.05, size=truth.shape)
    belief = Belief(
        se3.poses(np.eye(3), truth), np.tile(np.diag([0.05**2] * 3 + [0.0] * 3), (12, 1, 1))
    )
    residuals = Residuals(belief, se3.poses(np.eye(3), estimate), gauge, oriented=False)
    exact = position_error(truth, estimate, 0.05, gauge)
    error = generalised_absolute_error(residuals)
    assert error.log_likelihood == pytest.approx(exact, abs=2e-3)
    if gauge is Gauge.YAW:
        assert by_quadrature(error, 11) == pytest.approx(exact, abs=1e-6)


def test_an_uncertain_alignment_is_sampled_and_said() -> None:
    random = np.random.default_rng(1)
    truth = random.normal(size=(8, 3)) * [1.0, 0.3, 0.2]
    estimate = truth + random.normal(scale=0.3, size=truth.shape)
    belief = Belief(
        se3.poses(np.eye(3), truth), np.tile(np.diag([0.3**2] * 3 + [0.0] * 3), (8, 1, 1))
    )
    residuals = Residuals(belief, se3.poses(np.eye(3), estimate), Gauge.SE3, oriented=False)
    error = generalised_absolute_error(residuals)
    assert error.method == "importance"
    assert any("has a standard deviation of" in statement for statement in error.statements)
    exact = position_error(truth, estimate, 0.3, Gauge.SE3)
    assert error.log_likelihood == pytest.approx(exact, abs=0.1)
    laplace_value = by_laplace(generalised_absolute_error(residuals))
    assert abs(laplace_value - exact) > abs(error.log_likelihood - exact)


def test_refuses_what_has_no_likelihood() -> None:
    belief, estimate = drawn(8, 0, 0.02)
    still = Belief(np.tile(np.eye(4), (8, 1, 1)), belief.covariances)
    resting = np.tile(np.eye(4), (8, 1, 1))
    with pytest.raises(DegenerateGeometryError, match="scale of a body at rest"):
        generalised_absolute_error(Residuals(still, resting, Gauge.SIM3))
    assert np.isfinite(score(still, resting, Gauge.SE3))
    line = se3.poses(np.eye(3), np.arange(8.0)[:, None] * [1.0, 2.0, 0.5])
    with pytest.raises(DegenerateGeometryError, match="roll about a straight path"):
        generalised_absolute_error(
            Residuals(Belief(line, belief.covariances), line, Gauge.SE3, oriented=False)
        )
    sure = dataclasses.replace(belief, covariances=np.zeros((8, 6, 6)))
    with pytest.raises(DegenerateGeometryError, match="zero variance"):
        generalised_absolute_error(Residuals(sure, estimate, Gauge.SE3))
    with pytest.raises(DegenerateGeometryError, match="relative poses is singular"):
        first_order.generalised_relative_error(sure, estimate)
    with pytest.raises(SettingsError, match="planar"):
        generalised_absolute_error(Residuals(belief, estimate, Gauge.PLANAR))
    with pytest.raises(SettingsError, match="no closed form for gauge sim3"):
        position_error(np.eye(3), np.eye(3), 1.0, Gauge.SIM3)


def test_half_turns_and_tiny_noise_give_numbers() -> None:
    belief, estimate = drawn(30, 7, 0.01)
    estimate[15:] = estimate[15:] @ se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 3.1]))
    error = generalised_absolute_error(Residuals(belief, estimate, Gauge.SE3))
    assert np.isfinite(error.log_likelihood)
    assert (
        any("a pose differs by" in statement for statement in error.statements)
        or error.chi2_per_dof > 100.0
    )
    fine, close = drawn(30, 8, 1e-9)
    assert np.isfinite(score(fine, close, Gauge.SE3))


@pytest.mark.parametrize("distance_m", [3e5, 1e6, 1e7])
def test_likelihoods_do_not_depend_on_the_distance_from_the_origin(distance_m: float) -> None:
    belief, estimate = drawn(60, 4, 0.02)
    near = generalised_absolute_error(Residuals(belief, estimate, Gauge.SE3))

    def moved(poses: Array) -> Array:
        return se3.poses(poses[:, :3, :3], poses[:, :3, 3] + distance_m * np.array([1, -0.7, 0]))

    far = Belief(moved(belief.poses), belief.covariances)
    result = generalised_absolute_error(Residuals(far, moved(estimate), Gauge.SE3))
    assert result.log_likelihood == pytest.approx(near.log_likelihood, abs=1e-12 * distance_m)
    np.testing.assert_allclose(result.information, near.information, rtol=1e-6, atol=1.0)


def test_an_information_that_is_not_positive_definite_is_an_error() -> None:
    belief, estimate = drawn(20, 1, 0.02)
    result = generalised_absolute_error(Residuals(belief, estimate, Gauge.SE3))
    wrong = result.information.copy()
    wrong[0, 0] *= -1.0
    with pytest.raises(DegenerateGeometryError, match="do not determine all directions"):
        laplace(result.mode, wrong)
