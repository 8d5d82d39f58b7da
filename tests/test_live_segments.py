"""Segments of a live run: loops and restarts, each a run of its own, as its recording is."""

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
from ros_bags import ODOM, PATH, POSE, Message, messages_of, odometry_message, write_messages
from ros_processes import assert_same, offline
from strategies import make_pair
from test_live_run import COUNT, ESTIMATE, TRUTH, Live, messages, path_messages

from trajeval_ros import simulate
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.ros import estimate_segments
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.segmentation import Segmentation

SECOND = 10**9
WORDS = ("--gauge", "yaw", "--lengths", "2,4")


def expected_of(folder: Path, feed: Sequence[Message]) -> Any:
    """Return the run that a recording of some messages gives."""
    folder.mkdir()
    write_messages(folder / "bag", feed)
    return offline(folder / "bag", folder, TRUTH, [ESTIMATE], *WORDS)["runs"][0]


def assert_segments(live: Live, expected: Sequence[Any]) -> list[str]:
    """Assert that the runs are those; returns why segments began."""
    runs = live.result["runs"]
    names = ["vio", *(f"vio.{number}" for number in range(2, len(expected) + 1))]
    assert [each["estimate"]["name"] for each in runs] == names
    told = []
    for run, other in zip(runs, expected, strict=True):
        began = [each for each in run["warnings"] if each.startswith("segment ")]
        run["warnings"] = [each for each in run["warnings"] if each not in began]
        assert_same(run, other)
        told += began
    return told


def late(feed: Sequence[Message], messages_late: int) -> list[Message]:
    """Return messages of which those of the estimate arrive later by so many."""
    keys = [row + (each[0] == ESTIMATE) * messages_late for row, each in enumerate(feed)]
    return [feed[row] for row in np.argsort(keys, kind="stable")]


@pytest.mark.parametrize("messages_late", [0, 25, -25])
@pytest.mark.parametrize("batch", [1, 13, 1000])
def test_each_loop_of_a_bag_is_a_run(tmp_path: Path, messages_late: int, batch: int) -> None:
    loops = [messages(seed)[: 200 - seed] for seed in (21, 22, 23)]
    live = Live(tmp_path / "live", ODOM)
    feed = late([each for loop in loops for each in loop], messages_late)
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    live.end()
    expected = [expected_of(tmp_path / str(n), loop) for n, loop in enumerate(loops)]
    told = assert_segments(live, expected)
    assert [each.partition(":")[0] for each in told] == ["segment 2 of /vio", "segment 3 of /vio"]
    assert all("time stepped back by" in each for each in told)
    assert [each.values["segment"] for each in live.run.news] == [2, 3]


@pytest.mark.parametrize("messages_late", [0, 25, -25])
def test_dropped_messages_are_those_of_the_loop(tmp_path: Path, messages_late: int) -> None:
    """Also if the next loop begins before the previous one is complete."""
    loops = [messages(seed) for seed in (21, 22)]
    for loop, count in zip(loops, (1, 3), strict=True):
        rows = [row for row, each in enumerate(loop) if each[0] == ESTIMATE][5 : 5 + count]
        for row in rows:
            topic, kind, stamp, _ = loop[row]
            unset = odometry_message(0, [0.0] * 3, [0.0, 0.0, 0.0, 1.0])
            loop[row] = (topic, kind, stamp, unset)
    live = Live(tmp_path / "live", ODOM)
    for each in late([each for loop in loops for each in loop], messages_late):
        live.feed([each])
    live.end()
    dropped = [run["association"]["dropped"]["zero_stamp"] for run in live.result["runs"]]
    assert dropped == [1, 3]


def test_what_is_published_goes_on_after_a_loop(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM)
    loops = [messages(24)] * 2
    counts = [sum(each.pairs for part in loop for each in live.feed([part])) for loop in loops]
    assert counts[0] == counts[1] > 50
    live.end()


def restarted(seed: int, row: int) -> tuple[Trajectory, Trajectory, int]:
    """Return a flight, an estimate with another origin from a row on, and the row's stamp."""
    pair = make_pair(seed, COUNT, smooth=True)
    moved = pair.estimate.positions.copy()
    moved[row:] += [30.0, -20.0, 10.0]
    estimate = dataclasses.replace(pair.estimate, positions=moved)
    return pair.groundtruth, estimate, int(estimate.stamps[row])


@pytest.mark.parametrize("batch", [1, 17, 1000])
def test_a_restart_begins_a_run(tmp_path: Path, batch: int) -> None:
    truth, estimate, stamp = restarted(31, 40)
    written = [*messages_of(truth, TRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    feed = sorted(written, key=lambda each: each[2])
    live = Live(tmp_path / "live", ODOM, segmentation=Segmentation(on_restart="segment"))
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    live.end()
    paired = read_stamps(live)
    first = min(each for each in paired[1] if each >= stamp)  # the first that has groundtruth
    last_before = truth.stamps[truth.stamps <= first].max()
    first_after = truth.stamps[truth.stamps >= first].min()
    parts = [
        [each for each in feed if each[2] <= (first_after if each[0] == TRUTH else first - 1)],
        [each for each in feed if each[2] >= (last_before if each[0] == TRUTH else first)],
    ]
    expected = [expected_of(tmp_path / str(n), part) for n, part in enumerate(parts)]
    assert assert_segments(live, expected) == ["segment 2 of /vio: the estimate jumped"]
    whole = expected_of(tmp_path / "whole", feed)
    worst = max(each["ate"]["position_m"]["rmse"] for each in expected)
    assert worst < 0.5 * whole["ate"]["position_m"]["rmse"]


def read_stamps(live: Live, segments: int = 2) -> list[list[int]]:
    from trajeval_ros.io.live.pair_file import read_pairs

    names = ("vio.pairs", *(f"vio.{number}.pairs" for number in range(2, segments + 1)))
    return [read_pairs(live.folder / name).stamps.tolist() for name in names]


@pytest.mark.parametrize("ends_early", [False, True])
@pytest.mark.parametrize("batch", [20, 2000])
def test_restarts_while_the_groundtruth_is_held_begin_runs(
    tmp_path: Path, batch: int, ends_early: bool
) -> None:
    """Nothing is evaluated for a minute, and then all of it is, segment by segment."""
    flown = simulate(8, 40.0 if ends_early else 70.0)
    estimate, stamps = flown.estimate, flown.estimate.stamps
    rows = [len(stamps) // 5, len(stamps) // 2]
    moved = estimate.positions.copy()
    for row in rows:
        moved[row:] += [25.0, -10.0, 5.0]
    estimate = dataclasses.replace(estimate, positions=moved)
    truth = flown.groundtruth[::2]
    written = [*messages_of(truth, TRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    feed = sorted(written, key=lambda each: each[2])
    restarts = Segmentation(on_restart="segment")
    live = Live(tmp_path / "live", ODOM, body=NeverKnown(), segmentation=restarts)
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    assert live.run.holds == ends_early
    live.end()
    assert [each.values["segment"] for each in live.run.news] == [2, 3]
    found = read_stamps(live, 3)
    assert [each[0] for each in found[1:]] == stamps[rows].tolist()
    ends = [0, *stamps[rows].tolist(), feed[-1][2] + 1]
    runs = zip(live.result["runs"], itertools.pairwise(ends), strict=True)
    for number, (run, (first, end)) in enumerate(runs):
        begin = truth.stamps[truth.stamps <= max(first, truth.stamps[0])].max()
        until = truth.stamps[truth.stamps >= min(end, truth.stamps[-1])].min()
        part = [
            each
            for each in feed
            if (begin <= each[2] <= until if each[0] == TRUTH else first <= each[2] < end)
        ]
        run["warnings"] = []
        assert_same(run, {**expected_of(tmp_path / str(number), part), "warnings": []})


class NeverKnown(MarkerBody):
    """A marker whose pose in the body nobody finds."""

    def __init__(self) -> None:
        super().__init__("/tf_static:base.marker")

    def look(self, calibration: object, *, is_spent: bool) -> bool:
        del calibration
        return is_spent


def test_a_segment_that_is_complete_takes_no_memory(tmp_path: Path) -> None:
    truth, estimate, _ = restarted(31, 40)
    written = [*messages_of(truth, TRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    feed = sorted(written, key=lambda each: each[2])
    live = Live(tmp_path / "live", ODOM, segmentation=Segmentation(on_restart="segment"))
    first = weakref.ref(live.run.estimates[0])
    store = weakref.ref(live.run.estimates[0].evaluator.store)
    gc.collect()
    gc.disable()  # which comes rarely where few objects are made
    try:
        for begin in range(0, len(feed), 17):
            live.feed(feed[begin : begin + 17])
        assert live.run.estimates[0].segment == 2
        assert (first(), store()) == (None, None)
    finally:
        gc.enable()
    live.end()


@pytest.mark.parametrize("batch", [1, 17])
def test_millimetres_are_no_restarts(tmp_path: Path, batch: int) -> None:
    pair = make_pair(31, COUNT, smooth=True)
    estimate = dataclasses.replace(pair.estimate, positions=1e4 * pair.estimate.positions)
    written = [*messages_of(pair.groundtruth, TRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    feed = sorted(written, key=lambda each: each[2])
    live = Live(tmp_path / "live", ODOM, segmentation=Segmentation(on_restart="segment"))
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    live.end()
    assert len(list(live.folder.glob("*.pairs"))) == 3  # the first two steps might be jumps


def test_nothing_is_split_that_nobody_wants_split(tmp_path: Path) -> None:
    truth, estimate, _ = restarted(31, 40)
    written = [*messages_of(truth, TRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    live = Live(tmp_path / "live", ODOM, segmentation=Segmentation("ignore", "ignore"))
    feed = sorted(written, key=lambda each: each[2])
    for part in (feed, feed):
        for message in part:
            live.feed([message])
    live.end()
    [run] = live.result["runs"]
    assert run["estimate"]["name"] == "vio"
    assert run["live"]["jumps"] == 1


def test_a_reset_by_time_goes_on_in_another_folder(tmp_path: Path) -> None:
    loops = [messages(seed) for seed in (41, 42)]
    other = tmp_path / "other"

    def new_folder() -> Path:
        other.mkdir()
        return other

    live = Live(tmp_path / "live", ODOM, segmentation=Segmentation("reset"), new_folder=new_folder)
    ended = []
    for message in (each for loop in loops for each in loop):
        live.feed([message])
        ended += live.run.folders.complete()
    live.end()
    assert [each.folder for each in ended] == [tmp_path / "live"]
    assert live.run.folders.finisher.folder == other
    for folder, loop in ((tmp_path / "live", loops[0]), (other, loops[1])):
        live.folder = folder
        told = assert_segments(live, [expected_of(tmp_path / f"{folder.name}_", loop)])
        assert len(told) == (folder == other)


def test_an_end_soon_after_a_reset_by_time_leaves_the_results_before(tmp_path: Path) -> None:
    """Only the groundtruth has begun anew: the estimate's last messages might still come."""
    loops = [messages(seed) for seed in (41, 42)]

    def new_folder() -> Path:
        (tmp_path / "other").mkdir()
        return tmp_path / "other"

    live = Live(tmp_path / "live", ODOM, segmentation=Segmentation("reset"), new_folder=new_folder)
    for message in loops[0]:
        live.feed([message])
    assert live.run.has_pairs
    live.feed([each for each in loops[1] if each[0] == TRUTH][:20])
    assert live.run.folders.finisher.folder == tmp_path / "other"
    assert live.run.folders.complete() == []
    live.end()
    assert [each.folder for each in live.run.folders.complete()] == [tmp_path / "live"]
    assert not live.run.has_pairs
    assert_segments(live, [expected_of(tmp_path / "expected", loops[0])])


def test_one_clock_that_is_set_back_is_a_segment_of_that_estimate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The groundtruth goes on as before, and what is remembered of it serves the new segment."""
    monkeypatch.setattr(estimate_segments, "FOLLOWS_WITHIN_S", 0.0)
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
        [*messages_of(pair.groundtruth, TRUTH, POSE), *written], key=lambda each: each[2]
    )
    for message in feed:
        live.feed([message])
    live.end()
    runs = live.result["runs"]
    assert [each["estimate"]["poses"] for each in runs] == [middle, len(stamps) - middle]
    pairs = [each["association"]["pairs"] for each in runs]
    assert pairs[1] > 0.9 * (len(stamps) - middle) * (pairs[0] / middle)


def test_a_path_that_begins_anew_is_a_run(tmp_path: Path) -> None:
    loops = []
    for seed in (61, 62):
        pair = make_pair(seed, COUNT, smooth=True)
        drawn = [*messages_of(pair.groundtruth, TRUTH, POSE), *path_messages(pair.estimate, 7)]
        loops.append(sorted(drawn, key=lambda each: each[2]))
    live = Live(tmp_path / "live", PATH)
    for message in (each for loop in loops for each in loop):
        live.feed([message])
    live.end()
    runs = live.result["runs"]
    for number, (run, loop) in enumerate(zip(runs, loops, strict=True)):
        other = expected_of(tmp_path / str(number), loop)
        assert_same(run["ate"], other["ate"])
        assert_same(run["re"], other["re"])


def test_segmentation_knows_its_words() -> None:
    with pytest.raises(SettingsError, match="on_time_jump"):
        Segmentation("restart")
    with pytest.raises(SettingsError, match="on_restart"):
        Segmentation(on_restart="reset")
