"""Recorded outputs of real estimators, replayed: live results are those of the recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from ros_processes import GROUNDTRUTH, assert_same, offline, play_without_loss

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("bag", "modality", "covariance", "rate"),
    [
        ("v1_01/bag", "mono-inertial", "message", 10.0),
        ("lidar/lockstep/bag", "lidar", "none", 10.0),
    ],
    ids=["v1_01", "lidar"],
)
def test_live_results_of_three_estimators_are_those_of_the_bag(
    bag: str,
    modality: str,
    covariance: str,
    rate: float,
    shared_data: Path,
    environment: dict[str, str],
    peer: Any,
    tmp_path: Path,
) -> None:
    path = shared_data / "real_estimators" / bag
    if not path.is_dir():
        pytest.skip(f"../shared/data/real_estimators/{bag} is not beside the repository")
    topics = estimates(path)
    assert len(topics) == 3
    node = {"estimates": topics, "modality": modality, "covariance": covariance}
    # In the bag, poses of GTSAM arrive up to 40 s after their stamps.
    nodes = {"evaluator": {**node, "max_delay": 60.0}}
    done = play_without_loss(path, peer, environment, tmp_path, nodes, rate)
    options = ["--modality", modality, "--covariance", covariance]
    recorded = offline(path, tmp_path, GROUNDTRUTH, topics, *options)
    assert_same(done["evaluator"].result, recorded)


def estimates(path: Path) -> list[str]:
    """Return the topics of odometry in a bag."""
    from trajeval_ros.io.bags.bag import Bag

    with Bag(path) as opened:
        return sorted(topic.name for topic in opened.topics if topic.type.endswith("Odometry"))
