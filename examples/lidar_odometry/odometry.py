"""Lidar odometry: small_gicp, KISS-ICP or one of your own, as a ROS 2 node or in one process.

    python -m examples.lidar_odometry.odometry ESTIMATOR [--subscribers 2]

ESTIMATOR is `small_gicp`, `kiss_icp` or a Python file with a class `Estimator`. The node receives
/points and publishes /NAME, and /NAME/points: the scan without the distortion by the motion, and
without what is above the body.
"""

from __future__ import annotations

import argparse
import runpy
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from examples.lidar_odometry.world import FARTHEST_M, NEAREST_M, PERIOD_S, Flight
from trajeval_ros import Trajectory
from trajeval_ros.geometry.arrays import Floats

VOXEL_M = 1.0
ROOF_M = 0.6  # above the body: a view from above must not show the ceiling


class Estimator(Protocol):
    """What an estimator must have."""

    def register(self, points: Floats, after: Floats) -> Floats:
        """Process a sweep of the lidar.

        Args:
            points: (N, 3) in the frame of the body at the time of each point, metres.
            after: Times (N,) of the points after the beginning of the sweep, seconds.

        Returns:
            The pose at the end of the sweep, (4, 4), in a frame of the estimator's choice.
        """


class KissIcp:
    """KISS-ICP, with a map of its own."""

    def __init__(self) -> None:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        config = KISSConfig()
        config.mapping.voxel_size = VOXEL_M
        config.data.min_range, config.data.max_range = NEAREST_M, FARTHEST_M
        config.registration.max_num_threads = 1  # 0 takes all cores from the other processes
        self._odometry = KissICP(config)

    def register(self, points: Floats, after: Floats) -> Floats:
        """Return the pose at the end of a sweep."""
        self._odometry.register_frame(points, after / PERIOD_S)
        return np.asarray(self._odometry.last_pose)


class SmallGicp:
    """Generalised ICP of small_gicp against a map of voxels, at constant velocity."""

    def __init__(self) -> None:
        import small_gicp

        self._gicp = small_gicp
        self._map = small_gicp.GaussianVoxelMap(VOXEL_M)
        self._map.set_lru(horizon=300, clear_cycle=10)
        self._pose, self._step = np.eye(4), np.eye(4)

    def register(self, points: Floats, after: Floats) -> Floats:
        """Return the pose at the end of a sweep."""
        still = undistorted(points, after, self._step)
        cloud, _ = self._gicp.preprocess_points(still, 0.25, num_threads=1)
        if self._map.size():
            result = self._gicp.align(
                self._map,
                cloud,
                self._pose @ self._step,
                max_correspondence_distance=1.5,
                max_iterations=20,
                num_threads=1,
            ).T_target_source
            self._step = np.linalg.inv(self._pose) @ result
            self._pose = result
        self._map.insert(cloud, self._pose)
        return self._pose


def undistorted(points: Floats, after: Floats, step: Floats) -> Floats:
    """Return points (N, 3) in the frame of the body at the end of the sweep.

    Args:
        points: In the frame of the body at their times.
        after: Their times (N,) after the beginning, seconds.
        step: Motion of the body during a sweep, (4, 4); its velocity is taken as constant.
    """
    left = (after / PERIOD_S - 1.0)[:, None]
    rotation = Rotation.from_matrix(step[:3, :3]).as_rotvec()
    return np.asarray(Rotation.from_rotvec(left * rotation).apply(points) + left * step[:3, 3])


def estimator_of(name: str) -> Estimator:
    """Return an estimator by its name or the path of its file."""
    kinds: dict[str, Any] = {"small_gicp": SmallGicp, "kiss_icp": KissIcp}
    kind = kinds[name] if name in kinds else runpy.run_path(name)["Estimator"]
    made: Estimator = kind()
    return made


def in_one_process(name: str, sweeps: int, flight: Flight) -> Trajectory:
    """Return the odometry of the first sweeps of a flight, without ROS."""
    estimator, stamps, poses = estimator_of(name), [], []
    for number in range(sweeps):
        stamp, points, after = flight.sweep(number)
        # As they are transmitted.
        points, after = (item.astype(np.float32).astype(float) for item in (points, after))
        poses.append(estimator.register(points, after).copy())
        stamps.append(stamp + end_of_sweep_ns())
    matrices = np.array(poses)
    return Trajectory(
        name=Path(name).stem,
        stamps=np.array(stamps),
        positions=matrices[:, :3, 3],
        quaternions=Rotation.from_matrix(matrices[:, :3, :3]).as_quat(),
    )


def end_of_sweep_ns() -> int:
    """Return the time from the stamp of a cloud to the time of its pose, ns.

    The lidar stamps the beginning, and the estimators undo the motion towards the last point.
    """
    return round(PERIOD_S * 1e9)


def run_node(name: str, subscribers: int, arguments: Sequence[str]) -> None:
    """Publish the odometry until SIGINT; clouds are received after `subscribers` are there."""
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import PointCloud2

    from trajeval_ros.ros.lifetime import ros

    with ros(arguments) as stop:
        node = rclpy.create_node(Path(name).stem)
        estimator, before = estimator_of(name), np.eye(4)
        topic = f"/{Path(name).stem}"
        odometry = node.create_publisher(Odometry, topic, QoSProfile(depth=50))
        undone = node.create_publisher(PointCloud2, f"{topic}/points", QoSProfile(depth=5))

        def receive(cloud: Any) -> None:
            nonlocal before
            rows = np.frombuffer(cloud.data, np.float32).reshape(-1, 4).astype(float)
            points, after = rows[:, :3], rows[:, 3]
            pose = estimator.register(points, after).copy()
            stamp = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
            stamp += end_of_sweep_ns()
            odometry.publish(_odometry(pose, stamp, f"{Path(name).stem}_odom"))
            rows[:, :3] = undistorted(points, after, np.linalg.inv(before) @ pose)
            undone.publish(cloud_message(rows[points[:, 2] < ROOF_M], stamp))
            before = pose

        while odometry.get_subscription_count() < subscribers and not stop.is_asked_for:
            time.sleep(0.02)
        node.create_subscription(PointCloud2, "/points", receive, QoSProfile(depth=5))
        while not stop.is_asked_for:
            rclpy.spin_once(node, timeout_sec=0.1)
        odometry.wait_for_all_acked(Duration(seconds=30))
        node.destroy_node()


def _odometry(pose: Floats, stamp: int, frame: str) -> Any:
    from nav_msgs.msg import Odometry

    message = Odometry(child_frame_id="base_link")
    set_header(message.header, stamp, frame)
    fill_pose(message.pose.pose, pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat())
    return message


def fill_pose(message: Any, position: Floats, quaternion: Floats) -> None:
    """Set a geometry_msgs/Pose to a position (3,) and a quaternion xyzw (4,)."""
    p, q = message.position, message.orientation
    p.x, p.y, p.z = position.tolist()
    q.x, q.y, q.z, q.w = quaternion.tolist()


def set_header(header: Any, stamp: int, frame: str) -> None:
    """Set timestamp, ns, and frame of a std_msgs/Header."""
    header.stamp.sec, header.stamp.nanosec = divmod(stamp, 10**9)
    header.frame_id = frame


def cloud_message(rows: Floats, stamp: int) -> Any:
    """Return a sensor_msgs/PointCloud2 with x, y, z and time of the points, (N, 4)."""
    from sensor_msgs.msg import PointCloud2, PointField

    cloud = PointCloud2(height=1, width=len(rows), point_step=16, row_step=16 * len(rows))
    cloud.is_dense = True
    cloud.fields = [
        PointField(name=name, offset=4 * place, datatype=PointField.FLOAT32, count=1)
        for place, name in enumerate("xyzt")
    ]
    cloud.data.frombytes(rows.astype(np.float32).tobytes())
    set_header(cloud.header, stamp, "base_link")
    return cloud


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Lidar odometry as a ROS 2 node.")
    parser.add_argument("estimator", help="small_gicp, kiss_icp, or a file with Estimator")
    parser.add_argument("--subscribers", type=int, default=0, help="number to wait for")
    known, remaining = parser.parse_known_args()
    run_node(known.estimator, known.subscribers, remaining)
