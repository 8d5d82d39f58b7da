"""What the evaluator is called on the network, and what it says where nobody watches."""

from __future__ import annotations

import os
import pty
import sys
from pathlib import Path

import pytest
from ros_processes import GROUNDTRUTH, Peer, evaluating

from trajeval_ros.ros.terminal import StatusLine

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros


def test_names_are_those_of_the_namespace_and_twins_are_told_of(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    heard = peer.hear("/diagnostics", DiagnosticArray)

    def told(text: str) -> bool:
        statuses = [item for array in heard for item in array.status]
        return any(status.name == name and text in status.message for status in statuses)

    name = "drone1/evaluator: vio_odometry"
    arguments = ["-r", "__ns:=/drone1"]
    options = {"estimates": ["vio/odometry", "/other/odometry"], "groundtruth": GROUNDTRUTH}
    with evaluating(tmp_path / "one", environment, *arguments, **options) as first:
        peer.until(
            lambda: told(f"no groundtruth yet on {GROUNDTRUTH}"), "diagnostics have full names"
        )
        assert not told("nodes have the name")
        topics = dict(peer.node.get_topic_names_and_types())
        assert "/drone1/evaluator/vio_odometry/position_error" in topics
        assert "/drone1/evaluator/other_odometry/position_error" in topics
        assert not any("drone1_" in topic for topic in topics)
        first.wait_for(
            f"vio_odometry: no messages yet on {GROUNDTRUTH}  |  other_odometry: no messages yet"
        )
        assert "\r" not in first.printed
        with evaluating(tmp_path / "two", environment, *arguments, **options):
            peer.until(lambda: told("2 nodes have the name /drone1/evaluator"), "twins")


def test_a_terminal_without_a_size_gets_whole_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    actual, theirs = pty.openpty()  # as `ros2 launch` makes it with emulate_tty
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        line, parts = StatusLine(), ["vio_odometry: ATE 0.141 m " * 10, "slam_path: no pairs yet"]
        assert line.show(parts) == "  |  ".join(parts)
        assert line.show(parts) is None  # not each second
        line.clear()
    os.set_blocking(actual, False)
    with pytest.raises(OSError):  # noqa: PT011 - nothing was written
        os.read(actual, 1)
    os.close(actual)
