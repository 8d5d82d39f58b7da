"""The clock of a live run: which states it keeps, and when it is estimated."""

from __future__ import annotations

from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any
from unittest import mock

import numpy as np
import pytest
from numpy.linalg import LinAlgError
from state_rows import states, trajectory

from trajeval_ros import Gauge
from trajeval_ros.online import live_clock
from trajeval_ros.online.live_clock import ClockReport, OnlineClock

SECOND = 10**9


def at_rest(until_s: float, clock: OnlineClock) -> None:
    """Feed both sides up to a time, with a state every half second."""
    newest = clock._estimate.newest if len(clock._estimate) else -1
    stamps = np.arange(0, round(until_s * 1000) + 1, 500) * 1_000_000
    new = stamps[stamps > newest]
    for add in (clock.add_groundtruth, clock.add_estimate):
        add(trajectory(new, states(np.zeros((len(new), 3)))))


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
