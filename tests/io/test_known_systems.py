"""Systems that `info` recognises; frames that many systems share name none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from paths import SHARED
from ros_bags import STORE, write_messages

from trajeval_ros.cli.app import app
from trajeval_ros.io.describe import describe, recognised

ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
SYSTEMS = [
    ("OpenVINS", ODOMETRY, "/ov_msckf/odomimu", "global", "imu"),
    ("VINS-Fusion", ODOMETRY, "/vins_estimator/odometry", "world", "world"),
    ("FAST-LIO", ODOMETRY, "/Odometry", "camera_init", "body"),
    ("LOAM", ODOMETRY, "/aft_mapped_to_init", "camera_init", "aft_mapped"),
    ("KISS-ICP", ODOMETRY, "/kiss/odometry", "odom_lidar", "base_link"),
    ("Isaac ROS Visual SLAM", ODOMETRY, "/visual_slam/tracking/odometry", "odom", "base_link"),
    ("rtabmap", ODOMETRY, "/rtabmap/odom", "odom", "base_link"),
    ("robot_localization", ODOMETRY, "/odometry/filtered", "odom", "base_link"),
    ("MOLA", ODOMETRY, "/lidar_odometry/pose", "map", ""),
    ("ZED", ODOMETRY, "/zed2i/zed_node/odom", "odom", "zed_camera_link"),
    ("OpenVINS", WITH_COVARIANCE, "/ov_msckf/poseimu", "global", ""),
    ("AMCL", WITH_COVARIANCE, "/robot1/amcl_pose", "map", ""),
    ("slam_toolbox", WITH_COVARIANCE, "/pose", "map", ""),
    ("Spectacular AI", POSE, "/slam/odometry", "world", ""),
    ("rtabmap", "nav_msgs/msg/Path", "/rtabmap/mapPath", "map", ""),
    ("PX4", "px4_msgs/msg/VehicleOdometry", "/fmu/out/vehicle_odometry", "map_enu", ""),
]


@pytest.mark.parametrize(("name", "kind", "topic", "frame", "child"), SYSTEMS)
def test_topics_of_systems(name: str, kind: str, topic: str, frame: str, child: str) -> None:
    result = recognised(kind, topic, frame, child)
    assert result is not None
    assert result.name == name


@pytest.mark.parametrize(
    ("kind", "topic", "frame", "child"),
    [
        (ODOMETRY, "/odom", "odom", "base_link"),
        (ODOMETRY, "/good", "global", "imu"),
        (ODOMETRY, "/odometry", "world", "imu"),
        (ODOMETRY, "/my_odomimu", "global", "imu"),
        (POSE, "/pose", "map", ""),
        (WITH_COVARIANCE, "/mocap_pose", "map", ""),
        ("geometry_msgs/msg/PointStamped", "/Odometry", "camera_init", "body"),
    ],
)
def test_other_topics_have_no_name(kind: str, topic: str, frame: str, child: str) -> None:
    assert recognised(kind, topic, frame, child) is None


def odometry(seconds: int, frame: str, child: str) -> bytes:
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](1000 + seconds, 0)
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](float(seconds), float(seconds**2), 0.5),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8),
    )
    vector = types["geometry_msgs/msg/Vector3"]
    message = types[ODOMETRY](
        types["std_msgs/msg/Header"](stamp, frame),
        child,
        types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
        types["geometry_msgs/msg/TwistWithCovariance"](
            types["geometry_msgs/msg/Twist"](vector(1.0, 2.0, 3.0), vector(0.0, 0.0, 0.0)),
            np.zeros(36),
        ),
    )
    return bytes(STORE.serialize_cdr(message, ODOMETRY))


def test_info_prints_a_complete_command(tmp_path: Path) -> None:
    """A twist of a body with the name of the frame is in that frame."""
    topics = {
        "/groundtruth/odom": ("odom", "base_link"),
        "/vins_estimator/odometry": ("world", "world"),
        "/other": ("odom", "base_link"),
    }
    messages = [
        (topic, ODOMETRY, (1000 + index) * 10**9, odometry(index, *frames))
        for topic, frames in topics.items()
        for index in range(20)
    ]
    bag = tmp_path / "bag"
    write_messages(bag, messages)
    output = CliRunner().invoke(app, ["info", str(bag)]).output
    assert "/vins_estimator/odometry: looks like VINS-Fusion: the twist is in the world" in output
    start = f"trajeval evaluate -g {bag}:/groundtruth/odom"
    command = f"{start} -e {bag}:/vins_estimator/odometry --modality stereo-inertial"
    assert command in output
    assert f"{start} -e {bag}:/other --modality wheel" in output  # its height is constant
    assert "twist in the fixed frame: child_frame_id equals frame_id" in output
    ran = CliRunner().invoke(app, command.split()[1:])
    assert ran.exit_code == 0, ran.output
    assert "velocity [m/s]" in ran.output
    assert "the groundtruth is of body" not in ran.output


@pytest.mark.skipif(not (SHARED / "data" / "px4").is_dir(), reason="the PX4 logs are not here")
def test_of_px4() -> None:
    result = describe(str(SHARED / "data" / "px4" / "synthetic_1_16.mcap")).trajectories
    names = {item.source.rpartition("/")[2]: item.system and item.system.name for item in result}
    assert names["vehicle_odometry"] == "PX4"
    assert names["pose"] is None
