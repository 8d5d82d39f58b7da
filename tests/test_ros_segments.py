"""Loops, restarts, stamps of the future and covariances over the network, as their recordings."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from consistency_runs import with_growing_covariances
from ros_bags import ODOM, POSE, Message, messages_of, write_messages
from ros_processes import ODOMETRY, TRUTH, Peer, assert_same, evaluating, offline
from waiting import until

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.live.pair_file import read_pairs
from trajeval_ros.visual_inertial.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

WORDS = ("--gauge", "yaw", "--lengths", "2,4")
SUBSCRIBERS = {TRUTH: 1, ODOMETRY: 1}
HOUR = 3600 * 10**9


def written(truth: Trajectory, estimate: Trajectory) -> list[Message]:
    both = [*messages_of(truth, TRUTH, POSE), *messages_of(estimate, ODOMETRY, ODOM)]
    return sorted(both, key=lambda each: each[2])


def with_wrong_stamps(side: Trajectory, topic: str, kind: str, rows: list[int]) -> list[Message]:
    """Return messages of which some are stamped an hour ahead."""
    stamps = side.stamps.copy()
    stamps[rows] += HOUR
    wrong = messages_of(dataclasses.replace(side, stamps=stamps), topic, kind)
    times = side.stamps.tolist()
    return [(*each[:2], logged, each[3]) for each, logged in zip(wrong, times, strict=True)]


def test_a_loop_with_covariances_and_stamps_of_the_future(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    flown = simulate(7, 25.0)
    estimate = with_growing_covariances(flown.estimate)
    bag = tmp_path / "bag"
    feed = [
        *with_wrong_stamps(flown.groundtruth[::2], TRUTH, POSE, [300, 700]),
        *with_wrong_stamps(estimate, ODOMETRY, ODOM, [50, 200]),
    ]
    write_messages(bag, sorted(feed, key=lambda each: each[2]))
    with evaluating(
        tmp_path / "live", environment, gauge="yaw", lengths="2,4", covariance="message"
    ) as live:
        for _ in range(2):
            peer.play(bag, SUBSCRIBERS, ["evaluator"], rate=8.0)
        live.wait_for("segment 2 starts")
        assert live.end() == 0
    expected = offline(bag, tmp_path, TRUTH, [ODOMETRY], *WORDS, "--covariance", "message")
    assert any("2 poses dropped" in each for each in expected["runs"][0]["estimate"].pop("notes"))
    runs = live.result["runs"]
    assert [each["estimate"]["name"] for each in runs] == ["vio_odometry", "vio_odometry.2"]
    for run in runs:
        told = [each for each in run["warnings"] if each.startswith("segment 2 of /vio/odometry")]
        assert len(told) == run["live"]["segment"] - 1
        run["warnings"] = [each for each in run["warnings"] if each not in told]
        assert run["live"]["messages_lost"] == 0
        # Live it is of the topic so far.
        assert any("poses dropped" in each for each in run["estimate"].pop("notes"))
        assert_same(run, expected["runs"][0])
        assert run["association"]["dropped"]["lone_stamp"] == 2
        assert run["consistency"]["per_pose"]["poses"] == run["association"]["pairs"]
    assert (
        live.said.count("its timestamp differs") + live.said.count("their timestamps differ") == 2
    )  # each side


def test_a_reset_soon_after_a_reset_by_time(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from std_srvs.srv import Trigger

    flown = simulate(9, 25.0)
    feed = written(flown.groundtruth[::2], flown.estimate)
    bag, beginning = tmp_path / "bag", tmp_path / "beginning"
    write_messages(bag, feed)
    write_messages(beginning, [each for each in feed if each[0] == TRUTH][:50])
    with evaluating(
        tmp_path / "live", environment, gauge="yaw", lengths="2,4", on_time_jump="reset"
    ) as live:
        peer.play(bag, SUBSCRIBERS, ["evaluator"], rate=8.0)
        peer.play(beginning, {TRUTH: 1}, ["evaluator"], rate=8.0)
        live.wait_for("segment 1 starts")
        answer = peer.ask("/evaluator/reset", Trigger)
        assert answer.success
        assert f"new results in {tmp_path / 'live_3'}" in answer.message
        peer.play(bag, SUBSCRIBERS, ["evaluator"], rate=8.0)
        live.wait_for(f"results of {tmp_path / 'live'} are complete")
        assert live.end() == 0
    assert "can't be written" not in live.said
    assert not (tmp_path / "live_2" / "result.json").exists()  # nothing was paired
    expected = offline(bag, tmp_path, TRUTH, [ODOMETRY], *WORDS)["runs"]
    for folder in (tmp_path / "live", tmp_path / "live_3"):
        result = folder / "result.json"
        until(result.exists, f"there is {result}")
        assert_same(json.loads(result.read_text())["runs"], expected)


def test_a_restart_is_a_segment(peer: Peer, environment: dict[str, str], tmp_path: Path) -> None:
    flown = simulate(8, 25.0)
    truth, estimate = flown.groundtruth[::2], flown.estimate
    row = len(estimate) // 2
    moved = estimate.positions.copy()
    moved[row:] += [25.0, -10.0, 5.0]
    feed = written(truth, dataclasses.replace(estimate, positions=moved))
    bag, folder = tmp_path / "bag", tmp_path / "live"
    write_messages(bag, feed)
    with evaluating(folder, environment, gauge="yaw", lengths="2,4", on_restart="segment") as live:
        peer.play(bag, SUBSCRIBERS, ["evaluator"], rate=8.0)
        live.wait_for("segment 2 starts")
        assert live.end() == 0
    first = int(read_pairs(folder / "vio_odometry.2.pairs").stamps.min())
    assert first == estimate.stamps[row]
    last_before = truth.stamps[truth.stamps <= first].max()
    first_after = truth.stamps[truth.stamps >= first].min()
    parts = [
        [each for each in feed if each[2] <= (first_after if each[0] == TRUTH else first - 1)],
        [each for each in feed if each[2] >= (last_before if each[0] == TRUTH else first)],
    ]
    for number, (run, part) in enumerate(zip(live.result["runs"], parts, strict=True)):
        of_part = tmp_path / str(number)
        of_part.mkdir()
        write_messages(of_part / "bag", part)
        expected = offline(of_part / "bag", of_part, TRUTH, [ODOMETRY], *WORDS)["runs"][0]
        run["warnings"] = [each for each in run["warnings"] if not each.startswith("segment ")]
        assert_same(run, expected)
    assert "the estimate jumped; segment 2 starts" in live.said
