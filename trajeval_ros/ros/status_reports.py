"""The periodic report about all estimates: diagnostics, events and the status line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from trajeval_ros.online.notices import Notice
from trajeval_ros.online.reports import Update
from trajeval_ros.ros.diagnostics import diagnose, notices_about
from trajeval_ros.ros.diagnostics_topic import DiagnosticsTopic
from trajeval_ros.ros.events import EventTopic
from trajeval_ros.ros.graph import about_twins
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_outputs import LiveOutputs
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.terminal import summary
from trajeval_ros.ros.unused_messages import missing_source
from trajeval_ros.ros.watching import Watching

if TYPE_CHECKING:
    from rclpy.node import Node


class StatusReports:
    """Publishes the status of a run and the events about its changes."""

    def __init__(self, node: Node, events: EventTopic, watching: Watching) -> None:
        """Create the publisher of diagnostics.

        Args:
            node: The ROS node.
            events: Topic of the events.
            watching: Receives the same notices, and adds its own statuses.
        """
        self._node, self._events, self._watching = node, events, watching
        self._diagnostics = DiagnosticsTopic(node)

    def publish(
        self, run: LiveRun, outputs: LiveOutputs, values: Mapping[str, Any], undrawn: int
    ) -> list[str]:
        """Publish diagnostics and new events; return the estimates' parts of the status line.

        Args:
            run: The run.
            outputs: Its published errors. Estimates without a snapshot are left out.
            values: The parameters.
            undrawn: Number of updates that Rerun did not receive.
        """
        node, twins = self._node.get_fully_qualified_name(), about_twins(self._node)
        statuses, parts = [], []
        for estimate in run.estimates:
            snapshot = outputs.snapshots.get(estimate.name)
            if snapshot is None:
                continue
            newest = outputs.newest.get(estimate.name, Update())
            peaks = estimate.peaks.take()
            notices = notices_about(run, estimate, snapshot, peaks, values)
            notices += [*twins, *outputs.notices(estimate)]
            self._publish_changes(estimate, notices)
            statuses.append(
                diagnose(node, run, estimate, snapshot, newest, notices, peaks, undrawn)
            )
            missing = missing_source(run, estimate)
            parts.append(
                summary(estimate.name, snapshot, values["window"], newest.position_m, missing)
            )
        self._diagnostics.publish([*statuses, *self._watching.statuses()])
        return parts

    def _publish_changes(self, estimate: LiveEstimate, notices: Sequence[Notice]) -> None:
        """Publish the notices that are new, more severe, or no longer true."""
        # Every jump was published as an event.
        told = estimate.standing.renew(each for each in notices if each.kind != "jump")
        for each in told:
            self._events.publish(estimate.name, each)
        self._watching.see(told)
