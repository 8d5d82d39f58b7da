"""Rate, gaps and delays of a stream of messages."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.metrics.stream_health import UNKNOWN, StreamHealth, StreamMonitor

SECOND = 10**9
BEGIN = 1_700_000_000 * SECOND


def monitored(stamps: np.ndarray, arrived: np.ndarray, cuts: list[int]) -> StreamMonitor:
    """Return a monitor that has received messages in parts."""
    monitor = StreamMonitor()
    for part in np.split(np.arange(len(stamps)), sorted(cuts)):
        monitor.add(stamps[part], arrived[part])
    return monitor


def values(health: StreamHealth) -> list[float]:
    return [np.nan if item is None else item for item in dataclasses.astuple(health)]


@given(
    st.lists(st.integers(-(10**7), 10**9), min_size=1, max_size=300),
    st.lists(st.integers(0, 300), max_size=5),
    st.integers(0, 10**6),
)
def test_health_does_not_depend_on_the_batches(
    steps: list[int], cuts: list[int], seed: int
) -> None:
    stamps = BEGIN + np.cumsum(steps)
    delays = np.random.default_rng(seed).integers(-(10**8), 10**9, len(stamps))
    arrived = np.where(delays % 7 == 0, UNKNOWN, stamps + delays)
    one, other = monitored(stamps, arrived, cuts), monitored(stamps, arrived, [])
    for item, all_at_once in ((one.whole(), other.whole()), (one.recent(), other.recent())):
        # The jitter is the root of a difference of sums.
        np.testing.assert_allclose(values(item), values(all_at_once), rtol=1e-9, atol=1e-7)


@given(st.integers(2, 200), st.floats(1.0, 400.0), st.integers(0, 1000))
def test_health_of_a_run_is_that_of_numpy(count: int, rate_hz: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    steps = (random.uniform(0.5, 1.5, count) / rate_hz * SECOND).astype(np.int64)
    stamps = BEGIN + np.cumsum(steps)
    delays = random.integers(0, SECOND, count)
    whole = monitored(stamps, stamps + delays, [count // 2]).whole()
    intervals = np.diff(stamps) / SECOND
    assert whole.messages == count
    assert whole.rate_hz == pytest.approx(1.0 / intervals.mean(), rel=1e-9)
    assert whole.jitter_s == pytest.approx(intervals.std(), rel=1e-5, abs=1e-8)
    assert whole.largest_gap_s == pytest.approx(intervals.max())
    expected = [*np.percentile(delays, (50, 95)), delays.max()]
    result = [whole.arrival_p50_s, whole.arrival_p95_s, whole.arrival_max_s]
    assert result == pytest.approx(np.array(expected) / SECOND)
    assert whole.from_future == 0


def test_a_long_run_takes_constant_memory_and_keeps_its_percentiles() -> None:
    random, monitor, exact = np.random.default_rng(1), StreamMonitor(), []
    for begin in range(0, 300_000, 500):
        stamps = BEGIN + np.arange(begin, begin + 500) * 5_000_000
        delays = random.exponential(2e7, 500).astype(np.int64)
        monitor.add(stamps, stamps + delays)
        exact.append(delays)
    whole, delays = monitor.whole(), np.concatenate(exact) / SECOND
    assert len(pickle.dumps(monitor)) < 100_000
    assert whole.arrival_p50_s == pytest.approx(np.percentile(delays, 50), rel=0.05)
    assert whole.arrival_p95_s == pytest.approx(np.percentile(delays, 95), rel=0.05)
    assert whole.arrival_max_s == delays.max()


def test_recent_health_follows_a_change_within_ten_seconds() -> None:
    monitor = StreamMonitor()
    fast = BEGIN + np.arange(2000) * 50_000_000
    slow = fast[-1] + np.arange(1, 60) * 200_000_000
    monitor.add(fast, fast + 10_000_000)
    assert monitor.recent().rate_hz == pytest.approx(20.0)
    monitor.add(slow, slow + 300_000_000)
    recent = monitor.recent()
    assert recent.rate_hz == pytest.approx(5.0)
    assert recent.arrival_p50_s == pytest.approx(0.3)
    assert monitor.whole().arrival_p50_s == pytest.approx(0.01)


def test_messages_out_of_order_and_repeated_add_no_interval() -> None:
    stamps = BEGIN + np.array([0, 2, 1, 2, 3, 3, 4]) * SECOND
    whole = monitored(stamps, np.full(7, UNKNOWN), []).whole()
    assert (whole.messages, whole.rate_hz, whole.largest_gap_s) == (7, 0.75, 2.0)
    assert whole.arrival_p50_s is None


def test_timestamps_after_their_arrival_are_counted() -> None:
    stamps = BEGIN + np.arange(4) * SECOND
    delays = np.array([0, -5_000_000, -20_000_000, -SECOND])
    assert monitored(stamps, stamps + delays, []).whole().from_future == 2


def test_a_stream_without_messages_has_no_health() -> None:
    assert StreamMonitor().whole() == StreamMonitor().recent() == StreamHealth()


@pytest.mark.parametrize("rate", [0.2, 1.0, 8.0])
@pytest.mark.parametrize("late_s", [0.0, 0.3, 4.0])
@pytest.mark.parametrize("others_hz", [5.0, 200.0, 1000.0])
def test_arrivals_are_compared_at_equal_timestamps(
    rate: float, late_s: float, others_hz: float
) -> None:
    """Whatever the window of the other stream: 2000 messages at 1 kHz are 2 s."""
    late_ns = round(late_s * SECOND)
    monitors = []
    for step_s, after_ns in ((0.05, late_ns), (1.0 / others_hz, 0)):
        stamps = np.round(np.arange(0.0, 30.0, step_s) * SECOND).astype(np.int64)
        arrived = BEGIN + np.round(stamps / rate).astype(np.int64) + after_ns
        arrived[1::7] = UNKNOWN
        rows = np.arange(len(stamps))
        order = np.lexsort([-rows, rows // 5])  # each five of them arrive in reverse order
        monitors.append(monitored(BEGIN // 3 + stamps[order], arrived[order], []))
    assert monitors[0].arrival_after(monitors[1]) == pytest.approx(late_s, abs=1e-6)


def test_a_silent_stream_is_continued_and_a_few_late_messages_are_no_delay() -> None:
    """The last 3 s lack the other stream; one message of 25 is 9 s late."""
    stamps = BEGIN + np.arange(250) * SECOND // 25
    late = stamps + SECOND // 2
    late[::25] += 9 * SECOND
    estimated, other = monitored(stamps, late, []), monitored(stamps[:175], stamps[:175], [])
    assert estimated.arrival_after(other) == pytest.approx(0.5)
