"""What time it was in a simulation when a message was received."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.ros.timing import UNKNOWN, Arrivals, ClockSamples

WALL, SIMULATED = 1_700_000_000_000_000_000, 1_000_000_000
PERIOD = 100_000_000  # as /clock at 10 Hz


def played(rate: float, count: int) -> ClockSamples:
    clock = ClockSamples()
    for row in range(count):
        clock.see(WALL + row * PERIOD, SIMULATED + round(rate * row * PERIOD))
    return clock


@given(rate=st.floats(0.01, 50.0), after=st.integers(0, 10 * PERIOD))
def test_time_goes_on_between_messages(rate: float, after: int) -> None:
    result = played(rate, 10).at(np.array([WALL + after]))
    assert result[0] == pytest.approx(SIMULATED + rate * after, abs=2)


def test_time_that_nobody_told_is_unknown() -> None:
    clock = played(1.0, 10)
    newest = WALL + 9 * PERIOD
    times = np.array([WALL - 1, WALL, newest + PERIOD, newest + PERIOD + 1])
    assert (clock.at(times) == UNKNOWN).tolist() == [True, False, False, True]
    assert (played(1.0, 1).at(times) == UNKNOWN).all()


def test_time_may_begin_anew() -> None:
    """Times of messages from before the step back stay known, and one new sample is enough."""
    clock = played(2.0, 10)
    restart = WALL + 20 * PERIOD
    clock.see(restart, SIMULATED)
    last = WALL + 9 * PERIOD
    walls = np.array([WALL + 7, last + PERIOD // 2, last + 2 * PERIOD, restart - 1, restart + 7])
    times = np.array([14, 19 * PERIOD, UNKNOWN, UNKNOWN, 14])
    assert (
        clock.at(walls).tolist() == np.where(times == UNKNOWN, times, SIMULATED + times).tolist()
    )


@given(
    delays=st.lists(st.integers(0, PERIOD // 2), min_size=3, max_size=30),
    after=st.integers(0, PERIOD // 2),
)
def test_samples_may_arrive_together(delays: list[int], after: int) -> None:
    """Every message between two samples has a time between them, also after the newest one."""
    clock, arrived = ClockSamples(), []
    for row, delay in enumerate(delays):
        arrived.append(max(WALL + row * PERIOD + delay, *arrived[-1:], WALL))
        clock.see(arrived[-1], SIMULATED + row * PERIOD)
    walls = np.array([*arrived, arrived[-1] + after])
    times = clock.at(walls)
    expected = SIMULATED + np.minimum(np.arange(len(walls)), len(delays) - 1) * PERIOD
    longest = np.diff(arrived).max()
    assert (times[:-1] >= expected[:-1]).all()
    if after <= longest:
        assert expected[-1] <= times[-1] <= expected[-1] + PERIOD
    else:
        assert times[-1] == UNKNOWN


def test_messages_that_are_read_late_have_times() -> None:
    """Also if as many samples have arrived since as a fast replay sends."""
    clock = ClockSamples()
    for row in range(10_000):
        clock.see(WALL + row * 1_000_000, SIMULATED + row * PERIOD)
    late = np.array([WALL + 2_000 * 1_000_000 + 500_000])
    assert clock.at(late).tolist() == [SIMULATED + 2_000 * PERIOD + PERIOD // 2]


def test_arrivals_at_unknown_times_are_left_out() -> None:
    arrivals = Arrivals()
    arrivals.see(np.array([5]), np.array([UNKNOWN]))
    assert arrivals.offset_s is None
    arrivals.see(np.array([SIMULATED]), np.array([SIMULATED + 20_000_000]))
    assert arrivals.offset_s == pytest.approx(0.02)


def test_what_comes_at_once_arrives_at_once_whatever_the_clock_s_rate() -> None:
    """Messages 20 ms late, a clock at 10 Hz: by the newest clock message up to 0.1 s more."""
    clock, arrivals = played(1.0, 100), Arrivals()
    walls = WALL + np.arange(1, 90, 7) * PERIOD // 9
    stamps = SIMULATED + (walls - WALL) - 20_000_000
    for stamp, wall in zip(stamps, walls, strict=True):
        arrivals.see(np.array([stamp]), clock.at(np.array([wall])))
    assert arrivals.offset_s == pytest.approx(0.02, abs=1e-6)
