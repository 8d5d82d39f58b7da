"""Verdicts about the clocks of receive times."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.metrics.receive_clock import clock_correction, judged_receive_times

SECOND = 10**9
BEGIN = 1_700_000_000 * SECOND
STAMPS = BEGIN + np.arange(2000) * (SECOND // 20)


def times_of(seed: int = 0, least_s: float = 0.03) -> np.ndarray:
    random = np.random.default_rng(seed)
    delays_s = least_s + random.gamma(2.0, 0.01, len(STAMPS))
    return STAMPS + (delays_s * SECOND).astype(np.int64)


@pytest.mark.parametrize(
    ("times", "verdict", "message"),
    [
        (times_of(), "ok", ""),
        (STAMPS, "copied", "copies of the timestamps"),
        (times_of() - BEGIN, "epochs", "over a day"),
        (times_of() - SECOND // 20, "impossible", "before their timestamps; correct the clock"),
        (times_of() + 2 * SECOND, "suspicious", "check for a queue"),
        (times_of() + (STAMPS - BEGIN) // 20_000, "drift", " ppm; latencies include"),
        (times_of() + SECOND // 2 * (np.arange(2000) > 777), "step", "latencies change by +0."),
    ],
)
def test_verdicts(times: np.ndarray, verdict: str, message: str) -> None:
    _, clock = judged_receive_times(STAMPS, times)
    assert clock.verdict == verdict
    assert clock.is_usable == (verdict in ("ok", "suspicious", "step", "drift"))
    assert message in clock.sentence
    assert len(clock.sentence) <= 240


@given(st.integers(0, 10**6), st.floats(0.1, 5.0), st.booleans(), st.integers(60, 1940))
def test_a_step_of_the_clock_has_its_size_and_time(
    seed: int, step_s: float, is_back: bool, row: int
) -> None:
    step = (-step_s if is_back else step_s) * SECOND
    times = times_of(seed, least_s=6.0) + (step * (np.arange(2000) >= row)).astype(np.int64)
    _, clock = judged_receive_times(STAMPS, times, "-5.9" if is_back else "-6")
    assert clock.step_s == pytest.approx(step / SECOND, abs=0.02)
    assert clock.step_at_s == pytest.approx(row / 20, abs=1e-9)


@given(st.integers(0, 10**6), st.floats(0.0, 0.5))
def test_jitter_late_messages_and_a_growing_queue_are_no_step(seed: int, growth: float) -> None:
    random = np.random.default_rng(seed)
    late_s = random.exponential(1.0, 2000) * (random.uniform(size=2000) < 0.05)
    late_s += np.maximum(0.0, np.arange(2000) - 1000) / 20 * growth
    _, clock = judged_receive_times(STAMPS, times_of(seed) + (late_s * SECOND).astype(np.int64))
    assert clock.step_s == 0.0


def test_the_named_offset_is_enough() -> None:
    _, clock = judged_receive_times(STAMPS, times_of() - SECOND // 5)
    needed = clock.sentence.rsplit(" ", 1)[1]
    _, corrected = judged_receive_times(STAMPS, times_of() - SECOND // 5, str(float(needed)))
    assert corrected.verdict == "ok"


@given(st.integers(0, 10**6), st.floats(-5.0, 5.0), st.floats(-200e-6, 200e-6))
def test_fastest_message_sets_offset_and_drift(seed: int, offset_s: float, drift: float) -> None:
    exact = times_of(seed)
    shifted = exact + round(offset_s * SECOND) + ((STAMPS - BEGIN) * drift).astype(np.int64)
    result, clock = judged_receive_times(STAMPS, shifted, "fastest:0.005")
    expected, same = judged_receive_times(STAMPS, exact, "fastest:0.005")
    assert clock.verdict == "ok"
    assert clock.offset_s is None
    np.testing.assert_allclose(result, expected, atol=10)  # ns, of the rounded drift
    assert clock.drift_ppm - same.drift_ppm == pytest.approx(1e6 * drift, abs=1e-3)
    assert (result - STAMPS).min() == pytest.approx(0.005 * SECOND, abs=2)


@given(st.lists(st.floats(0.0, 10.0), min_size=2, max_size=40), st.integers(0, 10**6))
def test_drift_is_the_slope_of_the_hull_at_the_middle(latencies: list[float], seed: int) -> None:
    steps = np.random.default_rng(seed).integers(1, SECOND, len(latencies))
    stamps = BEGIN + np.cumsum(steps)
    times = stamps + (np.array(latencies) * SECOND).astype(np.int64)
    _, clock = judged_receive_times(stamps, times)
    seconds, above = (stamps - stamps[0]) / SECOND, (times - stamps) / SECOND
    slope = clock.drift_ppm / 1e6
    # The line with this slope below all points is the highest at the middle of all such lines.
    middle = (seconds[0] + seconds[-1]) / 2.0
    height = (above - slope * (seconds - middle)).min()
    for left in range(len(seconds)):
        for right in range(left + 1, len(seconds)):
            other = (above[right] - above[left]) / (seconds[right] - seconds[left])
            assert (above - other * (seconds - middle)).min() <= height + 1e-9 * (
                1.0 + abs(other) * seconds[-1]
            )


@pytest.mark.parametrize("text", ["", "soon", "slowest:1", "nan", "fastest:inf"])
def test_other_rules_are_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(SettingsError, match="clock of receive times"):
        clock_correction(text)
