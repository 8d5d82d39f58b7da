"""As-available errors of a live estimate: equal to those of a recording, in bounded memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.metrics.test_as_available import IDENTITY, rough
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.as_available import AvailabilityRule, as_available
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.live_availability import LiveAvailability


def often_corrected(estimate: Trajectory, count: int) -> Trajectory:
    """Return every pose so many times, 3 ms after one another, and 1 cm apart."""
    receive_times = estimate.reading.receive_times
    assert receive_times is not None
    number = np.tile(np.arange(count), len(estimate))
    repeated = estimate[np.repeat(np.arange(len(estimate)), count)]
    times = np.repeat(receive_times.times, count) + 3_000_000 * number
    reading = SourceInfo(receive_times=ReceiveTimes(times, corrected=times))
    moved = repeated.positions + 0.01 * number[:, None]
    repeated = replace(repeated, positions=moved, reading=reading)
    return repeated[np.argsort(times, kind="stable")]


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["hold", "constant"])
@pytest.mark.parametrize(("every", "corrections"), [(1, 1), (7, 1), (40, 1), (7, 6)])
def test_live_errors_equal_recorded_ones(motion: str, every: int, corrections: int) -> None:
    truth, estimate = rough(3)
    estimate = often_corrected(estimate, corrections) if corrections > 1 else estimate
    rule = AvailabilityRule(motion)
    expected = as_available(truth, estimate, IDENTITY, rule, AssociationRule())
    assert expected.samples is not None
    assert expected.samples.messages.late > 0.05 * len(estimate)
    receive_times = estimate.reading.receive_times
    assert receive_times is not None
    assert truth.quaternions is not None
    assert estimate.quaternions is not None
    live, result = LiveAvailability(rule, AssociationRule(), 10.0), []
    # Everything in the order of its receive time; groundtruth arrives 3 ms after its timestamp.
    events = [(int(at) + 3_000_000, 0, row) for row, at in enumerate(truth.stamps)]
    events += [(int(at), 1, row) for row, at in enumerate(receive_times.times)]
    most = 0
    for number, (_, kind, row) in enumerate(sorted(events)):
        part = slice(row, row + 1)
        if kind:
            live.add_estimate(estimate[part])
        else:
            live.add_groundtruth(truth[part])
        if number % every == 0 and (samples := live.update(IDENTITY)) is not None:
            result.append(samples)
            assert set(live.numbers) >= {"available/age", "available/latency"}
        most = max(most, len(live._messages))
    stamps = np.concatenate([item.stamps for item in result])
    rows_of = expected.samples.stamps.searchsorted(stamps)
    assert len(stamps) > 0.95 * len(expected.samples.stamps)
    np.testing.assert_array_equal(expected.samples.stamps[rows_of], stamps)
    for name in ("ages", "position", "rotation"):
        parts = np.concatenate([getattr(item, name) for item in result], axis=1)
        required = getattr(expected.samples, name)[:, rows_of]
        np.testing.assert_allclose(parts, required, atol=1e-12, err_msg=name)
    assert most < 100 * corrections
    missed = expected.numbers.missed_deadlines
    assert missed is not None
    assert abs(live.missed - missed.count) <= 1
    assert live.age_p95_s is not None


def test_nothing_is_reported_from_impossible_clocks_or_unknown_receive_times() -> None:
    truth, estimate = rough(4)
    for times, verdict in (
        (estimate.stamps - 50_000_000, "impossible"),
        (np.full(len(estimate), UNKNOWN), None),
    ):
        live = LiveAvailability(AvailabilityRule("hold"), AssociationRule(), 10.0)
        live.add_groundtruth(truth)
        live.add_estimate(replace(estimate, reading=SourceInfo(receive_times=ReceiveTimes(times))))
        assert live.update(IDENTITY) is None
        assert live.numbers == {}
        assert live.values["receive time clock"] == verdict


def states_on(stamps: np.ndarray, receive_times: ReceiveTimes | None = None) -> Trajectory:
    """Return poses that move along x at 2 m/s."""
    positions = np.outer(2.0 * stamps / 1e9, [1.0, 0.0, 0.0])
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
    return Trajectory(
        stamps, positions, quaternions, reading=SourceInfo(receive_times=receive_times)
    )


def fed(step_ms: int, until_ms: int, every_ms: int, deadline_s: float = 0.1) -> LiveAvailability:
    """Feed groundtruth at 200 Hz and messages that are received 30 ms after their timestamps."""
    live = LiveAvailability(AvailabilityRule("hold", deadline_s), AssociationRule(), 10.0)
    messages = np.arange(0, until_ms, every_ms) * 1_000_000
    truth = np.arange(0, until_ms, 5) * 1_000_000
    for begin in range(0, until_ms, step_ms):
        edges = begin * 1_000_000, (begin + step_ms) * 1_000_000
        now = truth[(truth >= edges[0]) & (truth < edges[1])]
        live.add_groundtruth(states_on(now))
        now = messages[(messages + 30_000_000 >= edges[0]) & (messages + 30_000_000 < edges[1])]
        live.add_estimate(states_on(now, ReceiveTimes(now + 30_000_000)))
        live.update(IDENTITY)
    return live


def test_a_twist_of_zero_is_used_once_there_was_another_one() -> None:
    """A robot at rest has one; a driver that measures none has no other."""
    stamps = np.arange(0, 8000, 5) * 1_000_000
    for moves, rate in ((False, 0.0), (True, 0.0), (True, np.nan)):
        live = LiveAvailability(AvailabilityRule("twist"), AssociationRule(), 10.0)
        for begin in range(0, len(stamps), 200):
            part = slice(begin, begin + 200)
            times = stamps[part] + 30_000_000
            receive_times = ReceiveTimes(times, body_rates=np.full((200, 3), rate))
            velocities = np.zeros((200, 3))
            velocities[:, 0] = 2.0 if moves and begin < 400 else 0.0
            live.add_groundtruth(states_on(stamps[part]))
            live.add_estimate(
                replace(states_on(stamps[part], receive_times), velocities=velocities)
            )
            live.update(IDENTITY)
        has_twist = moves and rate == 0.0
        assert bool(live.numbers) is has_twist
        assert [remark.code for remark in live.remarks] == ["receive_clock"] * (not has_twist)


def test_errors_of_a_held_pose_are_its_age_times_the_speed() -> None:
    live = fed(1000, 6000, 100)
    assert live.newest is not None
    age_s = live.numbers["available/age"]
    assert live.numbers["available/latency"] == pytest.approx(0.03)
    assert live.numbers["available/position_error"] == pytest.approx(2.0 * age_s)
    assert live.numbers["available/rotation_error"] == 0.0
    assert 0.03 <= age_s < 0.13
    # Ages are 30 to 120 ms in steps of 10 ms.
    assert live.age_p95_s == pytest.approx(0.12, abs=0.005)
    assert set(live.values) == {"pose age p95 [s]", "missed deadlines", "receive time clock"}


@pytest.mark.parametrize(
    ("deadline_s", "missed"), [(0.115, True), (0.1199, True), (0.12, False), (0.2, False)]
)
def test_a_deadline_is_missed_once_per_span_above_it(deadline_s: float, *, missed: bool) -> None:
    for step_ms in (1000, 200):
        live = fed(step_ms, 5000, 100, deadline_s)
        # Once after every message but the first ones and those that are not final yet.
        assert live.missed == 0 if not missed else 40 <= live.missed <= 49


def test_samples_are_evaluated_twice_a_second() -> None:
    live = LiveAvailability(AvailabilityRule("hold"), AssociationRule(), 10.0)
    stamps = np.arange(0, 2000, 5) * 1_000_000
    live.add_estimate(states_on(stamps, ReceiveTimes(stamps + 10_000_000)))
    evaluated = []
    for stamp in stamps:
        one = np.array([stamp])
        live.add_groundtruth(states_on(one))
        if live.update(IDENTITY) is not None:
            evaluated.append(int(stamp))
    steps = np.diff(evaluated)
    assert set(steps.tolist()) == {500_000_000}
    assert live.update(None) is None
    assert live.numbers == {}


def test_messages_without_a_reception_are_not_used() -> None:
    live = LiveAvailability(AvailabilityRule("hold"), AssociationRule(), 10.0)
    stamps = np.arange(3) * 10**9
    times = np.array([5, UNKNOWN, 2 * 10**9 + 5])
    live.add_estimate(states_on(stamps, ReceiveTimes(times)))
    live.store()
    assert live._messages["time"].tolist() == [5, 2 * 10**9 + 5]


def test_an_offset_moves_the_timestamps_and_not_the_receive_times() -> None:
    result = []
    for offset_ns in (0, 20_000_000):
        live = LiveAvailability(AvailabilityRule("hold"), AssociationRule(), 10.0)
        stamps = np.arange(0, 2000, 5) * 1_000_000
        live.add_groundtruth(states_on(stamps))
        live.add_estimate(states_on(stamps, ReceiveTimes(stamps + 50_000_000)))
        assert live.update(IDENTITY, offset_ns) is not None
        result.append(live.numbers)
    assert result[0]["available/age"] - result[1]["available/age"] == pytest.approx(0.02)
    assert result[0]["available/position_error"] == pytest.approx(
        result[1]["available/position_error"]
    )


@pytest.mark.parametrize("has_messages", [False, True])
def test_memory_is_bounded_before_the_first_alignment(*, has_messages: bool) -> None:
    live = LiveAvailability(AvailabilityRule("hold"), AssociationRule(), 10.0)
    for second in range(60):
        stamps = (second * 100 + np.arange(100)) * 10_000_000
        live.add_groundtruth(states_on(stamps))
        if has_messages:
            live.add_estimate(states_on(stamps, ReceiveTimes(stamps + 30_000_000)))
        live.update(None)
    assert len(live._truth) <= 1001
    assert len(live._messages) == (1001 if has_messages else 0)
    # The errors begin with what is left.
    if has_messages:
        stamps = (6000 + np.arange(100)) * 10_000_000
        live.add_groundtruth(states_on(stamps))
        live.add_estimate(states_on(stamps, ReceiveTimes(stamps + 30_000_000)))
        samples = live.update(IDENTITY)
        assert samples is not None
        assert len(samples.stamps) > 900


def test_there_is_no_error_before_the_first_message() -> None:
    live = LiveAvailability(AvailabilityRule("hold"), AssociationRule(), 10.0)
    truth, stamps = np.arange(0, 3000, 5) * 1_000_000, np.arange(1000, 3000, 50) * 1_000_000
    live.add_groundtruth(states_on(truth))
    live.add_estimate(states_on(stamps, ReceiveTimes(stamps + 30_000_000)))
    samples = live.update(IDENTITY)
    assert samples is not None
    assert samples.stamps[0] == 1_030_000_000
    assert (np.diff(samples.stamps) == 10_000_000).all()
    np.testing.assert_array_equal(samples.rows[:3], [0, 0, 0])
    np.testing.assert_allclose(samples.position_m, 2.0 * samples.age / 1e9, rtol=1e-9)
