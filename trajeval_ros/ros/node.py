"""The node of the live evaluator: its publishers, services and log."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.io.live.metrics_file import write_metrics
from trajeval_ros.io.requests.setting import AUTO
from trajeval_ros.online.error_topics import relative_error_topic
from trajeval_ros.ros import parameters
from trajeval_ros.ros.diagnostics import StatusReports
from trajeval_ros.ros.event_remarks import about_event, lasts
from trajeval_ros.ros.live_fixes import LiveFixes
from trajeval_ros.ros.live_outputs import EstimateOutputs, FrameBroadcaster, StreamOutputs
from trajeval_ros.ros.live_run import LiveRun, RunPlan
from trajeval_ros.ros.live_runs import LiveRuns
from trajeval_ros.ros.marker_body import MarkerBody, StaticTransform
from trajeval_ros.ros.output_folder import make_folder
from trajeval_ros.ros.parameter_table import (
    PARAMETERS,
    PAUSE,
    RESET,
    RESET_RUN,
    SAVE,
    START,
    STOP,
)
from trajeval_ros.ros.point_topic import PointTopic
from trajeval_ros.ros.pose_source import PoseSource, TimeAt, name_apart
from trajeval_ros.ros.recorded_state import why_no_pair, write_states
from trajeval_ros.ros.rerun_output import RerunOutput
from trajeval_ros.ros.result_writing import ResultWriting
from trajeval_ros.ros.start_decision import StartDecision
from trajeval_ros.ros.status_topics import EventTopic, log
from trajeval_ros.ros.terminal import StatusLine
from trajeval_ros.ros.timing import SimulatedClock
from trajeval_ros.ros.watching import Watching
from trajeval_ros.viewer.sinks import sinks_for

_PAUSED, _STOPPED = "paused", "stopped"


class EvaluatorNode:
    """Evaluates estimate topics against a groundtruth topic, side by side."""

    def __init__(self, node: Node, values: dict[str, Any]) -> None:
        self._node, self._values = node, values
        self._settings = parameters.settings_of(self._values)
        self._alarm_limits = parameters.alarm_limits_of(self._values)
        sinks_for(self._values["rerun"], Path(), "")  # refuses a wrong value at the start
        # It refuses a gauge with a scale before the output folder is made.
        broadcaster = (
            FrameBroadcaster(
                self._node, self._settings.protocol.gauge, self._values["transform_tolerance"]
            )
            if self._values["broadcast_tf"]
            else None
        )
        self._line = StatusLine()
        self._simulated_time = SimulatedClock(self._node)
        self._events = EventTopic(self._node)
        points = self._values["rerun_points"]
        self._points = PointTopic(self._node, points) if points else None
        self._watching = Watching(self._node, self._values, self._events, self._log)
        self._statuses = StatusReports(self._node, self._events, self._watching, self._log)
        self._worker = ThreadPoolExecutor(1, "clocks")
        self._runs = self._new_runs()
        self._pictures = {self._runs.current: self._new_picture(self._runs.current)}
        judges = self._settings.covariances.source != "none"
        self._outputs = {
            estimate.name: EstimateOutputs(self._node, estimate.name, broadcaster, judges=judges)
            for estimate in self._runs.current.estimates
        }
        sources = self._runs.current.plan.sources
        self._streams = [StreamOutputs(self._node, source.name) for source in sources]
        self._results = ResultWriting(lambda: self._runs.current, self._log)
        self._advertise()
        self._log(f"output folder: {self._runs.current.folder}")

    def finish(self) -> bool:
        """Evaluate the last messages and write everything; return whether it was written."""
        self._line.clear()
        try:
            if self._runs.current.idle:
                self._runs.discard()
                self._runs.conclude(self._time_at)
            else:
                self._runs.drain(self._time_at)
            self._watching.conclude()
        finally:
            written = self._write()
        return written

    def _write(self) -> bool:
        for item in self._picture.close():
            self._log(item, Level.WARNING)
        run = self._runs.current
        write_states(run)
        troubles = run.close()
        for trouble in troubles:
            self._log(trouble, Level.ERROR)
        if run.has_pairs:
            return self._results.conclude(run) and not troubles
        # The last loop of a bag may end soon after its start.
        level = Level.WARNING if self._results.has_finished else Level.ERROR
        self._log(why_no_pair(run), level)
        return self._results.has_finished and not troubles

    def _new_runs(self) -> LiveRuns:
        gauge, values = self._settings.protocol.gauge, self._values
        fixes = LiveFixes(parameters.request_of(values).fixes, gauge)
        groundtruth = PoseSource(self._node, values["groundtruth_topic"], fixes)
        estimates = [
            PoseSource(self._node, estimate_topic) for estimate_topic in values["estimate_topics"]
        ]
        name_apart(estimates, self._node.get_namespace())
        sources = [groundtruth, *estimates]
        runs = LiveRuns(
            sources,
            lambda: self._new_run(sources),
            self._new_folder,
            at_time_jumps=values["on_time_jump"] == RESET_RUN,
            at_restarts=values["on_restart"] == RESET_RUN,
        )
        runs.on_begun, runs.on_closed = self._begin_run, self._close_run
        return runs

    def _new_folder(self) -> Path:
        return make_folder(self._values["output"])

    def _new_run(self, sources: Sequence[PoseSource]) -> LiveRun:
        hand_eye = self._values["hand_eye"]
        transform = (
            StaticTransform(self._node, hand_eye) if parameters.names_frames(hand_eye) else None
        )
        known = parameters.known_hand_eye_of(self._values)
        axes = self._settings.covariances.rotation_frame
        body = MarkerBody(hand_eye, known, transform, axes)
        start = StartDecision(body, find_offset=self._values["time_offset"] == AUTO)
        about = {
            "label": self._values["label"],
            "metadata": parameters.metadata_of(self._values),
        }
        is_default = parameters.request_of(self._values).gauge_is_default
        plan = RunPlan(sources, self._settings, start, self._worker, about, is_default)
        return LiveRun(plan, self._new_folder())

    def _begin_run(self, ended: LiveRun, begun: LiveRun) -> None:
        self._pictures[begun] = self._new_picture(begun, self._pictures[ended])
        why = f"{begun.began_by}; " if begun.began_by else ""
        text = f"{why}previous results are in {ended.folder}, new results in {begun.folder}"
        self._log(text)
        values = {"folder": str(begun.folder)}
        self._events.publish("run", Remark(Level.NOTE, "restart", text, values=values))

    def _close_run(self, run: LiveRun, troubles: list[str]) -> None:
        self._pictures.pop(run).end()
        for trouble in troubles:
            self._log(trouble, Level.WARNING)
        self._results.finish(run)

    def _new_picture(self, run: LiveRun, before: RerunOutput | None = None) -> RerunOutput:
        protocol = self._settings.protocol
        value, modality = self._values["rerun"], protocol.modality
        picture = RerunOutput(value, run, protocol.gauge, before, modality)
        if picture.address:
            self._log(f"Rerun: rerun --connect {picture.address}")
        return picture

    def _advertise(self) -> None:
        from std_srvs.srv import Trigger

        self._advertise_lengths()
        # A call of ~/save that waits must not delay other services.
        asked = ReentrantCallbackGroup()
        for name, answer in (
            (SAVE, self._save),
            (RESET, self._reset),
            (START, self._start),
            (STOP, self._stop),
            (PAUSE, self._pause),
        ):
            self._node.create_service(Trigger, name, answer, callback_group=asked)
        self._node.add_on_set_parameters_callback(self._set)

    @property
    def _picture(self) -> RerunOutput:
        return self._pictures[self._runs.current]

    @property
    def tick_period_s(self) -> float:
        """Time between two ticks, seconds."""
        period: float = 1.0 / self._values["publish_rate"]
        return period

    def _advertise_lengths(self) -> None:
        for length in self._settings.protocol.lengths:
            for outputs in self._outputs.values() if length.unit != "%" else ():
                outputs.advertise_parts(relative_error_topic(str(length)))

    # Periodic work.

    def tick(self) -> None:
        """Receive messages, evaluate them, publish their errors."""
        self._watching.tick()
        if self._runs.current.idle:
            self._runs.discard()
        else:
            self._runs.take(self._time_at)
        for estimate, update in self._runs.update():
            if update.stamp is None:
                continue
            self._outputs[estimate.name].publish_update(self._runs.current, estimate, update)
            self._picture.update(estimate, update)
            latency_s = estimate.latency.publish(update.stamp, time.time_ns())
            estimate.peaks.see("latency_s", latency_s)
            estimate.peaks.see_update(update)
        if self._points is not None:
            for stamp, points in self._points.take():
                self._picture.points(stamp, points)
        run = self._runs.current
        news, run.news = run.news, []
        for item in news:
            self._log(item.text)
            self._events.publish("run", item)
        for estimate in run.estimates:
            for source in (run.groundtruth, estimate.source):
                estimate.peaks.see("staleness_s", source.silent_s)

    def report(self) -> None:
        """Match publishers, report events, and publish the errors of the window."""
        self._match()
        run = self._runs.current
        for estimate in run.estimates:
            for event in estimate.digest():
                remark = about_event(event)
                if not lasts(event) and self._events.publish(estimate.name, remark):
                    self._log(f"{estimate.name}: {remark.text}", remark.level)
                self._picture.event(event, f"{estimate.name}: {remark.text}")
        for place, stream in enumerate(self._streams):
            stream.publish(run.status_of(place).stream.recent())
        for estimate in run.estimates:
            arrival_s = estimate.status.stream.recent().arrival_p95_s
            estimate.peaks.see("arrival_s", arrival_s)
            published = self._outputs[estimate.name].publish_report(run, estimate)
            if estimate.availability is not None:
                estimate.peaks.see("age_s", estimate.availability.age_p95_s)
            self._picture.snapshot(estimate, *published)

    def _match(self) -> None:
        if self._time_at is not None:
            self._simulated_time.match()
        run = self._runs.current
        for source in run.plan.sources:
            for item in source.match():
                if self._events.publish(source.name, item):
                    self._log(item.text, item.level)
        if self._points is not None:
            for text in self._points.match():
                self._log(text)
        self._watching.match()
        if run.body.transform is not None and (text := run.body.transform.match()):
            self._log(text)

    def save(self) -> None:
        """Write counts, the file of metrics and, periodically, results."""
        run = self._runs.current
        write_states(run)
        metrics = {
            name: {"status": int(item.level), **item.values}
            for name, item in self._statuses.newest.items()
        }
        with suppress(InputError):  # the file of states reports a disk that can't be written
            write_metrics(run.folder, metrics)
        self._results.report(self._values["autosave_period"])

    def publish_status(self) -> None:
        """Publish diagnostics, and update the status line."""
        run = self._runs.current
        undrawn = self._picture.dropped
        window = self._values["window"]
        limits = self._alarm_limits
        parts = self._statuses.publish(run, self._outputs, limits, window, undrawn)
        self._picture.statuses(self._statuses.remarks)
        for about, remark in self._events.publish_counts():
            self._log(f"{about}: {remark.text}", remark.level)
        for news in self._picture.news():
            self._log(f"Rerun: {news}", Level.WARNING)
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
        ended = self._runs.current
        try:
            self._runs.reset(self._time_at)
        except TrajevalError as error:
            return _answered(response, str(error))
        if ended.body.transform is not None:
            ended.body.transform.leave()
        self._match()
        begun = self._runs.current
        text = f"previous results are in {ended.folder}, new results in {begun.folder}"
        return _answered(response, text, success=True)

    def _start(self, request: Any, response: Any) -> Any:
        """Handle ~/start: begin a run after ~/stop, or continue it after ~/pause."""
        run = self._runs.current
        if not run.idle:
            return _answered(response, "a run is active; to start a new one, call ~/reset")
        self._runs.discard()
        if run.idle == _STOPPED:
            return self._reset(request, response)
        run.idle = ""
        return self._answer(response, f"the run in {run.folder} continues")

    def _pause(self, request: Any, response: Any) -> Any:
        """Handle ~/pause: drop messages until ~/start."""
        del request
        run = self._runs.current
        if run.idle:
            return _answered(response, f"no active run: {run.idle}")
        run.idle = _PAUSED
        return self._answer(response, f"the run in {run.folder} is paused")

    async def _stop(self, request: Any, response: Any) -> Any:
        """Handle ~/stop: end this run; respond when result.json is written."""
        run = self._runs.current
        if run.idle == _STOPPED:
            return _answered(response, f"no active run: {run.idle}")
        if not run.idle:
            self._runs.conclude(self._time_at)
            run = self._runs.current  # another one if a restart was among the last messages
        run.idle = _STOPPED
        self._answer(response, f"the run in {run.folder} has ended")
        return await self._save(request, response)

    def _answer(self, response: Any, text: str) -> Any:
        self._log(text)
        self._events.publish("run", Remark(Level.NOTE, "run", text))
        return _answered(response, text, success=True)

    def _set(self, changes: list[Any]) -> Any:
        from rcl_interfaces.msg import SetParametersResult

        known = {parameter.name: parameter for parameter in PARAMETERS}
        try:
            new = {
                change.name: parameters.converted(known[change.name], change.value)
                for change in changes
                if change.name in known
            }
            values = {**self._values, **new}
            settings = parameters.settings_of(values)
            limits = parameters.alarm_limits_of(values)
            parameters.metadata_of(values)
        except SettingsError as error:
            return SetParametersResult(successful=False, reason=one_line(str(error)))
        self._values, self._settings, self._alarm_limits = values, settings, limits
        self._advertise_lengths()
        self._runs.current.change(settings)
        return SetParametersResult(successful=True)

    # Log.

    def _log(self, text: str, level: Level = Level.NOTE) -> None:
        self._line.clear()
        log(self._node, text, level)

    @property
    def _time_at(self) -> TimeAt | None:
        return self._simulated_time.at if self._node.get_parameter("use_sim_time").value else None


def _answered(response: Any, message: str, *, success: bool = False) -> Any:
    """Return a `std_srvs/Trigger` response; control characters in the message are escaped."""
    response.success, response.message = success, one_line(message)
    return response
