"""Parts of the watchdog by their definitions: rows, rotations, signals, limits and alarms."""

from __future__ import annotations

import dataclasses
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from watched_flights import SECOND, flight

from benchmarks.watch_faults import FAULTS
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.lie import running_products
from trajeval_ros.watchdog.inertial_mounting import Mounting
from trajeval_ros.watchdog.pair_signals import PairSignals, body_difference
from trajeval_ros.watchdog.pose_signals import CorrectionSignals, EventSignals, SmoothSignal
from trajeval_ros.watchdog.recording import error_spans, undetected_faults
from trajeval_ros.watchdog.row_buffer import OrderedFeed, RowBuffer
from trajeval_ros.watchdog.signals import (
    SIGNALS,
    Readings,
    Signals,
    in_order,
    joined,
    pair_sources,
    signal_of,
    source_of,
    source_words,
)
from trajeval_ros.watchdog.watch_alarms import AlarmBook

PAGE = Path(__file__).parents[2] / "docs" / "watchdog.md"
FACTOR = 1.0 / signal_of("step").limit  # its limit is then 1 m

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def poses(times: Floats, positions: Floats, quaternions: Floats = UPRIGHT) -> Floats:
    """Return rows of poses without a gap."""
    rotations = np.broadcast_to(quaternions, (len(times), 4))
    return OrderedFeed().rows(times, np.asarray(positions), rotations)


def along_x(times: Floats, speed: float = 1.0) -> Floats:
    return np.outer(speed * times, [1.0, 0.0, 0.0])


def test_rows_have_the_start_of_their_gapless_part() -> None:
    feed = OrderedFeed()
    rows = feed.rows(np.array([0.0, 1.0, 3.0, 5.5, 5.5, 4.0, 6.0]), np.arange(7.0)[:, None])
    assert rows.tolist() == [
        [0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [3.0, 0.0, 2.0], [5.5, 5.5, 3.0], [6.0, 5.5, 6.0],
    ]  # fmt: skip
    assert (feed.last, feed.out_of_order) == (6.0, 2)
    assert feed.rows(np.array([6.0, 5.0]), np.zeros((2, 1))).shape == (0, 3)
    assert feed.out_of_order == 4
    assert feed.rows(np.array([8.0, 10.5]), np.zeros((2, 1)))[:, 1].tolist() == [5.5, 10.5]


def test_old_rows_are_forgotten() -> None:
    recent = RowBuffer(2)
    for begin in range(0, 50_000, 500):
        recent.append(np.column_stack([np.arange(begin, begin + 500.0), np.zeros(500)]))
        recent.forget(begin - 100.0)
        assert recent.rows[0, 0] == max(begin - 100.0, 0.0)
        assert recent.rows[-1, 0] == begin + 499.0
    recent.forget_until(49_700.5)
    assert recent.rows[0, 0] == 49_700.0
    recent.forget_until(49_701.0)
    assert recent.rows[0, 0] == 49_701.0
    recent.forget_until(1.0)
    assert recent.rows[0, 0] == 49_701.0
    assert len(pickle.dumps(recent)) < 5000 * 2 * 8


def test_rotations_over_time() -> None:
    steps = Rotation.random(9, random_state=4)
    first = Rotation.random(random_state=5)
    expected, now = [], first
    for step in steps:
        now = now * step
        expected.append(now)
    result = Rotation.from_quat(running_products(first.as_quat(), steps.as_quat()))
    assert max((a.inv() * b).magnitude() for a, b in zip(result, expected, strict=True)) < 1e-12
    assert running_products(first.as_quat(), np.zeros((0, 4))).shape == (0, 4)


def test_limits_are_those_of_the_table_in_the_documentation() -> None:
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([\d.]+) ?([^|]*?) \|$", PAGE.read_text(), re.M)
    assert {name: (float(limit), unit) for name, limit, unit in rows} == {
        signal.name: (signal.limit, signal.unit) for signal in SIGNALS
    }
    assert AlarmBook(3.0).limit("step") == pytest.approx(4.5)
    assert AlarmBook().limit("pair_deg_5s.wheel") == 3.0


def test_names_of_signals_and_sources() -> None:
    names = ("gap", "pair_deg_5s", "pair_deg_5s.wheel", "gyro_deg_1s")
    assert [source_of(name) for name in names] == ["", "pair", "pair.wheel", "imu"]
    assert source_words("pair.wheel") == "second estimate wheel"
    assert source_words("pair") == "second estimate"
    assert in_order(["gap", "pair_deg_5s.b", "pair_deg_5s"]) == [
        "pair_deg_5s.b", "pair_deg_5s", "gap",
    ]  # fmt: skip
    assert pair_sources(["wheel"]) == ["pair"]
    assert pair_sources(["vio", "wheel"]) == ["pair.vio", "pair.wheel"]
    with pytest.raises(SettingsError, match="have the name b; remove"):
        pair_sources(["a", "b", "b"])
    parts = [
        {"gap": Readings(np.array([0.0]), np.array([1.0]))},
        {"smooth": Readings(np.array([0.5]), np.array([3.0]))},
        {"gap": Readings(np.array([1.0]), np.array([2.0]))},
    ]
    result = joined(parts)
    assert list(result) == ["gap", "smooth"]
    assert [item.tolist() for item in result["gap"]] == [[0.0, 1.0], [1.0, 2.0]]


def one_second(**values: float) -> dict[str, Readings]:
    return {name: Readings(np.array([1.0]), np.array([value])) for name, value in values.items()}


def test_alarms_that_a_restart_ends() -> None:
    book = AlarmBook(FACTOR)
    book.add(one_second(step=1.1))
    (before,) = book.standing
    book.end_all()
    assert before.is_over
    assert not book.standing
    (after,) = book.add({"step": Readings(np.array([0.1]), np.array([1.2]))})
    assert book.alarms == [before, after]
    book.forget(1.0)
    assert book.alarms == [before, after]
    book.forget(1.5)  # the second one has not ended
    assert book.alarms == [after]


def test_alarms_of_two_sources_at_a_time_are_errors() -> None:
    for names, gap_s, is_error in (
        (("step", "pair_deg_5s"), 5.0, True),
        (("step", "pair_deg_5s"), 5.1, False),
        (("step", "gap"), 1.0, False),  # both of the poses alone
    ):
        book = AlarmBook()
        for place, name in enumerate(names):
            value = np.array([1.2 * book.limit(name)])
            book.add({name: Readings(np.array([10.0 + place * gap_s]), value)})
        assert [book.is_error(alarm) for alarm in book.alarms] == [is_error, is_error]
        assert [item.signal for item in book.standing] == list(names)


def test_an_alarm_of_five_seconds_or_far_beyond_its_limit_is_an_error() -> None:
    for seconds, values, is_error in (
        ([0.0, 2.0, 4.9], [1.1, 0.71, 0.71], False),
        ([0.0, 2.0, 5.0], [1.1, 0.71, 0.71], True),
        ([0.0, 2.0, 5.0], [1.1, 0.71, 0.70], False),
        ([0.0], [1.5], False),
        ([0.0], [1.51], True),
    ):
        book = AlarmBook(FACTOR)
        (alarm,) = book.add({"step": Readings(np.array(seconds), np.array(values))})
        assert book.is_error(alarm) == is_error
        assert alarm.peak == max(values)


def test_errors_are_spans_of_the_estimates_clock() -> None:
    run = flight()
    origin = int(run.estimate.stamps[0])
    onset = origin + 50 * SECOND
    assert error_spans(run, 1.0) == []
    bad = FAULTS["jump 1 m"](run.estimate, onset, np.random.default_rng(1))
    spans = error_spans(dataclasses.replace(run, estimate=bad), 1.0)
    assert spans
    assert all(onset <= begin <= end <= int(run.estimate.stamps[-1]) for begin, end in spans)
    assert min(begin for begin, _ in spans) - onset < SECOND


def test_what_is_not_detected_is_said_once() -> None:
    assert list(undetected_faults(["twist", "imu", "pair"], ["imu", "pair"], [])) == []
    assert list(undetected_faults(["imu", "pair.a"], ["pair.a"], ["the IMU is odd"])) == [
        "no twist: disagreement of pose and velocity is not detected"
    ]
    assert [text.partition(":")[0] for text in undetected_faults([], [], [])] == [
        "no twist", "no IMU", "no second estimate",
    ]  # fmt: skip
    (message,) = undetected_faults(["twist", "imu", "pair", "map"], ["imu", "pair"], [])
    assert message.startswith("no data of the map-to-odom transform after arming (30 s of motion)")


def test_remarks_about_an_imu_need_a_difference_that_matters() -> None:
    def printed(turn_deg: float, offset_s: float, axis: Floats | None = None) -> list[str]:
        rotation = lie.from_rotation_vector(np.radians([turn_deg, 0.0, 0.0]))
        return Mounting(rotation, np.zeros(3), offset_s, axis, 0.1, np.eye(6)).remarks()

    assert printed(0.1, 0.001) == printed(-0.1, -0.001) == []
    assert printed(0.0, -0.2) == ["the estimate's clock is 0.200 s ahead of the IMU's (applied)"]
    [text] = printed(9.0, 0.0, np.ones(3))
    assert text.startswith("the robot rotated about only one axis: the gyroscope is compared")


def test_coasting_is_smoother_than_usual() -> None:
    """In any portions; a robot at rest is not smooth."""
    times, generator = np.arange(800) * 0.05, np.random.default_rng(1)
    positions = along_x(times) + generator.normal(0.0, 2e-3, (800, 3))
    positions[600:700] = positions[600] + along_x(times[:100])
    positions[700:] = positions[699]
    seconds, values = SmoothSignal(0.05).add(poses(times, positions))["smooth"]
    limit = signal_of("smooth").limit
    assert values[seconds < 30.5].max() < 3.0
    assert values[(seconds > 31.1) & (seconds < 34.9)].min() > limit
    assert values[seconds > 36.1].max() == 0.0
    whole = SmoothSignal(0.05)
    parts = [
        whole.add(poses(times, positions)[rows])["smooth"].values
        for rows in np.split(np.arange(800), [7, 8, 200, 650])
    ]
    np.testing.assert_array_equal(np.concatenate(parts), values)


def stop_and_go(resolution_m: float) -> Floats:
    """Return positions, 50 times a second, of a robot whose encoders have a resolution."""
    seconds = np.arange(0.0, 300.0, 0.02)
    speed = np.clip(np.minimum(seconds % 17.0, 12.0 - seconds % 17.0), 0.0, 0.4)
    path = np.floor(np.cumsum(0.02 * speed) / resolution_m) * resolution_m
    return np.outer(path, [1.0, 0.0, 0.0])


@pytest.mark.parametrize("resolution_m", [0.0005, 0.001, 0.002, 0.004])
def test_quantised_encoders_in_stop_and_go_do_not_coast(resolution_m: float) -> None:
    """At 0.4 m/s, every step is the same multiple of the resolution for seconds."""
    positions = stop_and_go(resolution_m)
    rows = poses(np.arange(len(positions)) * 0.02, positions)
    assert SmoothSignal(0.02).add(rows)["smooth"].values.max() < signal_of("smooth").limit


def signals_of(events: EventSignals, stamps: Stamps, rows: Floats) -> Signals:
    events.add(stamps, rows)
    return events.signals(stamps / SECOND, 0.0)


def events_in(positions: Floats, turns: Floats = UPRIGHT) -> dict[str, Readings]:
    """Return the signals of the events of positions 20 times a second."""
    times = np.arange(len(positions)) * 0.05
    stamps = np.rint(times * SECOND).astype(np.int64)
    quaternions = np.broadcast_to(turns, (len(times), 4))
    rows = np.hstack([positions, quaternions])
    whole = signals_of(EventSignals(0), stamps, rows)
    fed = EventSignals(0)
    parts = [
        signals_of(fed, stamps[some], rows[some])
        for some in np.split(np.arange(len(times)), [3, 301, 302, 450])
    ]
    for name, (seconds, values) in joined(parts).items():
        np.testing.assert_array_equal(seconds, whole[name].seconds)
        np.testing.assert_allclose(values, whole[name].values, rtol=1e-9, atol=1e-9)
    return dict(whole)


def test_signals_of_events_begin_when_they_are_known() -> None:
    times, generator = np.arange(600) * 0.05, np.random.default_rng(2)
    good = along_x(times, 2.0) + generator.normal(0.0, 1e-3, (600, 3))
    assert events_in(good) == {}
    jumped = good + np.where(times >= 20.0, 0.5, 0.0)[:, None] * [0.0, 1.0, 0.0]
    result = events_in(jumped)
    assert list(result) == ["step"]
    assert result["step"].seconds[0] == pytest.approx(20.05)  # with the next pose
    assert result["step"].values[0] > 3.0 * signal_of("step").limit
    assert not result["step"].values[1:].any()
    rotated = lie.from_rotation_vector(generator.normal(0.0, 1e-3, (600, 3)))
    rotated[400] = lie.multiply(rotated[400], np.array([1.0, 0.0, 0.0, 0.0]))
    assert list(events_in(good, rotated)) == ["flip"]


def test_a_freeze_lasts_and_a_gap_has_its_periods() -> None:
    times = np.arange(600) * 0.05
    result = events_in(along_x(np.minimum(times, 20.0)))
    assert list(result) == ["frozen_position"]
    seconds, values = result["frozen_position"]
    assert seconds[0] == pytest.approx(20.5)
    np.testing.assert_allclose(values, seconds - 20.0, atol=1e-9)
    stamps = np.rint((times + np.where(times > 20.0, 0.2, 0.0)) * SECOND).astype(np.int64)
    rows = np.hstack([along_x(times), np.tile(UPRIGHT, (600, 1))])
    [(name, gaps)] = signals_of(EventSignals(0), stamps, rows).items()
    assert name == "gap"
    assert (gaps.seconds[0], gaps.values[0]) == pytest.approx((20.25, 5.0))


def test_map_corrections_move_the_robot_where_it_is() -> None:
    signals = CorrectionSignals()
    times = np.arange(0.0, 30.0, 0.1)
    assert signals.add_other(poses(np.array([0.0]), np.zeros((1, 3)))) == {}
    first = signals.add(poses(times, along_x(times)))
    assert {name: len(item.values) for name, item in first.items()} == {
        "map_correction_m_1s": 0, "map_correction_deg_1s": 0,
    }  # fmt: skip
    rotation = lie.from_rotation_vector(np.array([0.0, 0.0, np.radians(2.0)]))
    result = signals.add_other(poses(np.array([10.0]), np.zeros((1, 3)), rotation))
    # At 10 m from the origin, 2 degrees are 0.349 m.
    assert result["map_correction_m_1s"].values == pytest.approx([20.0 * np.sin(np.radians(1.0))])
    assert result["map_correction_deg_1s"].values == pytest.approx([2.0])
    again = signals.add_other(poses(np.array([12.0]), np.zeros((1, 3)), rotation))
    assert again["map_correction_deg_1s"].values == pytest.approx([0.0], abs=1e-9)


@pytest.mark.parametrize("seed", range(4200, 4206))
def test_the_body_of_a_partner_of_a_planar_robot_is_within_its_standard_deviations(
    seed: int,
) -> None:
    """Rotations determine the body about one axis only, displacements the rest of it."""
    generator = np.random.default_rng(seed)
    count = 400
    own = Rotation.from_rotvec(np.outer(generator.normal(0.0, 0.5, count), [0.0, 0.0, 1.0]))
    steps = generator.normal(0.0, 1.0, (count, 3)) * [1.0, 1.0, 0.0]
    rotation, lever = Rotation.from_rotvec([0.4, -0.5, 0.3]), np.array([0.2, -0.1, 0.15])
    other_steps = rotation.inv().apply(steps - lever + own.apply(lever)) / 1.7
    other_steps += generator.normal(0.0, 0.005, steps.shape)
    noisy = rotation.inv() * own * rotation
    noisy *= Rotation.from_rotvec(generator.normal(0.0, 0.002, (count, 3)))
    result = body_difference(own.as_quat(), steps, noisy.as_quat(), other_steps)
    sigma = np.sqrt(np.diag(result.covariance))
    off = (Rotation.from_quat(result.rotation) * rotation.inv()).as_rotvec()
    assert np.degrees(np.linalg.norm(off)) < 0.5
    assert (np.abs(off) < 4.0 * sigma[:3]).all()
    assert (np.abs(result.lever_m - lever) < 4.0 * sigma[3:6]).all()
    assert abs(np.log(result.scale / 1.7)) < 4.0 * sigma[6]
    # The lever arm along the axis has no effect: only the prior of 0.5 m is known.
    assert sigma[5] == pytest.approx(0.5, rel=0.05)
    assert max(sigma[3:5]) < 0.01


def test_a_partner_with_one_state_is_waited_for() -> None:
    times = np.arange(0.0, 40.0, 0.1)
    positions = np.column_stack([np.sin(times), np.cos(0.7 * times), 0.1 * times])
    states = poses(times, positions)
    pair = PairSignals("pair.b", 0.1, 30.0)
    assert pair.add(states[:1]) == {}
    assert pair.add_other(states[:1]) == {}
    assert pair.add(states[1:]) == {}
    result = pair.add_other(states[1:])
    assert pair.usable
    assert set(result) == {
        f"pair_{name}s.b" for name in ("percent_5", "percent_20", "deg_5", "deg_20")
    }
    assert result["pair_percent_5s.b"].values.max() < 1e-6
    assert result["pair_percent_5s.b"].seconds[-1] == times[-1]
    # The fault of the partner: it moves 0.5 m aside at 36 s, after a path of 5 s.
    other = positions + np.where(times >= 36.0, 0.5, 0.0)[:, None] * [0.0, 0.0, 1.0]
    pair = PairSignals("pair", 0.1, 30.0)
    pair.add(states)
    result = pair.add_other(poses(times, other))
    seconds, values = result["pair_percent_5s"]
    path_m = 5.0 * np.median(np.linalg.norm(positions[10:] - positions[:-10], axis=1))
    assert values.max() == pytest.approx(100.0 * 0.5 / (1.0 + path_m), rel=0.3)
    assert seconds[values.argmax()] >= 36.0


def test_too_little_of_a_partner_is_said() -> None:
    times = np.arange(0.0, 40.0, 0.1)
    states = poses(times, along_x(times))
    pair = PairSignals("pair", 0.1, 30.0)
    assert pair.add(states) == {}
    assert pair.add_other(states[290:]) == {}
    assert not pair.usable
    assert pair.notices == [
        "too little data of the second estimate during the motion before arming: it is not "
        "compared"
    ]
    assert pair.add(states) == pair.add_other(states) == {}
