"""Loops and restarts: each begins a run in a folder of its own, as its recording is."""

from __future__ import annotations

import dataclasses
import gc
import itertools
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_runs import COUNT, ESTIMATE, GROUNDTRUTH, Live, messages, path_messages
from recorded_runs import pairs_of
from ros_bags import ODOM, PATH, POSE, Message, messages_of, odometry_message, write_messages
from ros_processes import assert_same, offline
from strategies import make_pair

from trajeval_ros import simulate
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.ros import live_runs
from trajeval_ros.ros.marker_body import MarkerBody

SECOND = 10**9
OTHER = "/other"
WORDS = ("--gauge", "yaw", "--lengths", "2,4")


def expected_of(folder: Path, feed: Sequence[Message]) -> Any:
    """Return the run that a recording of some messages gives."""
    folder.mkdir()
    write_messages(folder / "bag", feed)
    return offline(folder / "bag", folder, GROUNDTRUTH, [ESTIMATE], *WORDS)["runs"][0]


def assert_runs(live: Live, expected: Sequence[Any]) -> None:
    """Assert that the runs are those, each in a folder with the reason of its begin."""
    for result, other, began_by in zip(live.results, expected, ["", *live.begun], strict=True):
        [run] = result["runs"]
        assert run["live"]["began_by"] == began_by
        assert_same(run, other)


def late(feed: Sequence[Message], messages_late: int) -> list[Message]:
    """Return messages of which those of the estimate arrive later by so many."""
    keys = [row + (item[0] == ESTIMATE) * messages_late for row, item in enumerate(feed)]
    return [feed[row] for row in np.argsort(keys, kind="stable")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("messages_late", "batch"), [(0, 1), (0, 1000), (25, 13), (-25, 1), (-25, 1000)]
)
def test_each_loop_of_a_bag_is_a_run(tmp_path: Path, messages_late: int, batch: int) -> None:
    loops = [messages(seed)[: 200 - seed] for seed in (21, 22, 23)]
    live = Live(tmp_path / "live", ODOM)
    feed = late([item for loop in loops for item in loop], messages_late)
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    live.end()
    expected = [expected_of(tmp_path / str(n), loop) for n, loop in enumerate(loops)]
    assert_runs(live, expected)
    first = "/vio" if messages_late < 0 and batch < 1000 else "/groundtruth"
    assert all(item.startswith(f"time of {first} stepped back by") for item in live.begun)
    assert live.closed == live.folders[:2]


@pytest.mark.slow
@pytest.mark.parametrize("messages_late", [0, 25, -25])
def test_dropped_messages_are_those_of_the_loop(tmp_path: Path, messages_late: int) -> None:
    """Also if the next loop begins before the previous one is complete."""
    loops = [messages(seed) for seed in (21, 22)]
    for loop, count in zip(loops, (1, 3), strict=True):
        rows = [row for row, item in enumerate(loop) if item[0] == ESTIMATE][5 : 5 + count]
        for row in rows:
            topic, kind, stamp, _ = loop[row]
            unset = odometry_message(0, [0.0] * 3, [0.0, 0.0, 0.0, 1.0])
            loop[row] = (topic, kind, stamp, unset)
    live = Live(tmp_path / "live", ODOM)
    for item in late([message for loop in loops for message in loop], messages_late):
        live.feed([item])
    live.end()
    runs = [result["runs"][0] for result in live.results]
    dropped = [run["association"]["dropped"]["zero_stamp"] for run in runs]
    assert dropped == [1, 3]


@pytest.mark.slow
def test_what_is_published_goes_on_after_a_loop(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM)
    loops = [messages(24)] * 2
    counts = [sum(item.pairs for part in loop for item in live.feed([part])) for loop in loops]
    assert counts[0] == counts[1] > 50
    live.end()


def restarted(seed: int, row: int) -> tuple[Trajectory, Trajectory, int]:
    """Return a flight, an estimate with another origin from a row on, and the row's stamp."""
    pair = make_pair(seed, COUNT, smooth=True)
    moved = pair.estimate.positions.copy()
    moved[row:] += [30.0, -20.0, 10.0]
    estimate = dataclasses.replace(pair.estimate, positions=moved)
    return pair.groundtruth, estimate, int(estimate.stamps[row])


@pytest.mark.slow
@pytest.mark.parametrize("batch", [1, 1000])
def test_a_restart_begins_a_run(tmp_path: Path, batch: int) -> None:
    groundtruth, estimate, stamp = restarted(31, 40)
    written = [
        *messages_of(groundtruth, GROUNDTRUTH, POSE),
        *messages_of(estimate, ESTIMATE, ODOM),
    ]
    feed = sorted(written, key=lambda item: item[2])
    live = Live(tmp_path / "live", ODOM, at_restarts=True)
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    live.end()
    paired = read_stamps(live)
    first = min(item for item in paired[1] if item >= stamp)  # the first that has groundtruth
    last_before = groundtruth.stamps[groundtruth.stamps <= first].max()
    first_after = groundtruth.stamps[groundtruth.stamps >= first].min()
    parts = [
        [
            item
            for item in feed
            if item[2] <= (first_after if item[0] == GROUNDTRUTH else first - 1)
        ],
        [item for item in feed if item[2] >= (last_before if item[0] == GROUNDTRUTH else first)],
    ]
    expected = [expected_of(tmp_path / str(n), part) for n, part in enumerate(parts)]
    assert live.begun == ["vio jumped"]
    assert_runs(live, expected)
    whole = expected_of(tmp_path / "whole", feed)
    worst = max(item["ate"]["position_m"]["rmse"] for item in expected)
    assert worst < 0.5 * whole["ate"]["position_m"]["rmse"]


def read_stamps(live: Live) -> list[list[int]]:
    return [pairs_of(folder).estimate.stamps.tolist() for folder in live.folders]


@pytest.mark.slow
@pytest.mark.parametrize(("batch", "ends_early"), [(20, False), (2000, True)])
def test_restarts_while_the_groundtruth_is_held_begin_runs(
    tmp_path: Path, batch: int, ends_early: bool
) -> None:
    """Nothing is evaluated for a minute, and then all of it is, run by run."""
    flown = simulate(8, 40.0 if ends_early else 70.0)
    estimate, stamps = flown.estimate, flown.estimate.stamps
    rows = [len(stamps) // 5, len(stamps) // 2]
    moved = estimate.positions.copy()
    for row in rows:
        moved[row:] += [25.0, -10.0, 5.0]
    estimate = dataclasses.replace(estimate, positions=moved)
    groundtruth = flown.groundtruth[::2]
    written = [
        *messages_of(groundtruth, GROUNDTRUTH, POSE),
        *messages_of(estimate, ESTIMATE, ODOM),
    ]
    feed = sorted(written, key=lambda item: item[2])
    live = Live(tmp_path / "live", ODOM, body=NeverKnown(), at_restarts=True)
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    assert live.run.holds == ends_early
    live.end()
    assert live.begun == ["vio jumped"] * 2
    outcome = read_stamps(live)
    assert [item[0] for item in outcome[1:]] == stamps[rows].tolist()
    ends = [0, *stamps[rows].tolist(), feed[-1][2] + 1]
    runs = zip(live.results, itertools.pairwise(ends), strict=True)
    for number, (result, (first, end)) in enumerate(runs):
        begin = groundtruth.stamps[groundtruth.stamps <= max(first, groundtruth.stamps[0])].max()
        until = groundtruth.stamps[groundtruth.stamps >= min(end, groundtruth.stamps[-1])].min()
        part = [
            item
            for item in feed
            if (begin <= item[2] <= until if item[0] == GROUNDTRUTH else first <= item[2] < end)
        ]
        [run] = result["runs"]
        run["remarks"] = []
        assert_same(run, {**expected_of(tmp_path / str(number), part), "remarks": []})


class NeverKnown(MarkerBody):
    """A marker whose pose in the body nobody finds."""

    def __init__(self) -> None:
        super().__init__("/tf_static:base.marker")

    def look(self, calibration: object, *, is_spent: bool) -> bool:
        del calibration
        return is_spent


@pytest.mark.slow
def test_a_run_that_is_complete_takes_no_memory(tmp_path: Path) -> None:
    groundtruth, estimate, _ = restarted(31, 40)
    written = [
        *messages_of(groundtruth, GROUNDTRUTH, POSE),
        *messages_of(estimate, ESTIMATE, ODOM),
    ]
    feed = sorted(written, key=lambda item: item[2])
    live = Live(tmp_path / "live", ODOM, at_restarts=True)
    first = weakref.ref(live.run.estimates[0])
    store = weakref.ref(live.run.estimates[0].evaluator.store)
    gc.collect()
    gc.disable()  # which comes rarely where few objects are made
    try:
        for begin in range(0, len(feed), 17):
            live.feed(feed[begin : begin + 17])
        assert len(live.folders) == 2
        assert (first(), store()) == (None, None)
        assert gc.collect() == 0  # no part of it waits for the collector
    finally:
        gc.enable()
    live.end()


@pytest.mark.slow
def test_millimetres_are_no_restarts(tmp_path: Path) -> None:
    pair = make_pair(31, COUNT, smooth=True)
    estimate = dataclasses.replace(pair.estimate, positions=1e4 * pair.estimate.positions)
    written = [
        *messages_of(pair.groundtruth, GROUNDTRUTH, POSE),
        *messages_of(estimate, ESTIMATE, ODOM),
    ]
    feed = sorted(written, key=lambda item: item[2])
    live = Live(tmp_path / "live", ODOM, at_restarts=True)
    for begin in range(0, len(feed), 17):
        live.feed(feed[begin : begin + 17])
    live.end()
    assert len(live.folders) == 1


@pytest.mark.slow
def test_nothing_is_split_that_nobody_wants_split(tmp_path: Path) -> None:
    groundtruth, estimate, _ = restarted(31, 40)
    written = [
        *messages_of(groundtruth, GROUNDTRUTH, POSE),
        *messages_of(estimate, ESTIMATE, ODOM),
    ]
    live = Live(tmp_path / "live", ODOM, at_time_jumps=False)
    feed = sorted(written, key=lambda item: item[2])
    for part in (feed, feed):
        for message in part:
            live.feed([message])
    live.end()
    [run] = live.result["runs"]
    assert run["estimate"]["name"] == "vio"


@pytest.mark.slow
def test_an_end_soon_after_a_step_of_time_leaves_the_results_before(tmp_path: Path) -> None:
    """Only the groundtruth has begun anew: the estimate's last messages might still come."""
    loops = [messages(seed) for seed in (41, 42)]
    live = Live(tmp_path / "live", ODOM)
    for message in loops[0]:
        live.feed([message])
    assert live.run.has_pairs
    live.feed([loop for loop in loops[1] if loop[0] == GROUNDTRUTH][:20])
    assert live.run.folder == live.folders[1]
    assert live.closed == []
    live.end()
    assert live.closed == live.folders[:1]
    assert not live.run.has_pairs
    [run] = live.result["runs"]
    assert_same(run, expected_of(tmp_path / "expected", loops[0]))


@pytest.mark.parametrize("ahead", [0, 30])
def test_a_reset_ends_a_run_with_all_that_has_arrived(tmp_path: Path, ahead: int) -> None:
    """The next run has the same subscriptions, so that no message is lost between both."""
    loops = [messages(seed) for seed in (43, 44)]
    live = Live(tmp_path / "live", ODOM)
    live.feed(loops[0][: len(loops[0]) - ahead])
    for topic, _, _, payload in loops[0][len(loops[0]) - ahead :]:
        (live.groundtruth if topic == GROUNDTRUTH else live.estimate).queue.append(payload)
    live.reset()
    live.feed(loops[1])
    live.end()
    assert live.begun == [""]
    assert_runs(live, [expected_of(tmp_path / str(n), loop) for n, loop in enumerate(loops)])


def two_estimates(seed: int) -> tuple[list[Message], list[Message]]:
    """Return messages of a groundtruth and an estimate, and of an estimate that restarts."""
    groundtruth, restarts, _ = restarted(seed, 40)
    other = make_pair(seed, COUNT, smooth=True).estimate
    common = [*messages_of(groundtruth, GROUNDTRUTH, POSE), *messages_of(other, OTHER, ODOM)]
    return common, messages_of(restarts, ESTIMATE, ODOM)


@pytest.mark.slow
@pytest.mark.parametrize("batch", [1, 23])
def test_a_restart_loses_no_pair_of_another_estimate(tmp_path: Path, batch: int) -> None:
    common, restarts = two_estimates(33)
    feed = late(sorted([*common, *restarts], key=lambda restart: restart[2]), 11)
    stamps = []
    for at_restarts in (False, True):
        folder = tmp_path / str(at_restarts)
        live = Live(folder, ODOM, at_restarts=at_restarts, others=(OTHER,))
        for begin in range(0, len(feed), batch):
            live.feed(feed[begin : begin + batch])
        live.end()
        stamps.append(
            [
                np.concatenate([pairs_of(folder, name).estimate.stamps for folder in live.folders])
                for name in ("vio", "other")
            ]
        )
    assert len(live.folders) == 2
    for whole, parts in zip(*stamps, strict=True):
        assert parts.tolist() == whole.tolist()


@pytest.mark.slow
def test_one_clock_that_is_set_back_begins_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The groundtruth goes on as before, and what is remembered of it serves the new run."""
    monkeypatch.setattr(live_runs, "FOLLOWS_WITHIN_S", 0.0)
    pair = make_pair(51, COUNT, smooth=True)
    middle = COUNT // 4
    stamps = pair.estimate.stamps.copy()
    stamps[middle:] -= 2 * SECOND
    estimate = dataclasses.replace(pair.estimate, stamps=stamps)
    written = [
        (name, kind, logged, payload)
        for (name, kind, _, payload), logged in zip(
            messages_of(estimate, ESTIMATE, ODOM), pair.estimate.stamps.tolist(), strict=True
        )
    ]
    live = Live(tmp_path / "live", ODOM)
    feed = sorted(
        [*messages_of(pair.groundtruth, GROUNDTRUTH, POSE), *written], key=lambda item: item[2]
    )
    for message in feed:
        live.feed([message])
    live.end()
    runs = [result["runs"][0] for result in live.results]
    assert [run["estimate"]["poses"] for run in runs] == [middle, len(stamps) - middle]
    pairs = [run["association"]["pairs"] for run in runs]
    assert pairs[1] > 0.9 * (len(stamps) - middle) * (pairs[0] / middle)
    [told] = [remark for remark in runs[1]["remarks"] if remark["code"] == "clock_step"]
    assert told["text"].startswith("the estimate's clock stepped by -1.796 s")


@pytest.mark.slow
def test_a_path_that_begins_anew_is_a_run(tmp_path: Path) -> None:
    loops = []
    for seed in (61, 62):
        pair = make_pair(seed, COUNT, smooth=True)
        drawn = [
            *messages_of(pair.groundtruth, GROUNDTRUTH, POSE),
            *path_messages(pair.estimate, 7),
        ]
        loops.append(sorted(drawn, key=lambda item: item[2]))
    live = Live(tmp_path / "live", PATH)
    for message in (item for loop in loops for item in loop):
        live.feed([message])
    live.end()
    runs = [result["runs"][0] for result in live.results]
    for number, (run, loop) in enumerate(zip(runs, loops, strict=True)):
        other = expected_of(tmp_path / str(number), loop)
        assert_same(run["ate"], other["ate"])
        assert_same(run["re"], other["re"])
