"""Live equals offline: the evaluator on a replayed bag gives what `trajeval evaluate` gives."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_processes import (
    ODOM,
    ODOMETRY,
    PATH,
    POINT,
    POSE,
    TRUTH,
    Evaluator,
    Message,
    Peer,
    odometry_message,
    path_message,
    play_without_loss,
    point_message,
    pose_message,
    write_messages,
)

from trajeval_ros.cli.app import main
from trajeval_ros.simulation import simulate
from trajeval_ros.trajectory import Trajectory

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

POINTS, SLAM, FIRST = "/groundtruth/point", "/slam/path", "/slam/first"
# What two results of the same run may differ in: where it came from.
APART = {"source", "name", "inputs", "live"}


def messages_of(source: Trajectory, topic: str, kind: str) -> list[Message]:
    """Return a trajectory as messages, logged at their stamps."""
    assert source.quaternions is not None
    columns = source.stamps.tolist(), source.positions, source.quaternions
    if kind == POINT:
        return [
            (topic, kind, stamp, point_message(stamp, place))
            for stamp, place, _ in zip(*columns, strict=True)
        ]
    if kind == POSE:
        return [
            (topic, kind, stamp, pose_message(stamp, place, turn))
            for stamp, place, turn in zip(*columns, strict=True)
        ]
    velocities = np.zeros((len(source), 3))
    if source.velocities is not None and source.rotations is not None:
        velocities = source.rotations.inv().apply(source.velocities)
    return [
        (topic, kind, stamp, odometry_message(stamp, place, turn, velocity))
        for stamp, place, turn, velocity in zip(*columns, velocities, strict=True)
    ]


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
    simulated = simulate(3, 60.0)
    truth, estimate = simulated.groundtruth[::2], simulated.estimate
    keyframes = estimate[::2]
    keyframes = keyframes[: len(keyframes) // 5 * 5]
    bag = tmp_path_factory.mktemp("flight") / "bag"
    slam, as_new = growing_path(keyframes)
    write_messages(
        bag,
        [
            *messages_of(truth, TRUTH, POSE),
            *messages_of(truth, POINTS, POINT),
            *messages_of(estimate, ODOMETRY, ODOM),
            *slam,
        ],
    )
    # What the path was when each of its poses was new; not played, offline alone reads it.
    write_messages(
        bag.with_name("first"),
        [*messages_of(truth, TRUTH, POSE), *messages_of(as_new, FIRST, POSE)],
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


def offline(bag: Path, folder: Path, truth: str, estimates: list[str], *options: str) -> Any:
    """Return the result of `trajeval evaluate`."""
    arguments = ["evaluate", "--groundtruth", f"{bag}:{truth}", "--quiet"]
    for each in estimates:
        arguments += ["--estimate", f"{bag}:{each}"]
    file = folder / "offline.json"
    assert main([*arguments, *options, "--json", str(file)]) == 0
    return json.loads(file.read_text())


def assert_same(live: Any, recorded: Any, where: str = "result") -> None:
    """Compare all there is: counts and words exactly, numbers to 1e-9 of their size."""
    if isinstance(recorded, dict):
        assert live.keys() == recorded.keys(), where
        for key in recorded.keys() - APART:
            assert_same(live[key], recorded[key], f"{where}.{key}")
    elif isinstance(recorded, list):
        assert len(live) == len(recorded), (where, live, recorded)
        for number, (mine, other) in enumerate(zip(live, recorded, strict=True)):
            assert_same(mine, other, f"{where}[{number}]")
    elif isinstance(recorded, float):
        # An error may be zero but for rounding, as that of a first state that was aligned.
        assert live == pytest.approx(recorded, rel=1e-9, abs=1e-12), where
    else:
        assert live == recorded, where


@pytest.mark.parametrize("name", OPTIONS)
def test_live_is_offline(
    flown: dict[str, Evaluator], flight: Path, name: str, tmp_path: Path
) -> None:
    values = NODES[name]
    truth, estimates = values.get("groundtruth", TRUTH), values.get("estimates", [ODOMETRY])
    recorded = offline(flight, tmp_path, truth, estimates, *OPTIONS[name])
    live = flown[name].result
    # One below the other in order of their names; the command line keeps what was said.
    assert_same(live, recorded)
    assert [each["estimate"]["source"] for each in live["runs"]] == estimates


def test_a_frozen_alignment_is_that_of_its_first_states(
    flown: dict[str, Evaluator], flight: Path, tmp_path: Path
) -> None:
    live = flown["frozen"].result
    states = live["runs"][0]["alignment"]["states"]
    assert 3 <= states < live["runs"][0]["association"]["pairs"]
    options = ["--gauge", "sim3", "--align-states", str(states)]
    assert_same(live, offline(flight, tmp_path, TRUTH, [ODOMETRY], *options))


@pytest.mark.parametrize("name", ["whole", "planar"])
def test_of_a_path_each_pose_is_also_judged_as_it_was_first_published(
    flown: dict[str, Evaluator], flight: Path, name: str, tmp_path: Path
) -> None:
    revised = flown[name].run_of(SLAM)
    causal = revised["live"]["causal_ate"]
    options = OPTIONS[name]
    [recorded] = offline(flight.with_name("first"), tmp_path, TRUTH, [FIRST], *options)["runs"]
    assert_same({"form": "plain", **causal}, recorded["ate"])
    assert causal["position_m"]["rmse"] != pytest.approx(
        revised["ate"]["position_m"]["rmse"], rel=1e-3
    )


def test_live_is_offline_on_a_recording_of_ros1_with_two_estimates(
    shared_data: Path, peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    bag = shared_data / "bags" / "ROS_example.bag"
    values = {
        "groundtruth": "/groundtruth",
        "estimates": ["/ORB_SLAM", "/S_PTAM"],
        "gauge": "sim3",
        "lengths": "8,16,5s",
    }
    nodes = {"whole": {**values, "window": "0"}, "sliding": {**values, "window": "30s"}}
    done = play_without_loss(bag, peer, environment, tmp_path / "out", nodes, rate=90.0)
    options = ["--gauge", "sim3", "--lengths", "8,16,5s"]
    topics = ["/ORB-SLAM", "/S-PTAM"]
    recorded = offline(bag, tmp_path, "/groundtruth", topics, *options)
    for each in done.values():
        assert_same(each.result, recorded)


def test_live_is_offline_on_euroc(
    recording: Callable[[str], Trajectory],
    peer: Peer,
    environment: dict[str, str],
    tmp_path: Path,
) -> None:
    truth = recording("euroc/groundtruth/MH_01.txt")
    estimate = recording("euroc/vins_mono/MH_01.csv")
    bag = tmp_path / "bag"
    write_messages(bag, [*messages_of(truth, TRUTH, POSE), *messages_of(estimate, ODOMETRY, ODOM)])
    nodes = {
        "whole": {"modality": "mono-inertial", "window": "0"},
        "sliding": {"modality": "mono-inertial", "window": "30s"},
    }
    done = play_without_loss(bag, peer, environment, tmp_path / "out", nodes, rate=18.0)
    recorded = offline(bag, tmp_path, TRUTH, [ODOMETRY], "--modality", "mono-inertial")
    assert recorded["runs"][0]["association"]["pairs"] > 1700
    for each in done.values():
        assert_same(each.result, recorded)
