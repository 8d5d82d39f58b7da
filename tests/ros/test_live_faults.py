"""Faults of streams over the network: two publishers, other clocks, topics of the same name."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ros_bags import TRANSFORMS
from ros_processes import GROUNDTRUTH, Peer, evaluating

from trajeval_ros.ros import subscriptions
from trajeval_ros.ros.message_types import is_installed
from trajeval_ros.ros.pose_source import PoseSource

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

GOOD, AHEAD, BROKEN = "/vio/odometry", "/vio_odometry", "/broken"
FAULTS = {
    "vio_odometry": "messages of 2 publishers are mixed (peer, peer)",
    "vio_odometry_2": "are 7200 s ahead of those of the groundtruth",
    "broken": "no message with a valid pose (not finite)",
}


def pose(t: float, x: float) -> Any:
    from geometry_msgs.msg import PoseStamped

    message = PoseStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(t * 1e9), 10**9)
    message.pose.position.x = x
    message.pose.orientation.w = 1.0
    return message


@pytest.mark.skipif(
    not is_installed(TRANSFORMS),
    reason="tf2_msgs is missing; `make test-ros` builds it where there are a compiler and cmake",
)
def test_faults_of_streams_are_warnings_with_their_causes(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    """The list of topics has no quotes, and two of the topics have the same name."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from geometry_msgs.msg import PoseStamped

    arrays = peer.hear("/diagnostics", DiagnosticArray)
    events = peer.hear("/evaluator/event", DiagnosticStatus, latched=True)
    topics = f"estimate_topics:=[{GOOD},{AHEAD},{BROKEN},/tf:odom.base_link]"
    names = (GROUNDTRUTH, GOOD, GOOD, AHEAD, BROKEN)
    publishers = [peer.publisher(name, PoseStamped) for name in names]
    with evaluating(tmp_path / "out", environment, "-p", topics, lengths="none") as live:
        for item in publishers:
            peer.until(lambda: item.get_subscription_count() == 1, "it has subscribed")  # noqa: B023

        def publish_until_told() -> bool:
            now = peer.node.get_clock().now().nanoseconds / 1e9
            values = (
                (now, now),
                (now, now),
                (now, now + 5.0),
                (now + 7200.0, now),
                (now, float("nan")),
            )
            for publisher, (stamp, x) in zip(publishers, values, strict=True):
                publisher.publish(pose(stamp, x))
            return told(arrays) >= set(FAULTS)

        peer.until(publish_until_told, "all faults are in diagnostics")
        peer.until(lambda: told([DiagnosticArray(status=events)]) >= set(FAULTS), "and are events")
        live.end()
    [result] = [run for run in live.result["runs"] if run["estimate"]["name"] == "vio_odometry"]
    assert "mixed_publishers" in {
        remark["code"] for side in (result, result["estimate"]) for remark in side["remarks"]
    }


def told(arrays: list[Any]) -> set[str]:
    """Return the estimates whose fault is a warning."""
    return {
        name
        for array in arrays
        for status in array.status
        for name, fault in FAULTS.items()
        if status.name.endswith(f": {name}") and fault in status.message and status.level != b"\0"
    }


def test_publishers_are_mixed_when_their_names_are_known_or_stay_unknown(
    peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Publishers are discovered before the names of their nodes."""
    from geometry_msgs.msg import PoseStamped

    publishers = [peer.publisher("/named_later", PoseStamped) for _ in range(2)]
    peer.until(lambda: peer.node.count_publishers("/named_later") == 2, "two publishers")
    known = subscriptions._publishers_of

    def unnamed(*arguments: Any) -> list[Any]:
        return [
            SimpleNamespace(
                node_name="_NODE_NAME_UNKNOWN_",
                topic_type=item.topic_type,
                qos_profile=item.qos_profile,
            )
            for item in known(*arguments)
        ]

    later, never = (PoseSource(peer.node, "/named_later") for _ in range(2))
    monkeypatch.setattr(subscriptions, "_publishers_of", unnamed)
    for item in (later, never):
        item.match()
        assert not item.mixed
    never.match()
    for item in publishers:
        peer.until(lambda: item.get_subscription_count() == 2, "both have subscribed")  # noqa: B023

    def alternate() -> bool:
        for item in publishers:
            item.publish(pose(1.0, 0.0))
        for item in (later, never):
            item.take(None)
        return all(item.inputs[0].senders.alternate for item in (later, never))

    assert not never.mixed
    peer.until(alternate, "messages of both")
    assert "2 publishers are mixed (unknown, unknown)" in never.mixed
    monkeypatch.setattr(subscriptions, "_publishers_of", known)
    later.match()
    assert "2 publishers are mixed (peer, peer)" in later.mixed
    for item in (later, never):
        item.inputs[0].leave()
    for publisher in publishers:
        peer.node.destroy_publisher(publisher)


_PUBLISHER = f"""
import time
import rclpy
from geometry_msgs.msg import PoseStamped
rclpy.init()
node = rclpy.create_node("driver")
topics = "{GROUNDTRUTH}", "{GOOD}"
publishers = [node.create_publisher(PoseStamped, topic, 10) for topic in topics]
while True:
    message = PoseStamped()
    message.header.stamp = node.get_clock().now().to_msg()
    message.pose.position.x = time.time() % 60.0
    message.pose.orientation.w = 1.0
    for publisher in publishers:
        publisher.publish(message)
    time.sleep(0.02)
"""


def test_a_publisher_that_was_killed_and_started_again_is_a_restart(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    """The middleware lists a killed publisher for some seconds more."""
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseStamped

    arrays = peer.hear("/diagnostics", DiagnosticArray)
    poses = peer.hear(GOOD, PoseStamped)
    with evaluating(tmp_path / "out", environment, lengths="none") as live:
        for start in ("first", "second"):
            driver = subprocess.Popen([sys.executable, "-c", _PUBLISHER], env=environment)
            try:
                live.wait_for(f"subscribed to {GOOD}")
                if start == "first":
                    peer.until(lambda: len(poses) > 250, "its poses")
                else:
                    for topic in (GROUNDTRUTH, GOOD):
                        live.wait_for(f"{topic}: its publisher was restarted")
            finally:
                driver.kill()
                driver.wait()
        live.end()
    assert not [
        status.message for array in arrays for status in array.status if "mixed" in status.message
    ]
    assert live.printed.count("its publisher was restarted") == 2  # of both topics
    remarks = [remark for run in live.result["runs"] for remark in run["remarks"]]
    assert "mixed_publishers" not in {remark["code"] for remark in remarks}
