"""The interval of the ATE against uncertain groundtruth: formula, laws, how often it holds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import seeds

from benchmarks.intervals import flown
from trajeval_ros.likelihood.uncertain_ate import ate_interval, independent_number, rough_square

STEP_S = 0.5
TIMES = np.arange(0.0, 50.0, 0.05)


def errors_of(seed: int, size_m: float = 0.03) -> np.ndarray:
    random = np.random.default_rng(seed)
    angles = 2.0 * np.pi * random.uniform(0.05, 0.3, 3) * TIMES[:, None]
    return size_m * np.sin(angles + random.uniform(0.0, 2.0 * np.pi, 3))


@pytest.mark.parametrize("wave_m", [0.0, 0.01])
def test_the_formula_by_hand(wave_m: float) -> None:
    # A wave as long as a step of the samples is seen over half a step alone.
    errors = errors_of(1) + wave_m * np.sin(2.0 * np.pi * TIMES / STEP_S)[:, None]
    sigma_m, variance = 0.004, 1e-5
    supported = TIMES < 30.0
    used, when = errors[supported], TIMES[supported]
    rough = 0.0
    for lag in (5, 10):  # half a step of the samples, and one, in poses
        middle = 0.5 * (used[: -2 * lag] + used[2 * lag :])
        squares = np.sum((used[lag:-lag] - middle) ** 2, axis=1)
        rough = max(rough, squares.mean() / 1.5)
    bound = 3.0 * sigma_m**2 + rough
    mean = np.mean(np.sum(used**2, axis=1))
    products = sum(np.correlate(axis, axis, "full")[len(used) :] for axis in used.T)
    number = len(used) / (1.0 + 2.0 * np.sum((products / np.sum(used**2)) ** 2))
    parts = [part.mean() for part in np.array_split(np.sum(used**2, axis=1), 20)]
    spread = (4.0 * bound * mean + 2.0 * bound**2) / 3.0 / number
    spread += 0.4 * np.var(parts, ddof=1) / 20.0
    reach = 1.959964 * np.sqrt(spread)
    result = ate_interval(TIMES, errors, np.full(1000, variance), supported, sigma_m, STEP_S)
    assert result == pytest.approx(np.sqrt([mean - bound - reach, mean + reach]), rel=1e-4)
    assert when[-1] < 30.0


def test_a_model_less_sure_than_samples_counts_instead_of_them() -> None:
    everywhere = np.ones(len(TIMES), dtype=bool)
    intervals = [
        ate_interval(TIMES, errors_of(2), np.full(1000, variance), everywhere, sigma_m, STEP_S)
        for variance, sigma_m in ((3e-4, 0.002), (1e-6, 0.01))
    ]
    assert intervals[0] == pytest.approx(intervals[1], rel=1e-12)


def interval_of(
    errors: np.ndarray, supported: np.ndarray, variances: np.ndarray, sigma_m: float = 0.002
) -> tuple[float, float]:
    result = ate_interval(TIMES, errors, variances, supported, sigma_m, STEP_S)
    assert result is not None
    return result


def test_what_is_not_supported_has_no_variance_that_counts() -> None:
    supported, variances = TIMES < 30.0, np.full(1000, 1e-4)
    intervals = [
        interval_of(errors_of(6), supported, np.where(supported, variances, other))
        for other in (1e-4, 1.0)
    ]
    assert intervals[0] == intervals[1]


def test_the_lower_end_is_zero_where_noise_may_explain_all() -> None:
    everywhere = np.ones(len(TIMES), dtype=bool)
    low, high = interval_of(errors_of(7), everywhere, np.full(1000, 1e-4), 1.0)
    assert low == 0.0
    assert high > 0.05


def test_samples_faster_than_poses_are_no_finer_than_these() -> None:
    arguments = (TIMES, errors_of(8), np.full(1000, 1e-5), np.ones(1000, dtype=bool), 0.002)
    assert ate_interval(*arguments, 0.001) == ate_interval(*arguments, 0.05)


def test_fewer_poses_than_stretches_have_an_interval() -> None:
    times, supported = np.arange(20.0), np.arange(20) < 15
    result = ate_interval(times, errors_of(9)[::50], np.full(20, 1e-6), supported, 0.001, 1.0)
    assert result is not None
    assert np.isfinite(result).all()


@given(seed=seeds, factor=st.floats(0.01, 100.0))
def test_it_scales_and_holds_the_rmse(seed: int, factor: float) -> None:
    random = np.random.default_rng(seed)
    errors = errors_of(seed) + random.normal(scale=0.002, size=(1000, 3))
    supported = random.random(1000) < 0.9
    variances = np.full(1000, 1e-5)
    small = ate_interval(TIMES, errors, variances, supported, 0.002, STEP_S)
    large = ate_interval(
        TIMES, factor * errors, factor**2 * variances, supported, factor * 0.002, STEP_S
    )
    assert small is not None
    assert large == pytest.approx(factor * np.array(small), rel=1e-9)
    rmse = float(np.sqrt(np.mean(np.sum(errors[supported] ** 2, axis=1))))
    assert small[0] < rmse < small[1]


def test_rough_is_noise_and_neither_offset_nor_drift() -> None:
    noise = np.random.default_rng(3).normal(scale=0.01, size=(20_000, 3))
    times = 0.05 * np.arange(20_000)
    assert rough_square(times, noise, 1.0, STEP_S) == pytest.approx(3e-4, rel=0.03)
    drift = np.outer(times, [0.1, -0.2, 0.3]) + 5.0
    assert rough_square(times, drift, 1.0, STEP_S) == pytest.approx(0.0, abs=1e-20)


@pytest.mark.parametrize("apart_s", [0.85, 2.0])
def test_groundtruth_far_apart_tells_nothing_rough(apart_s: float) -> None:
    # Clusters of poses, further from each other than a step of the samples.
    times = np.concatenate([apart_s * place + 0.05 * np.arange(4) for place in range(20)])
    supported = np.ones(len(times), dtype=bool)
    errors = np.random.default_rng(4).normal(size=(len(times), 3))
    assert ate_interval(times, errors, np.ones(len(times)), supported, 0.1, STEP_S) is None
    assert rough_square(np.arange(2.0), np.zeros((2, 3)), 1.0, STEP_S) is None


def test_what_is_rough_takes_ten_differences() -> None:
    times = np.arange(30.0)
    assert rough_square(times, np.zeros((30, 3)), 1.0, 10.0) == 0.0
    assert rough_square(times[:-1], np.zeros((29, 3)), 1.0, 10.0) is None


def test_poses_may_be_close_to_each_other_or_repeated() -> None:
    fast = 2e-4 * np.arange(400)
    drift = np.outer(fast, [1.0, -2.0, 3.0])
    assert rough_square(fast, drift, 1.0, 0.0101) == pytest.approx(0.0, abs=1e-20)
    repeated = np.concatenate([[0.0], np.arange(40.0)])
    drift = np.outer(repeated, [1.0, -2.0, 3.0])
    assert rough_square(repeated, drift, 1.0, 10.0) == pytest.approx(0.0, abs=1e-20)


def test_how_many_independent_values() -> None:
    random = np.random.default_rng(5)
    white = random.normal(size=(20_000, 3))
    assert independent_number(white, 20_000) == pytest.approx(20_000, rel=0.6)
    held = np.repeat(white[:400], 50, axis=0)
    assert independent_number(held, 20_000) < 800.0
    assert independent_number(np.zeros((10, 3)), 10) == 10.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "noise", "size_m"),
    [
        ("stop-and-go", "white", 0.002),
        ("stop-and-go", "AR 0.5 s", 0.02),
        ("smooth", "2 % outliers", 0.02),
        ("smooth", "AR 2 s", 0.02),
        ("walk", "AR 2 s", 0.02),
        ("walk", "2 % outliers", 0.02),
        ("walk at 2 Hz", "Student t3", 0.002),
    ],
)
def test_it_covers_the_true_ate_where_noise_and_motion_are_hard(
    motion: str, noise: str, size_m: float
) -> None:
    result = [item for seed in range(5000, 5020) for item in flown(motion, noise, size_m, seed)]
    known = [item.covers for item in result if item.interval_m is not None]
    assert len(known) >= 0.5 * len(result)
    assert np.mean(known) >= 0.9
