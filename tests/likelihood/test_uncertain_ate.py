"""Parts of the interval of the ATE against uncertain groundtruth, by loops and by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from strategies import seeds

from trajeval_ros.continuous_time.samples import Noise, Samples
from trajeval_ros.likelihood.uncertain_ate import (
    _variance_of_mean,
    independent_number,
    rough_square,
    uncertain_ate,
)

Array = NDArray[np.float64]


@given(seed=seeds, lag=st.sampled_from([0.5, 1.0]))
@settings(max_examples=10)
def test_rough_parts_are_differences_of_interpolated_errors(seed: int, lag: float) -> None:
    generator = np.random.default_rng(seed)
    times = np.cumsum(generator.uniform(0.05, 0.4, size=60))
    errors, step_s = generator.normal(size=(60, 3)), 0.9
    reach, squares = lag * step_s, []
    for row, time in enumerate(times):
        if time - reach < times[0] or time + reach > times[-1]:
            continue
        both = [
            np.array([np.interp(time + sign * reach, times, column) for column in errors.T])
            for sign in (-1.0, 1.0)
        ]
        squares.append(np.square(errors[row] - 0.5 * (both[0] + both[1])).sum())
    found = rough_square(times, errors, lag, step_s)
    assert found == pytest.approx(np.mean(squares) / 1.5)


def test_rough_parts_need_neighbours_within_a_step() -> None:
    times = np.arange(40.0)
    errors = np.random.default_rng(0).normal(size=(40, 3))
    assert rough_square(times, errors, 1.0, 1.0) is not None
    assert rough_square(times, errors, 1.0, 0.999) is None


@given(seed=seeds)
@settings(max_examples=10)
def test_independent_numbers_are_sums_of_autocorrelations(seed: int) -> None:
    generator = np.random.default_rng(seed)
    errors = np.cumsum(generator.normal(size=(30, 3)), axis=0)
    products = [float(np.vdot(errors[: 30 - k], errors[k:])) for k in range(30)]
    ratios = np.array(products[1:]) / products[0]
    expected = 25 / (1.0 + 2.0 * np.square(ratios).sum())
    assert independent_number(errors, 25) == pytest.approx(expected, rel=1e-9)


def test_variances_of_means_are_those_of_twenty_stretches() -> None:
    values = np.repeat(np.arange(20.0), 7)
    assert _variance_of_mean(values) == pytest.approx(np.var(np.arange(20.0), ddof=1) / 20)
    assert _variance_of_mean(np.array([1.0, 3.0])) == pytest.approx(1.0)
    assert _variance_of_mean(np.array([1.0])) == 0.0


def test_poses_are_supported_by_the_error_or_by_samples() -> None:
    generator = np.random.default_rng(0)
    times = 0.1 * np.arange(100.0)
    truth = np.column_stack([np.sin(times), np.cos(times), times])
    errors = 0.1 * generator.normal(size=(100, 3))
    sigma = np.full(100, 0.01)
    samples = Samples(
        0, 0.1 * np.arange(100.0), np.tile(np.eye(4), (100, 1, 1)), False, Noise(0.01, 0.01)
    )

    def ate(sigma: Array, noise_m: float = 0.01):
        noisy = dataclasses.replace(samples, noise=Noise(noise_m, 0.01))
        spread = np.square(sigma)[:, None, None] * np.eye(3)
        return uncertain_ate(times, truth, spread, truth + errors, None, noisy)

    plain = ate(sigma)
    rmse = float(np.sqrt(np.square(errors).sum(axis=1).mean()))
    assert plain.weighted_m == pytest.approx(rmse)
    assert plain.supported_m == pytest.approx(rmse)
    assert plain.supported_share == 1.0
    assert plain.interval_m is not None
    # A standard deviation is that of three axes, and the limit half of the error.
    sigma[:10] = 0.5 * rmse / np.sqrt(3.0)
    weighted = ate(sigma).weighted_m
    for factor, count in ((0.999, 100), (1.001, 90)):
        sigma[:10] = factor * 0.5 * weighted / np.sqrt(3.0)
        assert int(ate(sigma).supported.sum()) == count
    # One and a half standard deviations of a sample are enough.
    for factor, count in ((0.999, 100), (1.001, 90)):
        sigma[:10] = factor * 1.5 * 0.2
        assert int(ate(sigma, 0.2).supported.sum()) == count
    none = ate(np.full(100, 9.0))
    assert (none.supported_m, none.interval_m, none.supported_share) == (None, None, 0.0)
    mixed = np.random.default_rng(1).permutation(100)
    spread = 1e-4 * np.tile(np.eye(3), (100, 1, 1))
    shuffled = uncertain_ate(
        times[mixed], truth[mixed], spread, (truth + errors)[mixed], None, samples
    )
    assert shuffled.interval_m == pytest.approx(plain.interval_m, rel=1e-9)
