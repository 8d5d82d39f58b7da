"""A robot at rest is a state and no fault; new warnings and errors are in the log, once."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_bags import ODOM, POSE, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Peer, evaluating

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros


def write_pair(bag: Path, groundtruth: Trajectory, estimate: Trajectory) -> None:
    both = [*messages_of(groundtruth, GROUNDTRUTH, POSE), *messages_of(estimate, ODOMETRY, ODOM)]
    write_messages(bag, sorted(both, key=lambda message: message[2]))


def at_rest(poses: Trajectory, noise_m: float) -> Trajectory:
    """Return the first pose at all times, with noise of the position."""
    assert poses.quaternions is not None
    noise = np.random.default_rng(1).normal(scale=noise_m, size=poses.positions.shape)
    return dataclasses.replace(
        poses,
        positions=poses.positions[0] + noise,
        quaternions=np.tile(poses.quaternions[0], (len(poses), 1)),
        velocities=None,
    )


def test_a_robot_that_never_moves_is_no_fault_and_has_a_result(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    flown = simulate(7, 25.0)
    write_pair(tmp_path / "bag", at_rest(flown.groundtruth, 0.0), at_rest(flown.estimate, 3e-3))
    heard = peer.hear("/diagnostics", DiagnosticArray)
    with evaluating(
        tmp_path / "live", environment, modality="stereo-inertial", autosave_period=1.0
    ) as live:
        peer.play(tmp_path / "bag", {GROUNDTRUTH: 1, ODOMETRY: 1}, ["evaluator"], rate=4.0)
        peer.until((live.folder / "result.json").exists, "results are written during the run")
        assert live.end() == 0
    statuses: list[Any] = [status for array in heard for status in array.status]
    errors = [status.message for status in statuses if status.level == b"\x02"]
    # The topics are silent after the bag, until the results are written.
    assert [
        text for text in errors if not text.startswith(("no groundtruth", "no estimate"))
    ] == []
    assert "no result" not in live.printed
    assert "can't be written" not in live.printed
    run = live.run_of(ODOMETRY)
    assert run["ate"]["position_m"]["rmse"] == pytest.approx(3e-3 * np.sqrt(3.0), rel=0.1)
    assert run["ate"]["rotation_deg"] is None
    assert run["diagnosis"] == []


def test_new_warnings_and_errors_are_logged_once(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    flown = simulate(7, 25.0)
    far = dataclasses.replace(flown.estimate, positions=1.2 * flown.estimate.positions)
    write_pair(tmp_path / "bag", flown.groundtruth, far)
    with evaluating(
        tmp_path / "live",
        environment,
        modality="stereo-inertial",
        limits_ate_position_m="0.001,0.002",
        limits_position_error_m="0.1,0.2",
    ) as live:
        peer.play(tmp_path / "bag", {GROUNDTRUTH: 1, ODOMETRY: 1}, ["evaluator"], rate=4.0)
        live.wait_for("] [evaluator]: vio_odometry: position ATE of the window")
        live.wait_for("] [evaluator]: vio_odometry: position error ")
        live.wait_for("vio_odometry: no groundtruth for")
        live.wait_for("vio_odometry: no estimate for")
        assert live.end() == 0
    lines = live.printed.splitlines()
    [alarm] = [line for line in lines if "position ATE of the window" in line]
    assert "[ERROR]" in alarm
    silences = [line for line in lines if ": no groundtruth for" in line]
    assert len(silences) == 1
    assert "[ERROR]" in silences[0]
    # Further events may be counted, but only after the alarm itself.
    first = next(line for line in lines if "position error " in line)
    assert "more event" not in first
