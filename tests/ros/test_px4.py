"""PX4's odometry live: decoded as in a bag, and what the node says without its message classes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from ros_processes import assert_same, offline, play_without_loss

from trajeval_ros.io.bags.px4_messages import ODOMETRY, PX4_POSE_TYPES
from trajeval_ros.ros.subscriptions import _why_unmatched

TOPIC, TRUTH = "/fmu/out/vehicle_odometry", "/mocap/pose"


def test_a_topic_without_message_classes_names_what_to_build() -> None:
    node = SimpleNamespace(
        resolve_topic_name=lambda name: name,
        get_publishers_info_by_topic=lambda _: [SimpleNamespace(topic_type=ODOMETRY)],
    )
    assert _why_unmatched(cast("Any", node), TOPIC, PX4_POSE_TYPES) == (
        "/fmu/out/vehicle_odometry has type px4_msgs/msg/VehicleOdometry, which is not installed; "
        "build PX4/px4_msgs (branch release/1.16 for PX4 1.16) in this workspace"
    )


@pytest.mark.ros
def test_live_results_are_those_of_the_bag(
    shared_data: Path, environment: dict[str, str], peer: Any, tmp_path: Path
) -> None:
    pytest.importorskip("px4_msgs", reason=".ci/make_tf2_msgs has not built px4_msgs")
    bag = shared_data / "px4" / "synthetic_1_16.mcap"
    if not bag.is_file():
        pytest.skip("../shared/data/px4 is not beside the repository")
    node = {"groundtruth": TRUTH, "estimates": [TOPIC], "modality": "gnss-aided"}
    done = play_without_loss(bag, peer, environment, tmp_path, {"evaluator": node}, 3.0)
    live = done["evaluator"].result
    recorded = offline(bag, tmp_path, TRUTH, [TOPIC], "--modality", "gnss-aided")
    (run,), (other,) = live["runs"], recorded["runs"]
    for part in ("association", "alignment", "ate", "re"):
        assert_same(run[part], other[part], part)
    # Resets that the estimator declares are events live, and a list of both results.
    assert len(other["estimate"]["resets"]) == 2
    assert_same(run["estimate"]["resets"], other["estimate"]["resets"], "resets")
    (told,), (also_told,) = (
        [remark for remark in side["estimate"]["remarks"] if remark["code"] == "declared_resets"]
        for side in (run, other)
    )
    assert told == also_told
    assert run["association"]["pairs"] == 2400
    assert run["ate"]["position_m"]["rmse"] == pytest.approx(1.0776, abs=1e-3)
