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
    median,
    round_below,
    statistics_of,
)

errors = arrays(
    np.float64, st.integers(1, 60), elements=st.floats(0.0, 1e9, allow_subnormal=False)
)


@given(values=errors)
def test_statistics_are_numpys(values: Array) -> None:
    result = statistics_of(values)
    assert result is not None
    size = float(values.max())
    assert result.rmse == pytest.approx(np.sqrt(np.mean(values**2)), rel=1e-12)
    assert result.mean == pytest.approx(np.mean(values), rel=1e-12)
    assert result.median == pytest.approx(np.median(values), rel=1e-12)
    assert result.std == pytest.approx(np.std(values), abs=1e-12 * size)
    assert result.p95 == pytest.approx(np.percentile(values, 95), rel=1e-12)
    assert (result.min, result.max, result.count) == (values.min(), values.max(), len(values))


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
        result, theirs = getattr(scaled, field.name), getattr(direct, field.name)
        assert result == pytest.approx(theirs, rel=1e-12, abs=tolerance), field.name


@given(values=errors)
def test_statistics_neither_sort_nor_change_what_they_are_given(values: Array) -> None:
    before = values.copy()
    first, second = statistics_of(values), statistics_of(values)
    assert first == second
    np.testing.assert_array_equal(values, before)


@pytest.mark.parametrize("nothing", [None, np.empty(0)])
def test_no_errors_have_no_statistics_rather_than_zeros(nothing: Array | None) -> None:
    assert statistics_of(nothing) is None
