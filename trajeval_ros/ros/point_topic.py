"""Scans of a lidar for the picture: few points of few messages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.ros.message_types import message_class, require_installed
from trajeval_ros.ros.subscriptions import TopicInput

if TYPE_CHECKING:
    from rclpy.node import Node


CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
MOST_POINTS = 2500
_EVERY_NS = NANOSECONDS // 2
_DEPTH = 5  # a scan may have megabytes
_NUMBERS = {7: "f4", 8: "f8"}  # FLOAT32 and FLOAT64, by the constants of sensor_msgs/PointField


class PointTopic:
    """Receives scans; two per second of their timestamps pass."""

    def __init__(self, node: Node, topic: str) -> None:
        require_installed(CLOUD_TYPE, f"rerun_points {topic}", "remove it")
        self._input = TopicInput(node, topic, [CLOUD_TYPE], depth=_DEPTH)
        self._slot = -1  # half second of the newest scan that passed
        self._is_refused = False
        self._news: list[str] = []

    def match(self) -> list[str]:
        """Connect to the present publishers; return sentences for the log."""
        texts = [item for item in (self._input.match(), *self._news) if item]
        self._news.clear()
        return texts

    def take(self) -> Iterator[tuple[int, Floats]]:
        """Yield timestamp, ns, and points (N, 3), metres, of the new scans."""
        from rclpy.serialization import deserialize_message

        for payload in self._input.take().payloads:
            cloud = deserialize_message(payload, message_class(CLOUD_TYPE))
            stamp = cloud.header.stamp.sec * NANOSECONDS + cloud.header.stamp.nanosec
            if stamp // _EVERY_NS == self._slot:
                continue
            self._slot = stamp // _EVERY_NS
            points = points_of(cloud)
            if points is not None:
                yield stamp, points
            elif not self._is_refused:
                self._is_refused = True
                self._news.append(
                    f"{self._input.topic}: scans without x, y and z as floating-point numbers are "
                    "not drawn"
                )


def points_of(cloud: Any) -> Floats | None:
    """Return at most 2500 finite points (N, 3) of a PointCloud2, evenly over its order.

    None if it has no coordinates, or fewer bytes than its points need.
    """
    order = ">" if cloud.is_bigendian else "<"
    places = {
        field.name: (f"{order}{_NUMBERS[field.datatype]}", field.offset)
        for field in cloud.fields
        if field.datatype in _NUMBERS
    }
    if not places.keys() >= {*"xyz"}:
        return None
    formats, offsets = zip(*(places[axis] for axis in "xyz"), strict=True)
    count = cloud.width * cloud.height
    try:
        kind = np.dtype(
            {
                "names": [*"xyz"],
                "formats": formats,
                "offsets": offsets,
                "itemsize": cloud.point_step,
            }
        )
        # Rows of an image-like cloud may be padded.
        rows = np.ndarray(
            (cloud.height, cloud.width),
            kind,
            cloud.data,
            strides=(cloud.row_step, cloud.point_step),
        )
    except (TypeError, ValueError):
        return None
    some = np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(np.int64))
    chosen = rows[np.divmod(some, max(cloud.width, 1))]
    points = np.stack([chosen[axis] for axis in "xyz"], axis=1).astype(float)
    finite: Floats = points[np.isfinite(points).all(axis=1)]
    return finite
