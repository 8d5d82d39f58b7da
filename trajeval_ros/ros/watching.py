"""Monitoring with or without an evaluation: watch, black box, snapshots."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.io.requests.limits_file import read_limits
from trajeval_ros.online.notices import ERROR, OK, STALE, Notice, Standing, gravest_first
from trajeval_ros.ros.background import BackgroundTask
from trajeval_ros.ros.black_box import BlackBox, BlackBoxSettings
from trajeval_ros.ros.events import EventTopic
from trajeval_ros.ros.live_watch import LiveWatch, WatchReport
from trajeval_ros.ros.snapshots import Snapshots
from trajeval_ros.ros.status_message import status_message
from trajeval_ros.ros.watched_topics import WatchedTopics

if TYPE_CHECKING:
    from rclpy.node import Node

# Processing one message takes about as much CPU time as processing twenty.
_LOOK_EVERY_S = 0.1
_MOST_SHARE = 0.25  # largest share of a core, for topics with high rates
_STALE_AFTER_S = 5.0

Log = Callable[[str, bool], object]


class EstimateWatch:
    """Watches the first estimate on its own thread.

    Attributes:
        name: Subject of its events and its status.
        report: The newest report.
    """

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        """Create it.

        Args:
            node: Subscribes.
            values: The parameters.

        Raises:
            InputError: The limits can't be read, or were learned without a source that is there.
            SettingsError: A topic's name is not valid.
        """
        limits = read_limits(Path(values["watch"]).expanduser())
        self._node_name = node.get_fully_qualified_name()
        self._topics = WatchedTopics(node, values)
        self._watch = LiveWatch(
            limits,
            values["watch_factor"],
            self._topics.estimate.stream,
            {source: each.stream for source, each in self._topics.others.items()},
            has_imu=bool(values["imu_topic"]),
        )
        self._task: BackgroundTask[WatchReport] = BackgroundTask(_MOST_SHARE)
        self._look_at = 0.0
        self.report = WatchReport()
        self.name = f"{self._topics.estimate.name} watch"

    def match(self) -> list[Notice]:
        """Connect to the current publishers; returns notices."""
        return self._topics.match()

    def tick(self) -> WatchReport | None:
        """Gather the messages that have arrived, and process them if due; return a new report."""
        self._topics.gather()
        found = self._task.take()
        if self._task.is_due and time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LOOK_EVERY_S
            messages = self._topics.gathered()
            self._task.start(lambda: self._watch.look(messages))
        self.report = found or self.report
        return found

    def conclude(self) -> list[WatchReport]:
        """Process the last messages; return the reports about them."""
        self._topics.gather()
        running = self._task.wait()
        self.report = self._watch.look(self._topics.gathered())
        self._task.close()
        return [self.report] if running is None else [running, self.report]

    @property
    def history(self) -> dict[str, Any]:
        """The signals of the last minute with their limits, for the JSON file of a clip."""
        return {"estimate": self._topics.estimate.source, **self.report.history}

    def status(self) -> Any:
        """Return the status, as `diagnostic_msgs/DiagnosticStatus`."""
        notices = gravest_first([*self._about_silence(), *self.report.notices])
        return status_message(
            notices[0].level if notices else OK,
            f"{self._node_name}: {self.name}",
            "; ".join(each.text for each in notices) or "no alarm",
            self.report.values,
        )

    def _about_silence(self) -> list[Notice]:
        side = self._topics.estimate
        silent_s = side.silent_s
        if silent_s is None:
            return [Notice("silence", STALE, f"nothing to watch yet on {side.source}")]
        if silent_s > _STALE_AFTER_S:
            said = f"nothing to watch for {silent_s:.0f} s on {side.source}"
            return [Notice("silence", STALE, said)]
        return []


class Watching:
    """The watch, the black box and rosbag2's snapshots, as requested by the parameters."""

    def __init__(
        self, node: Node, values: Mapping[str, Any], events: EventTopic, log: Log
    ) -> None:
        """Create it.

        Args:
            node: Subscribes.
            values: The parameters.
            events: Topic on which alarms are published.
            log: Called with a sentence, and whether it is a warning.

        Raises:
            InputError: A file can't be read, a folder not made, or the limits were learned
                without a source that is there.
            SettingsError: A parameter is not valid, or the service's type is not installed.
        """
        self._events, self._log = events, log
        kept = BlackBoxSettings.of(values)
        self._watch = EstimateWatch(node, values) if values["watch"] else None
        self._box = None if kept is None else BlackBox(node, kept, values)
        service = values["snapshot_service"]
        pause_s = values["black_box_pause"]
        self._snapshots = Snapshots(node, service, pause_s) if service else None
        self._standing = Standing()

    def match(self) -> None:
        """Connect to the current publishers."""
        if self._watch is not None:
            for each in self._watch.match():
                self._log(f"watch: {each.text}", each.level > OK)
        if self._box is not None:
            for said, warn in self._box.match():
                self._log(said, warn)

    def tick(self) -> None:
        """Process the messages that have arrived, and report alarms."""
        if self._watch is not None and (report := self._watch.tick()) is not None:
            self._tell(report)
        if self._box is not None:
            self._box.tick()
        if self._snapshots is not None and (told := self._snapshots.renew()) is not None:
            self._log(*told)

    def see(self, notices: Iterable[Notice]) -> None:
        """Process notices of the evaluation: exceeded error limits start a clip and a snapshot."""
        for each in notices:
            if each.kind == "alarm" and each.level == ERROR:
                self._trigger(each)

    def conclude(self) -> None:
        """Process the last messages, report alarms, and write the waiting clip."""
        if self._watch is not None:
            for report in self._watch.conclude():
                self._tell(report)
        if self._box is not None:
            for said, warn in self._box.conclude():
                self._log(said, warn)

    def statuses(self) -> list[Any]:
        """Return the statuses for the diagnostics, as `diagnostic_msgs/DiagnosticStatus`."""
        return [] if self._watch is None else [self._watch.status()]

    def _tell(self, report: WatchReport) -> None:
        assert self._watch is not None
        name = self._watch.name
        for each in [*report.news, *self._standing.renew(report.notices)]:
            self._log(f"{name}: {each.text}", each.level > OK)
            self._events.publish(name, each)
        for each in report.begun:
            self._trigger(each)

    def _trigger(self, cause: Notice) -> None:
        if self._box is not None:
            self._box.trigger(cause, self._history)
        if self._snapshots is not None:
            self._snapshots.trigger()

    def _history(self) -> dict[str, Any]:
        return {} if self._watch is None else self._watch.history
