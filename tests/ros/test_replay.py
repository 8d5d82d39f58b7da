"""Replay between real processes over DDS: what a bag holds is what subscribers get."""

from __future__ import annotations

import re
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from ros_bags import STORE
from ros_processes import GROUNDTRUTH, ODOMETRY, TYPES, Peer, listening, replay, replay_command
from rosbags.highlevel import AnyReader
from waiting import PATIENCE_S

from trajeval_ros.cli.app import main
from trajeval_ros.io.bags.bag import Bag

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

CLOCK = {"/clock": "rosgraph_msgs/msg/Clock"}


@pytest.fixture
def flight(flights: Path) -> Path:
    return flights / "mcap"


def recorded(bag: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Return log times and payloads by topic."""
    with Bag(bag) as opened:
        return {
            topic.name: [(stamp, payload) for _, stamp, payload in opened.messages([topic])]
            for topic in opened.topics
        }


def assert_same(received: list[bytes], sent: list[bytes]) -> None:
    """Compare messages one by one; DDS may fill the last of them up to a multiple of four."""
    assert len(received) == len(sent)
    for there, here in zip(received, sent, strict=True):
        assert there[: len(here)] == here
        assert len(there) - len(here) < 4


def clock_ns(payloads: list[bytes]) -> list[int]:
    clocks: list[Any] = [
        STORE.deserialize_cdr(payload, "rosgraph_msgs/msg/Clock").clock for payload in payloads
    ]
    return [clock.sec * 10**9 + clock.nanosec for clock in clocks]


def stamps_ns(payloads: list[bytes], kind: str) -> list[int]:
    headers: list[Any] = [STORE.deserialize_cdr(payload, kind).header for payload in payloads]  # type: ignore[attr-defined]
    return [header.stamp.sec * 10**9 + header.stamp.nanosec for header in headers]


@pytest.mark.parametrize("rate", [5, 20])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_all_arrives_in_order_and_with_the_clock(
    flights: Path, storage: str, rate: int, environment: dict[str, str], tmp_path: Path
) -> None:
    flight = flights / storage
    with listening({**TYPES, **CLOCK}, environment, tmp_path) as received:
        text = replay(flight, environment, "--rate", rate)
    sent = recorded(flight)
    for topic, kind in TYPES.items():
        payloads = [payload for _, payload in sent[topic]]
        assert_same(received[topic], payloads)
        assert stamps_ns(received[topic], kind) == stamps_ns(payloads, kind)
        assert f"{len(sent[topic])} on {topic}" in text
    clock = clock_ns(received["/clock"])
    assert clock == sorted(clock)
    times = [stamp for messages in sent.values() for stamp, _ in messages]
    assert min(times) <= clock[0] < clock[-1] == max(times)
    took = re.search(r"in ([\d.]+) s \(rate", text)
    assert took is not None
    # On a machine that is busy it may take longer.
    assert float(took[1]) > (max(times) - min(times)) / 1e9 / rate - 0.1


def test_a_part_of_one_topic_under_another_name(
    flight: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    renamed = {"/renamed": TYPES[ODOMETRY], **CLOCK}
    with listening(renamed, environment, tmp_path) as received:
        text = replay(
            flight, environment, "--topic", ODOMETRY, "--start", 5, "--end", 12.5, "--rate", 5,
            "--no-clock", "--ros-args", "-r", f"{ODOMETRY}:=/renamed",
        )  # fmt: skip
    sent = recorded(flight)
    first = min(messages[0][0] for messages in sent.values())
    window = range(first + 5 * 10**9, first + round(12.5 * 10**9) + 1)
    assert_same(received["/renamed"], [item for time, item in sent[ODOMETRY] if time in window])
    assert received["/clock"] == []
    assert GROUNDTRUTH not in text


def test_a_bag_of_ros1_is_encoded_anew(
    shared_data: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    bag = shared_data / "bags" / "ROS_example.bag"
    pose = "geometry_msgs/msg/PoseStamped"
    topics = dict.fromkeys(["/ORB_SLAM", "/S_PTAM", "/groundtruth"], pose)
    with listening(topics, environment, tmp_path) as received:
        text = replay(bag, environment, "--end", 300, "--rate", 50)
    assert "/ORB-SLAM is published as /ORB_SLAM" in text
    with AnyReader([bag]) as reader:
        end = reader.start_time + 300 * 10**9 + 1
        for name in ("/ORB-SLAM", "/S-PTAM", "/groundtruth"):
            connections = [c for c in reader.connections if c.topic.strip("/") == name.strip("/")]
            expected: list[Any] = [
                reader.deserialize(payload, pose)
                for _, _, payload in reader.messages(connections, stop=end)
            ]
            result: list[Any] = [
                STORE.deserialize_cdr(item, pose) for item in received[name.replace("-", "_")]
            ]
            assert len(expected) > 100
            assert [_essence(item) for item in result] == [_essence(item) for item in expected]


def _essence(message: Any) -> tuple[object, ...]:
    stamp, place, rotation = message.header.stamp, message.pose.position, message.pose.orientation
    numbers = (place.x, place.y, place.z, rotation.x, rotation.y, rotation.z, rotation.w)
    return stamp.sec, stamp.nanosec, message.header.frame_id, *numbers


def test_a_type_that_is_not_installed_is_named(
    shared_data: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    bag = shared_data / "bags" / "nav2_turtlebot.mcap"
    with listening({"/odom": TYPES[ODOMETRY]}, environment, tmp_path) as received:
        text = replay(bag, environment, "--end", 20, "--rate", 20, "--wait-for-subscribers", 15)
    assert received["/odom"]
    try:
        # Beside the tests there is a folder of the same name, which alone can be imported, too.
        from tf2_msgs.msg import TFMessage  # type: ignore[import-not-found]  # noqa: F401
    except ImportError:
        assert "/tf, /tf_static not played: tf2_msgs/msg/TFMessage is not installed" in text
    else:
        assert "on /tf" in text
    assert "no subscribers to /amcl_pose" in text


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_in_order(
    flight: Path, ending: signal.Signals, peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from rosgraph_msgs.msg import Clock

    ticks = peer.hear("/clock", Clock)
    with (
        listening(TYPES, environment, tmp_path) as received,
        subprocess.Popen(
            replay_command(flight),
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process,
    ):
        assert process.stdout is not None
        while not process.stdout.readline().startswith("playing"):
            assert process.poll() is None
        peer.until(
            lambda: ticks and ticks[-1].clock.sec > ticks[0].clock.sec, "a second is played"
        )
        process.send_signal(ending)
        process.send_signal(ending)
        text, complaints = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert complaints == ""
    counts = re.search(rf"stopped after .* (\d+) on {GROUNDTRUTH}, (\d+) on {ODOMETRY}", text)
    assert counts is not None
    assert [len(received[GROUNDTRUTH]), len(received[ODOMETRY])] == [
        int(group) for group in counts.groups()
    ]
    assert 0 < len(received[GROUNDTRUTH]) < len(recorded(flight)[GROUNDTRUTH])


def test_a_subscriber_that_stands_still_loses_nothing(
    environment: dict[str, str], tmp_path: Path
) -> None:
    """More is sent meanwhile than a publisher keeps, so that it has to wait."""
    flight = tmp_path / "flight"
    assert main(["simulate", str(flight), "--duration", "120"]) == 0
    groundtruth = {GROUNDTRUTH: TYPES[GROUNDTRUTH]}
    listeners: list[subprocess.Popen[str]] = []
    with (
        listening(groundtruth, environment, tmp_path, listeners.append) as received,
        subprocess.Popen(
            replay_command(flight, "--topic", GROUNDTRUTH, "--rate", 40),
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        ) as process,
    ):
        assert process.stdout is not None
        while not process.stdout.readline().startswith("playing"):
            assert process.poll() is None
        [listener] = listeners
        listener.send_signal(signal.SIGSTOP)
        time.sleep(6.0)  # Fast DDS gives a subscriber up after 20 s
        listener.send_signal(signal.SIGCONT)
        text, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, text
    assert_same(received[GROUNDTRUTH], [payload for _, payload in recorded(flight)[GROUNDTRUTH]])


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--topic", "/nope"], "has no topic /nope; it has"),
        (["--rate", "0"], "give a positive number"),
        (["--start", "1e6"], "is after the end of the bag"),
        (["--ros-args", "-r"], "ROS can't start with --ros-args -r"),
    ],
)
def test_a_mistake_is_one_sentence(
    flight: Path, options: list[str], complaint: str, environment: dict[str, str]
) -> None:
    done = subprocess.run(
        replay_command(flight, *options),
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    actual = [line for line in done.stderr.splitlines() if line.startswith("trajeval: ")]
    assert len(actual) == 1
    assert complaint in actual[0]
    assert "Traceback" not in done.stderr
