"""Laws of the watchdog: what is fed in any portions, of any gauge and body, gives the same."""

from __future__ import annotations

import dataclasses
from functools import cache, partial

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from watched_flights import SECOND, flight

from benchmarks.watch_faults import FAULTS
from trajeval_ros import Trajectory
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.watchdog.engine import Watchdog
from trajeval_ros.watchdog.pair_signals import body_difference
from trajeval_ros.watchdog.recording import Watched, WatchedRun, watched
from trajeval_ros.watchdog.signals import SIGNAL_NAMED, Readings, Signals, joined, signal_of
from trajeval_ros.watchdog.watch_alarms import AlarmBook

# Signals of a run without the event have no value.
EVENTS = {
    "step", "restart", "outlier", "flip", "flip_stays", "lost", "frozen_position",
    "frozen_rotation", "gap", "clock_step",
}  # fmt: skip


@cache
def seen() -> Watched:
    return watched(flight())


def assert_same(outcome: Signals, expected: Signals, tolerance: float = 1e-9) -> None:
    assert outcome.keys() == expected.keys()
    for name, (seconds, values) in expected.items():
        np.testing.assert_allclose(outcome[name].seconds, seconds, atol=1e-9)
        np.testing.assert_allclose(
            outcome[name].values, values, rtol=tolerance, atol=tolerance, err_msg=name
        )


def fed_in_portions(run: WatchedRun, ends: dict[str, list[int]]) -> Signals:
    """Feed a watchdog portion by portion, sources in turn, as arrival may have it."""
    watchdog = Watchdog(int(run.estimate.stamps[0]))
    imu, partner, estimate = run.imu, run.partners["pair"], run.estimate
    corrections = run.corrections
    assert imu is not None
    assert imu.accelerations is not None
    assert corrections is not None
    assert partner.quaternions is not None
    columns = {
        "imu": (partial(watchdog.add_source, "imu"), (imu.stamps, imu.rates, imu.accelerations)),
        "pair": (
            partial(watchdog.add_source, "pair"),
            (partner.stamps, partner.positions, partner.quaternions),
        ),
        "map": (
            partial(watchdog.add_source, "map"),
            (corrections.stamps, corrections.positions, corrections.quaternions),
        ),
        "states": (watchdog.add_estimate, (estimate,)),
    }
    parts: list[Signals] = []
    starts = dict.fromkeys(columns, 0)
    for rotation in range(max(map(len, ends.values()))):
        for source, (add, arrays) in columns.items():
            if rotation < len(ends[source]):
                rows = slice(starts[source], ends[source][rotation])
                parts.append(add(*(array[rows] for array in arrays)))  # type: ignore[operator]
                starts[source] = ends[source][rotation]
    return joined(parts)


# Without shrinking, which takes minutes; the portions of a failure are printed.
@pytest.mark.slow
@settings(max_examples=5, deadline=None, phases=(Phase.generate,))
@given(st.data())
def test_portions_and_arrival_change_nothing(data: st.DataObject) -> None:
    run = flight()
    assert run.imu is not None
    ends = {}
    for name, count in (
        ("imu", len(run.imu)),
        ("pair", len(run.partners["pair"])),
        ("map", len(run.corrections or [])),
        ("states", len(run.estimate)),
    ):
        cuts = data.draw(st.lists(st.integers(1, count), max_size=12, unique=True), label=name)
        ends[name] = [*sorted(cuts), count]
    result = fed_in_portions(run, ends)
    assert_same(result, seen().signals)


@pytest.mark.slow
def test_portions_of_a_live_timer_change_nothing() -> None:
    run = flight()
    ends = {
        name: [*range(step, count, step), count]
        for name, count, step in (
            ("imu", len(run.imu or []), 10),
            ("pair", len(run.partners["pair"]), 1),
            ("map", len(run.corrections or []), 3),
            ("states", len(run.estimate), 1),
        )
    }
    assert_same(fed_in_portions(run, ends), seen().signals)


def test_all_signals_are_there_and_small() -> None:
    assert set(seen().signals) == set(SIGNAL_NAMED) - EVENTS
    largest = {name: values.max() for name, (_, values) in seen().signals.items()}
    for name, value in largest.items():
        assert value < 0.6 * signal_of(name).limit
    assert all(seconds.min() >= seen().armed_s for seconds, _ in seen().signals.values())


def moved(
    partner: Trajectory, frame: Floats, body: Floats, lever: Floats, scale: float
) -> Trajectory:
    """Return a partner in another frame, of another body on the robot, and of another scale."""
    assert partner.quaternions is not None
    at = partner.positions + lie.rotate(
        partner.quaternions, np.broadcast_to(lever, partner.positions.shape)
    )
    return dataclasses.replace(
        partner,
        positions=scale * lie.rotate(frame[None], at) + [10.0, -20.0, 3.0],
        quaternions=lie.normalized(
            lie.multiply(lie.multiply(frame[None], partner.quaternions), body[None])
        ),
    )


vectors = st.tuples(*[st.floats(-1.5, 1.5)] * 3).map(np.array)


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(vectors, vectors, vectors, st.floats(0.2, 5.0))
def test_gauge_body_and_scale_of_the_partner_change_nothing(
    frame: Floats, body: Floats, lever: Floats, scale: float
) -> None:
    run = flight()
    rotated = moved(
        run.partners["pair"],
        lie.from_rotation_vector(frame),
        lie.from_rotation_vector(body),
        lever,
        scale,
    )
    result = watched(WatchedRun(run.estimate, partners={"pair": rotated})).signals
    assert len(result) > 0
    for name, (_, values) in result.items():
        if name.startswith("pair_deg"):
            # The prior of the lever arm and the weights of lengths differ by the body and scale.
            np.testing.assert_allclose(values, seen().signals[name].values, atol=0.02)


def test_frame_and_scale_of_the_partner_change_nothing_to_the_digit() -> None:
    run = flight()
    rotated = moved(
        run.partners["pair"],
        lie.from_rotation_vector(np.array([0.3, -1.0, 2.0])),
        np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3),
        3.0,
    )
    result = watched(WatchedRun(run.estimate, partners={"pair": rotated})).signals
    assert len(result) > 0
    for name, (_, values) in result.items():
        if name.startswith("pair"):
            np.testing.assert_allclose(values, seen().signals[name].values, atol=1e-6)


def test_outliers_of_the_partner_hardly_change_the_body_difference() -> None:
    generator = np.random.default_rng(0)
    count = 800
    rotations = lie.from_rotation_vector(generator.normal(0.0, 0.4, (count, 3)))
    rotation = lie.from_rotation_vector(np.array([0.4, -0.2, 1.0]))
    lever, scale = np.array([0.2, -0.1, 0.3]), 0.5
    others = generator.normal(0.0, 1.0, (count, 3))
    steps = scale * lie.rotate(rotation[None], others)
    steps += lever - lie.rotate(rotations, np.broadcast_to(lever, steps.shape))
    steps += generator.normal(0.0, 0.01, steps.shape)
    other_turns = lie.multiply(
        lie.multiply(lie.conjugate(rotation)[None], rotations), rotation[None]
    )
    bad = generator.choice(count, count // 50, replace=False)
    others[bad] += 10.0
    other_turns[bad] = lie.from_rotation_vector(generator.normal(0.0, 1.5, (len(bad), 3)))
    result = body_difference(rotations, steps, other_turns, others)
    assert result.scale == pytest.approx(scale, rel=0.01)
    np.testing.assert_allclose(result.lever_m, lever, atol=0.01)
    assert np.degrees(lie.angle(lie.multiply(lie.conjugate(rotation), result.rotation))) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "signals", "within_s"),
    [
        ("jump 0.3 m", {"step", "twist_m_5s"}, 0.2),
        ("yaw 1 deg/s", {"gyro_deg_20s", "pair_deg_5s"}, 6.0),
        ("diverging 0.2 m/s2", {"pair_percent_5s"}, 6.0),
        ("twist x 0.8", {"twist_m_5s"}, 3.0),
        ("freeze", {"frozen_position"}, 1.0),
        ("stamps late 200 ms", {"gap"}, 1.0),
        ("scale +50 %", {"pair_percent_5s"}, 12.0),
        ("coasting, rotation alive", {"smooth"}, 3.0),
    ],
)
def test_faults_are_found_soon(fault: str, signals: set[str], within_s: float) -> None:
    run = flight()
    onset = int(run.estimate.stamps[0]) + 50 * SECOND
    bad = FAULTS[fault](run.estimate, onset, np.random.default_rng(1))
    result = watched(dataclasses.replace(run, estimate=bad))
    book = AlarmBook()
    assert not book.add(seen().signals)
    begins: dict[str, float] = {}
    for alarm in book.add(result.signals):
        begins.setdefault(alarm.signal, alarm.begin_s - (onset - result.origin) / SECOND)
    assert min(begins.values()) >= 0.0
    for name in signals:
        assert begins[name] <= within_s, (name, begins)


def test_a_robot_that_stands_is_never_judged() -> None:
    stamps = np.arange(0, 300 * SECOND, SECOND // 20)
    still = np.zeros((len(stamps), 3))
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
    watchdog = Watchdog()
    assert not watchdog.add_estimate(Trajectory(stamps, still, upright))
    assert watchdog.armed_s is None
    with pytest.raises(InputError, match="only 0 s of motion"):
        watched(WatchedRun(Trajectory(stamps, still, upright)))


def test_arming_takes_thirty_seconds_of_motion() -> None:
    run = flight()
    assert seen().armed_s == pytest.approx(30.0, abs=0.2)
    watchdog = Watchdog()
    watchdog.add_estimate(run.estimate[: 12 * 20 + 1])
    assert watchdog.moved_s == pytest.approx(12.0, abs=0.1)


def test_stamps_that_step_back_begin_anew() -> None:
    estimate = flight().estimate
    watchdog = Watchdog()
    assert "smooth" in watchdog.add_estimate(estimate)
    assert not watchdog.add_estimate(estimate[: len(estimate) // 4])
    assert watchdog.armed_s is None
    assert watchdog.restarts == 1
    assert "the watch restarts" in watchdog.notices[0]


def test_late_messages_are_dropped_and_counted() -> None:
    estimate = flight().estimate
    order = np.arange(len(estimate))
    order[[500, 501]] = [501, 500]
    result = watched(WatchedRun(estimate[order]))
    assert any("1 state of" in notice for notice in result.notices)


def test_nothing_is_compared_across_a_gap() -> None:
    run = flight()
    seconds = run.estimate.seconds
    holed = run.estimate[(seconds < 45.0) | (seconds > 49.0)]
    result = watched(dataclasses.replace(run, estimate=holed)).signals
    for name, window_s in (("pair_deg_5s", 5.0), ("gyro_deg_20s", 20.0), ("twist_m_5s", 5.0)):
        after = result[name].seconds[result[name].seconds > 47.0]
        assert after[0] >= 49.0 + window_s
    gap_s, gap = result["gap"]
    assert gap.max() == pytest.approx(80.0, rel=0.05)
    assert gap_s[gap.argmax()] == pytest.approx(49.0, abs=0.1)


def imu_in(axes: Floats, late_ns: int = 0) -> InertialReadings:
    imu = flight().imu
    assert imu is not None
    assert imu.accelerations is not None
    return dataclasses.replace(
        imu,
        stamps=imu.stamps + late_ns,
        rates=imu.rates @ axes.T,
        accelerations=imu.accelerations @ axes.T,
    )


def test_an_imu_in_other_axes_is_found_and_said() -> None:
    axes = so3.exp(np.array([0.5, 1.0, -1.2]))
    result = watched(WatchedRun(flight().estimate, imu=imu_in(axes)))
    (text,) = [notice for notice in result.notices if "IMU frame is rotated" in notice]
    told_deg = float(text.split(" deg")[0].split()[-1])
    assert told_deg == pytest.approx(np.degrees(np.linalg.norm([0.5, 1.0, -1.2])), abs=0.3)
    for name in ("gyro_deg_1s", "gyro_deg_20s", "gravity_mps2_5s"):
        np.testing.assert_allclose(
            result.signals[name].values, seen().signals[name].values, atol=1e-3
        )


def test_a_clock_offset_of_the_imu_is_found_and_said() -> None:
    result = watched(WatchedRun(flight().estimate, imu=imu_in(np.eye(3), 200_000_000)))
    assert any("0.200 s behind the IMU's" in notice for notice in result.notices)
    assert result.signals["gyro_deg_1s"].values.max() < 0.3


def test_an_imu_of_another_robot_is_not_compared() -> None:
    other = imu_in(np.eye(3))
    noise = np.random.default_rng(5).normal(0.0, 5.0, other.rates.shape)
    smooth = [np.convolve(column, np.ones(200) / 200.0, "same") for column in noise.T]
    other = dataclasses.replace(other, rates=np.stack(smooth, axis=1))
    result = watched(WatchedRun(flight().estimate, imu=other))
    assert any("rotations of IMU and estimate do not agree" in notice for notice in result.notices)
    assert "gyro_deg_1s" not in result.signals


def test_sources_of_another_clock_are_said() -> None:
    run = flight()
    partner = run.partners["pair"]
    early = dataclasses.replace(partner, stamps=partner.stamps - 3600 * SECOND)
    imu = imu_in(np.eye(3), -3600 * SECOND)
    result = watched(WatchedRun(run.estimate, imu=imu, partners={"pair": early}))
    for words in ("no data of the IMU", "no data of the second estimate"):
        assert any(words in notice for notice in result.notices)
    assert not any(name.startswith(("pair", "gyro")) for name in result.signals)


def test_an_estimate_without_stamps_or_orientations_is_refused() -> None:
    estimate = flight().estimate
    with pytest.raises(InputError, match="has no timestamps"):
        watched(WatchedRun(dataclasses.replace(estimate, reading=SourceInfo(stamped=False))))
    with pytest.raises(InputError, match="has no orientations"):
        watched(WatchedRun(dataclasses.replace(estimate, quaternions=None)))


def test_the_lag_of_a_twist_is_found_and_used() -> None:
    estimate = flight().estimate
    assert estimate.velocities is not None
    assert estimate.quaternions is not None
    body = lie.rotate(lie.conjugate(estimate.quaternions), estimate.velocities)
    late = np.concatenate([np.tile(body[:1], (6, 1)), body[:-6]])
    slow = dataclasses.replace(estimate, velocities=lie.rotate(estimate.quaternions, late))
    result = watched(WatchedRun(slow))
    assert any("the twist is 0.30 s later" in notice for notice in result.notices)
    assert result.signals["twist_m_5s"].values.max() < 0.05
    assert not any("the twist is" in notice for notice in seen().notices)


def test_a_twist_in_the_worlds_axes_is_said_and_not_judged() -> None:
    estimate = flight().estimate
    wrong = FAULTS["twist in world axes"](estimate, 0, np.random.default_rng(0))
    result = watched(WatchedRun(wrong))
    assert any("world frame" in notice for notice in result.notices)
    assert "twist_m_5s" not in result.signals


@pytest.mark.parametrize(("factor", "message"), [(3.6, "3.6 times"), (0.5, "0.5 times")])
def test_the_factor_of_a_twist_is_said(factor: float, message: str) -> None:
    estimate = flight().estimate
    assert estimate.velocities is not None
    wrong = dataclasses.replace(estimate, velocities=factor * estimate.velocities)
    result = watched(WatchedRun(wrong))
    (notice,) = [item for item in result.notices if "times the motion of the pose" in item]
    assert message in notice
    assert ("as if it were in km/h" in notice) is (factor == 3.6)
    assert not any("times the motion" in item for item in seen().notices)


@pytest.mark.parametrize("resolution_m", [0.001, 0.003])
def test_wheels_with_quantised_encoders_in_stop_and_go_have_no_alarm(resolution_m: float) -> None:
    stamps = np.arange(0, 400 * SECOND, SECOND // 50)
    seconds = stamps / SECOND
    speed = np.clip(np.minimum(seconds % 17.0, 12.0 - seconds % 17.0), 0.0, 0.4)
    rate = speed * np.sin(seconds / 7.0)
    wheels = [speed + side * 0.15 * rate for side in (-1.0, 1.0)]
    left, right = (
        np.diff(np.floor(np.cumsum(0.02 * wheel) / resolution_m), prepend=0.0) * resolution_m
        for wheel in wheels
    )
    yaw = np.cumsum((right - left) / 0.3)
    along = np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1)
    positions = np.cumsum((0.5 * (left + right))[:, None] * along, axis=0)
    quaternions = lie.from_rotation_vector(np.outer(yaw, [0.0, 0.0, 1.0]))
    estimate = Trajectory(stamps, positions, quaternions, speed[:, None] * along)
    result = watched(WatchedRun(estimate))
    assert AlarmBook().add(result.signals) == []
    assert "smooth" in result.signals


def book_of(values: Floats) -> AlarmBook:
    """Return a book that saw one signal whose limit is 1, ten times a second."""
    book = AlarmBook(1.0 / signal_of("step").limit)
    seconds = np.arange(len(values)) / 10.0
    for begin in range(0, len(values), 7):
        rows = slice(begin, begin + 7)
        book.add({"step": Readings(seconds[rows], values[rows])})
    return book


def test_an_alarm_ends_when_its_signal_is_calm() -> None:
    values = np.zeros(300)
    values[[50, 70]] = 1.2, 1.4  # 2 s apart: one alarm
    values[150] = 3.0
    values[230] = 0.9  # below the limit: none
    book = book_of(values)
    assert [(alarm.begin_s, alarm.last_s, alarm.peak) for alarm in book.alarms] == [
        (5.0, 7.0, 1.4),
        (15.0, 15.0, 3.0),
    ]
    assert all(alarm.is_over for alarm in book.alarms)
    assert [book.is_error(alarm) for alarm in book.alarms] == [False, True]
    assert not book.standing


def test_an_alarm_that_lasts_is_an_error_and_stands() -> None:
    values = np.zeros(100)
    values[30:] = 1.1
    book = book_of(values)
    (alarm,) = book.standing
    assert not alarm.is_over
    assert book.is_error(alarm)
