"""Signals of the twist, with states one by one and all at once."""

from __future__ import annotations

import numpy as np
import pytest

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.watchdog.row_buffer import STATE_WIDTH
from trajeval_ros.watchdog.twist_signals import TwistSignals

STEP_S = 0.02


def states_with(lag_s: float) -> Floats:
    """Return states (N, 12) along x with a speed of 2 + sin(t), whose twist is late."""
    t = STEP_S * np.arange(1500)
    rows = np.zeros((len(t), STATE_WIDTH))
    rows[:, 0] = t
    rows[:, 2] = 2.0 * t - np.cos(t)
    rows[:, 8] = 1.0
    rows[:, 9] = 2.0 + np.sin(t - lag_s)
    return rows


@pytest.mark.parametrize("lag_s", [0.0, 0.3, -0.3])
def test_a_late_twist_is_awaited(lag_s: float) -> None:
    rows = states_with(lag_s)
    signals = TwistSignals(rows[:750])
    assert signals.lag_s == pytest.approx(lag_s, abs=0.026)
    result = [signals.add(rows[row : row + 1]) for row in range(750, len(rows))]
    values = [item["twist_m_5s"] for item in result if "twist_m_5s" in item]
    largest = max(float(np.abs(value).max()) for _, value in values if len(value))
    assert largest < 0.1  # the twist before the first state is unknown
    count = sum(len(times) for times, _ in values)
    # States wait for a twist that comes later, never for an earlier one.
    waiting = round(max(lag_s, 0.0) / STEP_S)
    assert count == pytest.approx(750 - waiting - 250, abs=3)


@pytest.mark.parametrize("seed", range(5))
def test_a_lag_needs_evidence(seed: int) -> None:
    rows = states_with(0.3)
    generator = np.random.default_rng(seed)
    rows[:, 2] = 2.0 * rows[:, 0] + generator.normal(0.0, 0.0015, len(rows))
    rows[:, 9] = 2.0 + generator.normal(0.0, 0.015, len(rows))
    assert TwistSignals(rows).lag_s == 0.0  # at constant speed the lag has no effect
