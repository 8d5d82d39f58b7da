"""Rates of motion, and the offsets and the rates between clocks that they show."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from trajeval_ros.diagnosis.clocks import (
    ClockMatch,
    RatesOfMotion,
    offsets_of_parts,
    rates_of_both,
    search_rate,
)
from trajeval_ros.diagnosis.input_pair import TimedPoses


def irregular(seed: int = 0, span_s: float = 60.0, step_s: float = 0.05) -> TimedPoses:
    """Return a body with irregular speed and angular speed."""
    random = np.random.default_rng(seed)
    seconds = np.arange(0.0, span_s, step_s)
    nodes = np.arange(0.0, span_s + 1.0)
    speeds = [1.5 + np.interp(seconds, nodes, random.uniform(-1.4, 1.4, len(nodes))) for _ in "ab"]
    along, angle = (np.cumsum(speed) * step_s for speed in speeds)
    quaternions = Rotation.from_rotvec(np.outer(angle, [0.0, 0.0, 1.0])).as_quat()
    return TimedPoses(seconds, np.outer(along, [0.6, 0.8, 0.0]), quaternions)


@pytest.mark.parametrize("oriented", [True, False])
def test_rates_are_speeds_and_angular_speeds(*, oriented: bool) -> None:
    """Along x with 0.5 m/s, and about an axis with 0.3 rad/s; and quaternions of either sign."""
    seconds = 3.0 + np.arange(0.0, 10.0, 0.1)
    quaternions = Rotation.from_rotvec(np.outer(0.3 * seconds, [0.6, 0.0, -0.8])).as_quat()
    quaternions *= (-1.0) ** np.arange(len(seconds))[:, None]
    positions = np.outer(0.5 * seconds, [1.0, 0.0, 0.0])
    poses = TimedPoses(seconds, positions, quaternions if oriented else None)
    rates = RatesOfMotion.of(poses, 0.05, 0.4)
    assert rates.values.shape == (1 + oriented, len(rates.known))
    inside = rates.known > 0.0
    assert 0.9 < inside.mean() < 1.0  # not at the ends
    np.testing.assert_allclose(rates.values[0, inside], 0.5, rtol=1e-9)
    if oriented:
        np.testing.assert_allclose(rates.values[1, inside], 0.3, rtol=1e-6)


@given(st.integers(0, 1000), st.floats(1.0, 1e3))
def test_standardized_rates_have_no_outliers_mean_zero_and_deviation_one(
    seed: int, outlier: float
) -> None:
    random = np.random.default_rng(seed)
    values, known = random.exponential(size=(1, 200)), (random.random(200) < 0.8).astype(float)
    values[0, [5, 70]] = outlier
    row = RatesOfMotion(0.0, known, values, 0.05).standardized[0]
    assert not row[known == 0.0].any()
    assert row[known > 0.0].mean() == pytest.approx(0.0, abs=1e-9)
    assert row[known > 0.0].std() == pytest.approx(1.0)
    assert np.abs(row).max() < 12.0


@settings(max_examples=10, deadline=None)
@given(st.floats(-9.0, 9.0), st.integers(0, 100))
def test_the_offset_is_where_rates_correlate(offset_s: float, seed: int) -> None:
    poses = irregular(seed)
    match = ClockMatch.between(*rates_of_both(poses, poses[200:1000].shifted(-offset_s)))
    assert match is not None
    assert match.offset_s == pytest.approx(offset_s, abs=0.02)
    assert match.peak > 0.95
    assert match.log_odds > match.log_odds_of_second + 12.0
    assert (match.as_stamped > 0.9) == (abs(offset_s) < 0.1) or abs(offset_s) < 0.3


def test_one_side_may_be_shorter_than_a_cell_of_the_other() -> None:
    """A run of three hours by one wrong timestamp has cells of three seconds."""
    poses = irregular(span_s=2.0)
    seconds = poses.seconds.copy()
    seconds[-1] += 1e4
    long = dataclasses.replace(poses, seconds=seconds)
    for sides in ((poses, long), (long, poses)):
        assert all(not len(side.known) for side in rates_of_both(*sides)) or (
            ClockMatch.between(*rates_of_both(*sides)) is None
        )


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.5, 0.93, 1.37, 1.907, 2.116])
def test_a_rate_is_found_between_the_steps_of_the_search(rate: float) -> None:
    """The last steps allow a shift of 0.7 s at the ends."""
    poses = irregular(span_s=300.0)
    estimate = poses[200:5800].shifted(0.0, 1.0 / rate - 1.0)
    factor, match = search_rate(*rates_of_both(poses, estimate))
    assert match is not None
    assert abs(np.log(factor / rate)) < 0.7 / (280.0 / rate)
    assert match.peak > 0.9


def test_parts_of_one_clock_agree_and_those_of_two_rates_do_not() -> None:
    poses = irregular(span_s=120.0)
    odds = []
    for ppm in (0.0, 20_000.0):
        rates = rates_of_both(poses, poses[200:2200].shifted(0.4, 1e-6 * ppm))
        match = ClockMatch.between(*rates)
        assert match is not None
        gain, factor = offsets_of_parts(*rates, match)
        odds.append(gain)
        assert factor == pytest.approx(1.0 / (1.0 + 1e-6 * ppm), abs=2e-3)
    assert odds[0] < 0.0
    assert odds[1] > 12.0


@pytest.mark.parametrize(
    ("part", "ppm"), [(slice(900), 0), (slice(1000, 1500), 0), (slice(800, None), 20_000)]
)
def test_parts_without_groundtruth_have_no_offset(part: slice, ppm: int) -> None:
    poses = irregular(span_s=120.0)
    rates = rates_of_both(poses[part], poses[200:2200].shifted(0.4, 1e-6 * ppm))
    match = ClockMatch.between(*rates)
    assert match is not None
    gain, factor = offsets_of_parts(*rates, match)
    assert (gain < 0.0) == (ppm == 0)
    assert factor == pytest.approx(1.0 / (1.0 + 1e-6 * ppm), abs=2e-3)
