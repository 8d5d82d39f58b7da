"""The topics of a live watch: an estimate, second estimates, map corrections, and an IMU."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.bags.rate_messages import IMU_TYPE
from trajeval_ros.online.notices import OK, WARN, Notice
from trajeval_ros.ros.live_watch import Batches, WatchedMessages
from trajeval_ros.ros.message_types import is_installed
from trajeval_ros.ros.sides import Side
from trajeval_ros.ros.subscriptions import TopicInput
from trajeval_ros.watchdog.signals import pair_sources

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rclpy.node import Node


class WatchedTopics:
    """Subscribes to the topics of the watch, separately from those of the evaluation.

    Attributes:
        estimate: The watched estimate.
        others: Second estimates, and transforms from the map, by source.
    """

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        """Start to search for publishers.

        Args:
            node: The subscribing node.
            values: The parameters.

        Raises:
            SettingsError: A name is not valid, two second estimates have the same one, or
                messages of an IMU can't be received.
        """
        imu, corrections = values["imu_topic"], values["map_to_odom"]
        self.estimate = Side(node, values["estimate_topics"][0])
        partners = [Side(node, each) for each in values["watch_with"]]
        sources = pair_sources([each.name for each in partners])
        self.others = dict(zip(sources, partners, strict=True))
        if corrections:
            self.others["map"] = Side(node, corrections)
        if imu and not is_installed(IMU_TYPE):
            raise SettingsError(
                f"imu_topic {imu} needs sensor_msgs; install ros-$ROS_DISTRO-sensor-msgs, or "
                "remove it"
            )
        self._imu = TopicInput(node, imu, [IMU_TYPE]) if imu else None
        self._estimates: list[Any] = []
        self._of_others: dict[str, list[Any]] = {each: [] for each in self.others}
        self._readings: list[bytes] = []

    @property
    def _sides(self) -> list[Side]:
        return [self.estimate, *self.others.values()]

    def match(self) -> list[Notice]:
        """Connect to the current publishers; returns notices."""
        told = [each for side in self._sides for each in side.match()]
        if self._imu is not None and (said := self._imu.match()):
            level = OK if said.startswith("subscribed") else WARN
            told.append(Notice("publishers", level, said))
        return told

    def gather(self) -> None:
        """Receive the messages that have arrived."""
        if self._imu is not None:
            self._readings += self._imu.take().payloads
        for source, each in self.others.items():
            self._of_others[source] += each.take(None)
        self._estimates += self.estimate.take(None)

    def gathered(self) -> WatchedMessages:
        """Return the messages gathered since the last call."""
        estimates: Batches
        estimates, self._estimates = self._estimates, []
        others, self._of_others = self._of_others, {each: [] for each in self.others}
        readings, self._readings = self._readings, []
        return WatchedMessages(estimates, others, readings)
