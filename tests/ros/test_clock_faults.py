"""Clocks that differ or step, unusable poses and repeated events, without a network."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from numpy.typing import NDArray
from ros_bags import ODOM, POSE, Message, messages_of, odometry_message

from trajeval_ros import simulate
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.online.alarms import LIMITED_QUANTITIES, ActiveAlarms, AlarmLimits
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.ros import clock_remarks
from trajeval_ros.ros.clock_remarks import about_clock_faults
from trajeval_ros.ros.diagnostics import Status, remarks_about
from trajeval_ros.ros.recorded_state import why_no_pair

SECOND = 10**9
FLIGHT = simulate(8, 20.0)
TRUTH, ESTIMATED = FLIGHT.groundtruth[::10], FLIGHT.estimate
BEGIN = int(TRUTH.stamps[0])
LIMITED = (
    "coverage",
    "rate_hz",
    *(limited_quantity.name for limited_quantity in LIMITED_QUANTITIES),
)
LIMITS = {name: AlarmLimits() for name in LIMITED}


def at(source: Trajectory, seconds: float) -> int:
    """Return the first row that many seconds after the start."""
    return int(source.stamps.searchsorted(BEGIN + round(seconds * SECOND)))


def sent(
    source: Trajectory,
    topic: str,
    stamps: NDArray[np.int64],
    rate: float = 1.0,
    late_s: float = 0.0,
) -> list[Message]:
    """Return messages with other timestamps, logged when the poses are measured."""
    logged = BEGIN + (source.stamps - BEGIN) / rate + round(late_s * SECOND)
    fed = messages_of(
        dataclasses.replace(source, stamps=stamps), topic, POSE if topic == GROUNDTRUTH else ODOM
    )
    by_stamp = {stamp: row for row, stamp in enumerate(stamps.tolist())}
    return [
        (name, kind, int(logged[by_stamp[stamp]]), payload) for name, kind, stamp, payload in fed
    ]


def stepped(source: Trajectory, seconds: float, step_s: float) -> NDArray[np.int64]:
    """Return timestamps that step after some seconds."""
    stamps = source.stamps.copy()
    stamps[at(source, seconds) :] += round(step_s * SECOND)
    return stamps


def fly(live: Live, *streams: list[Message]) -> None:
    for message in sorted(
        (item for stream in streams for item in stream), key=lambda item: item[2]
    ):
        live.feed([message])


def clock_faults(live: Live) -> list[Remark]:
    return list(about_clock_faults(live.run, live.run.estimates[0]))


def remarks(live: Live) -> list[Remark]:
    [estimate] = live.run.estimates
    return remarks_about(live.run, estimate, estimate.snapshot(), {}, LIMITS)


@pytest.mark.parametrize(
    ("ahead_s", "side", "cause"),
    [
        (100.0, "100 s ahead of", "not synchronised"),
        (-100.0, "100 s behind", "not synchronised"),
        (7200.0, "7200 s ahead of", "set time_offset:=-7200"),
        (18.0, "18 s ahead of", "GPS time is 18 s ahead of UTC"),
        (-37.0, "37 s behind", "TAI is 37 s ahead of UTC"),
        (-BEGIN / SECOND + 50.0, "behind", "/vio count from the start of a computer"),
    ],
)
def test_clocks_with_nothing_in_common_are_reported_within_three_seconds(
    tmp_path: Path, ahead_s: float, side: str, cause: str
) -> None:
    live = Live(tmp_path / "live", ODOM)
    until = at(ESTIMATED, 3.0)
    stamps = ESTIMATED.stamps + round(ahead_s * SECOND)
    fly(
        live,
        sent(TRUTH, GROUNDTRUTH, TRUTH.stamps)[: at(TRUTH, 3.0)],
        sent(ESTIMATED, ESTIMATE, stamps)[:until],
    )
    [fault] = clock_faults(live)
    assert (fault.level, fault.code, fault.subject) == (Level.WARNING, "clock", "apart")
    assert side in fault.text
    assert cause in fault.text
    assert fault in remarks(live)
    assert fault.text in why_no_pair(live.run)
    live.end()


@pytest.mark.slow
def test_clocks_far_apart_are_one_remark_that_keeps_its_numbers(tmp_path: Path) -> None:
    """A delay can't be measured by such clocks; and the offset has digits that can be typed."""
    live = Live(tmp_path / "live", ODOM)
    stamps = ESTIMATED.stamps + -100_000 * SECOND
    standing, printed, told = ActiveAlarms(), [], []
    for second in np.arange(0.0, 6.0, 0.5):
        fly(
            live,
            sent(TRUTH, GROUNDTRUTH, TRUTH.stamps)[at(TRUTH, second) : at(TRUTH, second + 0.5)],
            sent(ESTIMATED, ESTIMATE, stamps, late_s=0.000562 * (1.0 + second))[
                at(ESTIMATED, second) : at(ESTIMATED, second + 0.5)
            ],
        )
        now = remarks(live)
        assert not [item for item in now if item.code == "late"]
        told += [item.text for item in standing.renew(now) if item.code == "clock"]
        printed += [item.text for item in standing.kept_texts(now) if item.code == "clock"]
    assert len(printed) > 5
    assert set(printed) == set(told)
    [text] = told
    assert "100000 s" in text
    assert "e+" not in text
    live.end()


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "late_s"), [(0.5, 5.0), (15.0, 0.0)])
def test_equal_clocks_are_not_reported_at_any_rate(
    tmp_path: Path, rate: float, late_s: float
) -> None:
    """Also of an estimator that is late, and after tracking losses and gaps."""
    live = Live(tmp_path / "live", ODOM)
    rows = ESTIMATED.seconds
    with_gap = ESTIMATED[(rows < 7.0) | (rows > 12.0)]
    truth = TRUTH[(TRUTH.seconds < 13.0) | (TRUTH.seconds > 15.5)]
    fly(
        live,
        sent(truth, GROUNDTRUTH, truth.stamps, rate),
        sent(with_gap, ESTIMATE, with_gap.stamps, rate, late_s / rate),
    )
    assert clock_faults(live) == []
    live.end()


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.4, 2.5])
def test_poses_that_arrive_late_are_a_warning_with_their_delay(
    tmp_path: Path, late_s: float
) -> None:
    """The delay to their arrival is not that from there to the publication of the error."""
    live = Live(tmp_path / "live", ODOM)
    live.on_update = lambda estimate, update: (
        update.stamp and estimate.latency.publish(update.stamp, live.now_ns + SECOND // 10)
    )
    fly(
        live,
        sent(TRUTH, GROUNDTRUTH, TRUTH.stamps)[: at(TRUTH, 8.0)],
        sent(ESTIMATED, ESTIMATE, ESTIMATED.stamps, late_s=late_s)[: at(ESTIMATED, 5.0) : 4],
    )
    compared = clock_remarks.about_different_clocks
    with mock.patch.object(
        clock_remarks, "about_different_clocks", side_effect=compared
    ) as tested:
        [estimate], result = live.run.estimates, remarks(live)
    assert tested.call_count == 1
    snapshot = estimate.snapshot()
    values = Status.of(live.run, estimate, snapshot, result, {}, 0).values
    for name in ("p50", "p95", "max"):
        assert values[f"arrival after stamp, {name} [s]"] == pytest.approx(late_s, abs=1e-6)
    assert values["arrival to publication, p95 [s]"] == pytest.approx(0.1, abs=1e-6)
    late = [item.text for item in result if item.code == "late"]
    assert late == (
        []
        if late_s < 1.0
        else [
            "poses arrive 2.5 s (95th percentile) after the groundtruth of the same time: the "
            "estimator or its sensor is too slow"
        ]
    )
    live.end()


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "late_s"), [(0.3, 2.5), (5.0, 0.0), (5.0, 2.5)])
def test_lateness_does_not_depend_on_the_rate_of_a_replay(
    tmp_path: Path, rate: float, late_s: float
) -> None:
    """All delays from timestamp to arrival grow or fall in a replay, those of both sides alike."""
    live = Live(tmp_path / "live", ODOM)
    fly(
        live,
        sent(TRUTH, GROUNDTRUTH, TRUTH.stamps, rate)[: at(TRUTH, 12.0)],
        sent(ESTIMATED, ESTIMATE, ESTIMATED.stamps, rate, late_s)[: at(ESTIMATED, 12.0)],
    )
    late = [float(remark.values["value"]) for remark in remarks(live) if remark.code == "late"]
    assert late == pytest.approx([late_s] if late_s else [], abs=0.01)
    live.end()


@pytest.mark.parametrize(
    ("lacks", "cause"),
    [("time", ": the others arrive too late, after more than max_delay"), ("groundtruth", "")],
)
def test_low_coverage_names_poses_that_came_too_late_as_its_cause(
    tmp_path: Path, lacks: str, cause: str
) -> None:
    """Groundtruth is complete here, and the buffer has forgotten it; else a part is missing."""
    live = Live(tmp_path / "live", ODOM, limits=BufferLimits(past_s=1.0))
    until, half = at(ESTIMATED, 8.0), at(ESTIMATED, 3.0)
    messages = sent(ESTIMATED, ESTIMATE, ESTIMATED.stamps)[:until:4]
    truth = TRUTH
    if lacks == "time":
        late = sent(ESTIMATED, ESTIMATE, ESTIMATED.stamps, late_s=2.5)[half:until:4]
        messages = messages[: -(-half // 4)] + late
    else:
        truth = TRUTH[(TRUTH.seconds < 3.0) | (TRUTH.seconds > 8.0)]
    fly(live, sent(truth, GROUNDTRUTH, truth.stamps)[: at(truth, 12.0)], messages)
    [estimate] = live.run.estimates
    [printed] = [
        item.text
        for item in remarks_about(
            live.run, estimate, estimate.snapshot(), {}, LIMITS | {"coverage": AlarmLimits(0.9)}
        )
        if item.text.startswith("only ")
    ]
    share = estimate.snapshot().estimate_coverage
    assert share == pytest.approx(3.0 / 8.0, abs=0.03)
    assert printed == f"only {100 * share:.0f} % of the poses have groundtruth{cause}"
    live.end()


@pytest.mark.slow
def test_a_delay_that_grows_is_no_difference_of_clocks(tmp_path: Path) -> None:
    """An estimator that needs 2.5 s per second of data is 11.4 s late after 19 s."""
    live = Live(tmp_path / "live", ODOM)
    fly(
        live,
        sent(TRUTH, GROUNDTRUTH, TRUTH.stamps)[: at(TRUTH, 19.0)],
        sent(ESTIMATED, ESTIMATE, ESTIMATED.stamps, rate=0.4)[: at(ESTIMATED, 7.6)],
    )
    lead_s = live.estimate.stream.clocks.apart_s
    assert lead_s is not None
    assert abs(lead_s) < 2.0
    assert clock_faults(live) == []
    assert [remark.code for remark in remarks(live)].count("late") == 1
    live.end()


@pytest.mark.slow
def test_an_estimator_that_stalls_and_catches_up_has_no_faulty_clock(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM)
    messages = []
    for name, kind, logged, payload in sent(ESTIMATED, ESTIMATE, ESTIMATED.stamps):
        since_s = (logged - BEGIN) / SECOND
        if 6.0 < since_s < 9.0:
            logged += 4 * SECOND  # the estimator is 4 s late
        elif 9.0 <= since_s < 13.0:
            continue  # and leaves out images
        messages.append((name, kind, logged, payload))
    fly(live, sent(TRUTH, GROUNDTRUTH, TRUTH.stamps), messages)
    assert clock_faults(live) == []
    live.end()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step_s", "of_groundtruth", "rate"),
    [(3.0, False, 1.0), (0.5, True, 1.0), (-0.5, False, 8.0), (-3.0, True, 8.0)],
)
def test_a_step_of_one_clock_is_a_warning_until_a_reset(
    tmp_path: Path, step_s: float, of_groundtruth: bool, rate: float
) -> None:
    live = Live(tmp_path / "live", ODOM, at_time_jumps=False)
    sides = [
        (TRUTH, GROUNDTRUTH, step_s if of_groundtruth else 0.0),
        (ESTIMATED, ESTIMATE, 0.0 if of_groundtruth else step_s),
    ]
    feeds = [
        sent(source, topic, stepped(source, 8.0, by_s), rate) for source, topic, by_s in sides
    ]
    soon = BEGIN + round((8.0 + 3.0 * max(1.0, rate)) / rate * SECOND)
    fly(live, *([item for item in feed if item[2] <= soon] for feed in feeds))
    [fault] = clock_faults(live)
    side = "groundtruth" if of_groundtruth else "estimate"
    assert (fault.level, fault.code, fault.subject) == (Level.WARNING, "clock_step", side)
    assert f"the {side}'s clock stepped by {step_s:+.0f}"[:-1] in fault.text
    assert fault.values["step_s"] == pytest.approx(step_s, abs=0.1)
    told = [remark for remark in remarks(live) if remark.level > Level.NOTE]
    assert {item.code for item in told} <= {"clock_step"}
    live.reset()
    assert clock_faults(live) == []
    live.end()
    [run] = live.result["runs"]
    [event] = run["events"]
    assert (event["kind"], event["side"]) == ("clock_step", side)
    assert event["s"] == pytest.approx(step_s, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [-5.0, 5.0])
def test_a_step_of_both_clocks_is_a_new_run_and_no_fault(tmp_path: Path, step_s: float) -> None:
    live = Live(tmp_path / "live", ODOM)
    fly(
        live,
        sent(TRUTH, GROUNDTRUTH, stepped(TRUTH, 8.0, step_s)),
        sent(ESTIMATED, ESTIMATE, stepped(ESTIMATED, 8.4, step_s)),
    )
    assert clock_faults(live) == []
    assert len(live.folders) == (2 if step_s < 0 else 1)
    live.end()


def spoiled(kind: str, share: float) -> list[Message]:
    """Return the messages of an estimate of which some are unusable, in order of measurement."""
    assert ESTIMATED.quaternions is not None
    logged = ESTIMATED.stamps.tolist()
    stamps, places, rotations = (
        item.copy() for item in (ESTIMATED.stamps, ESTIMATED.positions, ESTIMATED.quaternions)
    )
    rows = np.flatnonzero(np.random.default_rng(3).random(len(stamps)) < share)
    if kind == "nan":
        places[rows] = np.nan
    elif kind == "zero quaternion":
        rotations[rows] = 0.0
    elif kind == "zero stamp":
        stamps[rows] = 0
    else:
        stamps[rows] = stamps[rows - 1] if share < 1.0 else stamps[0]
    columns = zip(logged, stamps.tolist(), places, rotations, strict=True)
    return [(ESTIMATE, ODOM, item, odometry_message(*rest)) for item, *rest in columns]


KINDS = {
    "nan": "not finite",
    "zero quaternion": "with a zero quaternion",
    "zero stamp": "with timestamp zero",
    "repeated": "with a duplicate timestamp",
}


@pytest.mark.parametrize("kind", list(KINDS))
def test_a_stream_of_unusable_poses_is_an_error_at_once(tmp_path: Path, kind: str) -> None:
    live = Live(tmp_path / "live", ODOM)
    fly(live, sent(TRUTH, GROUNDTRUTH, TRUTH.stamps)[:200], spoiled(kind, 1.0)[:20])
    [told] = [remark for remark in remarks(live) if "no message with a valid pose" in remark.text]
    assert told.level == Level.ERROR
    assert KINDS[kind] in told.text
    live.end()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "share", "is_told"),
    [*((kind, 0.08, True) for kind in KINDS), (next(iter(KINDS)), 0.02, False)],
)
def test_a_share_of_unusable_poses_is_a_warning_live_and_in_the_result(
    tmp_path: Path, kind: str, share: float, is_told: bool
) -> None:
    live = Live(tmp_path / "live", ODOM)
    fly(live, sent(TRUTH, GROUNDTRUTH, TRUTH.stamps), spoiled(kind, share))
    told = [remark for remark in remarks(live) if remark.subject == "unusable_estimate"]
    live.end()
    [run] = live.result["runs"]
    assert [item.level for item in told] == [Level.WARNING] * is_told
    assert any(remark["code"] == "unusable_poses" for remark in run["remarks"]) == is_told
    assert all(KINDS[kind] in item.text for item in told)


@pytest.mark.slow
def test_states_out_of_order_are_evaluated(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM)
    feed = sent(ESTIMATED, ESTIMATE, ESTIMATED.stamps)
    late = [
        (*item[:2], item[2] + SECOND // 2 * (row % 3 == 0), item[3])
        for row, item in enumerate(feed)
    ]
    fly(live, sent(TRUTH, GROUNDTRUTH, TRUTH.stamps), late)
    [estimate] = live.run.estimates
    snapshot = estimate.snapshot()
    assert snapshot.pairs > 0.9 * len(feed)
    assert snapshot.pairs + sum(snapshot.dropped.values()) + snapshot.waiting == len(feed)
    live.end()
    [run] = live.result["runs"]
    snapshot = estimate.snapshot()
    assert run["association"]["pairs"] == snapshot.pairs
    assert snapshot.position_rmse_m == pytest.approx(run["ate"]["position_m"]["rmse"], rel=1e-12)
