"""What takes long keeps no output waiting, however long it takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import ros_processes
from paths import SUPPORT
from ros_bags import ODOM, POSE, messages_of, write_messages
from ros_processes import GROUNDTRUTH, Peer, evaluating

from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

ESTIMATES = ("/one", "/two", "/three", "/four")


def test_four_estimates_go_on_while_clocks_and_hints_are_looked_for(
    peer: Peer, environment: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import Vector3Stamped

    monkeypatch.setattr(ros_processes, "EVALUATOR", SUPPORT.joinpath("blocked_evaluator.py"))
    go_on = tmp_path / "go_on"
    flown = simulate(4, 42.0)
    feed = messages_of(flown.groundtruth[::4], GROUNDTRUTH, POSE)
    for topic in ESTIMATES:
        feed += messages_of(flown.estimate, topic, ODOM)
    write_messages(tmp_path / "bag", feed)
    kind, name = Vector3Stamped, "stamped/position_error"
    errors = {estimate: peer.hear(f"/evaluator{estimate}/{name}", kind) for estimate in ESTIMATES}
    statuses = peer.hear("/diagnostics", DiagnosticArray)
    with evaluating(
        tmp_path / "live",
        {**environment, "UNTIL_FILE": str(go_on)},
        estimates=ESTIMATES,
        gauge="yaw",
        lengths="none",
        autosave_period=0,
    ) as live:
        subscribers = dict.fromkeys((GROUNDTRUTH, *ESTIMATES), 1)
        peer.play(tmp_path / "bag", subscribers, ["evaluator"], rate=4.0)
        # A clock is estimated from 35 s on, a hint looked for from 5 s on; both wait.
        for item in ("calibrate", "hints_about"):
            peer.until((tmp_path / item).exists, f"{item} is asked for")
        last = int(flown.groundtruth[::4].stamps[-1])
        for topic, heard in errors.items():
            peer.until(lambda heard=heard: heard and newest_ns(heard) > last - 100_000_000, topic)
        before = len(statuses)
        peer.until(lambda: len(statuses) > before, "diagnostics go on")
        assert not go_on.exists()
        go_on.touch()
        assert live.end() == 0
    runs = live.result["runs"]
    assert len(runs) == len(ESTIMATES)
    assert all(run["live"]["clock"]["offset_s"] is not None for run in runs)


def newest_ns(heard: list[Any]) -> int:
    stamp = heard[-1].header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)
