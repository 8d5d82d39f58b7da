"""Monitoring with or without an evaluation: the watch, and snapshots on an alarm."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.remarks import Level, Remark, most_severe_first, warning
from trajeval_ros.io.bags.rate_messages import IMU_TYPE
from trajeval_ros.online.alarms import ActiveAlarms
from trajeval_ros.ros.live_watch import LiveWatch, WatchedMessages, WatchReport
from trajeval_ros.ros.message_types import require_installed
from trajeval_ros.ros.pose_source import PoseSource, about_publishers
from trajeval_ros.ros.slow_evaluation import BackgroundTask
from trajeval_ros.ros.status_topics import DiagnosticsTopic, EventTopic, log, status_message
from trajeval_ros.ros.subscriptions import TopicInput
from trajeval_ros.watchdog.signals import pair_sources

if TYPE_CHECKING:
    from rclpy.node import Node


class WatchNode:
    """Watches an estimate, with the evaluator's name and parameters."""

    def __init__(self, node: Node, values: dict[str, Any]) -> None:
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

    def publish_status(self) -> None:
        """Publish diagnostics."""
        self._diagnostics.publish(self._watching.statuses())

    def save(self) -> None:
        """Do nothing, because there is no output to write."""

    def finish(self) -> bool:
        """Process the last messages; return True, because there is no output to write."""
        self._watching.conclude()
        return True


_SNAPSHOT_PATIENCE_S = 10.0
# Least time between two calls. The recorder's memory covers about as much time, so that a snapshot
# soon after another one has the same messages again.
_SNAPSHOT_PAUSE_S = 60.0


class Snapshots:
    """Calls the snapshot service of a recorder that runs in snapshot mode."""

    def __init__(self, node: Node, service: str) -> None:
        try:
            from rosbag2_interfaces.srv import Snapshot
        except ImportError as error:
            raise SettingsError(
                f"snapshot_service {service} needs rosbag2_interfaces; install "
                "ros-$ROS_DISTRO-rosbag2-interfaces, or remove it"
            ) from error
        try:
            self._client = node.create_client(Snapshot, service)
        except Exception as error:  # rclpy's exceptions here have no common base class
            reason = " ".join(str(error).split())
            raise SettingsError(f"{service!r} is not a service name: {reason}") from error
        self._request, self._name = Snapshot.Request, self._client.srv_name
        self._free_at = 0.0
        self._answer: Any = None
        self._late_at = 0.0
        self._is_asked_for = False

    def trigger(self) -> None:
        """Request a snapshot, unless the last request is too recent."""
        now = time.monotonic()
        if now >= self._free_at:
            self._free_at = now + _SNAPSHOT_PAUSE_S
            self._is_asked_for = True

    def renew(self) -> tuple[str, Level] | None:
        """Call the service or check its response; return a sentence and its level."""
        if self._is_asked_for:
            self._is_asked_for = False
            if not self._client.service_is_ready():
                return (
                    f"no snapshot: no service {self._name}; start ros2 bag record with "
                    "--snapshot-mode",
                    Level.WARNING,
                )
            self._answer = self._client.call_async(self._request())
            self._late_at = time.monotonic() + _SNAPSHOT_PATIENCE_S
        if self._answer is None:
            return None
        if self._answer.done():
            answer, self._answer = self._answer.result(), None
            if answer.success:
                return f"snapshot taken by {self._name}", Level.NOTE
            return f"no snapshot: {self._name} refused", Level.WARNING
        if time.monotonic() < self._late_at:
            return None
        self._client.remove_pending_request(self._answer)
        self._answer = None
        text = f"no snapshot: no answer of {self._name} within {_SNAPSHOT_PATIENCE_S:g} s"
        return text, Level.WARNING


# Processing one message takes about as much CPU time as processing twenty.
_LOOK_EVERY_S = 0.1
_MOST_SHARE = 0.25  # largest share of a core, for topics with high rates
_STALE_AFTER_S = 5.0

Log = Callable[[str, Level], object]


class EstimateWatch:
    """Watches the first estimate on its own thread, by subscriptions of its own."""

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        imu, corrections = values["imu_topic"], values["map_to_odom"]
        self._estimate = PoseSource(node, values["estimate_topics"][0])
        partners = [PoseSource(node, value) for value in values["watch_with"]]
        sources = pair_sources([partner.name for partner in partners])
        # Second estimates, and transforms from the map, by source.
        self._others = dict(zip(sources, partners, strict=True))
        if corrections:
            self._others["map"] = PoseSource(node, corrections)
        if imu:
            require_installed(IMU_TYPE, f"imu_topic {imu}", "remove it")
        self._imu = TopicInput(node, imu, [IMU_TYPE]) if imu else None
        self._watch = LiveWatch(
            values["watch_factor"],
            self._estimate.stream,
            {source: other.stream for source, other in self._others.items()},
            has_imu=bool(imu),
        )
        self._task: BackgroundTask[WatchReport] = BackgroundTask(_MOST_SHARE)
        self._look_at = 0.0
        self._forget_gathered()
        self._report = WatchReport()
        self.name = f"{self._estimate.name} watch"  # subject of its events and its status
        self._node, self.standing = node, ActiveAlarms()

    def match(self) -> list[Remark]:
        """Connect to the current publishers; return remarks."""
        sides = [self._estimate, *self._others.values()]
        remarks = [item for side in sides for item in side.match()]
        if self._imu is not None and (text := self._imu.match()):
            remarks.append(about_publishers(text))
        return remarks

    def tick(self) -> WatchReport | None:
        """Gather the messages that have arrived, and process them if due; return a new report."""
        self._gather()
        report = self._renewed_by(self._task.take())
        if self._task.is_due and time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LOOK_EVERY_S
            self._start()
        return report

    def conclude(self) -> list[WatchReport]:
        """Process the last messages; return the reports about them."""
        self._gather()
        reports = [self._renewed_by(self._task.wait())]
        self._start()
        reports.append(self._renewed_by(self._task.wait()))
        self._task.close()
        return [report for report in reports if report is not None]

    def _start(self) -> None:
        messages = self._gathered()
        self._task.start(lambda: self._watch.look(messages))

    def _renewed_by(self, report: WatchReport | None) -> WatchReport | None:
        """Keep a new report; after a failure it has the reason."""
        if self._task.trouble:
            text = f"the newest messages are not watched: {self._task.trouble}; report the defect"
            report = WatchReport([warning("watch", text)])
        self._report = report or self._report
        return report

    def _gather(self) -> None:
        if self._imu is not None:
            self._readings += self._imu.take().payloads
        for source, other in self._others.items():
            self._of_others[source] += other.take(None)
        self._estimates += self._estimate.take(None)

    def _gathered(self) -> WatchedMessages:
        gathered = WatchedMessages(self._estimates, self._of_others, self._readings)
        self._forget_gathered()
        return gathered

    def _forget_gathered(self) -> None:
        self._estimates: list[Any] = []
        self._readings: list[bytes] = []
        self._of_others: dict[str, list[Any]] = {other: [] for other in self._others}

    def status(self) -> Any:
        """Return the status, as `diagnostic_msgs/DiagnosticStatus`."""
        present = [*self._about_silence(), *self._report.remarks]
        remarks = most_severe_first(self.standing.kept_texts(present))
        return status_message(
            self._node,
            remarks[0].level if remarks else Level.NOTE,
            self.name,
            "; ".join(remark.text for remark in remarks) or "no alarm",
            self._report.values,
        )

    def _about_silence(self) -> list[Remark]:
        side, silent_s = self._estimate, self._estimate.silent_s
        if silent_s is None:
            return [warning("silence", f"nothing to watch yet on {side.source}")]
        if silent_s > _STALE_AFTER_S:
            text = f"nothing to watch for {silent_s:.0f} s on {side.source}"
            return [Remark(Level.ERROR, "silence", text)]
        return []


class Watching:
    """The watch and rosbag2's snapshots, as requested by the parameters."""

    def __init__(
        self, node: Node, values: Mapping[str, Any], events: EventTopic, log: Log
    ) -> None:
        self._events, self._log = events, log
        self._watch = EstimateWatch(node, values) if values["watch_factor"] else None
        service = values["snapshot_service"]
        self._snapshots = Snapshots(node, service) if service else None

    def match(self) -> None:
        """Connect to the current publishers."""
        if self._watch is not None:
            for item in self._watch.match():
                self._log(f"watch: {item.text}", item.level)

    def tick(self) -> None:
        """Process the messages that have arrived, and report alarms."""
        if self._watch is not None and (report := self._watch.tick()) is not None:
            self._tell(report)
        if self._snapshots is not None and (news := self._snapshots.renew()) is not None:
            self._log(*news)

    def see(self, remarks: Iterable[Remark]) -> None:
        """Process remarks of the evaluation: exceeded error limits request a snapshot."""
        for remark in remarks:
            if (
                remark.code == "alarm"
                and remark.level == Level.ERROR
                and self._snapshots is not None
            ):
                self._snapshots.trigger()

    def conclude(self) -> None:
        """Process the last messages, and report alarms."""
        if self._watch is not None:
            for report in self._watch.conclude():
                self._tell(report)

    def statuses(self) -> list[Any]:
        """Return the statuses for the diagnostics, as `diagnostic_msgs/DiagnosticStatus`."""
        return [] if self._watch is None else [self._watch.status()]

    def _tell(self, report: WatchReport) -> None:
        assert self._watch is not None
        name = self._watch.name
        for item in [*report.news, *self._watch.standing.renew(report.remarks)]:
            self._log(f"{name}: {item.text}", min(item.level, Level.WARNING))
            self._events.publish(name, item)
        if report.begun and self._snapshots is not None:
            self._snapshots.trigger()
