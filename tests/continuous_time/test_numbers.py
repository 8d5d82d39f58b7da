"""Formulas of the continuous-time models, each against an independent computation."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal
from solved_process import solved
from strategies import seeds

from trajeval_ros.continuous_time import white_noise
from trajeval_ros.continuous_time.kernels import (
    MATERN_32,
    MATERN_52,
    SQUARED_EXPONENTIAL,
    Kernel,
    most_likely,
    negative_log_likelihood,
)
from trajeval_ros.continuous_time.manifolds import Manifold, Positions, Rotations
from trajeval_ros.continuous_time.markov import Process
from trajeval_ros.geometry import so3

Array = NDArray[np.float64]
ORDERS = [1, 2, 3]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("time_s", [0.3, 1.0, 2.7])
def test_white_noise_is_van_loans_matrix_exponential(order: int, time_s: float) -> None:
    """Van Loan, Computing integrals involving the matrix exponential, 1978."""
    chain = np.eye(order, k=1)
    power = np.zeros((order, order))
    power[-1, -1] = 1.0
    both = expm(np.block([[-chain, power], [np.zeros_like(chain), chain.T]]) * time_s)
    phi = both[order:, order:].T
    spread = phi @ both[:order, order:]
    time = np.array([time_s])
    np.testing.assert_allclose(white_noise.transition(order, time)[0], phi, rtol=1e-12)
    np.testing.assert_allclose(white_noise.covariance(order, time)[0], spread, rtol=1e-11)
    information = white_noise.information(order, time)[0]
    np.testing.assert_allclose(information @ spread, np.eye(order), atol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
@given(step=st.floats(0.2, 3.0), share=st.floats(0.05, 0.95))
@settings(max_examples=8)
def test_interpolation_is_the_conditional_gaussian(order: int, step: float, share: float) -> None:
    since = share * step
    one = [np.array([item]) for item in (since, step - since, step)]
    before, after, whole = (white_noise.transition(order, item)[0] for item in one)
    estimated, rest, total = (white_noise.covariance(order, item)[0] for item in one)
    np.testing.assert_allclose(after @ estimated @ after.T + rest, total, rtol=1e-10, atol=1e-12)
    # The joint covariance of the states at `since` and `step`, given the first one.
    gain = estimated @ after.T @ np.linalg.inv(total)
    by_first, by_second, spread = white_noise.interpolation(order, one[2], one[0])
    np.testing.assert_allclose(by_second[0], gain[0], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(by_first[0], (before - gain @ whole)[0], rtol=1e-7, atol=1e-9)
    expected = (estimated - gain @ after @ estimated)[0, 0]
    assert spread[0] == pytest.approx(expected, rel=1e-6, abs=1e-12 * total[0, 0])


@pytest.mark.parametrize("dimension", [1, 3])
@pytest.mark.parametrize("order", ORDERS)
def test_axes_are_kronecker_products(order: int, dimension: int) -> None:
    generator = np.random.default_rng(order)
    matrices = generator.normal(size=(4, order, order))
    axes = generator.uniform(0.5, 2.0, size=dimension)
    result = white_noise.spread_over_axes(matrices, axes)
    for matrix, product in zip(matrices, result, strict=True):
        np.testing.assert_array_equal(product, np.kron(matrix, np.diag(axes)))


@pytest.mark.parametrize(
    ("kernel", "order"), [(MATERN_32, 1.5), (MATERN_52, 2.5), (SQUARED_EXPONENTIAL, math.inf)]
)
def test_kernels_are_those_of_bessel_functions(kernel: Kernel, order: float) -> None:
    """Rasmussen and Williams, Gaussian processes for machine learning, eq. (4.9) and (4.14)."""
    from scipy.special import gamma, kv

    lags, length = np.linspace(0.05, 4.0, 30), 0.8
    if np.isinf(order):
        expected = np.exp(-(lags**2) / (2.0 * length**2))
    else:
        scaled = math.sqrt(2.0 * order) * lags / length
        expected = 2.0 ** (1.0 - order) / gamma(order) * scaled**order * kv(order, scaled)
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(kernel.between(sign * lags, length), expected, rtol=1e-12)
    assert kernel.between(np.zeros(1), length)[0] == 1.0
    longer, shorter = (kernel.between(lags, length * math.exp(step)) for step in (1e-5, -1e-5))
    result = kernel.by_log_length(-lags, length)
    np.testing.assert_allclose(result, (longer - shorter) / 2e-5, rtol=1e-7, atol=1e-9)


@given(seed=seeds, axes=st.integers(1, 3))
@settings(max_examples=10)
def test_likelihood_of_segments_is_that_of_independent_gaussians(seed: int, axes: int) -> None:
    generator = np.random.default_rng(seed)
    times = np.sort(generator.uniform(0.0, 3.0, size=(2, 6)), axis=1)
    targets = generator.normal(size=(2, 6, axes))
    sigma, length, noise = 1.3, 0.7, 0.2
    lags = times[:, :, None] - times[:, None, :]
    expected = sum(
        multivariate_normal.logpdf(
            column, cov=sigma**2 * MATERN_52.between(lag, length) + noise**2 * np.eye(6)
        )
        for lag, target in zip(lags, targets, strict=True)
        for column in target.T
    )
    value, _ = negative_log_likelihood(MATERN_52, lags, targets, np.log([sigma, length, noise]))
    assert -value == pytest.approx(float(expected), rel=1e-10)


def test_hyperparameters_of_many_segments_are_a_maximum() -> None:
    """More than a hundred segments are represented by a hundred, evenly."""
    generator = np.random.default_rng(4)
    segments, noise = 150, 0.05
    times = np.tile(0.1 * np.arange(8.0), (segments, 1)) + np.arange(float(segments))[:, None]
    covariance = 0.6**2 * MATERN_32.between(times[0, :, None] - times[0], 0.4)
    root = np.linalg.cholesky(covariance + noise**2 * np.eye(8))
    targets = root @ generator.normal(size=(segments, 8, 3))
    _, result = most_likely((MATERN_32,), times, targets, noise, 0.1)
    assert result.noise == noise
    some = np.unique(np.linspace(0, 149, 100).astype(int))
    at = np.log([result.sigma, result.length, result.noise])
    lags = times[some, :, None] - times[some, None, :]
    best, gradient = negative_log_likelihood(MATERN_32, lags, targets[some], at)
    # The optimiser stops at a relative change of 2e-9 of the value.
    assert (np.abs(gradient[:2]) < 1e-3 * abs(best)).all()
    for step in 0.05 * np.eye(3)[:2]:
        for sign in (1.0, -1.0):
            assert negative_log_likelihood(MATERN_32, lags, targets[some], at + sign * step)[0] > (
                best
            )


def _random_states(generator: np.random.Generator, manifold: Manifold, count: int) -> Array:
    if isinstance(manifold, Positions):
        return generator.normal(size=(count, 3))
    vectors: Array = 0.4 * generator.normal(size=(count, 3))
    return so3.exp(vectors)


@given(seed=seeds, size=st.sampled_from([0.2, 1.0, 2.5]))
@settings(max_examples=8)
def test_local_variables_of_rotations_are_derivatives(seed: int, size: float) -> None:
    """Along any path of rotations, g' and g'' are the derivatives of Log(T^-1 T')."""
    generator = np.random.default_rng(seed)
    direction = generator.normal(size=3)
    start = size * direction / np.linalg.norm(direction)
    rate, acceleration = generator.normal(size=(2, 3))

    def path(time: float) -> Array:
        """Body rate w + a t to second order: Exp of the integral, the next term is t^3."""
        rotation = rate * time + 0.5 * acceleration * time**2
        return so3.log(so3.exp(start) @ so3.exp(rotation))

    step = 1e-4
    before, now, after = (path(time) for time in (-step, 0.0, step))
    local = Rotations().local(start[None], np.stack([rate, acceleration])[None])
    np.testing.assert_allclose(local.values[0, 0], now, atol=1e-12)
    np.testing.assert_allclose(local.values[0, 1], (after - before) / (2 * step), atol=1e-5)
    np.testing.assert_allclose(
        local.values[0, 2], (after - 2.0 * now + before) / step**2, atol=1e-5
    )


@pytest.mark.parametrize("order", ORDERS)
@given(seed=seeds, size=st.sampled_from([0.2, 1.0, 2.5]))
@settings(max_examples=4)
def test_jacobians_of_local_variables_are_derivatives(order: int, seed: int, size: float) -> None:
    generator = np.random.default_rng(seed)
    given_ = generator.normal(size=(1, order, 3))
    given_[:, 0] *= size / np.linalg.norm(given_[:, 0])
    for manifold in (Rotations(), Positions()):
        jacobian = manifold.local(given_[:, 0], given_[:, 1:]).jacobian
        for row, column in np.ndindex(order, 3):
            step = np.zeros_like(given_)
            step[:, row, column] = 1e-5
            ahead, behind = (given_ + sign * step for sign in (1.0, -1.0))
            change = (
                manifold.local(ahead[:, 0], ahead[:, 1:]).values
                - manifold.local(behind[:, 0], behind[:, 1:]).values
            ) / 2e-5
            np.testing.assert_allclose(jacobian[..., row, column], change, atol=1e-7)


@pytest.mark.parametrize("manifold", [Positions(), Rotations()])
@pytest.mark.parametrize("order", ORDERS)
def test_normal_equations_are_the_gradient_of_the_cost(manifold: Manifold, order: int) -> None:
    generator = np.random.default_rng(order)
    times = np.array([0.0, 0.5, 0.9, 1.7, 2.0])
    process = Process.unsolved(manifold, order, times, _random_states(generator, manifold, 5), 0.3)
    process = dataclasses.replace(
        process,
        density=np.array([0.5, 0.8, 1.3]),
        states=_random_states(generator, manifold, 5),
        rates=0.5 * generator.normal(size=process.rates.shape),
    )
    _, _, slope, _ = process._normal_equations()
    size = 3 * order
    for knot, column in np.ndindex(5, size):
        step = np.zeros((5, size))
        step[knot, column] = 1e-5

        def cost(sign: float, step: Array = step) -> float:
            moved = dataclasses.replace(
                process,
                states=manifold.plus(process.states, sign * step[:, :3]),
                rates=process.rates + sign * step[:, 3:].reshape(process.rates.shape),
            )
            return moved._normal_equations()[3]

        change = (cost(1.0) - cost(-1.0)) / 2e-5
        assert -slope[knot, column] == pytest.approx(change, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("manifold", [Positions(), Rotations()])
def test_a_fitted_density_is_the_most_likely_one(manifold: Manifold) -> None:
    generator = np.random.default_rng(7)
    times = 0.1 * np.arange(60.0)
    walk = np.cumsum(np.cumsum(0.02 * generator.normal(size=(60, 3)), axis=0), axis=0)
    states = walk if isinstance(manifold, Positions) else Rotation.from_rotvec(walk).as_matrix()
    fitted = Process.fit(manifold, 2, times, states, 0.01)
    assert np.ptp(fitted.density) == 0.0
    at = math.log(fitted.density[0])
    # Near its maximum the likelihood is a parabola: it is the same a step to either side.
    below, here, above = (
        solved(manifold, 2, times, states, 0.01, math.exp(at + step)).log_likelihood()
        for step in (-0.2, 0.0, 0.2)
    )
    assert here > max(below, above)
    shift = 0.1 * (above - below) / (2.0 * here - above - below)
    assert abs(shift) < 0.02  # the optimiser's tolerance is 0.003, Gauss-Newton's is coarser


@pytest.mark.parametrize("manifold", [Positions(), Rotations()])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("since_s", [0.2, -0.3])
def test_a_carried_state_is_a_derivative(manifold: Manifold, order: int, since_s: float) -> None:
    generator = np.random.default_rng(order)
    times = np.arange(4.0)
    process = Process.unsolved(manifold, order, times, _random_states(generator, manifold, 4), 0.3)
    process = dataclasses.replace(process, rates=generator.normal(size=process.rates.shape))
    knots = np.array([1])

    def at(step: Array) -> Array:
        state = manifold.plus(process.states[knots], step[None, :3])
        rates = process.rates[1] + step[3:].reshape(order - 1, 3)
        powers = [since_s, since_s**2 / 2.0][: order - 1]
        return manifold.plus(state, np.einsum("k,kd->d", powers, rates)[None])

    result = process.carried(knots, np.array([since_s]))[0]
    for column, step in enumerate(1e-5 * np.eye(3 * order)):
        change = manifold.between(at(-step), at(step))[0] / 2e-5
        # To second order in the step along its own path, symmetric differences are exact.
        np.testing.assert_allclose(result[:, column], change, atol=1e-7)


@pytest.mark.parametrize("order", ORDERS)
def test_a_knot_without_a_sample_leaves_the_likelihood(order: int) -> None:
    generator = np.random.default_rng(order)
    times = np.cumsum(generator.uniform(0.3, 0.9, size=7))
    positions = generator.normal(size=(7, 3))
    alone = solved(Positions(), order, times, positions, 0.2, 0.6)
    more = np.sort(np.append(times, 0.5 * (times[2:4] + times[3:5])))
    rows = np.searchsorted(more, times)
    states, information = np.zeros((9, 3)), np.zeros((9, 3))
    states[rows], information[rows] = positions, 0.2**-2
    between = dataclasses.replace(
        alone,
        times=more,
        measured=states,
        information=information,
        states=states,
        rates=np.zeros((9, order - 1, 3)),
    ).solved()
    assert between.log_likelihood() == pytest.approx(alone.log_likelihood(), rel=1e-9)
    np.testing.assert_allclose(between.states[rows], alone.states, atol=1e-9)
