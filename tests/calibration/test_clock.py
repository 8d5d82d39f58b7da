"""The correlation of rates of motion, and offsets of flights."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from exact_flights import FAULT, flown
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from strategies import seeds

from trajeval_ros.calibration.clock_offset import (
    guess_offset,
    guess_offset_by,
    masked_correlation,
)
from trajeval_ros.calibration.increments import whole_nanoseconds

Array = NDArray[np.float64]


@given(seed=seeds, first=st.integers(3, 12), second=st.integers(3, 20))
@settings(max_examples=15)
def test_masked_correlations_are_those_of_common_samples(
    seed: int, first: int, second: int
) -> None:
    generator = np.random.default_rng(seed)
    a, b = generator.normal(size=(2, first)), generator.normal(size=(2, second))
    in_a, in_b = (generator.uniform(size=size) < 0.8 for size in (first, second))
    for most in (None, 0, 1, second - 1):
        lags, correlation, common = masked_correlation(
            a * in_a, in_a.astype(float), b * in_b, in_b.astype(float), most
        )
        expected = range(1 - first, second) if most is None else range(most + 1)
        assert lags.tolist() == list(expected)
        for place, lag in enumerate(lags.tolist()):
            rows = [n for n in range(first) if 0 <= n + lag < second]
            both = [n for n in rows if in_a[n] and in_b[n + lag]]
            assert common[place] == len(both)
            for signal in range(2):
                one = a[signal, both]
                other = b[signal, [n + lag for n in both]]
                value = np.corrcoef(one, other)[0, 1] if len(both) > 1 else 0.0
                assert correlation[signal, place] == pytest.approx(value, abs=1e-6)


def test_offsets_of_flights_are_found_by_both_rates() -> None:
    truth, estimate, _ = flown()
    for signal in ("angular rate", "speed"):
        result = guess_offset_by(truth, estimate, 0.0, 5.0, signal)
        assert result.signal == signal
        assert result.offset_s == pytest.approx(FAULT.offset_s, abs=0.02)
        assert result.peak > (0.99 if signal == "angular rate" else 0.5)
    assert guess_offset(truth, estimate).signal == "angular rate"
    bare = dataclasses.replace(truth, quaternions=None)
    assert guess_offset(bare, estimate).signal == "speed"
    later = dataclasses.replace(truth, stamps=truth.stamps + whole_nanoseconds(7.0))
    problem = guess_offset_by(later, estimate, 0.0, 5.0, "angular rate").problem
    assert "probably +7.01 s, outside the search range of 5 s around 0 s" in problem
    around = guess_offset(later, estimate, around_s=6.0)
    assert around.offset_s == pytest.approx(7.0 + FAULT.offset_s, abs=0.01)
    anywhere = guess_offset(later, estimate, search_s=None)
    assert anywhere.offset_s == pytest.approx(7.0 + FAULT.offset_s, abs=0.01)
