"""When recorded messages are sent again, by a clock that only the test moves."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.io.bags import playback
from trajeval_ros.io.bags.playback import TICK_S, PlaybackResult, play

SECOND = 10**9
BEGIN = 1_700_000_000 * SECOND


class Clock:
    """A clock that only sleeping and sending move."""

    def __init__(self, cost_s: float = 0.0, wait_s: float = 0.0) -> None:
        self.time_s = 100.0
        self.sent: list[tuple[float, str]] = []
        self.ticks: list[int] = []
        self.cost_s, self.wait_s = cost_s, wait_s

    def sleep(self, duration_s: float) -> None:
        assert duration_s > 0.0
        self.time_s += duration_s

    def publish(self, channel: str, payload: bytes) -> float:  # noqa: ARG002
        self.time_s += self.wait_s
        self.sent.append((self.time_s - 100.0, channel))
        self.time_s += self.cost_s
        return self.wait_s

    def play(
        self, times_s: Sequence[float], rate: float, stop_s: float = 1e9
    ) -> PlaybackResult[str]:
        clock = SimpleNamespace(monotonic=lambda: self.time_s, sleep=self.sleep)
        with mock.patch.object(playback, "time", clock):
            return play(
                [(BEGIN + round(time * SECOND), f"{time}", b"") for time in times_s],
                BEGIN,
                rate,
                publish=self.publish,
                tick=self.ticks.append,
                is_stopped=lambda: self.time_s - 100.0 >= stop_s,
            )


TIMES = st.lists(st.floats(0.0, 20.0), max_size=60).map(sorted)


@given(TIMES, st.sampled_from([0.3, 1.0, 5.0, 20.0]))
def test_messages_are_sent_when_due(times_s: list[float], rate: float) -> None:
    clock = Clock()
    played = clock.play(times_s, rate)
    assert [name for _, name in clock.sent] == [f"{time}" for time in times_s]
    late = np.array([sent for sent, _ in clock.sent]) - np.array(times_s) / rate
    assert np.all(late > -1e-6)
    assert np.all(late <= 0.0011)
    assert played.worst_lag_s == pytest.approx(max(late, default=0.0), abs=1e-6)
    assert played.is_complete


@given(TIMES, st.sampled_from([0.3, 1.0, 5.0]), st.sampled_from([0.0, 0.05, 0.5]))
def test_the_clock_runs_evenly_and_never_past_a_message_unsent(
    times_s: list[float], rate: float, cost_s: float
) -> None:
    clock = Clock(cost_s)
    played = clock.play(times_s, rate)
    assert clock.ticks == sorted(clock.ticks)
    last = BEGIN + round(max(times_s, default=0.0) * SECOND)
    assert clock.ticks[-1] == played.reached_ns == last
    if not cost_s and times_s:
        assert clock.ticks[0] == BEGIN
        assert np.diff(clock.ticks).max(initial=0) <= (TICK_S + 0.002) * rate * SECOND + 1


def test_what_is_late_is_sent_at_once_and_the_lag_is_told() -> None:
    clock = Clock(cost_s=0.1)
    played = clock.play([0.01 * row for row in range(100)], 1.0)
    assert len(clock.sent) == 100
    assert played.worst_lag_s == pytest.approx(99 * 0.09, abs=0.01)
    assert len(clock.ticks) <= 102


@given(TIMES, st.sampled_from([0.3, 1.0, 5.0]), st.sampled_from([0.02, 0.3]))
def test_what_comes_after_waiting_for_subscribers_is_not_sent_at_once(
    times_s: list[float], rate: float, wait_s: float
) -> None:
    clock = Clock(wait_s=wait_s)
    played = clock.play(times_s, rate)
    sent = np.array([moment for moment, _ in clock.sent])
    # The distances of the recording, and the waiting on top; a millisecond is sent at once.
    assert np.all(np.diff(sent) >= np.diff(times_s) / rate + wait_s - 0.0011)
    assert played.waited_s == pytest.approx(wait_s * len(times_s), abs=1e-6)
    assert played.worst_lag_s <= 0.0011
    assert clock.ticks == sorted(clock.ticks)


def test_stopping_keeps_what_was_sent() -> None:
    clock = Clock()
    played = clock.play(list(range(10)), 1.0, stop_s=3.5)
    assert [name for _, name in clock.sent] == ["0", "1", "2", "3"]
    assert not played.is_complete
    assert (played.reached_ns - BEGIN) / SECOND == pytest.approx(3.5, abs=0.02)
