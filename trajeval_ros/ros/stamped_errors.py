"""Errors of every pair as `geometry_msgs/Vector3Stamped`, under `~/NAME/stamped/`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.online.pair_errors import PairErrors

if TYPE_CHECKING:
    from rclpy.node import Node

_QUEUE = 1000  # messages: those of a tick come together
_VECTORS: dict[str, Callable[[PairErrors], Floats | None]] = {
    "position_error": lambda errors: errors.position,
    "rotation_error": lambda errors: errors.rotation_vector_deg,
    "velocity_error": lambda errors: errors.velocity,
    "attitude_error": lambda errors: errors.attitude_deg,
    "heading_error": lambda errors: errors.along_cross_vertical,
}
_BY_UP = {"attitude_error", "heading_error"}


class StampedErrors:
    """Publishers of one estimate; a vector without a subscriber is not even computed."""

    def __init__(self, node: Node, name: str) -> None:
        """Advertise them."""
        from geometry_msgs.msg import Vector3Stamped

        self._publishers = {
            each: node.create_publisher(Vector3Stamped, f"~/{name}/stamped/{each}", _QUEUE)
            for each in _VECTORS
        }

    def publish(self, errors: PairErrors, frame: str, offset_ns: int, *, knows_up: bool) -> None:
        """Publish the errors of N pairs.

        Args:
            errors: Of the pairs.
            frame: The groundtruth's.
            offset_ns: What was added to the estimate's stamps, which are published as they were.
            knows_up: False withholds what depends on the up axis.
        """
        for name, publisher in self._publishers.items():
            if not publisher.get_subscription_count() or (name in _BY_UP and not knows_up):
                continue
            vectors = _VECTORS[name](errors)
            if vectors is None:
                continue
            rows = np.flatnonzero(np.isfinite(vectors).all(axis=1))
            stamps = (errors.stamps[rows] - offset_ns).tolist()
            for stamp, vector in zip(stamps, vectors[rows].tolist(), strict=True):
                publisher.publish(_message(stamp, frame, vector))


def _message(stamp: int, frame: str, vector: list[float]) -> Any:
    from geometry_msgs.msg import Vector3Stamped

    message = Vector3Stamped()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
    message.header.frame_id = frame
    message.vector.x, message.vector.y, message.vector.z = vector
    return message
