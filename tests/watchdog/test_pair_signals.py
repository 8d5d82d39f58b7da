"""Signals of two estimates, of an exact motion with errors that begin at a known time."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from turning_body import places, rotated

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.watchdog import pair_signals
from trajeval_ros.watchdog.pair_signals import PairSignals, body_difference
from trajeval_ros.watchdog.row_buffer import OrderedFeed
from trajeval_ros.watchdog.signals import Signals

PERIOD_S, ARMED_S, FAULT_S, END_S = 0.1, 30.0, 50.0, 76.0
TIMES = np.arange(0.0, END_S, PERIOD_S)
BODY, LEVER, SCALE = Rotation.from_rotvec([0.4, -0.9, 0.6]), np.array([0.2, -0.1, 0.3]), 1.7
FRAME, MOVED = Rotation.from_rotvec([0.1, 0.2, -1.4]), np.array([5.0, -3.0, 2.0])
WINDOWS_S = (5.0, 20.0)


def partner(times: Floats) -> Floats:
    """Return the second estimate: of another frame, body and scale, without an error."""
    positions = FRAME.apply(places(times) + rotated(times).apply(LEVER)) / SCALE + MOVED
    return OrderedFeed().rows(times, positions, (FRAME * rotated(times) * BODY).as_quat())


def signals_of(turns: Rotation, positions: Floats, source: str = "pair") -> Signals:
    signals = PairSignals(source, PERIOD_S, ARMED_S)
    assert signals.add_other(partner(TIMES)) == {}
    result = signals.add(OrderedFeed().rows(TIMES, positions, turns.as_quat()))
    assert signals.usable
    return result


def test_the_body_of_a_partner_is_found_exactly(monkeypatch: pytest.MonkeyPatch) -> None:
    result: list[Any] = []

    def kept(*given: Any, **options: Any) -> Any:
        result.append((body_difference(*given, **options), options, len(given[0])))
        return result[-1][0]

    monkeypatch.setattr(pair_signals, "body_difference", kept)
    signals = signals_of(rotated(TIMES), places(TIMES), "pair.wheel")
    assert sorted(signals) == sorted(
        f"pair_{name}s.wheel" for name in ("percent_5", "percent_20", "deg_5", "deg_20")
    )
    assert all(values.max() < 1e-3 for _, values in signals.values())
    [(body, options, count)] = result
    assert options == {"overlap": pytest.approx(PERIOD_S / 2.0)}
    assert count == 280  # windows of 2 s before arming
    apart = Rotation.from_quat(body.rotation) * BODY.inv()
    # The prior of half a metre draws the lever arm by much less.
    assert apart.magnitude() < 1e-4
    np.testing.assert_allclose(body.lever_m, LEVER, atol=1e-4)
    assert body.scale == pytest.approx(SCALE, rel=1e-4)


def test_a_step_of_the_orientation_is_seen_for_the_length_of_the_windows() -> None:
    rotation = Rotation.from_rotvec(
        np.radians(2.0) * np.outer(TIMES >= FAULT_S, [1.0, 2.0, -2.0]) / 3
    )
    result = signals_of(rotation * rotated(TIMES), places(TIMES))
    for window_s in WINDOWS_S:
        seconds, values = result[f"pair_deg_{window_s:g}s"]
        assert seconds[0] == pytest.approx(window_s)
        assert seconds[-1] == TIMES[-1]
        inside = (seconds > FAULT_S - 1e-6) & (seconds < FAULT_S + window_s - 1e-6)
        np.testing.assert_allclose(values[inside], 2.0, rtol=0.03)
        assert values[~inside].max() < 0.01


@pytest.mark.parametrize("size", [0.5, 3.0])
def test_a_step_of_the_position_is_a_part_of_the_path(size: float) -> None:
    """One metre longer, so that a robot at rest has no infinite error."""
    step = size * np.outer(TIMES >= FAULT_S, [0.6, 0.0, -0.8])
    result = signals_of(rotated(TIMES), places(TIMES) + step)
    moved = np.zeros(len(TIMES))
    moved[10:] = np.linalg.norm(places(TIMES)[10:] - places(TIMES)[:-10], axis=1)
    path = PERIOD_S * np.cumsum(moved)
    for window_s in WINDOWS_S:
        seconds, values = result[f"pair_percent_{window_s:g}s"]
        rows, back = np.rint(seconds / PERIOD_S).astype(int), round(window_s / PERIOD_S)
        expected = 100.0 * size / (1.0 + path[rows] - path[rows - back])
        inside = (seconds > FAULT_S - 1e-6) & (seconds < FAULT_S + window_s - 1e-6)
        np.testing.assert_allclose(values[inside], expected[inside], rtol=0.004)
        assert values[~inside].max() < 0.05


def test_errors_count_as_far_as_the_body_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """The variance is that of the displacement predicted from rotation, lever arm and scale."""
    sigma = np.array([0.01, 0.02, 0.005, 0.1, 0.05, 0.2, 0.03])
    covariances = [np.zeros((7, 7)), np.diag(sigma**2)]
    made = []
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    rotation = Rotation.from_rotvec(np.radians(2.0) * np.outer(TIMES >= FAULT_S, axis))
    step = 0.5 * np.outer(TIMES >= FAULT_S, [0.6, 0.0, -0.8])
    for covariance in covariances:
        monkeypatch.setattr(
            pair_signals,
            "body_difference",
            lambda *given, covariance=covariance, **options: dataclasses.replace(
                body_difference(*given, **options), covariance=covariance
            ),
        )
        both = signals_of(rotated(TIMES), places(TIMES) + step)
        angles = signals_of(rotation * rotated(TIMES), places(TIMES))
        made.append({**both, **{name: angles[name] for name in both if "deg" in name}})
    for window_s in WINDOWS_S:
        name, floor = f"pair_percent_{window_s:g}s", 0.01 + 0.005 * window_s
        seconds = made[0][name].seconds
        inside = (seconds > FAULT_S - 1e-6) & (seconds < FAULT_S + window_s - 1e-6)
        times = seconds[inside]
        start, end = rotated(times - window_s), rotated(times)
        along = start.inv().apply([0.6, 0.0, -0.8])
        moved = start.inv().apply(
            places(times) + end.apply(LEVER) - places(times - window_s) - start.apply(LEVER)
        )
        reach = [
            np.cross(moved, along),  # of [r] x moved
            along - (start.inv() * end).inv().apply(along),
            np.sum(moved * along, axis=1)[:, None],
        ]
        variance = np.square(np.concatenate(reach, axis=1) * sigma).sum(axis=1)
        share = floor / np.sqrt(floor**2 + variance)
        assert share.min() < 0.8
        expected = made[0][name].values[inside] * share
        np.testing.assert_allclose(made[1][name].values[inside], expected, rtol=0.01)
        back = (start.inv() * end).inv()
        away = end.inv().apply(axis)  # the axis of the error, in the body
        reach_of_turn = back.inv().apply(away) - away
        variance = np.square(reach_of_turn * sigma[:3]).sum(axis=1)
        floor = np.radians(0.1 + 0.02 * window_s)
        expected = 2.0 * floor / np.sqrt(floor**2 + variance)
        values = made[1][f"pair_deg_{window_s:g}s"].values
        np.testing.assert_allclose(values[inside], expected, rtol=0.01)


@pytest.mark.parametrize(("begin_s", "is_enough"), [(26.0, True), (26.05, False)])
def test_twenty_windows_before_arming_are_needed(begin_s: float, *, is_enough: bool) -> None:
    """Of 2 s, that end before 30 s. Those of states from 26 s on are twenty."""
    signals = PairSignals("pair", PERIOD_S, ARMED_S)
    signals.add_other(partner(np.arange(begin_s, END_S, 0.05)))
    signals.add(OrderedFeed().rows(TIMES, places(TIMES), rotated(TIMES).as_quat()))
    assert signals.usable == is_enough
    assert bool(signals.notices) != is_enough
