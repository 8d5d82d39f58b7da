"""Groundtruth of a marker over DDS: hints without `hand_eye`, the offline numbers with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from marker_flights import of_marker, write_mounting
from ros_bags import ODOM, POSE, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Peer, assert_same, offline, play_without_loss

from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

WITHIN_S = 30.0  # of motion


def test_a_marker_is_told_of_in_time_and_applied_from_a_file(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    flight, file = simulate(5, 30.0), str(write_mounting(tmp_path))
    bag = tmp_path / "bag"
    write_messages(
        bag,
        [
            *messages_of(of_marker(flight.groundtruth), GROUNDTRUTH, POSE),
            *messages_of(flight.estimate, ODOMETRY, ODOM),
        ],
    )
    heard = peer.hear("/diagnostics", DiagnosticArray)
    common = {"gauge": "yaw", "lengths": "4,8"}
    nodes = {"plain": common, "mounted": {**common, "hand_eye": file}}
    done = play_without_loss(bag, peer, environment, tmp_path, nodes, rate=3.0)

    def statuses(node: str) -> list[DiagnosticStatus]:
        return [item for array in heard for item in array.status if node in item.name]

    def warns_of_body(status: DiagnosticStatus) -> bool:
        return status.level == DiagnosticStatus.WARN and "hand_eye:=auto" in status.message

    peer.until(lambda: any(map(warns_of_body, statuses("plain"))), "the marker is told of")
    rate = len(flight.estimate) / flight.estimate.duration_s
    first = next(filter(warns_of_body, statuses("plain")))
    [pairs] = [int(value.value) for value in first.values if value.key == "pairs"]
    assert pairs <= WITHIN_S * rate
    assert not any(map(warns_of_body, statuses("mounted")))

    options = ["--gauge", "yaw", "--lengths", "4,8", "--hand-eye", file]
    recorded = offline(bag, tmp_path, GROUNDTRUTH, [ODOMETRY], *options)
    recorded["runs"][0]["calibration"]["ate"]["before"] = None  # live, nobody pairs the marker
    assert_same(done["mounted"].result, recorded)
    [told] = [
        remark["text"]
        for remark in done["plain"].result["runs"][0]["remarks"]
        if "--hand-eye" in remark["text"]
    ]
    assert "is probably of another body" in told
