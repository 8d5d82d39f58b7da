"""Alarms: no excursion passes unseen between two looks, and each is told once."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from state_rows import states, trajectory

from trajeval_ros import Protocol, Trajectory
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.remarks import Level, Remark, most_severe_first
from trajeval_ros.geometry import lie
from trajeval_ros.online.alarms import (
    LIMITED_QUANTITIES,
    ActiveAlarms,
    AlarmLimits,
    MaxSinceLast,
    Peak,
    alarms,
)
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings

NONE = {limited_quantity.name: AlarmLimits() for limited_quantity in LIMITED_QUANTITIES}
SECOND = 10**9


def circling(count: int, rate_hz: int) -> Trajectory:
    """Return a body that circles at 1 m/s and nods."""
    t = np.arange(count) / rate_hz
    nods = np.stack([0.2 * np.sin(t), 0.1 * np.cos(2.0 * t), t / 3.0], axis=1)
    return Trajectory(
        stamps=SECOND + np.arange(count) * (SECOND // rate_hz),
        positions=np.stack([3.0 * np.cos(t / 3.0), 3.0 * np.sin(t / 3.0), 0.0 * t], axis=1),
        quaternions=lie.from_rotation_vector(nods),
    )


def levels(
    position: np.ndarray, turned_deg: np.ndarray, limits: dict[str, Any], tick_s: float = 0.05
) -> list[dict[str, int]]:
    """Return what is over its limits in each second of a flight with such errors.

    The estimate is off by `position` (N, 3) metres and by `turned_deg` (N,) about gravity.
    """
    flight = circling(len(position), 200)
    assert flight.quaternions is not None
    rotated = np.zeros((len(position), 3))
    rotated[:, 2] = np.radians(turned_deg)
    estimate = dataclasses.replace(
        flight,
        positions=flight.positions + position,
        quaternions=lie.multiply(lie.from_rotation_vector(rotated), flight.quaternions),
    )
    live = OnlineEvaluator(OnlineSettings(Protocol(gauge="none", lengths=())))
    peaks, seen = MaxSinceLast(), []
    every = round(tick_s * 200)
    for tick, row in enumerate(range(0, len(flight), every)):
        for add, side in ((live.add_groundtruth, flight), (live.add_estimate, estimate)):
            rows = slice(row, row + every)
            assert side.quaternions is not None
            add(
                trajectory(side.stamps[rows], states(side.positions[rows], side.quaternions[rows]))
            )
        peaks.see_update(live.update())
        if (tick + 1) * every % 200 == 0:
            seen.append({alarm.subject: alarm.level for alarm in alarms(peaks.take(), limits)})
    return seen


@pytest.mark.slow
def test_all_excursions_of_a_tenth_of_a_second_are_seen() -> None:
    seconds = 101
    position = np.zeros((200 * seconds, 3))
    # In every second second, at another place of it.
    begins = 200 + 400 * np.arange(50) + np.rint(170 * ((0.618 * np.arange(50)) % 1.0))
    for begin in begins.astype(int):
        position[begin : begin + 20, 0] = 0.5
    rotated = np.where(position[:, 0] > 0.0, 5.0, 0.0)
    limits = {
        **NONE,
        "position_error_m": AlarmLimits(0.1, 0.4),
        "yaw_error_deg": AlarmLimits(3.0),
        "rotation_error_deg": AlarmLimits(6.0),
    }
    seen = levels(position, rotated, limits)
    assert len(seen) == seconds
    expected = {"position_error_m": Level.ERROR, "yaw_error_deg": Level.WARNING}
    assert [item == expected for item in seen] == [
        bool((position[200 * second : 200 * second + 200] > 0).any()) for second in range(seconds)
    ]
    assert sum(item == expected for item in seen) == 50
    assert all(item in ({}, expected) for item in seen)


def test_the_largest_value_counts_once_and_says_when_it_was() -> None:
    peaks = MaxSinceLast()
    for value, stamp in ((0.1, 1), (0.9, 2), (0.4, 3), (None, None)):
        peaks.see("position_error_m", value, stamp)
    assert peaks.take() == {"position_error_m": Peak(0.9, 2)}
    assert peaks.take() == {}


@pytest.mark.parametrize("quantity", LIMITED_QUANTITIES)
def test_every_quantity_has_two_limits(quantity: Any) -> None:
    limits = {**NONE, quantity.name: AlarmLimits.parse("1,2.0", "limits")}
    result = [alarms({quantity.name: Peak(item, 7)}, limits) for item in (0.9, 1.0, 1.5, 2.5)]
    assert result[:2] == [[], []]
    [warned], [failed] = result[2:]
    assert (warned.level, failed.level) == (Level.WARNING, Level.ERROR)
    assert warned.subject == quantity.name
    number, limit = (f"{name} {quantity.unit}".strip() for name in ("1.5", "1"))
    assert warned.text == f"{quantity.words} {number} is over {limit}"
    assert failed.values == {"value": 2.5, "limit": 2.0, "unit": quantity.unit, "stamp_ns": 7}
    assert alarms({quantity.name: Peak(9.0)}, NONE) == []


def test_drift_is_the_largest_of_the_sub_trajectories_that_ended() -> None:
    flight = circling(180, 20)
    assert flight.quaternions is not None
    positions = flight.positions * np.linspace(1.0, 1.2, 180)[:, None]
    rows = states(flight.positions, flight.quaternions)
    drifted = states(positions, flight.quaternions)
    result = []
    for count in (1, 180):  # one by one, and all together
        protocol = Protocol(gauge="none", lengths=("4m", "3s"))
        live, peaks = OnlineEvaluator(OnlineSettings(protocol)), MaxSinceLast()
        live.add_groundtruth(trajectory(flight.stamps, rows))
        for begin in range(0, 180, count):
            part = slice(begin, begin + count)
            live.add_estimate(trajectory(flight.stamps[part], drifted[part]))
            peaks.see_update(live.update())
        peaks.see_update(live.update(at_end=True))
        result.append(peaks.take()["drift_percent"].value)
    assert result[0] == pytest.approx(result[1], rel=1e-9)
    assert result[0] > 0.0


@pytest.mark.parametrize("knows_up", [True, False])
def test_peaks_are_the_largest_errors_of_all_pairs_and_their_stamps(*, knows_up: bool) -> None:
    flight = circling(4, 20)
    assert flight.quaternions is not None
    off = flight.positions + np.outer([0.1, 0.7, 0.2, 0.3], [1.0, 0.0, 0.0])
    live, peaks = OnlineEvaluator(OnlineSettings(Protocol(gauge="none"))), MaxSinceLast()
    live.add_groundtruth(trajectory(flight.stamps, states(flight.positions, flight.quaternions)))
    live.add_estimate(trajectory(flight.stamps, states(off, flight.quaternions)))
    live.up_axis_doubt = "" if knows_up else "y is up"
    peaks.see_update(live.update())
    result = peaks.take()
    assert result["position_error_m"].value == pytest.approx(0.7)
    assert result["position_error_m"].stamp == flight.stamps[1]
    assert ("yaw_error_deg" in result) == knows_up


def test_what_stands_is_told_when_it_begins_gets_graver_and_ends() -> None:
    standing = ActiveAlarms()
    warned = Remark(Level.WARNING, "alarm", "0.2 m is over 0.1 m", "position_error_m")
    worse = dataclasses.replace(warned, level=Level.ERROR, text="0.6 m is over 0.5 m")
    silent = Remark(Level.ERROR, "silence", "no estimate for 6 s", "estimate")
    warming = Remark(Level.NOTE, "alignment", "warming up")
    assert standing.renew([warned, warming]) == [warned]
    assert standing.renew([dataclasses.replace(warned, text="0.3 m is over 0.1 m")]) == []
    assert standing.renew([worse, silent]) == [worse, silent]
    assert standing.renew([warned, silent]) == []
    [over] = standing.renew([silent])
    assert (over.level, over.text) == (Level.NOTE, "no longer: 0.2 m is over 0.1 m")
    assert standing.renew([silent, warned]) == [warned]


def test_an_error_comes_before_a_warning() -> None:
    levels = [Level.NOTE, Level.ERROR, Level.WARNING]
    remarks = [Remark(level, "a", "") for level in levels]
    assert [item.level for item in most_severe_first(remarks)] == sorted(levels, reverse=True)


def test_the_numbers_of_a_text_change_every_ten_seconds() -> None:
    now_s = 0.0
    standing = ActiveAlarms(lambda: now_s)
    first = Remark(Level.WARNING, "hint", "0.2 m is over 0.1 m", "rate")
    later = dataclasses.replace(first, text="0.3 m is over 0.1 m")
    last = dataclasses.replace(first, text="-0.4 m is over 0.1 m")
    worse = dataclasses.replace(first, level=Level.ERROR, text="0.6 m is over 0.5 m")
    other = dataclasses.replace(first, text="0.3 s is over 0.1 s")
    standing.renew([first])
    now_s = 9.9
    assert standing.renew([later]) == []
    assert standing.kept_texts([later, worse, other]) == [first, worse, other]
    now_s = 10.1
    assert standing.renew([later]) == []
    assert standing.kept_texts([later]) == [later]
    now_s = 20.0
    assert standing.kept_texts([last]) == [later]
    now_s = 20.2
    assert standing.kept_texts([last]) == [last]
    standing.renew([])
    assert standing.kept_texts([first]) == [first]


@pytest.mark.parametrize(
    ("text", "limits"), [("", (0, 0)), ("0", (0, 0)), ("2", (0, 2)), ("0.5, 1e1", (0.5, 10))]
)
def test_limits_are_one_number_or_two(text: str, limits: tuple[float, float]) -> None:
    assert AlarmLimits.parse(text, "limits_nees") == limits


@pytest.mark.parametrize("text", ["1,2,3", "x", "-1", "1,nan", "inf", ","])
def test_other_limits_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="parameter limits_nees must be the limits"):
        AlarmLimits.parse(text, "limits_nees")


def test_errors_of_pairs_reach_the_alarms() -> None:
    position = np.zeros((800, 3))
    position[250:270, 0] = 0.5
    limits = {
        **NONE,
        "position_error_m": AlarmLimits(0.1, 0.4),
        "yaw_error_deg": AlarmLimits(3.0),
        "rotation_error_deg": AlarmLimits(3.0),
    }
    seen = levels(position, np.where(position[:, 0] > 0.0, 5.0, 0.0), limits)
    assert [item for item in seen if item] == [
        {
            "position_error_m": Level.ERROR,
            "yaw_error_deg": Level.WARNING,
            "rotation_error_deg": Level.WARNING,
        }
    ]
