"""The clocks' offset while a run goes on: published, and applied if it was asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration_flights import Fault, fly
from live_runs import ESTIMATE, GROUNDTRUTH, Live, path_messages
from ros_bags import ODOM, PATH, POSE, Message, messages_of, write_messages
from ros_processes import assert_same, offline
from state_rows import states, trajectory
from strategies import make_pair

from trajeval_ros.calibration.calibrate import calibrate
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.online.live_clock import FIRST_S, ClockReport, OnlineClock
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.ros import live_run


def fed(
    clock: OnlineClock, groundtruth: Trajectory, estimate: Trajectory, batch_s: float = 1.0
) -> None:
    """Feed both sides in batches, and let the clock estimate when it wants to."""
    first, batch = int(groundtruth.stamps[0]), round(batch_s * 1e9)
    last = max(int(groundtruth.stamps[-1]), int(estimate.stamps[-1]))
    for begin in range(first, last + 1, batch):
        for side, add in ((groundtruth, clock.add_groundtruth), (estimate, clock.add_estimate)):
            now = side[(side.stamps >= begin) & (side.stamps < begin + batch)]
            if len(now):
                add(trajectory(now.stamps, states(now.positions, now.quaternions)))
        clock.update()


@pytest.mark.slow
def test_the_offset_is_that_of_the_recording() -> None:
    groundtruth, estimate = fly(1, 45.0, fault=Fault(0.1, 0.0, (0.3, 0.2, 1.0), (0.1, 0.0, 0.1)))
    clock = OnlineClock(Gauge.YAW)
    fed(clock, groundtruth, estimate)
    clock.update(at_end=True)
    report = clock.report
    assert report.is_significant
    assert report.span_s == pytest.approx(45.0, abs=0.2)
    assert report.offset_s == pytest.approx(0.1, abs=2e-3)
    offline_offset = calibrate(groundtruth, estimate, Gauge.YAW).offset
    assert offline_offset.value is not None
    assert report.offset_s == pytest.approx(offline_offset.value[0], abs=1e-3)


def test_clocks_that_are_one_are_left_alone() -> None:
    clock = OnlineClock(Gauge.YAW)
    fed(clock, *fly(0, 40.0))
    assert clock.report.status == "insignificant"
    assert clock.report.offset_s == pytest.approx(0.0, abs=2e-3)


@pytest.mark.slow
def test_nothing_is_said_too_early_or_of_what_doesn_t_move() -> None:
    clock = OnlineClock(Gauge.YAW)
    fed(clock, *fly(1, 30.0))
    assert clock.report == ClockReport()
    assert not OnlineClock(Gauge.YAW).update(at_end=True)
    clock = OnlineClock(Gauge.YAW)
    fed(clock, *fly(1, 40.0, "static"))
    assert clock.report.status == "unobservable"
    assert clock.report.offset_s is None


def still(like: Trajectory, place: float) -> Trajectory:
    """Return poses that are exactly the same all the time."""
    count = len(like.stamps)
    return Trajectory.from_columns(
        like.stamps, np.full((count, 3), place), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    )


@pytest.mark.parametrize(
    ("spoil", "gauge"),
    [
        (lambda groundtruth, estimate: (still(groundtruth, 0.0), still(estimate, 0.0)), Gauge.SE3),
        (
            lambda groundtruth, estimate: (still(groundtruth, 2.0), still(estimate, 0.3)),
            Gauge.SIM3,
        ),
        (lambda groundtruth, estimate: (groundtruth, still(estimate, 0.0)), Gauge.YAW),
    ],
    ids=["at rest at the origin", "at rest", "identity"],
)
def test_what_nothing_can_be_known_from_is_unobservable(spoil: Any, gauge: Gauge) -> None:
    clock = OnlineClock(gauge)
    fed(clock, *spoil(*fly(1, 40.0)))
    assert clock.report.status == "unobservable"
    assert clock.report.reason


@pytest.mark.parametrize(
    ("gauge", "factor"),
    [(Gauge.SE3, 1e5), (Gauge.YAW, 1e11), (Gauge.SE3, 1e200), (Gauge.SIM3, 1e11)],
)
def test_an_estimate_gone_wild_has_no_clock(gauge: Gauge, factor: float) -> None:
    groundtruth, estimate = fly(1, 40.0)
    clock = OnlineClock(gauge)
    fed(clock, groundtruth, dataclasses.replace(estimate, positions=factor * estimate.positions))
    # A scale is part of Sim(3), so that any size of an estimate is a right one.
    assert not clock.report.is_significant or gauge is Gauge.SIM3


def test_positions_alone_have_a_clock_too() -> None:
    groundtruth, estimate = fly(1, 40.0, fault=Fault(0.1))
    clock = OnlineClock(Gauge.YAW)
    fed(clock, dataclasses.replace(groundtruth, quaternions=None), estimate)
    assert clock.report.is_significant
    assert clock.report.offset_s == pytest.approx(0.1, abs=3e-3)


def test_memory_and_work_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    estimates = []
    monkeypatch.setattr(
        "trajeval_ros.online.live_clock._estimated",
        lambda span_s, *_: estimates.append(span_s) or (ClockReport(), None),
    )
    clock = OnlineClock(Gauge.YAW)
    stamps = np.arange(0, 7200 * 10, dtype=np.int64) * 100_000_000 + 1
    rows = states(np.random.default_rng(0).normal(size=(len(stamps), 3)))
    for part in np.split(np.arange(len(stamps)), 720):
        clock.add_groundtruth(trajectory(stamps[part], rows[part]))
        clock.add_estimate(trajectory(stamps[part], rows[part]))
        clock.update()
    held = [len(clock._groundtruth), len(clock._estimate)]
    assert max(held) <= 6001
    # Rarer and rarer: from every 5 s to every tenth of the time so far.
    assert len(estimates) < 60
    assert np.diff(estimates).max() >= 0.1 * estimates[-2]


class Busy(Executor):
    """Does what it is asked when a test wants it done."""

    def __init__(self) -> None:
        self.asked: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, do: Callable[..., Any], /, *known: Any, **_: Any) -> Future[Any]:
        self.asked.append((Future(), lambda: do(*known)))
        return self.asked[-1][0]

    def work(self) -> None:
        for future, do in self.asked:
            future.set_result(do())
        self.asked = []


def test_estimating_keeps_nobody_waiting() -> None:
    groundtruth, estimate = fly(1, 60.0, fault=Fault(0.1))
    worker = Busy()
    clock = OnlineClock(Gauge.YAW, worker)
    fed(clock, groundtruth, estimate)
    assert clock.report == ClockReport()  # 60 s, and not one of them was waited for
    assert len(worker.asked) == 1
    worker.work()
    assert clock.update()
    assert clock.report.is_significant
    assert clock.report.span_s == pytest.approx(FIRST_S, abs=1.5)
    assert not clock.update()  # the next one is being estimated
    assert len(worker.asked) == 1
    worker.work()
    assert clock.update(at_end=True)
    assert clock.report.span_s == pytest.approx(60.0, abs=0.2)


def test_late_and_odd_states_do_no_harm() -> None:
    groundtruth, estimate = fly(1, 40.0, fault=Fault(0.1))
    clock = OnlineClock(Gauge.YAW)
    fed(clock, groundtruth, estimate)
    before = clock.report
    nowhere = states(np.full((2, 3), np.nan), np.zeros((2, 4)))
    clock.add_estimate(trajectory(estimate.stamps[:2], nowhere))
    clock.add_groundtruth(trajectory(groundtruth.stamps[-1:] + 10**9, nowhere[:1]))
    clock.update(at_end=True)
    assert clock.report.offset_s is not None
    assert clock.report.offset_s == pytest.approx(before.offset_s, abs=1e-3)


def messages(offset_s: float, duration_s: float) -> list[Message]:
    groundtruth, estimate = fly(1, duration_s, fault=Fault(offset_s))
    both = [
        *messages_of(groundtruth[::4], GROUNDTRUTH, POSE),
        *messages_of(estimate, ESTIMATE, ODOM),
    ]
    return sorted(both, key=lambda item: item[2])


def run(folder: Path, feed: list[Message], *, find_offset: bool) -> Live:
    live = Live(folder, ODOM, find_offset=find_offset)
    for part in np.array_split(np.arange(len(feed)), 100):
        live.feed([feed[row] for row in part])
    return live


@pytest.mark.slow
@pytest.mark.parametrize("duration_s", [20.0, 40.0])
def test_an_offset_that_is_asked_for_is_applied_from_the_first_pair_on(
    tmp_path: Path, duration_s: float
) -> None:
    feed = messages(0.1, duration_s)
    write_messages(tmp_path / "bag", feed)
    live = run(tmp_path / "live", feed, find_offset=True)
    # Before 35 s nothing is known, and the end decides.
    assert live.run.holds == (duration_s < 35.0)
    live.end()
    assert not live.run.holds
    result = live.result
    (actual,) = result["runs"]
    offset_s = actual["association"]["time_offset_s"]
    assert offset_s == pytest.approx(0.1, abs=5e-3)
    assert any(
        f"time offset of {offset_s:.4f} s applied" in remark["text"]
        for remark in actual["remarks"]
    )
    assert actual["live"]["clock"]["status"] == "significant"
    options = ("--time-offset", repr(offset_s), "--gauge", "yaw", "--lengths", "2,4")
    recorded = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *options)["runs"][0]
    assert_same({**actual, "remarks": []}, {**recorded, "remarks": []})


@pytest.mark.slow
def test_an_offset_that_isn_t_there_is_not_applied(tmp_path: Path) -> None:
    live = run(tmp_path / "live", messages(0.0, 62.0), find_offset=True)
    assert not live.run.holds  # a minute has passed
    live.end()
    (actual,) = live.result["runs"]
    assert actual["association"]["time_offset_s"] == 0.0
    assert any("no time offset applied" in remark["text"] for remark in actual["remarks"])


def test_a_path_is_evaluated_at_once_without_an_offset(tmp_path: Path) -> None:
    pair = make_pair(3, 160, smooth=True)
    feed = [
        *messages_of(pair.groundtruth, GROUNDTRUTH, POSE),
        *path_messages(pair.estimate, 7),
    ]
    feed.sort(key=lambda item: item[2])
    write_messages(tmp_path / "bag", feed)
    live = Live(tmp_path / "live", PATH, find_offset=True)
    live.feed(feed[:100])
    assert not live.run.holds
    assert live.run.has_pairs
    live.feed(feed[100:])
    live.end()
    (actual,) = live.result["runs"]
    assert any(
        "no time offset applied (vio: paths are revised" in remark["text"]
        for remark in actual["remarks"]
    )
    options = ("--gauge", "yaw", "--lengths", "2,4")
    (recorded,) = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *options)["runs"]
    assert_same(actual["ate"], recorded["ate"])


@pytest.mark.slow
def test_groundtruth_without_an_estimate_is_not_held(tmp_path: Path) -> None:
    feed = messages(0.1, 140.0)
    later = feed[0][2] + 100 * 10**9
    feed = [item for item in feed if item[0] == GROUNDTRUTH or item[2] > later]
    write_messages(tmp_path / "bag", feed)
    live = Live(tmp_path / "live", ODOM, find_offset=True)
    alone = [item for item in feed if item[2] < later]
    for part in np.array_split(np.arange(len(alone)), 100):
        live.feed([alone[row] for row in part])
    assert live.run.holds
    assert live.run._held_s == 0.0
    live.feed(feed[len(alone) :])
    assert not live.run.holds
    live.end()
    (actual,) = live.result["runs"]
    offset_s = actual["association"]["time_offset_s"]
    assert offset_s == pytest.approx(0.1, abs=5e-3)
    options = ("--time-offset", repr(offset_s), "--gauge", "yaw", "--lengths", "2,4")
    recorded = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *options)["runs"][0]
    assert_same({**actual, "remarks": []}, {**recorded, "remarks": []})


@pytest.mark.slow
@pytest.mark.parametrize("alone", [GROUNDTRUTH, ESTIMATE])
def test_no_side_is_waited_for_longer_than_a_minute(tmp_path: Path, alone: str) -> None:
    feed = messages(0.1, 70.0)
    begin = next(item[2] for item in feed if item[0] == ESTIMATE) + 5 * 10**9
    live = run(
        tmp_path / "live",
        [item for item in feed if item[0] == alone or item[2] < begin],
        find_offset=True,
    )
    assert not live.run.holds
    live.end()
    (actual,) = live.result["runs"]
    assert any("no time offset applied (vio: " in remark["text"] for remark in actual["remarks"])


@pytest.mark.slow
def test_nothing_of_what_is_held_is_dropped(tmp_path: Path) -> None:
    feed = messages(0.0, 62.0)
    live = Live(tmp_path / "live", ODOM, find_offset=True, limits=BufferLimits(waiting_states=300))
    updates = [
        update
        for part in np.array_split(np.arange(len(feed)), 100)
        for update in live.feed([feed[row] for row in part])
    ]
    assert not live.run.holds
    live.end()
    (actual,) = live.result["runs"]
    assert actual["association"]["pairs"] > 1200
    assert actual["association"]["dropped"] == {}
    ends = [end.stamp for update in updates for end in update.ends]
    assert min(ends) < feed[0][2] + 20 * 10**9


@pytest.mark.slow
def test_an_offset_that_nobody_asked_for_is_told_and_not_applied(tmp_path: Path) -> None:
    live = run(tmp_path / "live", messages(0.1, 40.0), find_offset=False)
    live.end()
    (actual,) = live.result["runs"]
    assert actual["association"]["time_offset_s"] == 0.0
    assert actual["live"]["clock"]["offset_s"] == pytest.approx(0.1, abs=5e-3)


def test_stamps_that_stand_still_are_not_held_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_run, "_MOST_HELD", 100)
    feed = messages(0.0, 2.0)
    still = [item for topic in (GROUNDTRUTH, ESTIMATE) for item in feed if item[0] == topic][:5]
    still += [item for item in feed if item[0] == ESTIMATE][:5]
    live = Live(tmp_path / "live", ODOM, find_offset=True, at_time_jumps=False)
    holds = []
    for _ in range(15):
        live.feed(still)
        holds.append(live.run.holds)
    assert holds[:9] == [True] * 9
    assert not holds[-1]
    live.end()
