"""GNSS fixes and points over DDS: the node's results are those of the recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from fix_runs import DATUM, fix_messages, fixes_of, later, quality
from ros_bags import ODOM, POINT, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Peer, assert_same, offline, play_without_loss

from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

LEVER = (0.3, -0.1, 0.5)
ARM = ",".join(map(str, LEVER))
LATE_S = 1.5


def test_fixes_that_come_late(peer: Peer, environment: dict[str, str], tmp_path: Path) -> None:
    pytest.importorskip("sensor_msgs")
    flight = simulate(6, 40.0)
    groundtruth = flight.groundtruth[::80]  # 2.5 Hz
    assert groundtruth.rotations is not None
    rows = quality(len(groundtruth))
    rows[10:20, 2:] *= 400.0
    fixes = fixes_of(
        groundtruth.stamps, groundtruth.positions + groundtruth.rotations.apply(LEVER), rows
    )
    estimate = flight.estimate[60:]  # fixes before the first estimate
    bag = tmp_path / "bag"
    sent = later(fix_messages(fixes, GROUNDTRUTH), LATE_S)
    write_messages(bag, [*sent, *messages_of(estimate, ODOMETRY, ODOM)])
    common = {"lengths": "4,8", "lever_arm": ARM}
    gates = {"datum": str(DATUM), "min_fix_status": 2.0, "max_fix_sigma": 0.05}
    nodes = {
        "plain": common,
        "gated": {**common, **gates, "gauge": "planar", "fix_correlation": 30.0},
    }
    done = play_without_loss(bag, peer, environment, tmp_path, nodes, rate=4.0)
    options = {
        "plain": [],
        "gated": [
            "--datum", str(DATUM), "--min-fix-status", "2", "--max-fix-sigma", "0.05",
            "--fix-correlation", "30", "--gauge", "planar",
        ],
    }  # fmt: skip
    for name, own in options.items():
        words = ["--lengths", "4,8", "--lever-arm", ARM, *own]
        recorded = offline(bag, tmp_path, GROUNDTRUTH, [ODOMETRY], *words)
        result = done[name].result
        assert_same(result, recorded)
        assert_same(result["groundtruth"]["fixes"], recorded["groundtruth"]["fixes"])
        [run] = result["runs"]
        assert run["association"]["method"] == "groundtruth-stamps"
        assert run["noise_corrected_ate"] is not None
    assert "the alignment uses gauge yaw" in done["plain"].printed
    assert done["gated"].result["groundtruth"]["fixes"]["datum"] == asdict(DATUM)


def test_a_wheeled_robot_s_bag(
    peer: Peer,
    environment: dict[str, str],
    shared_data: Path,
    reference: Callable[[str], Any],
    tmp_path: Path,
) -> None:
    """Of a real robot: 989 fixes of a receiver, and odometry of its wheels."""
    pytest.importorskip("sensor_msgs")
    bag, odometry = shared_data / "gnss" / "husky_outdoor.bag", "/husky_velocity_controller/odom"
    husky = reference("gnss")["husky"]
    datum = ",".join(map(repr, husky["datum"]))
    common = {"groundtruth": "/fix", "estimates": [odometry], "lengths": "20,40,80"}
    nodes = {
        "planar": {**common, "gauge": "planar", "datum": datum},
        "plain": {**common, "datum": datum},
    }
    done = play_without_loss(bag, peer, environment, tmp_path, nodes, rate=27.0)
    for name, gauge in {"planar": "planar", "plain": "yaw"}.items():
        words = ["--gauge", gauge, "--lengths", "20,40,80", "--datum", datum]
        recorded = offline(bag, tmp_path, "/fix", [odometry], *words)
        outcome = done[name].result
        # Another gauge cannot be tried on the pairs of a live run, so it has no advice there.
        for result in (outcome, recorded):
            [run] = result["runs"]
            assert {diagnosi["cause"] for diagnosi in run["diagnosis"]} <= {"flat"}
            del run["diagnosis"]
            run["remarks"] = [remark for remark in run["remarks"] if remark["code"] != "flat"]
        assert_same(outcome, recorded)
        assert_same(outcome["groundtruth"]["fixes"], recorded["groundtruth"]["fixes"])
        [run] = outcome["runs"]
        known = husky["wheel_odometry"][f"{gauge}/none"]
        assert run["association"]["pairs"] == husky["wheel_odometry"]["pairs"]
        assert run["ate"]["position_m"]["rmse"] == pytest.approx(known["ate_3d"]["rmse"], rel=1e-9)


def test_surveyed_points(peer: Peer, environment: dict[str, str], tmp_path: Path) -> None:
    flight = simulate(9, 30.0)
    points = messages_of(flight.groundtruth[::200], GROUNDTRUTH, POINT)
    bag = tmp_path / "bag"
    write_messages(bag, [*points, *messages_of(flight.estimate, ODOMETRY, ODOM)])
    nodes = {"evaluator": {"gauge": "yaw", "lengths": "4"}}
    done = play_without_loss(bag, peer, environment, tmp_path, nodes, rate=4.0)["evaluator"]
    recorded = offline(bag, tmp_path, GROUNDTRUTH, [ODOMETRY], "--gauge", "yaw", "--lengths", "4")
    assert_same(done.result, recorded)
    assert done.result["runs"][0]["association"]["method"] == "groundtruth-stamps"
