"""Systems that `trajeval info` recognises by the type, name and frames of a topic.

The sources of the systems state what they publish. A wrong name is worse than none: frames that
many systems share, such as `odom` and `base_link`, identify none of them. Nothing is applied.
"""

from __future__ import annotations

import re
from typing import NamedTuple


class KnownSystem(NamedTuple):
    """A system, and how its topics are evaluated."""

    name: str
    topic: str  # regular expression of the end of the topic's name, "" for any
    frames: tuple[str | None, str | None]  # frame and child frame; None for any
    modality: str
    options: str  # further options of `trajeval evaluate`
    trap: str  # what to expect

    def matches(self, topic: str, frame: str, child: str) -> bool:
        """Return whether a topic can be of this system."""
        found = zip(self.frames, (frame, child), strict=True)
        return re.search(rf"(^|/){self.topic}$", topic) is not None and all(
            own is None or own == other for own, other in found
        )


_OF_MESSAGES = "--covariance message --rotation-covariance-frame body"
_ANY = (None, None)
_ODOMETRY, _POSE, _POSE_COVARIANCE, _PATH = (
    *("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"),
    *("geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Path"),
)
_ISAAC = "visual_slam/tracking/"
# By message type; the first match applies.
_SYSTEMS: dict[str, tuple[KnownSystem, ...]] = {
    _ODOMETRY: (
        KnownSystem("OpenVINS", "odomimu", ("global", "imu"), "stereo-inertial", _OF_MESSAGES,
            "rotation covariances are about the body's axes"),
        KnownSystem("VINS-Fusion", ".*odometry", ("world", "world"), "stereo-inertial", "",
            "the twist is in the world"),
        KnownSystem("FAST-LIO", "Odometry", ("camera_init", "body"), "lidar-inertial", "",
            "covariances have the rotation first"),
        KnownSystem("LOAM", ".*", ("camera_init", "aft_mapped"), "lidar", "",
            "the frame is of the first scan, not of a camera"),
        KnownSystem("KISS-ICP", "kiss/odometry", ("odom_lidar", None), "lidar", "",
            "covariances are parameters"),
        KnownSystem("Isaac ROS Visual SLAM", f"{_ISAAC}odometry", _ANY, "stereo-inertial", "",
            "covariances are the scatter of recent poses"),
        KnownSystem("rtabmap", "rtabmap/odom", _ANY, "rgbd", "",
            "covariances are of the last registration"),
        KnownSystem("robot_localization", "odometry/(filtered|local)", _ANY, "wheel", "",
            "two filters can publish on one topic"),
        KnownSystem("robot_localization", "odometry/global", _ANY, "gnss-aided", "",
            "two filters can publish on one topic"),
        KnownSystem("MOLA", "lidar_odometry/pose", ("map", ""), "lidar", "",
            "messages name no body"),
        KnownSystem("ZED", r"zed\w*/zed_node/odom", _ANY, "stereo-inertial", "",
            "poses can jump at loop closures"),
    ),
    _POSE_COVARIANCE: (
        KnownSystem("OpenVINS", "poseimu", ("global", None), "stereo-inertial", _OF_MESSAGES,
            "rotation covariances are about the body's axes"),
        KnownSystem("Isaac ROS Visual SLAM", f"{_ISAAC}vo_pose_covariance", _ANY,
            "stereo-inertial", "--covariance message", "covariances are of the estimator"),
        KnownSystem("AMCL", "amcl_pose", ("map", None), "wheel", "",
            "height, roll and pitch have variance zero"),
        KnownSystem("slam_toolbox", "pose", ("map", None), "wheel", "",
            "height, roll and pitch have variance zero"),
    ),
    _POSE: (
        KnownSystem("Spectacular AI", "slam/odometry", ("world", None), "stereo-inertial",
            "--hand-eye auto", "the body is a camera with optical axes"),
        KnownSystem("ZED", r"zed\w*/zed_node/pose", ("map", None), "stereo-inertial", "",
            "poses can jump at loop closures"),
    ),
    _PATH: (
        KnownSystem("Isaac ROS Visual SLAM", f"{_ISAAC}slam_path", _ANY, "stereo-inertial", "",
            "the path is revised at loop closures"),
        KnownSystem("rtabmap", "rtabmap/mapPath", _ANY, "rgbd", "",
            "the path is revised at loop closures"),
    ),
    "px4_msgs/msg/VehicleOdometry": (
        KnownSystem("PX4", ".*vehicle_(visual|mocap)_odometry", _ANY, "stereo-inertial", "",
            "converted to ROS axes"),
        KnownSystem("PX4", ".*", _ANY, "gnss-aided", "", "converted to ROS axes"),
    ),
}  # fmt: skip


def recognised(message_type: str, topic: str, frame: str, child: str) -> KnownSystem | None:
    """Return the system that probably publishes a topic; None if no system fits."""
    candidates = _SYSTEMS.get(message_type, ())
    return next((each for each in candidates if each.matches(topic, frame, child)), None)
