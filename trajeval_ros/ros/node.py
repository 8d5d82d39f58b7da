"""The node of the live evaluator: its publishers, services and log."""

from __future__ import annotations

import time
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from trajeval_ros.exceptions import SettingsError, TrajevalError
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.online.notices import OK, Notice
from trajeval_ros.ros import parameters
from trajeval_ros.ros.events import EventTopic
from trajeval_ros.ros.frame_broadcaster import FrameBroadcaster
from trajeval_ros.ros.live_fixes import LiveFixes
from trajeval_ros.ros.live_outputs import LiveOutputs
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.node_log import log
from trajeval_ros.ros.output_folder import make_folder
from trajeval_ros.ros.parameter_table import PARAMETERS, RESET, SAVE
from trajeval_ros.ros.rerun_output import RerunOutput
from trajeval_ros.ros.result_writing import ResultWriting
from trajeval_ros.ros.segment_jumps import about_jump
from trajeval_ros.ros.sides import Side, TimeAt, name_apart
from trajeval_ros.ros.simulated_clock import SimulatedClock
from trajeval_ros.ros.static_transform import StaticTransform
from trajeval_ros.ros.status_reports import StatusReports
from trajeval_ros.ros.terminal import StatusLine
from trajeval_ros.ros.unused_messages import why_no_pair
from trajeval_ros.ros.watching import Watching

_SNAPSHOTS_SHARE = 0.05  # largest share of a core; with the whole run as window, cost increases


class EvaluatorNode:
    """Evaluates estimate topics against a groundtruth topic, side by side."""

    def __init__(self, node: Node, values: dict[str, Any]) -> None:
        """Create publishers, services and the output folder, and start.

        Args:
            node: The ROS node.
            values: Its parameters.

        Raises:
            SettingsError: A parameter is invalid.
            InputError: The output folder can't be created.
        """
        self._node, self._values = node, values
        self._settings = parameters.settings_of(self._values)
        # It refuses a gauge with a scale before the output folder is made.
        broadcaster = (
            FrameBroadcaster(self._node, self._settings.protocol.gauge)
            if self._values["broadcast_tf"]
            else None
        )
        self._line = StatusLine()
        self._simulated_time = SimulatedClock(self._node)
        self._events = EventTopic(self._node)
        self._watching = Watching(self._node, self._values, self._events, self._log)
        self._statuses = StatusReports(self._node, self._events, self._watching)
        self._run = self._new_run()
        self._picture = self._new_picture()
        self._outputs = LiveOutputs(
            self._node,
            [each.name for each in self._run.estimates],
            broadcaster,
            judges=self._settings.covariances.source != "none",
        )
        self._snapshot_at = 0.0
        self._results = ResultWriting(lambda: self._run, self._log)
        self._advertise()
        self._log(f"output folder: {self._run.folders.finisher.folder}")

    def finish(self) -> bool:
        """Evaluate the last messages and write everything; return whether it was written."""
        self._line.clear()
        try:
            self._run.drain(self._time_at)
            self._watching.conclude()
        finally:
            written = self._write()
        return written

    def _write(self) -> bool:
        for each in self._picture.close():
            self._log(each, warn=True)
        troubles = self._run.close()
        self._results.finish_left_folders(self._run)
        for each in troubles:
            self._log_error(each)
        if not self._run.has_pairs:
            self._log_error(why_no_pair(self._run))
            return False
        return self._run.folders.finisher.finish(quiet=False) and not troubles

    def _new_run(self) -> LiveRun:
        gauge = self._settings.protocol.gauge
        fixes = LiveFixes(parameters.fixes_of(self._values), gauge)
        groundtruth = Side(self._node, self._values["groundtruth_topic"], fixes)
        sides = [Side(self._node, each) for each in self._values["estimate_topics"]]
        name_apart(sides, self._node.get_namespace())
        hand_eye = self._values["hand_eye"]
        transform = (
            StaticTransform(self._node, hand_eye) if parameters.names_frames(hand_eye) else None
        )
        known = parameters.known_hand_eye_of(self._values)
        return LiveRun(
            groundtruth,
            sides,
            self._settings,
            parameters.words_of(self._values),
            make_folder(self._values["output"]),
            find_offset=parameters.finds_offset(self._values),
            body=MarkerBody(hand_eye, known, transform, self._settings.covariances.rotation_frame),
            segmentation=parameters.segmentation_of(self._values),
            new_folder=lambda: make_folder(self._values["output"]),
        )

    def _new_picture(self, before: RerunOutput | None = None) -> RerunOutput:
        gauge = self._settings.protocol.gauge
        picture = RerunOutput(self._values["rerun"], self._run, gauge, before)
        if picture.address:
            self._log(f"Rerun: rerun --connect {picture.address}")
        return picture

    def _advertise(self) -> None:
        from std_srvs.srv import Trigger

        self._outputs.advertise_lengths(self._lengths)
        # A call of ~/save that waits must not delay other services.
        asked = ReentrantCallbackGroup()
        self._node.create_service(Trigger, RESET, self._reset, callback_group=asked)
        self._node.create_service(Trigger, SAVE, self._save, callback_group=asked)
        self._node.add_on_set_parameters_callback(self._set)

    @property
    def tick_period_s(self) -> float:
        """Time between two ticks, seconds."""
        period: float = 1.0 / self._values["publish_rate"]
        return period

    @property
    def _lengths(self) -> list[str]:
        """The lengths of sub-trajectories that are evaluated during the run."""
        return [str(each) for each in self._settings.protocol.lengths if each.unit != "%"]

    # Periodic work.

    def tick(self) -> None:
        """Receive messages, evaluate them, publish their errors."""
        self._watching.tick()
        self._run.take(self._time_at)
        for estimate, update in self._run.update():
            if update.stamp is None:
                continue
            self._outputs.publish_update(self._run, estimate, update)
            self._picture.update(estimate, update)
            latency_s = estimate.latency.publish(update.stamp, time.time_ns())
            estimate.peaks.see("latency_s", latency_s)
            estimate.peaks.see_update(update, knows_up=not estimate.doubt)
        self._tell_of_segments()
        for estimate in self._run.estimates:
            for side in (self._run.groundtruth, estimate.side):
                estimate.peaks.see("staleness_s", side.silent_s)

    def report(self) -> None:
        """Match publishers, detect jumps, and publish the errors of the window."""
        self._match()
        for estimate in self._run.estimates:
            for jump in estimate.digest():
                notice = about_jump(estimate.name, jump)
                self._log(notice.text, warn=True)
                self._events.publish(estimate.name, notice)
                self._picture.jump(estimate, jump)
        begin = time.monotonic()
        if begin < self._snapshot_at:
            return
        for estimate in self._run.estimates:
            snapshot = self._outputs.publish_snapshot(estimate)
            revised_m = self._outputs.publish_revised(self._run, estimate)
            self._picture.snapshot(estimate, snapshot, revised_m)
            self._outputs.publish_geometry(self._run, estimate, snapshot)
        took = time.monotonic() - begin
        self._snapshot_at = begin + took / _SNAPSHOTS_SHARE

    def _tell_of_segments(self) -> None:
        """Report new segments, and write the results of complete folders."""
        news, self._run.news = self._run.news, []
        for each in news:
            self._log(each.text)
            self._events.publish("run", each)
        self._results.finish_left_folders(self._run)

    def _match(self) -> None:
        if self._time_at is not None:
            self._simulated_time.match()
        for side in (self._run.groundtruth, *(each.side for each in self._run.estimates)):
            for each in side.match():
                self._log(each.text, warn=each.level > OK)
                self._events.publish(side.name, each)
        self._watching.match()
        if self._run.body.transform is not None and (said := self._run.body.transform.match()):
            self._log(said)

    def tell(self) -> None:
        """Write counts, publish diagnostics, save periodically, update the status line."""
        self._run.write_states()
        undrawn = self._picture.dropped
        parts = self._statuses.publish(self._run, self._outputs, self._values, undrawn)
        for news in self._picture.news():
            self._log(f"no output in Rerun: {news}", warn=True)
        self._results.tell(self._values["autosave_period"])
        if (line := self._line.show(parts)) is not None:
            self._log(line)

    # Services and parameters.

    async def _save(self, request: Any, response: Any) -> Any:
        """Handle ~/save; respond when result.json is written."""
        del request
        success, message = await self._results.saved()
        return _answered(response, message, success=success)

    def _reset(self, request: Any, response: Any) -> Any:
        """Handle ~/reset: end this run, keep its results, and start another one."""
        del request
        try:
            begun = self._new_run()
        except TrajevalError as error:
            return _answered(response, str(error))
        ended, self._run = self._run, begun
        ended.conclude(self._time_at)
        for trouble in ended.close():
            self._log(trouble, warn=True)
        self._results.finish_left_folders(ended)
        for side in (ended.groundtruth, *(each.side for each in ended.estimates)):
            side.leave()
        if ended.body.transform is not None:
            ended.body.transform.leave()
        self._match()
        self._picture = self._new_picture(self._picture)
        self._outputs.begin_run()
        self._results.finish(ended)
        said = (
            f"previous results are in {ended.folders.finisher.folder}, new results in "
            f"{self._run.folders.finisher.folder}"
        )
        self._log(said)
        self._events.publish("run", Notice("restart", OK, said))
        return _answered(response, said, success=True)

    def _set(self, changes: list[Any]) -> Any:
        """Accept or reject parameters that are set during the run."""
        from rcl_interfaces.msg import SetParametersResult

        known = {each.name: each for each in PARAMETERS}
        try:
            new = {
                each.name: parameters.converted(known[each.name], each.value)
                for each in changes
                if each.name in known
            }
            values = {**self._values, **new}
            settings = parameters.settings_of(values)
        except SettingsError as error:
            return SetParametersResult(successful=False, reason=one_line(str(error)))
        self._values, self._settings = values, settings
        self._outputs.advertise_lengths(self._lengths)
        self._run.change(settings, parameters.words_of(values))
        return SetParametersResult(successful=True)

    # Log.

    def _log(self, text: str, warn: bool = False) -> None:
        self._line.clear()
        log(self._node, text, warn=warn)

    def _log_error(self, text: str) -> None:
        self._line.clear()
        self._node.get_logger().error(one_line(text))

    @property
    def _time_at(self) -> TimeAt | None:
        """The function that returns simulated times; None without simulated time."""
        return self._simulated_time.at if self._node.get_parameter("use_sim_time").value else None


def _answered(response: Any, message: str, *, success: bool = False) -> Any:
    """Return a `std_srvs/Trigger` response; control characters in the message are escaped."""
    response.success, response.message = success, one_line(message)
    return response
