"""Signals of an IMU, of an exact motion with errors that begin at a known time."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from turning_body import places, rotated

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.watchdog import inertial_signals
from trajeval_ros.watchdog.inertial_mounting import Mounting, mounting_of
from trajeval_ros.watchdog.inertial_signals import InertialSignals
from trajeval_ros.watchdog.row_buffer import OrderedFeed
from trajeval_ros.watchdog.signals import Signals, joined

PERIOD_S, ARMED_S, FAULT_S, END_S = 0.05, 30.0, 48.0, 72.0
MOUNTED, BIAS = Rotation.from_rotvec([0.4, -0.9, 0.6]), np.array([0.004, -0.006, 0.003])
OFFSET_S, GRAVITY = 0.12, 9.81
TIMES = np.arange(0.0, END_S, PERIOD_S)


@cache
def readings() -> Floats:
    """Return IMU rows of 200 Hz: exact up to the differences of a fraction of a step."""
    clock = np.arange(-0.5, END_S + 1.0, 0.005)
    times, step = clock - OFFSET_S, 1e-3
    before, after = rotated(times - step), rotated(times + step)
    rates = (before.inv() * after).as_rotvec() / (2.0 * step)
    ahead, here, behind = (places(times + item) for item in (step, 0.0, -step))
    force = (ahead - 2.0 * here + behind) / step**2 + [0.0, 0.0, GRAVITY]
    body = rotated(times).inv().apply(force)
    return OrderedFeed().rows(clock, MOUNTED.inv().apply(rates) + BIAS, MOUNTED.inv().apply(body))


def signals_of(turns: Rotation, positions: Floats, imu: Floats | None = None) -> Signals:
    imu = readings() if imu is None else imu
    signals = InertialSignals(PERIOD_S, ARMED_S)
    assert signals.add_other(imu) == {}
    result = signals.add(OrderedFeed().rows(TIMES, positions, turns.as_quat()))
    assert signals.usable
    return result


def since_fault(times: Floats) -> Floats:
    after: Floats = np.maximum(times - FAULT_S, 0.0)
    return after


def test_an_exact_motion_has_no_error() -> None:
    result = signals_of(rotated(TIMES), places(TIMES))
    assert set(result) == {"gyro_deg_1s", "gyro_deg_20s", "gravity_mps2_5s"}
    for name, limit in (("gyro_deg_1s", 1e-3), ("gyro_deg_20s", 1e-2), ("gravity_mps2_5s", 1e-3)):
        seconds, values = result[name]
        window_s = float(name.partition("_")[2].partition("_")[2][:-1])
        assert values.max() < limit
        # The velocity is a mean over 0.1 s.
        first = window_s + (0.1 if "gravity" in name else 0.0)
        assert seconds[0] == pytest.approx(first)
        # The last states are those before the last reading that is used.
        np.testing.assert_allclose(np.diff(seconds), PERIOD_S, rtol=1e-6)
        assert seconds[-1] >= TIMES[-2]


@pytest.mark.parametrize("degrees", [2.0, 7.0])
def test_a_step_of_the_orientation_is_seen_for_the_length_of_the_windows(degrees: float) -> None:
    rotation = Rotation.from_rotvec(
        np.radians(degrees) * np.outer(TIMES >= FAULT_S, [1.0, 2.0, -2.0]) / 3.0
    )
    result = signals_of(rotation * rotated(TIMES), places(TIMES))
    for name, window_s in (("gyro_deg_1s", 1.0), ("gyro_deg_20s", 20.0)):
        seconds, values = result[name]
        inside = (seconds > FAULT_S - 1e-6) & (seconds < FAULT_S + window_s - 1e-6)
        np.testing.assert_allclose(values[inside], degrees, rtol=0.004)
        assert values[~inside].max() < 0.01


def test_a_drift_of_the_orientation_grows_with_the_window() -> None:
    rotation = Rotation.from_rotvec(
        np.radians(0.3) * np.outer(since_fault(TIMES), [0.0, 0.0, 1.0])
    )
    result = signals_of(rotation * rotated(TIMES), places(TIMES))
    for name, window_s in (("gyro_deg_1s", 1.0), ("gyro_deg_20s", 20.0)):
        seconds, values = result[name]
        expected = 0.3 * np.minimum(since_fault(seconds), window_s)
        np.testing.assert_allclose(values, expected, rtol=0.003, atol=0.01)


@pytest.mark.parametrize("extra", [0.5, 2.0])
def test_a_wrong_acceleration_is_seen_as_far_as_it_is_in_the_window(extra: float) -> None:
    """A velocity is valid in the middle of the two steps of which it is the mean."""
    along = np.array([0.6, 0.0, -0.8])
    positions = places(TIMES) + 0.5 * extra * np.outer(since_fault(TIMES) ** 2, along)
    seconds, values = signals_of(rotated(TIMES), positions)["gravity_mps2_5s"]
    expected = extra * np.minimum(since_fault(seconds - 0.05), 5.0) / 5.0
    np.testing.assert_allclose(values, expected, rtol=0.003, atol=0.001 + 0.003 * extra)
    rotations = signals_of(rotated(TIMES), positions)["gyro_deg_20s"].values
    assert rotations.max() < 0.01


def test_errors_count_as_far_as_the_mounting_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its rotation about the vertical does not tilt gravity."""
    spread = np.radians(np.diag([0.2, 0.9, 0.4])) ** 2

    def uncertain(states: Floats, imu: Floats) -> Mounting:
        covariance = np.zeros((6, 6))
        covariance[3:, 3:] = spread
        return dataclasses.replace(mounting_of(states, imu), covariance=covariance)

    monkeypatch.setattr(inertial_signals, "mounting_of", uncertain)
    degrees = 2.0 * (TIMES >= FAULT_S)
    rotation = Rotation.from_rotvec(np.radians(np.outer(degrees, [0.0, 0.0, 1.0])))
    positions = places(TIMES) + 0.5 * np.outer(since_fault(TIMES) ** 2, [0.0, 1.0, 0.0])
    result = signals_of(rotation * rotated(TIMES), positions)
    seconds, values = result["gravity_mps2_5s"]
    late = seconds > FAULT_S + 6.0
    up = rotated(seconds).inv().apply([0.0, 0.0, 1.0])
    variance = np.trace(spread) - np.einsum("ni,ij,nj->n", up, spread, up)
    floor = np.radians(0.3)
    # The orientations are turned about the vertical, and with them the force and its integral.
    share = floor / np.sqrt(floor**2 + variance)
    assert np.ptp(share[late]) > 0.1
    known = signals_without(monkeypatch, rotation * rotated(TIMES), positions)["gravity_mps2_5s"]
    np.testing.assert_allclose(values[late], (known.values * share)[late], rtol=2e-3)
    for name, window_s in (("gyro_deg_1s", 1.0), ("gyro_deg_20s", 20.0)):
        seconds, values = result[name]
        inside = (seconds > FAULT_S - 1e-6) & (seconds < FAULT_S + window_s - 1e-6)
        before, after = rotated(seconds[inside] - window_s), rotated(seconds[inside])
        back = (before.inv() * after).inv()
        axis = after.inv().apply([0.0, 0.0, 1.0])
        reach = axis - back.inv().apply(axis)  # (I - P')' u
        floor = np.radians(0.1 + 0.02 * window_s)
        variance = np.einsum("ni,ij,nj->n", reach, spread, reach)
        expected = 2.0 * floor / np.sqrt(floor**2 + variance)
        np.testing.assert_allclose(values[inside], expected, rtol=5e-3)


def signals_without(
    monkeypatch: pytest.MonkeyPatch, turns: Rotation, positions: Floats
) -> Signals:
    """Return the signals with a mounting that is known exactly."""

    def known(states: Floats, imu: Floats) -> Mounting:
        return dataclasses.replace(mounting_of(states, imu), covariance=np.zeros((6, 6)))

    monkeypatch.setattr(inertial_signals, "mounting_of", known)
    return signals_of(turns, positions)


@pytest.mark.parametrize("late_s", [0.0, 0.7])
def test_portions_with_another_clock_give_the_same(late_s: float) -> None:
    """Two seconds each, the readings before the states or after them."""
    rotation = Rotation.from_rotvec(
        np.radians(0.3) * np.outer(since_fault(TIMES), [0.0, 0.0, 1.0])
    )
    quaternions = (rotation * rotated(TIMES)).as_quat()
    states, imu = OrderedFeed().rows(TIMES, places(TIMES), quaternions), readings()
    signals, parts = InertialSignals(PERIOD_S, ARMED_S), []
    for begin in np.arange(-1.0, END_S + 3.0, 2.0):
        heard = (imu[:, 0] >= begin - late_s) & (imu[:, 0] < begin + 2.0 - late_s)
        told = (begin <= TIMES) & (begin + 2.0 > TIMES)
        if heard.any():
            parts.append(signals.add_other(imu[heard]))
        if told.any():
            parts.append(signals.add(states[told]))
    whole = signals_of(rotation * rotated(TIMES), places(TIMES))
    for name, result in joined(parts).items():
        # What the last readings cover.
        count = len(whole[name].seconds)
        assert len(result.seconds) - count in (0, 1)
        assert result.seconds[:count].tolist() == whole[name].seconds.tolist()
        np.testing.assert_allclose(result.values[:count], whole[name].values, atol=1e-9)


@pytest.mark.parametrize(("begin_s", "is_enough"), [(27.99, True), (28.01, False)])
def test_twenty_states_a_second_after_the_first_reading_are_needed(
    begin_s: float, *, is_enough: bool
) -> None:
    signals = InertialSignals(PERIOD_S, ARMED_S)
    imu = readings()[readings()[:, 0] >= begin_s]
    signals.add_other(OrderedFeed().rows(imu[:, 0], imu[:, 2:5], imu[:, 5:8]))
    signals.add(OrderedFeed().rows(TIMES, places(TIMES), rotated(TIMES).as_quat()))
    few = "too little IMU data during the motion before arming: the IMU is not compared"
    assert (few in signals.notices) != is_enough


def test_windows_begin_after_gaps() -> None:
    """No state for 3 s, or no reading of the IMU."""
    kept = (TIMES < 60.0) | (TIMES > 63.0)
    signals = InertialSignals(PERIOD_S, ARMED_S)
    signals.add_other(readings())
    result = signals.add(
        OrderedFeed().rows(TIMES[kept], places(TIMES)[kept], rotated(TIMES)[kept].as_quat())
    )
    clock = readings()[:, 0]
    heard = (clock < 60.0 + OFFSET_S) | (clock > 63.0 + OFFSET_S)
    columns = readings()[heard]
    rows = OrderedFeed().rows(columns[:, 0], columns[:, 2:5], columns[:, 5:8])
    other = signals_of(rotated(TIMES), places(TIMES), rows)
    for signals_found in (result, other):
        for name, first in (("gyro_deg_1s", 1.0), ("gravity_mps2_5s", 5.1)):
            seconds = signals_found[name].seconds
            inside = seconds[(seconds > 60.1) & (seconds < 69.0)]
            assert inside[0] == pytest.approx(63.0 + first, abs=2.1 * PERIOD_S)
