"""`trajeval RECORDING` on the topics that named systems and datasets publish by default."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from made_bags import TYPES, header, write
from scipy.spatial.transform import Rotation, Slerp

from trajeval_ros.cli.app import main
from trajeval_ros.geometry.gauge import MODALITIES, Gauge
from trajeval_ros.simulation.drifting_odometry import simulate

Topic = tuple[str, str, str, str]  # name, message type, frame, child frame
POSE, POINT = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PointStamped"
UNCERTAIN = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM, PATH, ODOM = (
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Path",
    "nav_msgs/msg/Odometry",
)
IMU, IMAGE, CLOUD = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
SCAN = "sensor_msgs/msg/LaserScan"

CAM0, CAM1, IMU0 = ("/cam0/image_raw", IMAGE), ("/cam1/image_raw", IMAGE), ("/imu0", IMU)
POINTS, INERTIAL = ("/points_raw", CLOUD), ("/imu/data", IMU)
# Groundtruth as EuRoC, GrandTour, Gazebo and motion capture name it.
VICON = ("/vicon/firefly_sbx/firefly_sbx", TRANSFORM, "world", "vicon/firefly_sbx/firefly_sbx")
LEICA = ("/leica/position", POINT, "world", "")
BOX = ("/gt_box/inertial_explorer/tc/odometry", ODOM, "enu_origin", "cpt7_imu")
STATE = ("/ground_truth/state", ODOM, "world", "base_link")
MOCAP = ("/mocap/pose", POSE, "mocap", "")


class System(NamedTuple):
    source: str  # where the topics are stated
    groundtruth: Topic
    estimates: list[Topic]
    others: list[tuple[str, str]]  # topics of sensors
    modality: str  # "" if nothing tells the sensors, "two choices" if it is refused
    omitted: tuple[str, ...] = ()  # topics that are no estimates


def odometry(name: str, frame: str, child: str) -> Topic:
    return (name, ODOM, frame, child)


SYSTEMS = {
    "ORB-SLAM3": System("github.com/thien94/orb_slam3_ros README.md", LEICA,
        [("/orb_slam3/camera_pose", POSE, "world", "")], [CAM0, CAM1], "stereo"),
    "ORB-SLAM3 inertial": System("github.com/thien94/orb_slam3_ros README.md", VICON,
        [("/orb_slam3_ros/camera_pose", POSE, "world", ""),
            odometry("/orb_slam3_ros/body_odom", "world", "imu")], [CAM0, IMU0], "mono-inertial"),
    "VINS-Fusion": System(
        "github.com/HKUST-Aerial-Robotics/VINS-Fusion src/utility/visualization.cpp",
        VICON, [odometry("/vins_estimator/odometry", "world", "world"),
            odometry("/vins_estimator/imu_propagate", "world", ""),
            odometry("/vins_estimator/extrinsic", "world", ""),
            ("/vins_estimator/path", PATH, "world", "")],
        [CAM0, CAM1, IMU0], "stereo-inertial", ("/vins_estimator/extrinsic",)),
    "OpenVINS": System("github.com/rpng/open_vins ov_msckf/src/ros/ROS2Visualizer.cpp", LEICA,
        [odometry("/ov_msckf/odomimu", "global", "imu"),
            ("/ov_msckf/poseimu", UNCERTAIN, "global", ""),
            ("/ov_msckf/pathimu", PATH, "global", "")], [CAM0, CAM1, IMU0], "stereo-inertial"),
    "OpenVINS, simulated": System("github.com/rpng/open_vins ov_msckf/src/ros/ROS2Visualizer.cpp",
        ("/ov_msckf/posegt", POSE, "global", ""),
        [odometry("/ov_msckf/odomimu", "global", "imu")], [], "stereo-inertial"),
    "FAST-LIO2": System("github.com/hku-mars/FAST_LIO src/laserMapping.cpp", MOCAP,
        [odometry("/Odometry", "camera_init", "body"), ("/path", PATH, "camera_init", "")],
        [POINTS, INERTIAL], "lidar-inertial"),
    "Point-LIO": System("github.com/hku-mars/Point-LIO src/laserMapping.cpp", MOCAP,
        [odometry("/aft_mapped_to_init", "camera_init", "aft_mapped")], [POINTS, INERTIAL],
        "lidar-inertial"),
    "A-LOAM": System("github.com/HKUST-Aerial-Robotics/A-LOAM src/laserMapping.cpp", MOCAP,
        [odometry("/aft_mapped_to_init", "camera_init", "aft_mapped")], [POINTS], "lidar"),
    "LIO-SAM": System("github.com/TixiaoShan/LIO-SAM src/mapOptmization.cpp", STATE,
        [odometry("/lio_sam/mapping/odometry", "odom", "odom_mapping"),
            odometry("/odometry/imu", "odom", "odom_imu"),
            ("/lio_sam/mapping/path", PATH, "odom", "")], [POINTS, INERTIAL], "lidar-inertial"),
    "DLIO": System("github.com/vectr-ucla/direct_lidar_inertial_odometry launch/dlio.launch", BOX,
        [odometry("/dlio/odom_node/odom", "odom", "base_link"),
            ("/dlio/odom_node/pose", POSE, "odom", "")], [], "lidar-inertial"),
    "KISS-ICP": System("github.com/PRBonn/kiss-icp ros/src/OdometryServer.cpp", STATE,
        [odometry("/kiss/odometry", "odom_lidar", "")], [POINTS, INERTIAL], "lidar"),
    "Kimera": System("github.com/MIT-SPARK/Kimera-VIO-ROS launch/kimera_vio_ros.launch", VICON,
        [odometry("/kimera_vio_ros/odometry", "world", "base_link"),
            ("/kimera_vio_ros/optimized_trajectory", PATH, "world", "")],
        [CAM0, CAM1, IMU0], "stereo-inertial"),
    "BASALT": System("github.com/berndpfrommer/basalt_ros src/vio_publisher.cpp", VICON,
        [odometry("/odom", "world", "odom")], [CAM0, CAM1, IMU0], "stereo-inertial"),
    "RTAB-Map": System("docs.ros.org rtabmap_slam", MOCAP,
        [odometry("/rtabmap/odom", "odom", "base_link"), ("/rtabmap/mapPath", PATH, "map", "")],
        [("/rgb/image_rect", IMAGE), ("/depth/image_raw", IMAGE)], "rgbd"),
    "OKVIS2": System("github.com/smartroboticslab/okvis2 okvis_ros2/src/Publisher.cpp", LEICA,
        [odometry("/okvis/okvis_odometry", "world", "body"),
            ("/okvis/okvis_transform", TRANSFORM, "world", "body")], [], "stereo-inertial"),
    "MSCKF": System("github.com/KumarRobotics/msckf_vio src/msckf_vio.cpp", VICON,
        [odometry("/firefly_sbx/vio/odom", "world", "odom")], [CAM0, CAM1, IMU0],
        "stereo-inertial"),
    "SVO": System("github.com/uzh-rpg/rpg_svo_pro_open svo_ros/src/visualizer.cpp", VICON,
        [("/svo/pose_imu", UNCERTAIN, "world", ""), ("/svo/pose_cam/0", POSE, "world", "")],
        [CAM0], "mono"),
    "SVO without images": System(
        "github.com/uzh-rpg/rpg_svo_pro_open svo_ros/src/visualizer.cpp", VICON,
        [("/svo/pose_imu", UNCERTAIN, "world", "")], [], ""),
    "Cartographer": System("github.com/ros2/cartographer_ros node_constants.h", STATE,
        [("/tracked_pose", POSE, "map", "")], [("/scan", SCAN)], "wheel"),
    "robot_localization": System("docs.ros.org robot_localization", STATE,
        [odometry("/odometry/filtered", "odom", "base_link"),
            odometry("/wheel/odom", "odom", "base_link")], [INERTIAL], "wheel"),
    "Nav2": System("docs.nav2.org", STATE,
        [odometry("/odom", "odom", "base_link"), ("/amcl_pose", UNCERTAIN, "map", ""),
            ("/goal_pose", POSE, "map", ""), ("/initialpose", UNCERTAIN, "map", "")],
        [("/scan", SCAN)], "wheel", ("/goal_pose", "/initialpose")),
    "PX4": System("docs.px4.io MAVROS", ("/mavros/mocap/pose", POSE, "map", ""),
        [("/mavros/local_position/pose", POSE, "map", ""),
            ("/mavros/setpoint_position/local", POSE, "map", "")],
        [("/mavros/imu/data", IMU)], "stereo-inertial", ("/mavros/setpoint_position/local",)),
    "ZED": System("www.stereolabs.com/docs/ros2", MOCAP,
        [odometry("/zed/zed_node/odom", "odom", "zed_camera_link"),
            ("/zed/zed_node/pose", POSE, "map", "")], [], "stereo-inertial"),
    "RealSense T265": System("github.com/IntelRealSense/realsense-ros README.md", MOCAP,
        [odometry("/camera/odom/sample", "camera_odom_frame", "camera_pose_frame")],
        [("/camera/gyro/sample", IMU), ("/camera/fisheye1/image_raw", IMAGE),
            ("/camera/fisheye2/image_raw", IMAGE)], "stereo-inertial"),
    "Isaac ROS Visual SLAM": System("nvidia-isaac-ros.github.io isaac_ros_visual_slam", MOCAP,
        [odometry("/visual_slam/tracking/odometry", "odom", "base_link"),
            odometry("/visual_slam/vis/slam_odometry", "map", "base_link"),
            ("/visual_slam/tracking/vo_pose", POSE, "odom", "")], [], "stereo-inertial"),
    "namespace of both": System("grand-tour.leggedrobotics.com", BOX,
        [odometry("/gt_box/zed2i/zed_node/odom", "odom", "zed2i_camera_link")], [], "two choices"),
    "no name": System("github.com/L2S-lab/natnet_ros2 README.md",
        ("/natnet_ros/robot/pose", POSE, "world", ""),
        [odometry("/vio/odometry", "odom", "base_link")], [], "two choices"),
}  # fmt: skip
STEPS = 60  # of the flight


def _type(name: str) -> Any:
    return TYPES[f"geometry_msgs/msg/{name}"]


def message(topic: Topic, stamp: int, position: Any, quaternion: Any) -> Any:
    """Return one pose as a message of the topic's type."""
    _, kind, frame, child = topic
    start, point = header(stamp, frame), _type("Point")(*position)
    rotation, zero = _type("Quaternion")(*quaternion), _type("Vector3")(0.0, 0.0, 0.0)
    pose = _type("Pose")(point, rotation)
    if kind == POINT:
        return TYPES[kind](start, point)
    if kind == TRANSFORM:
        moved = _type("Transform")(_type("Vector3")(*position), rotation)
        return TYPES[kind](start, child, moved)
    if kind == POSE:
        return TYPES[kind](start, pose)
    uncertain = _type("PoseWithCovariance")(pose, np.zeros(36))
    if kind == UNCERTAIN:
        return TYPES[kind](start, uncertain)
    twist = _type("TwistWithCovariance")(_type("Twist")(zero, zero), np.zeros(36))
    return TYPES[ODOM](start, child, uncertain, twist)


def sensor(kind: str, stamp: int) -> Any:
    """Return a message without data; only its type matters."""
    make, start, zeros = TYPES[kind], header(stamp), np.zeros(9)
    nothing, floats = np.zeros(0, dtype=np.uint8), np.zeros(0, dtype=np.float32)
    if kind == IMU:
        zero, rotation = _type("Vector3")(0.0, 0.0, 0.0), _type("Quaternion")(0.0, 0.0, 0.0, 1.0)
        return make(start, rotation, zeros, zero, zeros, zero, zeros)
    if kind == IMAGE:
        return make(start, 0, 0, "mono8", 0, 0, nothing)
    if kind == CLOUD:
        return make(start, 0, 0, [], False, 0, 0, nothing, True)
    return make(start, *np.zeros(7).tolist(), floats, floats)


def flight(*, is_flat: bool) -> tuple[Any, Any, Any, Any, Any]:
    """Return stamps, positions and quaternions of the groundtruth, and those of the estimate."""
    simulated = simulate(seed=2, duration_s=12.0)
    truth, estimate = (
        simulated.groundtruth,
        simulated.estimate[:: len(simulated.estimate) // STEPS],
    )
    times = np.clip(estimate.stamps, truth.stamps[0], truth.stamps[-1]) - truth.stamps[0]
    known = truth.stamps - truth.stamps[0]
    places = np.column_stack([np.interp(times, known, column) for column in truth.positions.T])
    rotations = Slerp(known, Rotation.from_quat(truth.quaternions))(times).as_quat()
    moved = estimate.positions.copy()
    if is_flat:
        places[:, 2], moved[:, 2] = 0.0, 0.3
    return estimate.stamps, places, rotations, moved, estimate.quaternions


def recording(folder: Path, system: System) -> tuple[Path, dict[str, Any]]:
    """Write a bag; return it with the written positions and the groundtruth's by topic."""
    stamps, places, rotations, moved, rotated = flight(is_flat=system.modality == "wheel")
    sides: dict[str, Any] = {}
    messages: list[Any] = []
    for topic in (system.groundtruth, *system.estimates):
        name, kind, frame, _ = topic
        positions, quaternions, rows = moved, rotated, np.arange(len(stamps))
        if topic is system.groundtruth:
            positions, quaternions = places, rotations
        elif name.endswith("extrinsic"):
            positions = 0.01 + 1e-4 * np.sin(moved)
        elif name in ("/goal_pose", "/initialpose"):
            rows = rows[:2]
        poses = [
            (int(stamps[row]), message(topic, int(stamps[row]), positions[row], quaternions[row]))
            for row in rows
        ]
        if kind == PATH:  # all poses until now
            single = (name, POSE, frame, "")
            steps = [message(single, int(stamps[row]), moved[row], rotated[row]) for row in rows]
            poses = [
                (int(stamps[row]), TYPES[PATH](header(int(stamps[row]), frame), steps[: row + 1]))
                for row in (*rows[9::10], rows[-1])
            ]
        messages += [(name, kind, stamp, sent) for stamp, sent in poses]
        sides[name] = (positions[rows], places[rows])
    for name, kind in system.others:
        messages += [(name, kind, int(stamp), sensor(kind, int(stamp))) for stamp in stamps[::10]]
    return write(folder / "run", sorted(messages, key=lambda item: item[2])), sides


def aligned_rmse(estimate: Any, truth: Any, gauge: Gauge) -> float:
    """Return the ATE of positions (N, 3) by numpy: Umeyama (1991), or his solution in a plane."""
    size = 2 if gauge is Gauge.PLANAR else 3
    estimate, truth = estimate[:, :size], truth[:, :size]
    centred, target = estimate - estimate.mean(axis=0), truth - truth.mean(axis=0)
    free = 2 if gauge in (Gauge.YAW, Gauge.PLANAR) else 3  # axes that rotate into each other
    left, values, right = np.linalg.svd(target[:, :free].T @ centred[:, :free])
    signs = np.ones(free)
    signs[-1] = np.sign(np.linalg.det(left @ right))
    rotation = np.eye(size)
    rotation[:free, :free] = left @ np.diag(signs) @ right
    scale = values @ signs / np.sum(centred**2) if gauge is Gauge.SIM3 else 1.0
    errors = scale * centred @ rotation.T - target
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_numbers_of_a_named_system(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    system = SYSTEMS[name]
    bag, sides = recording(tmp_path, system)
    saved = tmp_path / "result.json"
    status = main([str(bag), f"--json={saved}"])
    printed = capsys.readouterr()
    if system.modality == "two choices":
        assert status == 2
        assert len(printed.out.splitlines()) == 2
        assert not saved.exists()
        return
    assert status == 0
    assert f"groundtruth {system.groundtruth[0]}: by its name" in printed.err
    for topic in system.omitted:
        assert f"{topic} omitted: " in printed.err
    modality = f"--modality {system.modality}" if system.modality else "sensors unknown"
    assert modality in printed.out + printed.err
    runs = json.loads(saved.read_text(encoding="utf-8"))["runs"]
    results = {run["estimate"]["source"].rpartition(":")[2]: run for run in runs}
    assert set(results) == {topic[0] for topic in system.estimates} - set(system.omitted)
    for topic, run in results.items():
        gauge = Gauge.of(run["alignment"]["gauge"])
        assert gauge is MODALITIES.get(system.modality, Gauge.SE3)
        expected = aligned_rmse(*sides[topic], gauge)
        assert run["ate"]["position_m"]["count"] == len(sides[topic][0])
        np.testing.assert_allclose(run["ate"]["position_m"]["rmse"], expected, rtol=1e-6)
