"""Alignments on `/tf`, if requested: from the groundtruth frame to the estimate frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.io.bags.encode_messages import encode_transforms
from trajeval_ros.io.bags.pose_messages import TRANSFORM_TYPES
from trajeval_ros.online.notices import WARN, Notice
from trajeval_ros.ros.advertise import advertise
from trajeval_ros.ros.message_types import message_class

if TYPE_CHECKING:
    from rclpy.node import Node


class FrameBroadcaster:
    """Broadcasts one transform per frame of the estimates.

    A frame has one parent. If another node publishes a different parent of an estimate's frame,
    the TF tree is invalid.
    """

    def __init__(self, node: Node, gauge: Gauge) -> None:
        """Create the publisher.

        Raises:
            SettingsError: The gauge has a scale, which a transform can't contain, or transforms
                can't be published.
        """
        if gauge.has_scale:
            raise SettingsError(
                f"broadcast_tf can't publish gauge {gauge.value}, since a transform has no "
                "scale; remove it, or use a gauge without scale"
            )
        kind = message_class(TRANSFORM_TYPES[0])
        if kind is None:
            raise SettingsError("broadcast_tf needs tf2_msgs; install ros-$ROS_DISTRO-tf2-msgs")
        self._publisher = advertise(node, kind, "/tf")
        self._owners: dict[str, str] = {}
        self._refused: dict[str, Notice] = {}

    def publish(
        self, name: str, alignment: Similarity, stamp: int, frame: str, child_frame: str
    ) -> None:
        """Publish an estimate's alignment.

        Args:
            name: Name of the estimate.
            alignment: Similarity from the estimate's frame to the groundtruth's frame.
            stamp: Timestamp of the newest pair, nanoseconds.
            frame: Frame of the groundtruth.
            child_frame: Frame of the estimate.
        """
        owner = self._owners.setdefault(child_frame, name)
        why = ""
        if not frame or not child_frame or frame == child_frame:
            why = f"two frame names are required, found {frame!r} and {child_frame!r}"
        elif owner != name:
            why = f"{child_frame} is also the frame of {owner}, and a frame has only one parent"
        self._refused.pop(name, None)
        if why:
            said = f"broadcast_tf:=true has no effect for {name}: {why}"
            self._refused[name] = Notice("hint", WARN, said, "broadcast_tf")
            return
        pose = np.concatenate([alignment.translation, alignment.rotation_xyzw])
        stamps = np.array([stamp], dtype=np.int64)
        self._publisher.publish(
            bytes(encode_transforms(stamps, pose[None], (frame, child_frame))[0])
        )

    def notices(self, name: str) -> list[Notice]:
        """Return why the alignment of an estimate is not broadcast; empty if it is."""
        return [self._refused[name]] if name in self._refused else []
