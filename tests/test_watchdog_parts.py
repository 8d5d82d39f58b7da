"""Parts of the watchdog by their definitions: rows, rotations, signals, limits and alarms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from watched_flights import SECOND, flight

from benchmarks.watch_faults import FAULTS
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.watchdog.alarm_book import AlarmBook
from trajeval_ros.watchdog.correction_signals import CorrectionSignals
from trajeval_ros.watchdog.error_spans import error_spans
from trajeval_ros.watchdog.inertial_mounting import Mounting
from trajeval_ros.watchdog.limits import HealthyValues, WatchLimits
from trajeval_ros.watchdog.pair_signals import PairSignals, body_difference
from trajeval_ros.watchdog.pose_signals import PoseSignals
from trajeval_ros.watchdog.recent import Feed, Recent, window_begins
from trajeval_ros.watchdog.recording import watched
from trajeval_ros.watchdog.rotations_over_time import angles_deg, running_products, slerp_at
from trajeval_ros.watchdog.signal_history import SignalHistory
from trajeval_ros.watchdog.signals import (
    SIGNALS,
    Readings,
    in_order,
    joined,
    pair_sources,
    signal_of,
    source_of,
    source_words,
)
from trajeval_ros.watchdog.unseen import unseen

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def poses(times: Floats, positions: Floats, quaternions: Floats = UPRIGHT) -> Floats:
    """Return rows of poses without a gap."""
    turns = np.broadcast_to(quaternions, (len(times), 4))
    return Feed().rows(times, np.asarray(positions), turns)


def along_x(times: Floats, speed: float = 1.0) -> Floats:
    return np.outer(speed * times, [1.0, 0.0, 0.0])


def test_rows_have_the_start_of_their_gapless_part() -> None:
    feed = Feed()
    rows = feed.rows(np.array([0.0, 1.0, 3.0, 5.5, 5.5, 4.0, 6.0]), np.arange(7.0)[:, None])
    assert rows.tolist() == [
        [0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [3.0, 0.0, 2.0], [5.5, 5.5, 3.0], [6.0, 5.5, 6.0],
    ]  # fmt: skip
    assert (feed.last, feed.out_of_order) == (6.0, 2)
    assert feed.rows(np.array([6.0, 5.0]), np.zeros((2, 1))).shape == (0, 3)
    assert feed.out_of_order == 4
    assert feed.rows(np.array([8.0, 10.5]), np.zeros((2, 1)))[:, 1].tolist() == [5.5, 10.5]


def test_old_rows_are_forgotten() -> None:
    recent = Recent(2)
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
    assert len(recent._store) < 5000


def test_windows_begin_at_their_first_row_and_have_no_gap() -> None:
    times = np.array([0.0, 0.5, 1.0, 1.5, 5.0, 5.5, 6.0])
    rows = Feed().rows(times, np.zeros((7, 1)))
    begins, known = window_begins(rows, 1, 1.0)
    assert begins.tolist() == [0, 0, 1, 4, 4, 4]
    assert known.tolist() == [False, True, True, False, False, True]


def test_rotations_over_time() -> None:
    generator = np.random.default_rng(4)
    steps = Rotation.random(9, random_state=4)
    first = Rotation.random(random_state=5)
    expected, now = [], first
    for step in steps:
        now = now * step
        expected.append(now)
    found = Rotation.from_quat(running_products(first.as_quat(), steps.as_quat()))
    assert max((a.inv() * b).magnitude() for a, b in zip(found, expected, strict=True)) < 1e-12
    assert running_products(first.as_quat(), np.zeros((0, 4))).shape == (0, 4)
    times = np.arange(3.0)
    turned = lie.from_rotation_vector(np.outer([0.0, 0.2, 0.8], [0.0, 0.0, 1.0]))
    found = slerp_at(times, turned, np.array([-1.0, 0.5, 1.25, 9.0]))
    np.testing.assert_allclose(lie.rotation_vector(found)[:, 2], [0.0, 0.1, 0.35, 0.8], atol=1e-12)
    axis = np.array([0.6, 0.0, 0.8])
    angles = np.array([0.0, 10.0, 179.0, 181.0, 350.0, 370.0])
    about = lie.from_rotation_vector(np.outer(np.radians(angles), axis))
    signs = generator.choice([-1.0, 1.0], len(angles))[:, None]
    for quaternions in (about, signs * about):
        np.testing.assert_allclose(
            angles_deg(quaternions, axis), [0.0, 10.0, 179.0, 179.0, 10.0, 10.0], atol=1e-9
        )
        np.testing.assert_allclose(
            angles_deg(quaternions), [0.0, 10.0, 179.0, 179.0, 10.0, 10.0], atol=1e-5
        )


def test_the_history_has_the_largest_value_of_each_second() -> None:
    history = SignalHistory()
    assert history.latest == {}
    history.add({"gap": Readings(np.array([0.2, 0.9, 1.1, 3.0]), np.array([1.0, 3.0, 2.0, 1.5]))})
    history.add({"gap": Readings(np.array([3.5, 3.9]), np.array([1.0, 4.0]))})
    history.add({"gap": Readings(np.array([3.95]), np.array([2.0]))})
    history.add({"speed": Readings(np.zeros(0), np.zeros(0))})
    assert history.by_second == {"gap": [(0, 3.0), (1, 2.0), (3, 4.0)], "speed": []}
    assert history.latest == {"gap": 4.0}
    whole, parts = SignalHistory(), SignalHistory()
    seconds = 1000.0 + np.arange(1000.0) / 10.0
    values = np.random.default_rng(0).random(1000)
    whole.add({"gap": Readings(seconds, values)})
    for begin in range(0, 1000, 7):
        rows = slice(begin, begin + 7)
        parts.add({"gap": Readings(seconds[rows], values[rows])})
    expected = [
        (1000 + second, values[10 * second : 10 * second + 10].max()) for second in range(40, 100)
    ]
    assert whole.by_second == parts.by_second == {"gap": expected}


def test_minimum_healthy_values_increase_with_the_window() -> None:
    floors = {
        "pair_m_1s": 0.015, "pair_m_5s": 0.035, "pair_m_20s": 0.11, "map_correction_m_20s": 0.11,
        "pair_deg_1s": 0.12, "gyro_deg_5s": 0.2, "pair_angle_deg_20s": 0.5,
    }  # fmt: skip
    assert {name: signal_of(name).floor for name in floors} == pytest.approx(floors)
    # Of the others, as in docs/watchdog.md.
    others = {
        "pair_scale": 0.02, "gyro_slip_ms": 3.0, "twist_scale": 0.01, "smooth": 30.0,
        "freeze_hard_s": 0.25, "jump_m": 0.01, "jump_deg": 0.1, "gap": 1.5, "jitter": 0.02,
        "gravity_deg_1s": 0.5, "gravity_deg_5s": 0.3, "gravity_mps2_5s": 0.05, "speed": 1.0,
        "standstill_m": 0.005,
    }  # fmt: skip
    assert {
        each.name: each.floor
        for each in SIGNALS
        if not each.name.startswith(("pair_m", "pair_deg", "pair_angle", "gyro_deg", "twist_m",
                                     "map_"))
    } == others  # fmt: skip
    assert {each.name for each in SIGNALS if each.least_factor} == {"pair_scale", "jump_deg"}
    assert signal_of("twist_m_5s.x").unit == "m"
    assert signal_of("gyro_deg_1s").unit == "deg"


def test_names_of_signals_and_sources() -> None:
    names = ("gap", "pair_m_1s", "pair_m_1s.wheel", "gyro_slip_ms")
    assert [source_of(name) for name in names] == ["", "pair", "pair.wheel", "imu"]
    assert source_words("pair.wheel") == "second estimate wheel"
    assert source_words("pair") == "second estimate"
    assert in_order(["gap", "pair_m_1s.b", "pair_m_1s"]) == ["pair_m_1s.b", "pair_m_1s", "gap"]
    assert pair_sources(["wheel"]) == ["pair"]
    assert pair_sources(["vio", "wheel"]) == ["pair.vio", "pair.wheel"]
    with pytest.raises(SettingsError, match="have the name b; remove"):
        pair_sources(["a", "b", "b"])
    parts = [
        {"gap": Readings(np.array([0.0]), np.array([1.0]))},
        {"speed": Readings(np.array([0.5]), np.array([3.0]))},
        {"gap": Readings(np.array([1.0]), np.array([2.0]))},
    ]
    found = joined(parts)
    assert list(found) == ["gap", "speed"]
    assert [each.tolist() for each in found["gap"]] == [[0.0, 1.0], [1.0, 2.0]]


def one_second(**values: float) -> dict[str, Readings]:
    return {name: Readings(np.array([1.0]), np.array([value])) for name, value in values.items()}


def test_alarms_that_a_restart_ends() -> None:
    book = AlarmBook(WatchLimits({"jump_m": HealthyValues(0.5, 0.1)}, 1.0), 2.0)
    book.add(one_second(jump_m=1.1))
    (before,) = book.standing
    book.end_all()
    assert before.is_over
    assert not book.standing
    (after,) = book.add({"jump_m": Readings(np.array([0.1]), np.array([1.2]))})
    assert book.alarms == [before, after]
    book.forget(1.0)
    assert book.alarms == [before, after]
    book.forget(1.5)  # the second one has not ended
    assert book.alarms == [after]


def test_alarms_of_two_sources_at_a_time_are_errors() -> None:
    limits = WatchLimits(
        {name: HealthyValues(1.0, 0.1) for name in ("jump_m", "gap", "pair_m_1s")}, 1.0
    )
    for names, gap_s, is_error in (
        (("jump_m", "pair_m_1s"), 5.0, True),
        (("jump_m", "pair_m_1s"), 5.1, False),
        (("jump_m", "gap"), 1.0, False),  # both of the poses alone
    ):
        book = AlarmBook(limits, 2.0)
        for place, name in enumerate(names):
            value = np.array([1.2 * book.limits.limit(name, 2.0)])  # type: ignore[operator]
            book.add({name: Readings(np.array([10.0 + place * gap_s]), value)})
        assert [book.is_error(each) for each in book.alarms] == [is_error, is_error]
        assert [each.signal for each in book.standing] == list(names)


def test_an_alarm_of_five_seconds_or_far_beyond_its_limit_is_an_error() -> None:
    limits = WatchLimits({"jump_m": HealthyValues(0.5, 0.1)}, 1.0)
    for seconds, values, is_error in (
        ([0.0, 2.0, 4.9], [1.1, 0.71, 0.71], False),
        ([0.0, 2.0, 5.0], [1.1, 0.71, 0.71], True),
        ([0.0, 2.0, 5.0], [1.1, 0.71, 0.70], False),
        ([0.0], [1.5], False),
        ([0.0], [1.51], True),
    ):
        book = AlarmBook(limits, 2.0)
        (alarm,) = book.add({"jump_m": Readings(np.array(seconds), np.array(values))})
        assert book.is_error(alarm) == is_error
        assert alarm.peak == max(values)


def test_limits_of_another_robot_are_those_that_differ_tenfold_all_the_time() -> None:
    names = ("jump_m", "gap", "jitter", "speed")
    limits = WatchLimits({name: HealthyValues(2.0, 1.0) for name in names}, 1.0)

    def of(*levels: float, count: int = 200) -> dict[str, Readings]:
        times = np.arange(float(count))
        return {
            name: Readings(times, np.full(count, level))
            for name, level in zip(names, levels, strict=True)
        }

    limits.require_of(of(9.9, 9.9, 0.11, 0.11))
    limits.require_of(of(10.0, 1.0, 1.0, 1.0))
    limits.require_of(of(10.0, 10.0, 10.0, 10.0, count=99))  # too few to tell
    half = of(10.0, 0.1, 1.0, 1.0)
    with pytest.raises(
        InputError, match=r"2 of 4 signals .*\(gap: typical value 0.1, learned 1\)"
    ):
        limits.require_of(half)
    half["jump_m"].values[:60] = 1.0  # a fault that came later
    limits.require_of(half)
    idle = of(0.0, 0.0, 1.0, 10.0)  # the robot does not do this here
    with pytest.raises(InputError, match="1 of 2 signals"):
        limits.require_of(idle)
    with pytest.raises(InputError, match="without the IMU, which this run has"):
        limits.require_of({**of(1.0, 1.0, 1.0, 1.0), **one_second(gyro_slip_ms=1.0)})
    learned = WatchLimits.learned(
        {"gap": Readings(np.arange(3.0), np.array([1.0, 9.0, 2.0])),
         "speed": Readings(np.zeros(0), np.zeros(0))}, 2.0, {"estimate": "x"}, "so",
    )  # fmt: skip
    assert learned == WatchLimits({"gap": HealthyValues(9.0, 2.0)}, 2.0, {"estimate": "x"}, "so")


def test_errors_are_spans_of_the_estimates_clock() -> None:
    run = flight()
    origin = int(run.estimate.stamps[0])
    onset = origin + 50 * SECOND
    seen = watched(run)
    limits = WatchLimits.learned(seen.signals, seen.hours, {}, "")
    assert error_spans(run, limits) == []
    bad = FAULTS["jump 1 m"](run.estimate, onset, np.random.default_rng(1))
    spans = error_spans(dataclasses.replace(run, estimate=bad), limits)
    assert spans
    assert all(onset <= begin <= end <= int(run.estimate.stamps[-1]) for begin, end in spans)
    assert min(begin for begin, _ in spans) - onset < SECOND


def test_what_is_not_detected_is_said_once() -> None:
    assert list(unseen(["twist", "imu", "pair"], ["imu", "pair"], [])) == []
    assert list(unseen(["imu", "pair.a"], ["pair.a"], ["the IMU is odd"])) == [
        "no twist: disagreement of pose and velocity is not detected"
    ]
    assert [each.partition(":")[0] for each in unseen([], [], [])] == [
        "no twist", "no IMU", "no second estimate",
    ]  # fmt: skip
    (said,) = unseen(["twist", "imu", "pair", "map"], ["imu", "pair"], [])
    assert said.startswith("no data of the map-to-odom transform after arming (30 s of motion)")


def test_remarks_about_an_imu_need_a_difference_that_matters() -> None:
    def said(turn_deg: float, offset_s: float, axis: Floats | None = None) -> list[str]:
        turn = lie.from_rotation_vector(np.radians([turn_deg, 0.0, 0.0]))
        return Mounting(turn, np.zeros(3), offset_s, axis, 0.1).remarks()

    assert said(4.9, 0.049) == said(-4.9, -0.049) == []
    assert [each[:37] for each in said(5.1, 0.0)] == ["the IMU frame is rotated by 5.1 deg f"]
    assert said(0.0, 0.051) == ["the estimate's clock is 0.051 s behind the IMU's (applied)"]
    assert said(0.0, -0.051) == ["the estimate's clock is 0.051 s ahead of the IMU's (applied)"]
    assert [each[:40] for each in said(9.0, 0.0, np.ones(3))] == [
        "the robot rotated about only one axis: t"
    ]
    related = Mounting(UPRIGHT, np.zeros(3), 0.0, None, 0.499)
    assert related.is_related
    assert not dataclasses.replace(related, misfit=0.5).is_related


def test_signals_of_poses_on_a_straight_line() -> None:
    times = np.arange(400) * 0.05
    found = PoseSignals(0.05).add(poses(times, along_x(times)))
    assert found["jump_m"].seconds[0] == times[2]
    assert found["jump_m"].values.max() < 1e-12
    assert found["gap"].values == pytest.approx(np.ones(399))
    assert found["jitter"].values.max() < 1e-9
    assert found["speed"].seconds[0] == pytest.approx(5.0)
    # The speed is known after half a second; until then the slowest top speed counts.
    assert found["speed"].values[0] == pytest.approx(2.0)
    assert found["speed"].values[-1] == pytest.approx(1.0)
    assert found["freeze_hard_s"].values.max() == 0.0


def test_signals_of_a_jump_a_gap_and_a_freeze() -> None:
    times = np.arange(400) * 0.05
    positions = along_x(times, 2.0)
    positions[200:, 1] += 0.5
    turns = np.tile(UPRIGHT, (400, 1))
    turns[200:] = lie.from_rotation_vector(np.array([0.0, 0.0, np.radians(3.0)]))
    found = PoseSignals(0.05).add(poses(times, positions, turns))
    assert found["jump_m"].values.max() == pytest.approx(0.5)
    assert found["jump_deg"].values.max() == pytest.approx(3.0)
    assert found["jump_m"].seconds[found["jump_m"].values.argmax()] in times[200:202]
    late = times.copy()
    late[300:] += 0.2
    gaps = PoseSignals(0.05).add(poses(late, along_x(late)))["gap"]
    assert (gaps.values.max(), gaps.seconds[gaps.values.argmax()]) == pytest.approx(
        (5.0, late[300])
    )
    stopped = along_x(np.minimum(times, 15.0))
    frozen = PoseSignals(0.05).add(poses(times, stopped))["freeze_hard_s"]
    assert frozen.values[-1] == pytest.approx(times[-1] - 15.0)
    assert frozen.values[frozen.seconds < 15.01].max() == 0.0


def test_map_corrections_move_the_robot_where_it_is() -> None:
    signals = CorrectionSignals()
    times = np.arange(0.0, 30.0, 0.1)
    assert signals.add_transforms(poses(np.array([0.0]), np.zeros((1, 3)))) == {}
    first = signals.add(poses(times, along_x(times)))
    assert {name: len(each.values) for name, each in first.items()} == {
        f"map_correction_{unit}_{window}s": 0 for window in (1, 5, 20) for unit in ("m", "deg")
    }
    turn = lie.from_rotation_vector(np.array([0.0, 0.0, np.radians(2.0)]))
    found = signals.add_transforms(poses(np.array([10.0]), np.zeros((1, 3)), turn))
    # At 10 m from the origin, 2 degrees are 0.349 m; no transform is as old as 20 s.
    assert found["map_correction_m_5s"].values == pytest.approx([20.0 * np.sin(np.radians(1.0))])
    assert found["map_correction_deg_1s"].values == pytest.approx([2.0])
    assert len(found["map_correction_m_20s"].values) == 0
    again = signals.add_transforms(poses(np.array([12.0]), np.zeros((1, 3)), turn))
    assert again["map_correction_deg_1s"].values == pytest.approx([0.0], abs=1e-9)
    assert again["map_correction_deg_5s"].values == pytest.approx([2.0])


def test_the_body_of_a_partner_by_its_definition() -> None:
    generator = np.random.default_rng(2)
    turns = lie.from_rotation_vector(generator.normal(0.0, 0.5, (80, 3)))
    steps = generator.normal(0.0, 1.0, (80, 3))
    rotation, lever = Rotation.random(random_state=3), np.array([0.3, -0.2, 0.1])
    own = Rotation.from_quat(turns)
    other_turns = (rotation.inv() * own * rotation).as_quat()
    other_steps = rotation.inv().apply(steps - lever + own.apply(lever)) / 1.7
    found = body_difference(turns, steps, other_turns, other_steps)
    assert (Rotation.from_quat(found.rotation).inv() * rotation).magnitude() < 1e-9
    np.testing.assert_allclose(found.lever_m, lever, atol=1e-9)
    assert found.scale == pytest.approx(1.7)


def test_the_body_of_a_partner_of_a_robot_that_turns_about_one_axis() -> None:
    generator = np.random.default_rng(2)
    own = Rotation.from_rotvec(np.outer(generator.normal(0.0, 0.5, 80), [0.0, 0.0, 1.0]))
    steps = generator.normal(0.0, 1.0, (80, 3)) * [1.0, 1.0, 0.0]
    rotation, lever = Rotation.from_rotvec([0.0, 0.0, 0.7]), np.array([0.3, -0.2, 0.0])
    other_steps = rotation.inv().apply(steps - lever + own.apply(lever)) / 1.7
    found = body_difference(own.as_quat(), steps, own.as_quat(), other_steps)
    assert (Rotation.from_quat(found.rotation).inv() * rotation).magnitude() < 1e-6
    np.testing.assert_allclose(found.lever_m, lever, atol=1e-6)
    assert found.scale == pytest.approx(1.7)


def test_a_robot_that_hardly_turns_has_no_lever_arm() -> None:
    generator = np.random.default_rng(2)
    turns = lie.from_rotation_vector(generator.normal(0.0, 1e-4, (80, 3)))
    steps = generator.normal(0.0, 1.0, (80, 3))
    noisy = steps + generator.normal(0.0, 1e-3, (80, 3))
    found = body_difference(turns, steps, turns, noisy)
    np.testing.assert_allclose(found.lever_m, 0.0, atol=1e-12)
    assert found.scale == pytest.approx(1.0, abs=1e-3)


def test_a_partner_with_one_state_is_waited_for() -> None:
    times = np.arange(0.0, 40.0, 0.1)
    positions = np.column_stack([np.sin(times), np.cos(0.7 * times), 0.1 * times])
    states = poses(times, positions)
    pair = PairSignals("pair.b", 0.1, 30.0)
    assert pair.add(states[:1]) == {}
    assert pair.add_partner(states[:1]) == {}
    assert pair.add(states[1:]) == {}
    found = pair.add_partner(states[1:])
    assert pair.usable
    assert set(found) >= {"pair_m_1s.b", "pair_scale.b"}
    assert found["pair_m_1s.b"].values.max() < 1e-9
    assert found["pair_m_1s.b"].seconds[-1] == times[-1]
    # The fault of the partner: it moves 0.1 m aside at 36 s.
    other = positions + np.where(times >= 36.0, 0.1, 0.0)[:, None] * [0.0, 0.0, 1.0]
    pair = PairSignals("pair", 0.1, 30.0)
    pair.add(states)
    found = pair.add_partner(poses(times, other))
    assert found["pair_m_1s"].values.max() == pytest.approx(0.1)
    assert found["pair_m_1s"].seconds[found["pair_m_1s"].values.argmax()] >= 36.0


def test_the_scale_of_a_partner_is_compared_while_the_robot_moves() -> None:
    times = np.arange(0.0, 120.0, 0.1)
    path = np.where(times < 80.0, times, 80.0)
    positions = np.column_stack([np.sin(path), np.cos(0.7 * path), 0.1 * path])
    scales = np.where(times < 50.0, 1.0, 1.5)
    steps = np.diff(positions, axis=0, prepend=positions[:1]) * scales[:, None]
    pair = PairSignals("pair", 0.1, 30.0)
    pair.add(poses(times, positions))
    seconds, values = pair.add_partner(poses(times, np.cumsum(steps, axis=0)))["pair_scale"]
    assert values[seconds < 50.0].max() < 1e-9
    # After 10 s all of the window has the other scale.
    assert values[(seconds > 62.0) & (seconds < 80.0)] == pytest.approx(np.log(1.5))
    assert values[seconds > 92.0].max() == values[seconds > 92.0].min() == 0.0


def test_too_little_of_a_partner_is_said() -> None:
    times = np.arange(0.0, 40.0, 0.1)
    states = poses(times, along_x(times))
    pair = PairSignals("pair", 0.1, 30.0)
    assert pair.add(states) == {}
    assert pair.add_partner(states[290:]) == {}
    assert not pair.usable
    assert pair.notices == [
        "too little data of the second estimate during the motion before arming: it is not "
        "compared"
    ]
    assert pair.add(states) == pair.add_partner(states) == {}
