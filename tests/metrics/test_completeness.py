"""Completeness against a loop over the states, and the error of interpolation on known curves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.metrics.completeness import CompletenessSums, InterpolationMeter

SECOND = 10**9
STATES = st.lists(
    st.tuples(st.integers(1, 5), st.integers(-9, 9), st.booleans()), min_size=1, max_size=25
)


def _columns(
    states: list[tuple[int, int, bool]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return stamps, positions on a line through space, and which states have an estimate."""
    steps, places, result = zip(*states, strict=True)
    positions = np.outer(places, [0.6, 0.0, 0.8])
    return 7 * SECOND + np.cumsum(steps) * SECOND, positions, np.array(result)


def _expected(states: list[tuple[int, int, bool]]) -> tuple[float, float, float, float]:
    """Return share, span, and duration and reach of the longest gap; of no gap zeros."""
    stamps, _, result = _columns(states)
    times = [int(stamp) // SECOND for stamp in stamps]
    places = [place for _, place, _ in states]
    edges = [0, *np.flatnonzero(result).tolist()]  # a gap begins at the first state, or at one
    best = (0, 0.0)
    for order, begin in enumerate(edges):
        end = edges[order + 1] if order + 1 < len(edges) else len(states) - 1
        between = [row for row in range(begin, end + 1) if not result[row]]
        if between and times[end] - times[begin] > best[0]:
            reach = max(abs(places[row] - places[begin]) for row in range(begin, end + 1))
            best = (times[end] - times[begin], float(reach))
    own = [time for time, item in zip(times, result, strict=True) if item]
    whole = times[-1] - times[0]
    span = (own[-1] - own[0]) / whole if whole else 1.0
    return len(own) / len(states), span, *best


@given(STATES, st.integers(1, 25))
def test_coverage_is_that_of_a_loop_over_the_states(
    states: list[tuple[int, int, bool]], batch: int
) -> None:
    stamps, positions, result = _columns(states)
    sums = CompletenessSums()
    for begin in range(0, len(stamps), batch):
        part = slice(begin, begin + batch)
        sums.add(stamps[part], positions[part], result[part])
    coverage = sums.coverage()
    if not result.any():
        assert coverage is None
        return
    assert coverage is not None
    gap = coverage.longest_gap
    told = (gap.duration_s, gap.reach_m) if gap else (0.0, 0.0)
    assert (coverage.covered, coverage.span, *told) == pytest.approx(_expected(states))


def test_older_states_are_counted_and_move_nothing() -> None:
    """Of a groundtruth whose messages come out of order."""
    sums = CompletenessSums()
    sums.add(np.array([0, 2, 4]) * SECOND, np.zeros((3, 3)), np.array([True, False, True]))
    before = sums.coverage()
    sums.add(np.array([3, 4]) * SECOND, np.full((2, 3), 9.0), np.array([False, True]))
    after = sums.coverage()
    assert before is not None
    assert after is not None
    assert [before.covered, after.covered] == pytest.approx([2 / 3, 3 / 5])
    assert (before.span, before.longest_gap) == (after.span, after.longest_gap)


@pytest.mark.parametrize("batch", [1, 2, 7])
def test_interpolation_on_a_circle_is_off_by_its_sagitta(batch: int) -> None:
    """Halfway on a chord of a circle: r (1 - cos(w h / 2)); at most a bin of 2.2 % more."""
    radius_m, step_s, rate = 3.0, 0.2, 0.5
    count = 40
    angles = rate * step_s * np.arange(count)
    circle = radius_m * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
    stamps = 5 * SECOND + np.arange(count) * round(step_s * SECOND)
    meter = InterpolationMeter()
    for begin in range(0, count, batch):
        if begin < 3:
            assert meter.interpolation is None
        meter.add(stamps[begin : begin + batch], circle[begin : begin + batch])
        meter.add(stamps[:0], circle[:0])
    assert meter.interpolation is not None
    assert meter.interpolation.step_s == pytest.approx(step_s)
    sagitta_m = radius_m * (1.0 - np.cos(rate * step_s / 2.0))
    # An eighth of second differences is (r / 4) (1 - cos w h), the sagitta to 0.1 %.
    assert sagitta_m * 0.999 <= meter.interpolation.off_m <= sagitta_m * 1.023
