"""Loops, restarts, stamps of the future and covariances over the network, as their recordings."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
from consistency_runs import with_growing_covariances
from recorded_runs import pairs_of
from ros_bags import ODOM, POSE, Message, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Peer, assert_same, evaluating, offline
from waiting import until

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

WORDS = ("--gauge", "yaw", "--lengths", "2,4")
SUBSCRIBERS = {GROUNDTRUTH: 1, ODOMETRY: 1}
HOUR = 3600 * 10**9


def written(groundtruth: Trajectory, estimate: Trajectory) -> list[Message]:
    both = [*messages_of(groundtruth, GROUNDTRUTH, POSE), *messages_of(estimate, ODOMETRY, ODOM)]
    return sorted(both, key=lambda item: item[2])


def with_wrong_stamps(side: Trajectory, topic: str, kind: str, rows: list[int]) -> list[Message]:
    """Return messages of which some are stamped an hour ahead."""
    stamps = side.stamps.copy()
    stamps[rows] += HOUR
    wrong = messages_of(dataclasses.replace(side, stamps=stamps), topic, kind)
    times = side.stamps.tolist()
    return [(*item[:2], logged, item[3]) for item, logged in zip(wrong, times, strict=True)]


def test_a_loop_with_covariances_and_stamps_of_the_future(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    flown = simulate(7, 25.0)
    estimate = with_growing_covariances(flown.estimate)
    bag = tmp_path / "bag"
    feed = [
        *with_wrong_stamps(flown.groundtruth[::2], GROUNDTRUTH, POSE, [300, 700]),
        *with_wrong_stamps(estimate, ODOMETRY, ODOM, [50, 200]),
    ]
    write_messages(bag, sorted(feed, key=lambda item: item[2]))
    with evaluating(
        tmp_path / "live", environment, gauge="yaw", lengths="2,4", covariance="message"
    ) as live:
        for _ in range(2):
            peer.play(bag, SUBSCRIBERS, ["evaluator"], rate=8.0)
        live.wait_for(f"new results in {tmp_path / 'live_2'}")
        assert live.end() == 0
    expected = offline(bag, tmp_path, GROUNDTRUTH, [ODOMETRY], *WORDS, "--covariance", "message")
    for folder, begin in ((tmp_path / "live", ""), (tmp_path / "live_2", "time of /")):
        [run] = result_in(folder)["runs"]
        assert run["live"]["began_by"].startswith(begin)
        assert run["live"]["messages_lost"] == 0
        assert_same(run, expected["runs"][0])
        assert run["association"]["dropped"]["lone_stamp"] == 2
        assert run["consistency"]["per_pose"]["poses"] == run["association"]["pairs"]
    log = [line for line in live.printed.splitlines() if line.startswith("[")]  # not of `finish`
    told = [line for line in log if "timestamp differs" in line or "timestamps differ" in line]
    assert len(told) == 4  # each side of each run


def test_a_reset_soon_after_a_reset_by_time(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from std_srvs.srv import Trigger

    flown = simulate(9, 25.0)
    feed = written(flown.groundtruth[::2], flown.estimate)
    bag, beginning = tmp_path / "bag", tmp_path / "beginning"
    write_messages(bag, feed)
    write_messages(beginning, [item for item in feed if item[0] == GROUNDTRUTH][:50])
    with evaluating(tmp_path / "live", environment, gauge="yaw", lengths="2,4") as live:
        peer.play(bag, SUBSCRIBERS, ["evaluator"], rate=8.0)
        peer.play(beginning, {GROUNDTRUTH: 1}, ["evaluator"], rate=8.0)
        live.wait_for(f"new results in {tmp_path / 'live_2'}")
        answer = peer.ask("/evaluator/reset", Trigger)
        assert answer.success
        assert f"new results in {tmp_path / 'live_3'}" in answer.message
        peer.play(bag, SUBSCRIBERS, ["evaluator"], rate=8.0)
        live.wait_for(f"results of {tmp_path / 'live'} are complete")
        assert live.end() == 0
    assert "can't be written" not in live.printed
    assert not (tmp_path / "live_2" / "result.json").exists()  # nothing was paired
    expected = offline(bag, tmp_path, GROUNDTRUTH, [ODOMETRY], *WORDS)["runs"]
    for folder in (tmp_path / "live", tmp_path / "live_3"):
        assert_same(result_in(folder)["runs"], expected)


def result_in(folder: Path) -> Any:
    """Return the result of a run, which another process may still write."""
    result = folder / "result.json"
    until(result.exists, f"there is {result}")
    return json.loads(result.read_text())


def test_a_restart_begins_a_run(peer: Peer, environment: dict[str, str], tmp_path: Path) -> None:
    flown = simulate(8, 25.0)
    groundtruth, estimate = flown.groundtruth[::2], flown.estimate
    row = len(estimate) // 2
    moved = estimate.positions.copy()
    moved[row:] += [25.0, -10.0, 5.0]
    feed = written(groundtruth, dataclasses.replace(estimate, positions=moved))
    bag, folder = tmp_path / "bag", tmp_path / "live"
    write_messages(bag, feed)
    with evaluating(folder, environment, gauge="yaw", lengths="2,4", on_restart="reset") as live:
        peer.play(bag, SUBSCRIBERS, ["evaluator"], rate=8.0)
        live.wait_for(f"vio_odometry jumped; previous results are in {folder}")
        assert live.end() == 0
    folders = [folder, tmp_path / "live_2"]
    first = int(pairs_of(folders[1], "vio_odometry").estimate.stamps.min())
    assert first == estimate.stamps[row]
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
    for number, (item, part) in enumerate(zip(folders, parts, strict=True)):
        [run] = result_in(item)["runs"]
        of_part = tmp_path / str(number)
        of_part.mkdir()
        write_messages(of_part / "bag", part)
        expected = offline(of_part / "bag", of_part, GROUNDTRUTH, [ODOMETRY], *WORDS)["runs"][0]
        assert_same(run, expected)
