"""Live equals offline: the evaluator on a replayed bag gives what `trajeval evaluate` gives."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_bags import (
    ODOM,
    PATH,
    POINT,
    POSE,
    Message,
    messages_of,
    path_message,
    write_messages,
)
from ros_processes import (
    GROUNDTRUTH,
    ODOMETRY,
    Evaluator,
    Peer,
    assert_same,
    offline,
    play_without_loss,
)

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

POINTS, SLAM, FIRST = "/groundtruth/point", "/slam/path", "/slam/first"


def growing_path(source: Trajectory) -> tuple[list[Message], Trajectory]:
    """Return a path that grows by five poses a message, and its poses as they were when new.

    Loop closures revise it, for better and for worse.
    """
    assert source.quaternions is not None
    messages: list[Message] = []
    revision = np.zeros((len(source), 3))
    as_new = source.positions.copy()
    for end in range(5, len(source) + 1, 5):
        if end % 300 == 0:
            revision[:end] += np.linspace([0.4, -0.2, 0.1], [0.0, 0.0, 0.0], end)
        stamps = source.stamps[:end].tolist()
        poses = (source.positions + revision)[:end], source.quaternions[:end]
        as_new[end - 5 : end] = poses[0][-5:]
        messages.append((SLAM, PATH, stamps[-1], path_message(stamps, *poses)))
    return messages, dataclasses.replace(source, positions=as_new)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a simulated flight, with its poses in several kinds of messages."""
    simulated = simulate(3, 40.0)
    groundtruth, estimate = simulated.groundtruth[::2], simulated.estimate
    keyframes = estimate[::2]
    keyframes = keyframes[: len(keyframes) // 5 * 5]
    bag = tmp_path_factory.mktemp("flight") / "bag"
    slam, as_new = growing_path(keyframes)
    write_messages(
        bag,
        [
            *messages_of(groundtruth, GROUNDTRUTH, POSE),
            *messages_of(groundtruth, POINTS, POINT),
            *messages_of(estimate, ODOMETRY, ODOM),
            *slam,
        ],
    )
    # What the path was when each of its poses was new; not played, offline alone reads it.
    write_messages(
        bag.with_name("first"),
        [*messages_of(groundtruth, GROUNDTRUTH, POSE), *messages_of(as_new, FIRST, POSE)],
    )
    return bag


NODES: dict[str, dict[str, Any]] = {
    "whole": {"gauge": "yaw", "window": "0", "estimates": [ODOMETRY, SLAM]},
    "sliding": {"modality": "stereo-inertial", "window": "30s"},
    "planar": {"gauge": "planar", "window": "0", "estimates": [ODOMETRY, SLAM]},
    "points": {"groundtruth": POINTS, "gauge": "se3"},
    "first": {
        "gauge": "yaw",
        "time_offset": 0.013,
        "lengths": "10%,20%,4s",
        "align_states": 50,
        "max_gap": 1,
    },
    "frozen": {"gauge": "sim3", "align_states": "frozen", "window": "20m"},
}
OPTIONS = {
    "whole": ["--gauge", "yaw"],
    "sliding": ["--modality", "stereo-inertial"],
    "planar": ["--gauge", "planar"],
    "points": ["--gauge", "se3"],
    "first": [
        "--gauge", "yaw", "--time-offset", "0.013", "--lengths", "10%,20%,4s",
        "--align-states", "50", "--max-gap", "1",
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def flown(
    flight: Path, peer: Peer, environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Evaluator]:
    """What six evaluators say of the same flight."""
    folder = tmp_path_factory.mktemp("flown")
    return play_without_loss(flight, peer, environment, folder, NODES, rate=9.0)


@pytest.mark.parametrize("name", OPTIONS)
def test_live_is_offline(
    flown: dict[str, Evaluator], flight: Path, name: str, tmp_path: Path
) -> None:
    values = NODES[name]
    groundtruth, estimates = (
        values.get("groundtruth", GROUNDTRUTH),
        values.get("estimates", [ODOMETRY]),
    )
    recorded = offline(flight, tmp_path, groundtruth, estimates, *OPTIONS[name])
    live = flown[name].result
    assert_same(live, recorded)
    assert [run["estimate"]["source"] for run in live["runs"]] == estimates


def test_a_frozen_alignment_is_that_of_its_first_states(
    flown: dict[str, Evaluator], flight: Path, tmp_path: Path
) -> None:
    live = flown["frozen"].result
    states = live["runs"][0]["alignment"]["states"]
    assert 3 <= states < live["runs"][0]["association"]["pairs"]
    options = ["--gauge", "sim3", "--align-states", str(states)]
    assert_same(live, offline(flight, tmp_path, GROUNDTRUTH, [ODOMETRY], *options))


@pytest.mark.parametrize("name", ["whole", "planar"])
def test_of_a_path_each_pose_is_also_judged_as_it_was_first_published(
    flown: dict[str, Evaluator], flight: Path, name: str, tmp_path: Path
) -> None:
    revised = flown[name].run_of(SLAM)
    causal = revised["live"]["causal_ate"]
    options = OPTIONS[name]
    [recorded] = offline(flight.with_name("first"), tmp_path, GROUNDTRUTH, [FIRST], *options)[
        "runs"
    ]
    assert_same({"form": "plain", **causal}, recorded["ate"])
    assert causal["position_m"]["rmse"] != pytest.approx(
        revised["ate"]["position_m"]["rmse"], rel=1e-3
    )


def test_live_is_offline_on_a_recording_of_ros1_with_two_estimates(
    shared_data: Path, peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    bag = shared_data / "bags" / "ROS_example.bag"
    nodes = {
        "sliding": {
            "groundtruth": "/groundtruth",
            "estimates": ["/ORB_SLAM", "/S_PTAM"],
            "gauge": "sim3",
            "lengths": "8,16,5s",
            "window": "30s",
        }
    }
    done = play_without_loss(bag, peer, environment, tmp_path / "out", nodes, rate=90.0)
    options = ["--gauge", "sim3", "--lengths", "8,16,5s"]
    topics = ["/ORB-SLAM", "/S-PTAM"]
    recorded = offline(bag, tmp_path, "/groundtruth", topics, *options)
    assert_same(done["sliding"].result, recorded)


def test_live_is_offline_on_euroc(
    recording: Callable[[str], Trajectory],
    peer: Peer,
    environment: dict[str, str],
    tmp_path: Path,
) -> None:
    groundtruth = recording("euroc/groundtruth/MH_01.txt")
    estimate = recording("euroc/vins_mono/MH_01.csv")
    bag = tmp_path / "bag"
    write_messages(
        bag, [*messages_of(groundtruth, GROUNDTRUTH, POSE), *messages_of(estimate, ODOMETRY, ODOM)]
    )
    nodes = {"whole": {"modality": "mono-inertial", "window": "0"}}
    done = play_without_loss(bag, peer, environment, tmp_path / "out", nodes, rate=18.0)
    recorded = offline(bag, tmp_path, GROUNDTRUTH, [ODOMETRY], "--modality", "mono-inertial")
    assert recorded["runs"][0]["association"]["pairs"] > 1700
    assert_same(done["whole"].result, recorded)
