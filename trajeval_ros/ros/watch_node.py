"""The node without groundtruth: it monitors an estimate and evaluates nothing."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from trajeval_ros.ros.diagnostics_topic import DiagnosticsTopic
from trajeval_ros.ros.events import EventTopic
from trajeval_ros.ros.node_log import log
from trajeval_ros.ros.watching import Watching

if TYPE_CHECKING:
    from rclpy.node import Node


class WatchNode:
    """Watches an estimate, with the evaluator's name and parameters."""

    def __init__(self, node: Node, values: dict[str, Any]) -> None:
        """Create publishers and subscriptions.

        Args:
            node: The ROS node.
            values: Its parameters.

        Raises:
            InputError: The limits can't be read, or were learned without one of the sources.
            SettingsError: A topic's name is not valid.
        """
        self._values = values
        self._watching = Watching(node, values, EventTopic(node), partial(log, node))
        self._diagnostics = DiagnosticsTopic(node)
        log(node, "no groundtruth_topic: the estimate is watched without evaluation")

    @property
    def tick_period_s(self) -> float:
        """Time between two ticks, seconds."""
        period: float = 1.0 / self._values["publish_rate"]
        return period

    def tick(self) -> None:
        """Receive messages, and report alarms."""
        self._watching.tick()

    def report(self) -> None:
        """Match publishers."""
        self._watching.match()

    def tell(self) -> None:
        """Publish diagnostics."""
        self._diagnostics.publish(self._watching.statuses())

    def finish(self) -> bool:
        """Process the last messages; return True, because there is no output to write."""
        self._watching.conclude()
        return True
