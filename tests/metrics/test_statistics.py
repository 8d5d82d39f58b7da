"""Statistics against numpy's."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from strategies import Array

from trajeval_ros.metrics.statistics import (
    Statistics,
    median,
    quantile,
    round_below,
    statistics_of,
)

errors = arrays(
    np.float64, st.integers(1, 60), elements=st.floats(0.0, 1e9, allow_subnormal=False)
)


@given(values=errors)
def test_statistics_are_numpys(values: Array) -> None:
    ours = statistics_of(values)
    assert ours is not None
    size = float(values.max())
    assert ours.rmse == pytest.approx(np.sqrt(np.mean(values**2)), rel=1e-12)
    assert ours.mean == pytest.approx(np.mean(values), rel=1e-12)
    assert ours.median == pytest.approx(np.median(values), rel=1e-12)
    assert ours.std == pytest.approx(np.std(values), abs=1e-12 * size)
    assert ours.p95 == pytest.approx(np.percentile(values, 95), rel=1e-12)
    assert (ours.min, ours.max, ours.count) == (values.min(), values.max(), len(values))


@given(values=arrays(np.float64, st.integers(1, 9), elements=st.floats(-1e9, 1e9)))
def test_the_median_is_numpys_to_the_last_bit(values: Array) -> None:
    assert median(values) == np.median(values)
    assert median(values.astype(np.int64)) == np.median(values.astype(np.int64))
    kept = values.copy()
    median(values)
    assert (values == kept).all()


@given(st.integers(-9, 9), st.sampled_from([1.0, 2.0, 5.0]), st.floats(1.0, 1.999))
def test_a_round_number_below_is_one_two_or_five(power: int, step: float, more: float) -> None:
    """The next ones are 2, 2.5 and 2 times larger."""
    rounded = float(f"{step:g}e{power}")
    assert round_below(rounded * (1.0 + 1e-9) * more) == pytest.approx(rounded, rel=1e-12)


def test_the_median_of_nothing_or_with_nan_is_none() -> None:
    assert np.isnan(median(np.zeros(0)))
    assert np.isnan(median(np.array([1.0, np.nan, 2.0])))


@given(values=errors, factor=st.floats(1e-3, 1e3))
def test_statistics_scale_with_the_unit(values: Array, factor: float) -> None:
    statistics, direct = statistics_of(values), statistics_of(values * factor)
    assert statistics is not None
    assert direct is not None
    scaled = statistics.scaled(factor)
    tolerance = 1e-12 * factor * float(values.max())
    for field in dataclasses.fields(scaled):
        ours, theirs = getattr(scaled, field.name), getattr(direct, field.name)
        assert ours == pytest.approx(theirs, rel=1e-12, abs=tolerance), field.name


@given(values=errors)
def test_statistics_neither_sort_nor_change_what_they_are_given(values: Array) -> None:
    before = values.copy()
    first, second = statistics_of(values), statistics_of(values)
    assert first == second
    np.testing.assert_array_equal(values, before)


def by_sorting(values: Array) -> Statistics:
    """Return the statistics as they are defined, of sorted values."""
    ordered = np.sort(values)
    mean = float(ordered.mean())
    return Statistics(
        rmse=float(np.sqrt(np.mean(ordered**2))),
        mean=mean,
        median=quantile(ordered, 0.5),
        std=float(np.sqrt(np.mean((ordered - mean) ** 2))),
        min=float(ordered[0]),
        max=float(ordered[-1]),
        p95=quantile(ordered, 0.95),
        count=len(ordered),
    )


def assert_same(ours: Statistics | None, expected: Statistics | None) -> None:
    """Compare: what is a number of the sample is that number, sums differ by rounding."""
    assert ours is not None
    assert expected is not None
    for name in ("median", "min", "max", "p95", "count"):
        assert getattr(ours, name) == getattr(expected, name), name
    for name in ("rmse", "mean", "std"):
        close = pytest.approx(getattr(expected, name), rel=1e-14, abs=1e-14 * expected.max)
        assert getattr(ours, name) == close, name


@given(values=errors)
def test_statistics_of_few_are_those_of_sorted_values(values: Array) -> None:
    assert_same(statistics_of(values), by_sorting(values))


@pytest.mark.parametrize("count", [999, 1000, 1001, 1020, 100_001])
@pytest.mark.parametrize("digits", [1, 12], ids=["with ties", "without"])
def test_statistics_of_many_are_those_of_sorted_values(count: int, digits: int) -> None:
    values = np.round(np.random.default_rng(count).lognormal(size=count), digits)
    assert_same(statistics_of(values), by_sorting(values))


def test_statistics_of_a_strided_column_are_those_of_its_values() -> None:
    columns = np.random.default_rng(3).lognormal(size=(500, 2))
    assert_same(statistics_of(columns[:, 1]), by_sorting(columns[:, 1]))


@given(values=errors, seed=st.integers(0, 1000))
def test_statistics_do_not_depend_on_the_order(values: Array, seed: int) -> None:
    shuffled = np.random.default_rng(seed).permutation(values)
    assert_same(statistics_of(shuffled), statistics_of(values))


def test_percentile_is_the_samples_not_a_normal_distributions() -> None:
    values = np.concatenate([np.full(90, 0.1), np.full(10, 50.0)])
    ours = statistics_of(values)
    assert ours is not None
    assert ours.p95 == np.percentile(values, 95) == 50.0
    assert ours.p95 != pytest.approx(values.mean() + 1.645 * values.std(), rel=0.1)


def test_rmse_is_the_root_mean_square_and_not_the_mean() -> None:
    ours = statistics_of(np.array([0.0, 2.0]))
    assert ours is not None
    assert ours.rmse == pytest.approx(np.sqrt(2.0))
    assert ours.mean == 1.0


@pytest.mark.parametrize("nothing", [None, np.empty(0)])
def test_no_errors_have_no_statistics_rather_than_zeros(nothing: Array | None) -> None:
    assert statistics_of(nothing) is None
