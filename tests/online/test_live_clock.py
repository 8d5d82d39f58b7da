"""The clock of a live run: which states it keeps, and when it is estimated."""

from __future__ import annotations

from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.linalg import LinAlgError
from state_rows import states, trajectory
from strategies import seeds

from trajeval_ros import Gauge
from trajeval_ros.online import live_clock
from trajeval_ros.online.live_clock import ClockReport, OnlineClock

SECOND = 10**9


@given(seed=seeds, step_ns=st.sampled_from([20_000_000, 100_000_000]))
def test_a_clock_keeps_the_first_state_of_every_step(seed: int, step_ns: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = 3 * SECOND + np.cumsum(rng.integers(1_000_000, 90_000_000, size=60))
    rows = states(stamps[:, None] * np.ones(3), np.tile([0.0, 0.0, 0.0, 1.0], (60, 1)))
    rows[rng.integers(0, 60, size=5), 0] = np.nan
    rows[rng.integers(0, 60, size=5), 3] = np.inf
    expected: list[int] = []
    for stamp, row in zip(stamps.tolist(), rows, strict=True):
        is_new = not expected or stamp // step_ns > expected[-1] // step_ns
        if is_new and np.isfinite(row[:3]).all() and not np.isinf(row[3]):
            expected.append(stamp)
    clock = OnlineClock(Gauge.YAW)
    add = clock.add_groundtruth if step_ns == 20_000_000 else clock.add_estimate
    for part in np.array_split(np.arange(60), np.sort(rng.integers(0, 60, size=6))):
        add(trajectory(stamps[part], rows[part]))
    add(trajectory(stamps[:30], rows[:30]))  # what comes late is passed over
    held = (clock._groundtruth if step_ns == 20_000_000 else clock._estimate).trajectory()
    assert held.stamps.tolist() == expected
    assert held.positions[:, 0].tolist() == [float(item) for item in expected]
    if step_ns == 100_000_000:
        assert clock.span_s == (expected[-1] - expected[0]) / SECOND


def test_a_clock_keeps_ten_minutes() -> None:
    clock = OnlineClock(Gauge.YAW)
    stamps = np.arange(0, 700) * SECOND
    for part in (slice(0, 1), slice(1, None)):
        clock.add_estimate(trajectory(stamps[part], states(np.zeros((700, 3)))[part]))
    assert clock._estimate.stamps.tolist() == stamps[99:].tolist()
    assert clock.span_s == 699.0


def at_rest(until_s: float, clock: OnlineClock) -> None:
    """Feed both sides up to a time, with a state every half second."""
    newest = clock._estimate.newest if len(clock._estimate) else -1
    stamps = np.arange(0, round(until_s * 1000) + 1, 500) * 1_000_000
    new = stamps[stamps > newest]
    for add in (clock.add_groundtruth, clock.add_estimate):
        add(trajectory(new, states(np.zeros((len(new), 3)))))


def test_a_clock_is_estimated_after_35_s_and_then_by_the_run_s_length() -> None:
    clock = OnlineClock(Gauge.YAW)
    assert clock.report == ClockReport()
    assert clock.report.reason == "needs 35 s of both trajectories"
    assert not clock.report.is_significant
    due = []
    for half_seconds in range(1, 260):
        at_rest(half_seconds / 2, clock)
        if clock.update():
            due.append(half_seconds / 2)
            assert clock.report.span_s == half_seconds / 2
            assert clock.report.status == "unobservable"
    # Pauses are 5 s, and a tenth of the run if that is longer.
    assert due == [35.0, 40.0, 45.0, 50.0, 55.0, 60.5, 67.0, 74.0, 81.5, 90.0, 99.0, 109.0, 120.0]
    assert not clock.update()
    assert clock.update(at_end=True)
    assert clock.report.span_s == 129.5
    assert not clock.update(at_end=True)


def test_a_clock_without_groundtruth_waits() -> None:
    clock = OnlineClock(Gauge.YAW)
    clock.add_estimate(trajectory(np.arange(50) * SECOND, states(np.zeros((50, 3)))))
    assert not clock.update(at_end=True)
    assert clock.report.status == "waiting"


@pytest.mark.parametrize("error", [ValueError("zero-size array"), MemoryError(), LinAlgError("x")])
def test_a_failed_estimation_is_a_reason_and_no_exception(error: Exception) -> None:
    with ThreadPoolExecutor(1) as worker:
        clock = OnlineClock(Gauge.YAW, worker)
        at_rest(36.0, clock)
        with mock.patch.object(live_clock, "calibrate", side_effect=error):
            clock.update()
            clock.update(at_end=True)
    assert clock.report.status == "unobservable"
    assert type(error).__name__ in clock.report.reason


def test_a_clock_is_estimated_by_a_worker_that_may_take_long() -> None:
    worker, future = mock.Mock(spec=Executor), Future[Any]()
    worker.submit.return_value = future
    clock = OnlineClock(Gauge.YAW, worker)
    at_rest(36.0, clock)
    assert not clock.update()
    assert not clock.update()
    assert worker.submit.call_count == 1
    report = ClockReport(36.0, 0.25, status="significant")
    future.set_result((report, None))
    assert clock.update()
    assert clock.report is report
    assert report.is_significant
    assert not clock.update()
    at_rest(50.0, clock)
    with mock.patch.object(live_clock, "_estimated", return_value=(ClockReport(50.0), None)):
        assert clock.update(waits=True)
    assert worker.submit.call_count == 1
    assert clock.report.span_s == 50.0
