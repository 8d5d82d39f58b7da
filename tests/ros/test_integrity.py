"""Protection levels over DDS: those of the recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from consistency_runs import with_growing_covariances
from ros_bags import ODOM, POSE, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Peer, evaluating

from trajeval_ros import CovarianceRequest, Protocol, simulate
from trajeval_ros.consistency.covariance_request import IntegrityRequest
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.online.error_topics import PROTECTION_LEVELS
from trajeval_ros.pipeline.pipeline import run
from trajeval_ros.pipeline.request import Request

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros


def test_protection_levels_are_published_as_the_recording_has_them(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from std_msgs.msg import Float64

    flown = simulate(7, 25.0)
    estimate = with_growing_covariances(flown.estimate)
    bag = tmp_path / "bag"
    both = [
        *messages_of(flown.groundtruth[::2], GROUNDTRUTH, POSE),
        *messages_of(estimate, ODOMETRY, ODOM),
    ]
    write_messages(bag, sorted(both, key=lambda item: item[2]))
    asked = Request(
        Protocol(gauge="yaw", align_states=1, lengths=()),
        covariances=CovarianceRequest("message"),
        integrity=IntegrityRequest(0.5, 2.0, 0.01),
    )
    groundtruth, told = (read_trajectory(f"{bag}:{item}") for item in (GROUNDTRUTH, ODOMETRY))
    expected = run(groundtruth, [told], asked).runs[0].integrity
    assert expected is not None
    newest = {PROTECTION_LEVELS[part.part]: float(part.levels[-1]) for part in expected.parts}
    assert newest.keys() == set(PROTECTION_LEVELS.values())
    heard = {name: peer.hear(f"/evaluator/vio_odometry/{name}", Float64) for name in newest}
    values: dict[str, Any] = {
        "gauge": "yaw", "align_states": "1", "lengths": "none", "window": "0",
        "covariance": "message", "alert_limit": "0.5,2", "risk": 0.01,
    }  # fmt: skip
    with evaluating(tmp_path / "live", environment, **values) as live:
        peer.play(bag, {GROUNDTRUTH: 1, ODOMETRY: 1}, ["evaluator"], rate=8.0)
        for name, level in newest.items():
            peer.until(
                lambda: any(item.data == pytest.approx(level, rel=1e-9) for item in heard[name]),  # noqa: B023
                f"the newest {name}, {level:g}, after {[item.data for item in heard[name]][-3:]}",
            )
        assert live.end() == 0
