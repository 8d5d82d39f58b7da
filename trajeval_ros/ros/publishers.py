"""What the evaluator publishes about one estimate, under `~/NAME/`."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.pose_messages import encode_path
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.online.trail import Trail
from trajeval_ros.ros.stamped_errors import StampedErrors

if TYPE_CHECKING:
    from rclpy.node import Node

_PATH_EVERY_S = 1.0


class Outputs:
    """Publishers of one estimate; numbers without a subscriber cost nothing.

    Errors are `std_msgs/Float64`, which PlotJuggler and rqt_plot draw as they are, and vectors
    with stamps: `StampedErrors`.
    """

    def __init__(self, node: Node, name: str) -> None:
        """Advertise what doesn't depend on settings."""
        from geometry_msgs.msg import TransformStamped
        from nav_msgs.msg import Path
        from rclpy.qos import DurabilityPolicy, QoSProfile

        self._node, self._name = node, name
        self._numbers: dict[str, Any] = {}
        for each in ("position_error", "rotation_error", "yaw_error", "tilt_error"):
            self._advertise(each)
        for each in ("ate_position", "ate_rotation"):
            self._advertise(each)
        self._stamped = StampedErrors(node, name)
        # Whoever comes late sees the newest alignment and paths at once.
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._alignment = node.create_publisher(TransformStamped, f"~/{name}/alignment", latched)
        self._paths = {
            each: node.create_publisher(Path, f"~/{name}/{each}", latched)
            for each in ("aligned_path", "groundtruth_path")
        }
        self._path_at = 0.0

    def advertise_lengths(self, lengths: Iterable[str]) -> None:
        """Advertise the relative errors of these lengths; a topic's name can't begin with 8."""
        for each in lengths:
            self._advertise(_relative_error(each))

    def advertise_revised(self) -> None:
        """Advertise the ATE of the newest path, which only estimates that are paths have."""
        self._advertise("revised_ate_position")

    def publish_update(
        self, update: Update, frame: str, offset_ns: int, *, knows_up: bool
    ) -> None:
        """Publish the errors of new pairs, and of sub-trajectories that have ended.

        Args:
            update: What is new; of its pairs, plain numbers are about the newest one.
            frame: The groundtruth's.
            offset_ns: What was added to the estimate's stamps.
            knows_up: False withholds what depends on the up axis.
        """
        self._publish("position_error", update.position_m)
        self._publish("rotation_error", update.rotation_deg)
        for errors in update.errors:
            self._stamped.publish(errors, frame, offset_ns, knows_up=knows_up)
        if update.errors and knows_up:
            newest = update.errors[-1]
            for name, degrees in (("yaw_error", newest.yaw_deg), ("tilt_error", newest.tilt_deg)):
                self._publish(name, None if degrees is None else float(degrees[-1]))
        for end in update.ends:
            self._publish(_relative_error(end.length), end.position_m)

    def publish_snapshot(self, snapshot: Snapshot, revised_m: float | None) -> None:
        """Publish the errors of the window."""
        self._publish("ate_position", snapshot.window_position_rmse_m)
        rotation = snapshot.ate.get("rotation_deg")
        self._publish("ate_rotation", None if rotation is None else rotation.rmse)
        self._publish("revised_ate_position", revised_m)

    def publish_geometry(
        self, trail: Trail, alignment: Similarity, frame: str, child_frame: str
    ) -> None:
        """Publish the alignment, and paths in the groundtruth's frame, about once a second.

        Args:
            trail: What is left of the pairs.
            alignment: From the estimate's frame to the groundtruth's.
            frame: The groundtruth's.
            child_frame: The estimate's.
        """
        if time.monotonic() < self._path_at or not len(trail):
            return
        self._path_at = time.monotonic() + _PATH_EVERY_S
        stamps, truth, estimate = trail.columns()
        self._alignment.publish(_transform(alignment, int(stamps[-1]), frame, child_frame))
        turned = np.nan_to_num(estimate[:, 3:7])
        turned[~turned.any(axis=1), 3] = 1.0  # of positions alone
        self._paths["aligned_path"].publish(
            encode_path(
                stamps,
                alignment.positions(estimate[:, :3]),
                alignment.quaternions(turned),
                frame,
            )
        )
        true_turns = np.nan_to_num(truth[:, 3:7])
        true_turns[~true_turns.any(axis=1), 3] = 1.0
        self._paths["groundtruth_path"].publish(
            encode_path(stamps, truth[:, :3], true_turns, frame)
        )

    def _advertise(self, name: str) -> None:
        from std_msgs.msg import Float64

        if name not in self._numbers:
            self._numbers[name] = self._node.create_publisher(
                Float64, f"~/{self._name}/{name}", 10
            )

    def _publish(self, name: str, value: float | None) -> None:
        from std_msgs.msg import Float64

        if value is not None:
            self._numbers[name].publish(Float64(data=value))


def _relative_error(length: str) -> str:
    return f"relative_error/length_{length.replace('.', '_')}"


def _transform(alignment: Similarity, stamp: int, frame: str, child_frame: str) -> Any:
    """Return an alignment as a transform, which can't hold its scale."""
    from geometry_msgs.msg import TransformStamped

    message = TransformStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
    message.header.frame_id, message.child_frame_id = frame, child_frame
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = alignment.translation.tolist()
    rotation.x, rotation.y, rotation.z, rotation.w = alignment.rotation_xyzw.tolist()
    return message
