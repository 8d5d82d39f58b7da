"""evo's absolute pose error, number by number."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.protocol import PROTOCOLS
from trajeval_ros.pipeline.pipeline import evaluate

Recording = Callable[[str], Trajectory]
Reference = Callable[[str], Any]

FILES = {
    "tum fr2_desk_groundtruth.txt fr2_desk_ORB.txt": (
        "tum/fr2_desk_groundtruth.txt",
        "tum/fr2_desk_ORB.txt",
    ),
    "kitti KITTI_00_gt.txt KITTI_00_ORB.txt": ("kitti/KITTI_00_gt.txt", "kitti/KITTI_00_ORB.txt"),
    "euroc V102_groundtruth.csv V102.txt": (
        "euroc/groundtruth/V1_02_asl.csv",
        "euroc/V1_02_estimate.txt",
    ),
}
TOPICS = ("ORB-SLAM", "S-PTAM")
GAUGES = {"": Gauge.NONE, "-a ": Gauge.SE3, "-as ": Gauge.SIM3}
METRICS = {"trans_part": "position_m", "angle_deg": "rotation_deg"}


def assert_evos(
    groundtruth: Trajectory, estimate: Trajectory, command: str, flags: str, numbers: Any
) -> None:
    protocol = dataclasses.replace(PROTOCOLS["evo"], gauge=GAUGES[flags])
    result = evaluate(groundtruth, estimate, protocol)
    for relation, metric in METRICS.items():
        required = f"evo_ape {command} {flags}-r {relation}"
        (theirs,) = [item for item in numbers["results"] if item["cmd"] == required]
        actual = result.ate[metric]
        assert actual is not None
        assert actual.count == len(result.association) == theirs["n"]
        for name in ("rmse", "mean", "median", "std", "min", "max"):
            expected = pytest.approx(theirs["stats"][name], rel=1e-8)
            assert getattr(actual, name) == expected, (metric, name)


@pytest.mark.parametrize("flags", GAUGES)
@pytest.mark.parametrize("command", FILES, ids=["fr2_desk", "KITTI_00", "V1_02"])
def test_absolute_errors_are_evos(
    command: str, flags: str, recording: Recording, reference: Reference
) -> None:
    groundtruth, estimate = (recording(name) for name in FILES[command])
    assert_evos(groundtruth, estimate, command, flags, reference("evo"))


@pytest.mark.slow
@pytest.mark.parametrize("flags", GAUGES)
@pytest.mark.parametrize("topic", TOPICS)
def test_absolute_errors_of_topics_in_a_bag_are_evos(
    topic: str, flags: str, recording: Recording, reference: Reference
) -> None:
    groundtruth, estimate = (
        recording(f"bags/ROS_example.bag:{item}") for item in ("groundtruth", topic)
    )
    command = f"bag ROS_example.bag groundtruth {topic}"
    assert_evos(groundtruth, estimate, command, flags, reference("evo"))


def test_of_repeated_stamps_evo_takes_the_last(recording: Recording) -> None:
    # `evo_ape tum -a`. The first ones are outliers of 10 m, which give 0.57 m.
    groundtruth, estimate = (
        recording(f"hilti_2021/uzh_run2_{name}.txt") for name in ("mocap", "hdl")
    )
    actual = evaluate(groundtruth, estimate, PROTOCOLS["evo"]).ate["position_m"]
    assert actual is not None
    assert actual.count == 893
    assert actual.rmse == pytest.approx(0.352249, abs=5e-7)


def test_default_warns_of_repeated_stamps_that_conflict(recording: Recording) -> None:
    groundtruth, estimate = (
        recording(f"hilti_2021/uzh_run2_{name}.txt") for name in ("mocap", "hdl")
    )
    begin = "uzh_run2_mocap has 2 repeated timestamps (of 1787) with different positions"
    (text,) = (text for text in evaluate(groundtruth, estimate).warnings if text.startswith(begin))
    assert "up to 10.1 m apart" in text
