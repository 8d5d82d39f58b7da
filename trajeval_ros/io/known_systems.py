"""Systems that `trajeval info` recognises by the type, name and frames of a topic.

The sources of the systems state what they publish. A wrong name is worse than none: frames that
many systems share, such as `odom` and `base_link`, identify none of them. Nothing is applied.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple


class KnownSystem(NamedTuple):
    """A system, and how its topics are evaluated."""

    name: str
    topic: str  # regular expression of the end of the topic's name, "" for any
    frames: tuple[str | None, str | None]  # frame and child frame; None for any
    modality: str  # "" if it can have several
    trap: str  # what to expect
    options: str = ""  # further options of `trajeval evaluate`

    def matches(self, topic: str, frame: str, child: str) -> bool:
        """Return whether a topic can be of this system."""
        pairs = zip(self.frames, (frame, child), strict=True)
        return re.search(rf"(^|/){self.topic}$", topic) is not None and all(
            expected is None or expected == other for expected, other in pairs
        )


_ANY, _ISAAC, _VIO = (None, None), "visual_slam/tracking/", "stereo-inertial"
_OF_BODY = "rotation covariances are about the body's axes"
_OF_MESSAGES = "--covariance message --rotation-covariance-frame body"
_JUMPS, _REVISED = "poses can jump at loop closures", "the path is revised at loop closures"
_TWO, _FLAT = "two filters can publish on one topic", "height, roll and pitch have variance zero"
_CONVERTED = "converted to ROS axes"
# By message type: rows of `KnownSystem`; the first match applies.
_SYSTEMS: dict[str, tuple[tuple[Any, ...], ...]] = {
    "nav_msgs/msg/Odometry": (
        ("OpenVINS", "odomimu", ("global", "imu"), _VIO, _OF_BODY, _OF_MESSAGES),
        ("VINS-Fusion", ".*odometry", ("world", "world"), _VIO, "the twist is in the world"),
        ("FAST-LIO", "Odometry", ("camera_init", "body"), "lidar-inertial",
            "covariances have the rotation first"),
        # With or without an IMU: the other topics show it.
        ("LOAM", ".*", ("camera_init", "aft_mapped"), "",
            "the frame is of the first scan, not of a camera"),
        ("KISS-ICP", "kiss/odometry", ("odom_lidar", None), "lidar",
            "covariances are parameters"),
        ("Isaac ROS Visual SLAM", f"{_ISAAC}odometry", _ANY, _VIO,
            "covariances are the scatter of recent poses"),
        ("rtabmap", "rtabmap/odom", _ANY, "rgbd", "covariances are of the last registration"),
        ("robot_localization", "odometry/(filtered|local)", _ANY, "wheel", _TWO),
        ("robot_localization", "odometry/global", _ANY, "gnss-aided", _TWO),
        ("MOLA", "lidar_odometry/pose", ("map", ""), "lidar", "messages name no body"),
        ("ZED", r"zed\w*/zed_node/odom", _ANY, _VIO, _JUMPS),
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        ("OpenVINS", "poseimu", ("global", None), _VIO, _OF_BODY, _OF_MESSAGES),
        ("Isaac ROS Visual SLAM", f"{_ISAAC}vo_pose_covariance", _ANY, _VIO,
            "covariances are of the estimator", "--covariance message"),
        ("AMCL", "amcl_pose", ("map", None), "wheel", _FLAT),
        ("slam_toolbox", "pose", ("map", None), "wheel", _FLAT),
    ),
    "geometry_msgs/msg/PoseStamped": (
        ("Spectacular AI", "slam/odometry", ("world", None), _VIO,
            "the body is a camera with optical axes", "--hand-eye auto"),
        ("ZED", r"zed\w*/zed_node/pose", ("map", None), _VIO, _JUMPS),
    ),
    "nav_msgs/msg/Path": (
        ("Isaac ROS Visual SLAM", f"{_ISAAC}slam_path", _ANY, _VIO, _REVISED),
        ("rtabmap", "rtabmap/mapPath", _ANY, "rgbd", _REVISED),
    ),
    "px4_msgs/msg/VehicleOdometry": (
        ("PX4", ".*vehicle_(visual|mocap)_odometry", _ANY, _VIO, _CONVERTED),
        ("PX4", ".*", _ANY, "gnss-aided", _CONVERTED),
    ),
}  # fmt: skip


def recognised(message_type: str, topic: str, frame: str, child: str) -> KnownSystem | None:
    """Return the system that probably publishes a topic; None if no system fits."""
    candidates = (KnownSystem(*item) for item in _SYSTEMS.get(message_type, ()))
    return next(
        (candidate for candidate in candidates if candidate.matches(topic, frame, child)), None
    )
