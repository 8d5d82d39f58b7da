"""Rules of the live evaluation at their limits: counts, clocks, open starts, levers."""

from __future__ import annotations

import dataclasses
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_feeding import make_pair, rows_of
from numpy.typing import NDArray
from state_rows import states, trajectory
from strategies import make_groundtruth, seeds

from tests.online.test_error_topics import EMPTY
from trajeval_ros import Gauge, Protocol
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level, warning
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.discontinuities.events import DIVERGED, ESTIMATE, FROZEN, Loss
from trajeval_ros.online import live_relative_errors
from trajeval_ros.online.alarms import AlarmLimits, about_loss, alarm_below
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_frames import LiveFrames
from trajeval_ros.online.live_relative_errors import RelativeTracker, RunningErrors
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import PairedStates, Pairing
from trajeval_ros.online.repeated_remarks import RepeatedRemarks
from trajeval_ros.online.state_buffer import NEVER, BufferLimits
from trajeval_ros.online.window import PairStore

Array = NDArray[Any]
SECOND = 10**9
ARM = HandEye.of(np.array([0.3, -0.2, 0.5]), np.array([0.4, -0.1, 0.2]))


def test_counts_of_events_come_after_spans_that_double_up_to_an_hour() -> None:
    repeated, now, spans = RepeatedRemarks(), 0.0, []
    for _ in range(12):
        for _ in range(5):
            repeated.may_report("vio", warning("jump", "at 3 s"), now)
        span_s = next(index for index in range(1, 4000) if repeated.counts(now + index))
        spans.append(span_s)
        now += span_s
    assert spans == [10, 20, 40, 80, 160, 320, 640, 1280, 2560, 3600, 3600, 3600]


def test_one_more_event_than_is_reported_is_counted() -> None:
    repeated = RepeatedRemarks()
    for _ in range(4):
        repeated.may_report("vio", warning("jump", "at 3 s"), 0.0)
    [(_, count)] = repeated.counts(10.5)
    assert count.text == "1 more event of this kind in 10 s; the newest: at 3 s"
    # The next span begins now, and reports three again.
    assert [repeated.may_report("vio", warning("jump", ""), 11.0) for _ in range(4)] == [
        *(True, True, True, False)
    ]
    assert repeated.counts(30.4) == []
    assert "in 20 s" in repeated.counts(30.5)[0][1].text


def test_kinds_of_events_are_counted_apart() -> None:
    repeated = RepeatedRemarks()
    for about, now, count in (("a", 0.0, 4), ("b", 6.0, 5), ("c", 1.0, 6), ("d", 1.0, 2)):
        for _ in range(count):
            repeated.may_report(about, warning("jump", "at 3 s"), now)
    found = repeated.counts(11.0)
    assert [(about, item.values["more"]) for about, item in found] == [("a", 1), ("c", 3)]
    assert [about for about, _ in repeated.counts(16.0)] == ["b"]
    assert repeated.counts(16.0) == []


@pytest.mark.parametrize(
    ("value", "level"),
    [(0.5, None), (0.49, Level.WARNING), (0.2, Level.WARNING), (0.19, Level.ERROR), (0.0, 2)],
)
def test_an_alarm_below_a_limit(value: float, level: Level | None) -> None:
    found = alarm_below("coverage", value, AlarmLimits(0.5, 0.2), "less than {limit}")
    if level is None:
        assert found == []
        return
    [remark] = found
    limit = 0.5 if remark.level == Level.WARNING else 0.2
    assert remark.level == (Level.ERROR if value < 0.2 else level)
    assert (remark.text, remark.subject) == (f"less than {limit}", "coverage")
    assert remark.values == {"value": value, "limit": limit}


@pytest.mark.parametrize("cause", [FROZEN, DIVERGED])
@pytest.mark.parametrize("is_error", [False, True])
def test_a_loss_is_told_with_its_numbers(cause: str, *, is_error: bool) -> None:
    lasted_s = 3.0 if is_error else 2.99
    loss = Loss(cause, ESTIMATE, 5_250_000_000, 9_000_000_000, m=4.0, s=lasted_s, moved_m=7.0)
    [remark] = about_loss(dataclasses.replace(EMPTY, loss=loss))
    assert remark.level == (Level.ERROR if is_error else Level.WARNING)
    assert remark.code == cause
    assert "since 5.250 s" in remark.text
    assert ("repeats its pose" in remark.text) == (cause == FROZEN)
    values = {"stamp_ns": 5_250_000_000, "duration_s": lasted_s, "true_m": 4.0, "moved_m": 7.0}
    assert remark.values == values
    [known] = about_loss(dataclasses.replace(EMPTY, loss=loss, ate_before_loss_m=0.25))
    assert known.text == f"{remark.text}; the ATE until then is 0.25 m"
    assert known.values == {**values, "ate_before_m": 0.25}
    assert about_loss(EMPTY) == []


def source_rows(seed: int) -> tuple[Trajectory, Array]:
    source = make_groundtruth(seed, 15)
    rows = states(source.positions, source.quaternions, source.velocities)
    rows[4, 3:7] = np.nan
    return source, rows


def test_a_lever_arm_makes_the_groundtruth_points_and_leaves_out_velocities() -> None:
    source, _ = source_rows(1)
    with_arm = LiveFrames(OnlineSettings(Protocol(gauge="se3", lever_m=(0.1, 0.0, 0.0))))
    plain = LiveFrames(OnlineSettings(Protocol(gauge="se3")))
    assert plain.of_groundtruth(source) is source
    points = with_arm.of_groundtruth(source)
    assert points.quaternions is points.velocities is None
    assert plain.of_estimate(points) is points
    with pytest.raises(InputError, match="no lever arm can be applied"):
        with_arm.of_estimate(points)
    assert with_arm.of_estimate(source) is source


@pytest.mark.parametrize("most", [5, 12])
def test_starts_are_given_up_when_there_are_too_many(most: int) -> None:
    tracker, store = RelativeTracker(Protocol(lengths=("5m", "2s"))), PairStore()
    with mock.patch.object(live_relative_errors, "MOST_OPEN_STARTS", most):
        for begin in range(0, 40, 4):
            positions = np.zeros((4, 3))  # at rest: no length in metres ends
            turned = np.tile([0.0, 0.0, 0.0, 1.0], (4, 1))
            stamps = (begin + np.arange(4)) * SECOND // 2
            side = Trajectory(stamps, positions, turned)
            store.add(PairedStates(side, side))
            tracker.update(store, 1.0)
            oldest = tracker.oldest_needed(store)
            assert oldest == max(store.end - most, 0)
            store.drop_before(oldest)
    assert RunningErrors() == RunningErrors(0, 0.0, 0.0, 0)
    assert live_relative_errors.MOST_OPEN_STARTS == 200_000
    # A length of 2 s is decided by the fourth pair after its start.
    assert tracker.running == {
        "5m": RunningErrors(0, 0.0, 0.0, 40 - most),
        "2s": RunningErrors(36, 0.0, 0.0, 0),
    }


def all_pairs(pairing: Pairing, sides: list[tuple[Array, Array]], cut: int, size: int) -> Any:
    """Return the pairs of two streams; a second pairing takes over at a batch."""
    found, batches = [], range(0, len(sides[0][0]), size)
    for begin in batches:
        if begin // size == cut:
            border, at_groundtruth = pairing.unused_from, pairing.at_groundtruth
            pairing = Pairing(at_groundtruth=at_groundtruth)
            for row, (add, (stamps, rows)) in enumerate(zip(adds_of(pairing), sides, strict=True)):
                known, first = stamps[:begin], border
                if row == at_groundtruth:  # interpolated: the state before the border, too
                    first = known[known <= border].max(initial=NEVER)
                part = known >= first
                add(trajectory(known[part], rows[:begin][part]))
        for add, (stamps, rows) in zip(adds_of(pairing), sides, strict=True):
            add(trajectory(stamps[begin : begin + size], rows[begin : begin + size]))
        found.append(pairing.made())
        pairing.settle()
        pairing.forget()
    found.append(pairing.made(at_end=True))
    pairing.settle()
    store = PairStore()
    for pairs in found:
        if pairs is not None:
            store.add(pairs)
    return store.pairs(slice(None)), sum(0 if pairs is None else len(pairs) for pairs in found)


def adds_of(pairing: Pairing) -> tuple[Any, Any]:
    return pairing.add_groundtruth, pairing.add_estimate


@settings(max_examples=20)
@given(
    seed=seeds,
    cut=st.integers(1, 12),
    size=st.integers(3, 12),
    delay=st.integers(0, 30),
    at_groundtruth=st.booleans(),
)
def test_a_run_that_follows_begins_at_the_first_state_that_was_not_used(
    seed: int, cut: int, size: int, delay: int, *, at_groundtruth: bool
) -> None:
    """Both runs together make the pairs of one, none twice."""
    groundtruth, estimate = make_pair(seed, 100)
    count = min(len(groundtruth), len(estimate)) - delay
    sides = [
        (groundtruth.stamps[delay : delay + count], rows_of(groundtruth)[delay : delay + count]),
        (estimate.stamps[:count], rows_of(estimate)[:count]),
    ]
    whole, _ = all_pairs(Pairing(at_groundtruth=at_groundtruth), sides, -1, size)
    parts, made = all_pairs(Pairing(at_groundtruth=at_groundtruth), sides, cut, size)
    np.testing.assert_array_equal(parts.stamps, whole.stamps)
    assert made == len(whole)
    for name in ("groundtruth", "estimate"):
        found, expected = (rows_of(getattr(pairs, name)) for pairs in (parts, whole))
        np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("waiting", [10, 11, 12])
def test_the_oldest_of_too_many_waiting_states_is_dropped(waiting: int) -> None:
    pairing = Pairing(limits=BufferLimits(waiting_states=11))
    stamps = np.arange(waiting, dtype=np.int64)
    pairing.add_estimate(trajectory(stamps, states(np.zeros((waiting, 3)))))
    assert pairing.waiting == min(waiting, 11)
    lost = max(waiting - 11, 0)
    assert pairing.dropped == ({"waited_too_long": lost} if lost else {})
    assert bool(pairing.why_forgotten) == bool(lost)


def test_a_repeated_timestamp_is_counted_while_it_is_remembered() -> None:
    pairing = Pairing(limits=BufferLimits(past_s=2.0))
    seconds = np.arange(10, dtype=np.int64) * SECOND
    sides = Trajectory(seconds, np.zeros((10, 3)))
    pairing.add_groundtruth(sides)
    pairing.add_estimate(sides)
    pairing.made()
    pairing.settle()
    pairing.forget()
    for stamp, count in ((9, 1), (7, 2), (6, 2)):  # the horizon is at 7 s
        pairing.add_estimate(trajectory(np.array([stamp * SECOND]), states(np.zeros((1, 3)))))
        assert pairing.dropped == {"duplicate_stamp": count}


def test_a_snapshot_needs_the_alignment_of_enough_states() -> None:
    groundtruth, estimate = make_pair(3, 60)
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge=Gauge.SE3)))
    assert evaluator.snapshot().warming_up == "no pairs yet"
    evaluator.add_groundtruth(trajectory(groundtruth.stamps, rows_of(groundtruth)))
    seen = []
    for row in range(5):
        part = slice(row, row + 1)
        evaluator.add_estimate(trajectory(estimate.stamps[part], rows_of(estimate)[part]))
        evaluator.update()
        seen.append((evaluator.pairs, evaluator.snapshot().warming_up))
    wanted = Gauge.SE3.minimum_states
    for pairs, text in seen:
        if 0 < pairs < wanted:
            assert text == f"{pairs} of {wanted} states for the alignment"
    assert max(pairs for pairs, _ in seen) >= wanted
