"""`time_offset:=auto` over the network."""

from __future__ import annotations

from pathlib import Path

import pytest
from calibration_flights import Fault, fly
from ros_bags import ODOM, POSE, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Peer, assert_same, offline, play_without_loss

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros


def test_a_clock_is_found_and_applied(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    groundtruth, estimate = fly(1, 50.0, fault=Fault(0.1))
    bag = tmp_path / "bag"
    messages = [
        *messages_of(groundtruth[::4], GROUNDTRUTH, POSE),
        *messages_of(estimate, ODOMETRY, ODOM),
    ]
    write_messages(bag, sorted(messages, key=lambda message: message[2]))
    nodes = {"auto": {"gauge": "yaw", "time_offset": "auto"}, "plain": {"gauge": "yaw"}}
    flown = play_without_loss(bag, peer, environment, tmp_path, nodes, rate=8.0)

    (plain,) = flown["plain"].result["runs"]
    assert plain["association"]["time_offset_s"] == 0.0
    assert plain["live"]["clock"]["status"] == "significant"

    (result,) = flown["auto"].result["runs"]
    offset_s = result["association"]["time_offset_s"]
    assert offset_s == pytest.approx(0.1, abs=5e-3)
    assert any(
        "applied, estimated from the first" in remark["text"] for remark in result["remarks"]
    )
    options = ("--gauge", "yaw", "--time-offset", repr(offset_s))
    recorded = offline(bag, tmp_path, GROUNDTRUTH, [ODOMETRY], *options)["runs"][0]
    assert_same({**result, "remarks": []}, {**recorded, "remarks": []})
