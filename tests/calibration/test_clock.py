"""The correlation of rates of motion, its peak, and the verdict on it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from calibration_flights import stamps_of
from exact_flights import FAULT, flown
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from strategies import seeds

from trajeval_ros.calibration import clock_offset
from trajeval_ros.calibration.clock_offset import (
    OffsetGuess,
    _highest,
    _rate,
    guess_offset,
    guess_offset_by,
    masked_correlation,
    refined_peak,
)
from trajeval_ros.calibration.increments import PoseInterpolator, whole_nanoseconds
from trajeval_ros.geometry.trajectory import Trajectory

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


def test_constant_signals_have_no_correlation() -> None:
    ones, signal = np.ones(8), np.array([1.0, 3.0, 2.0, 5.0, 4.0, 2.0, 1.0, 6.0])
    assert not masked_correlation(0.0 * ones, ones, signal, ones)[1].any()


@given(shift=st.floats(-0.5, 0.5), bend=st.floats(0.1, 3.0))
def test_the_refined_peak_is_that_of_the_parabola(shift: float, bend: float) -> None:
    cells = np.arange(5.0)
    assert refined_peak(4.0 - bend * (cells - 2.0 - shift) ** 2, 2) == pytest.approx(shift)
    assert refined_peak(cells, 0) == refined_peak(cells, 4) == refined_peak(cells, 2) == 0.0
    assert refined_peak(np.array([4.0, 1.0, 5.0]), 1) == 0.0


def highest(heights: Array, *, common: Array | None = None, search_s: float | None = 5.0,
            around_s: float = 0.0, signal: str = "speed") -> OffsetGuess:  # fmt: skip
    lags_s = 0.02 * (np.arange(float(len(heights))) - len(heights) // 2)
    overlap = np.full(len(heights), 1000.0) if common is None else common
    return _highest(lags_s, heights, overlap, around_s, search_s, signal)


def lobe(cells: int = 201, at: int = 100, width: float = 10.0, height: float = 0.9) -> Array:
    places = np.arange(float(cells)) - at
    return np.asarray(height * np.exp(-0.5 * (places / width) ** 2))


def test_the_highest_correlation_and_its_verdict() -> None:
    found = highest(lobe(at=110))
    assert found.is_usable
    assert found.offset_s == pytest.approx(0.2, abs=1e-6)
    assert found.peak == pytest.approx(0.9)
    assert found.overlap_s == pytest.approx(20.0)
    # The lobe ends at its limit of 0.8, and falls from there on: the rest is beyond it.
    assert found.second < 0.8 * 0.9
    heights = lobe() + lobe(at=20, width=5.0, height=0.71)
    assert highest(heights).is_usable
    assert highest(heights).second == pytest.approx(0.71, abs=1e-6)
    heights = lobe() + lobe(at=180, width=5.0, height=0.73)
    assert "match at several offsets" in highest(heights).problem
    assert highest(heights).second == pytest.approx(0.73, abs=1e-6)
    # A ripple on the top is no second peak.
    heights = lobe(width=20.0)
    heights[108], heights[92] = 0.89, 0.88
    assert highest(heights).is_usable
    sides = highest(heights + lobe(at=20, width=5.0, height=0.5))
    assert sides.peak_to_sidelobe > 3.0


@pytest.mark.parametrize("at", [10, 190])
def test_a_lobe_that_falls_to_both_limits_has_no_sides(at: int) -> None:
    for width in (30.0, 500.0):
        found = highest(lobe(at=at, width=width))
        assert found.is_usable
        assert (found.second, found.peak_to_sidelobe) == (-1.0, 0.0)


def test_sides_have_a_mean_and_a_deviation() -> None:
    sides = np.tile([0.1, 0.3], 50)
    for heights in (
        np.concatenate([lobe(101, 50, 5.0), sides]),
        np.concatenate([sides[::-1], lobe(101, 50, 5.0)]),
    ):
        found = highest(heights)
        assert found.second == pytest.approx(0.3)
        assert found.peak_to_sidelobe == pytest.approx((0.9 - 0.2) / 0.1)


@pytest.mark.parametrize(("signal", "least"), [("speed", 0.5), ("angular rate", 0.7)])
def test_correlations_have_a_least_height(signal: str, least: float) -> None:
    assert highest(lobe(height=least + 1e-6), signal=signal).is_usable
    low = highest(lobe(height=least - 1e-6), signal=signal)
    assert "do not correlate" in low.problem
    assert not low.is_usable


def test_matches_at_the_limits_of_the_search() -> None:
    for at in (0, 200):
        assert "at the limit" in highest(lobe(at=at)).problem
    for at in (1, 199):
        assert highest(lobe(at=at)).is_usable
    # A range of +-1 s around 0.5 s has the lags from -0.5 to 1.5 s.
    assert "at the limit" in highest(lobe(at=175), search_s=1.0, around_s=0.5).problem
    assert "at the limit" in highest(lobe(at=76), search_s=1.0, around_s=0.51).problem
    near = highest(lobe(at=174), search_s=1.0, around_s=0.5)
    assert near.is_usable


def test_short_overlaps_do_not_count() -> None:
    common = np.full(201, 499.0)
    assert "no offset within 5 s around 0 s" in highest(lobe(), common=common).problem
    assert highest(lobe(), common=common).overlap_s == pytest.approx(9.98)
    common[99:102] = 500.0  # 10 s
    assert highest(lobe(), common=common).is_usable
    common[101] = 499.0
    assert "common time span" in highest(lobe(), common=common).problem
    # Over all lags, half of the longest overlap is needed.
    common = np.full(201, 1999.0)
    common[90:111] = 4000.0
    assert highest(lobe(at=150), common=common, search_s=None).offset_s < 0.3
    common[120:] = 2000.0
    assert highest(lobe(at=150), common=common, search_s=None).offset_s == pytest.approx(1.0)


def test_offsets_of_flights_are_found_by_both_rates() -> None:
    truth, estimate, _ = flown()
    for signal in ("angular rate", "speed"):
        found = guess_offset_by(truth, estimate, 0.0, 5.0, signal)
        assert found.signal == signal
        assert found.offset_s == pytest.approx(FAULT.offset_s, abs=0.02)
        assert found.peak > (0.99 if signal == "angular rate" else 0.5)
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


def test_rates_are_central_differences_of_known_motion() -> None:
    seconds = np.arange(0.0, 4.0001, 0.01)
    positions = np.column_stack([seconds**2, 0.0 * seconds, 0.0 * seconds])
    turns = Rotation.from_rotvec(np.outer(0.5 * seconds**2, [0.0, 0.6, 0.8])).as_quat()
    path = Trajectory(stamps_of(seconds), positions, turns)
    for oriented, factor in ((False, 2.0), (True, 1.0)):
        poses = PoseInterpolator.of(path, with_rotations=oriented)
        rate, known = _rate(poses, 0.1)
        assert len(rate) == len(known) == 200  # a grid of 20 ms, without the last stamp
        # Half a window after the first stamp and before the last one.
        assert np.flatnonzero(known)[[0, -1]].tolist() == [3, 197]
        inside = known > 0.0
        expected = factor * 0.02 * np.flatnonzero(inside)
        np.testing.assert_allclose(rate[inside], expected - expected.mean(), atol=1e-4)
        assert not rate[~inside].any()
    # A gap of more than half a second is not known.
    kept = (seconds < 1.5) | (seconds > 2.2)
    _, known = _rate(PoseInterpolator.of(path[kept], with_rotations=False), 0.1)
    assert not known[np.arange(75, 110)].any()
    assert known[np.r_[3:72, 114:197]].all()


@pytest.mark.parametrize(("every", "window_s"), [(1, 0.1), (2, 0.1), (3, 0.15), (10, 0.5)])
def test_both_sides_have_the_window_of_the_slower_estimate(
    monkeypatch: pytest.MonkeyPatch, every: int, window_s: float
) -> None:
    windows = []

    def seen(poses: PoseInterpolator, window_s: float) -> tuple[Array, Array]:
        windows.append(window_s)
        return _rate(poses, window_s)

    monkeypatch.setattr(clock_offset, "_rate", seen)
    truth, estimate, _ = flown()
    guess_offset_by(truth, estimate[::every], 0.0, 5.0, "speed")
    assert windows == [pytest.approx(window_s)] * 2
