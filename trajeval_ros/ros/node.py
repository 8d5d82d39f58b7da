"""The live evaluator as a node: what it publishes, answers, and says."""

from __future__ import annotations

import time
from difflib import get_close_matches
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future

from trajeval_ros.exceptions import SettingsError, TrajevalError
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.online.jump_detector import Jump
from trajeval_ros.online.notices import OK, WARN, Notice
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.ros import parameters
from trajeval_ros.ros.diagnostics import diagnose, notices_about
from trajeval_ros.ros.events import EventTopic
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.output_folder import Finisher, make_folder
from trajeval_ros.ros.publishers import Outputs
from trajeval_ros.ros.rerun_output import RerunOutput
from trajeval_ros.ros.sides import Side, told_apart
from trajeval_ros.ros.terminal import StatusLine, seconds, summary

_SNAPSHOTS_SHARE = 0.05  # of a core at the most: a window that is the whole run grows


class EvaluatorNode(Node):  # type: ignore[misc]
    """Evaluates estimate topics against a groundtruth topic, side by side."""

    def __init__(self) -> None:
        """Declare parameters, advertise, make the output folder, and begin.

        Raises:
            SettingsError: A parameter means nothing, or topics are missing.
            InputError: The output folder can't be made.
        """
        super().__init__("evaluator")
        self._values = parameters.declare(self)
        self._settings = parameters.settings_of(self._values)
        self._line = StatusLine()
        self._run = self._new_run()
        self._picture = self._new_picture()
        self._outputs = {each.name: Outputs(self, each.name) for each in self._run.estimates}
        self._snapshots: dict[str, Snapshot] = {}
        self._newest: dict[str, Update] = {}
        self._snapshot_at = 0.0
        self._saved_at = time.monotonic()
        self._saved = Future()
        self._ended: list[Finisher] = []  # of runs before a reset, still writing
        self._complaint = ""
        self._advertise()
        self._warn_of_unknown_parameters()
        self._log(f"results go to {self._run.finisher.folder}")

    def finish(self) -> bool:
        """Evaluate what is left, and write everything; returns whether it was written."""
        self._line.clear()
        try:
            self._run.drain(self._simulated_ns())
        finally:
            written = self._write()
        return written

    def _write(self) -> bool:
        for each in self._picture.close():
            self._log(each, warn=True)
        troubles = self._run.close()
        for each in troubles:
            self._log_error(each)
        if not self._run.has_pairs:
            self._log_error(self._run.why_no_pair())
            return False
        return self._run.finisher.finish(quiet=False) and not troubles

    def _new_run(self) -> LiveRun:
        groundtruth = Side(self, self._values["groundtruth_topic"], is_groundtruth=True)
        sides = [
            Side(self, each, is_groundtruth=False) for each in self._values["estimate_topics"]
        ]
        told_apart(sides)
        return LiveRun(
            groundtruth,
            sides,
            self._settings,
            parameters.words_of(self._values),
            make_folder(self._values["output"]),
            find_offset=parameters.finds_offset(self._values),
        )

    def _new_picture(self, before: RerunOutput | None = None) -> RerunOutput:
        gauge = self._settings.protocol.gauge
        return RerunOutput(self._values["rerun"], self._run, gauge, before)

    def _advertise(self) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from std_srvs.srv import Trigger

        for each in self._outputs.values():
            each.advertise_lengths(self._lengths)
        self._events = EventTopic(self)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # Whoever waits for ~/save must not keep other services waiting.
        asked = ReentrantCallbackGroup()
        self.create_service(Trigger, "~/reset", self._reset, callback_group=asked)
        self.create_service(Trigger, "~/save", self._save, callback_group=asked)
        self.add_on_set_parameters_callback(self._set)

    @property
    def tick_period_s(self) -> float:
        """How long to wait between two ticks, seconds."""
        period: float = 1.0 / self._values["publish_rate"]
        return period

    @property
    def _lengths(self) -> list[str]:
        """The lengths of sub-trajectories that end while the run goes on."""
        return [str(each) for each in self._settings.protocol.lengths if each.unit != "%"]

    # What happens again and again.

    def tick(self) -> None:
        """Take messages, evaluate them, publish their errors."""
        self._run.take(self._simulated_ns())
        for estimate, update in self._run.update():
            if update.stamp is None:
                continue
            self._newest[estimate.name] = update
            self._outputs[estimate.name].publish_update(
                update,
                self._run.groundtruth.stream.status.frame,
                estimate.offset_ns,
                knows_up=not estimate.doubt,
            )
            self._picture.update(estimate, update)
            latency_s = estimate.latency.publish(update.stamp, time.time_ns())
            estimate.peaks.see("latency_s", latency_s)
            estimate.peaks.see_update(update, knows_up=not estimate.doubt)
        for estimate in self._run.estimates:
            for side in (self._run.groundtruth, estimate.side):
                estimate.peaks.see("staleness_s", side.silent_s)

    def report(self) -> None:
        """Match publishers, look for jumps, and publish what is about the window."""
        self._match()
        for estimate in self._run.estimates:
            for jump in estimate.digest():
                self._tell_of_jump(estimate, jump)
                self._picture.jump(estimate, jump)
        begin = time.monotonic()
        if begin < self._snapshot_at:
            return
        for estimate in self._run.estimates:
            snapshot = estimate.snapshot()
            self._snapshots[estimate.name] = snapshot
            estimate.peaks.see_snapshot(snapshot)
            outputs = self._outputs[estimate.name]
            revised = None
            if estimate.revised is not None:
                outputs.advertise_revised()
                revised = estimate.revised.position_rmse_m(self._run.groundtruth_up)
            outputs.publish_snapshot(snapshot, revised)
            self._picture.snapshot(estimate, snapshot, revised)
            if snapshot.alignment is not None:
                outputs.publish_geometry(
                    estimate.trail,
                    snapshot.alignment.similarity,
                    self._run.groundtruth.stream.status.frame,
                    estimate.stream.status.frame,
                )
        took = time.monotonic() - begin
        self._snapshot_at = begin + took / _SNAPSHOTS_SHARE

    def _match(self) -> None:
        for side in (self._run.groundtruth, *(each.side for each in self._run.estimates)):
            for each in side.match():
                self._log(each.text, warn=each.level > OK)
                self._events.publish(side.name, each)

    def tell(self) -> None:
        """Write the counts, publish diagnostics, save now and then, renew the terminal's line."""
        from diagnostic_msgs.msg import DiagnosticArray

        self._run.write_states()
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        parts = []
        for estimate in self._run.estimates:
            snapshot = self._snapshots.get(estimate.name)
            if snapshot is None:
                continue
            update = self._newest.get(estimate.name, Update())
            peaks = estimate.peaks.take()
            notices = notices_about(self._run, estimate, snapshot, peaks, self._values)
            # Each jump has been an event of its own.
            standing = [each for each in notices if each.kind != "jump"]
            for each in estimate.standing.renew(standing):
                self._events.publish(estimate.name, each)
            message.status.append(
                diagnose(
                    self.get_name(),
                    self._run,
                    estimate,
                    snapshot,
                    update,
                    notices,
                    peaks,
                    self._picture.dropped,
                )
            )
            parts.append(
                summary(
                    estimate.name,
                    snapshot,
                    self._values["window"],
                    update.position_m,
                    self._run.missing(estimate),
                )
            )
        self._diagnostics.publish(message)
        for news in self._picture.news():
            self._log(f"there is no picture in Rerun: {news}", warn=True)
        self._complain()
        self._autosave()
        self._line.show(parts)

    def _autosave(self) -> None:
        if self._run.finisher.poll():
            self._tell_saved()
        for each in self._ended:
            if each.poll() and each.trouble:
                self._log(f"results can't be written to {each.folder}: {each.trouble}", warn=True)
        self._ended = [each for each in self._ended if each.is_busy]
        period = self._values["autosave_period"]
        if period and time.monotonic() >= self._saved_at + period and self._run.finisher.is_due:
            self._begin_to_save()

    def _begin_to_save(self) -> str:
        """Begin to write result.json; returns why it can't be written, empty if it can."""
        if not self._run.has_pairs:
            return self._run.why_no_pair()
        self._saved_at = time.monotonic()
        try:
            self._run.save()
        except TrajevalError as error:
            self._log(str(error), warn=True)
            return str(error)
        return ""

    def _tell_saved(self) -> None:
        """Let those go on who wait until something is written."""
        saved, self._saved = self._saved, Future()
        saved.set_result(None)

    # What is answered.

    async def _save(self, request: Any, response: Any) -> Any:
        """Answer ~/save when result.json is written."""
        del request
        while self._run.finisher.is_busy:  # with what was there before the newest pairs
            await self._saved
        finisher = self._run.finisher
        response.message = self._begin_to_save()
        if response.message:
            return response
        await self._saved
        result = finisher.folder / "result.json"
        if finisher is not self._run.finisher:
            response.message = f"~/reset came before {result} was written, which it is now"
            return response
        response.success = not finisher.trouble
        response.message = finisher.trouble or str(result)
        return response

    def _reset(self, request: Any, response: Any) -> Any:
        """Answer ~/reset: end this run, whose results stay, and begin another one."""
        del request
        try:
            begun = self._new_run()
        except TrajevalError as error:
            response.message = str(error)
            return response
        ended, self._run = self._run, begun
        ended.conclude(self._simulated_ns())
        for trouble in ended.close():
            self._log(trouble, warn=True)
        for side in (ended.groundtruth, *(each.side for each in ended.estimates)):
            side.leave()
        self._match()
        self._picture = self._new_picture(self._picture)
        self._snapshots, self._newest = {}, {}
        if ended.has_pairs:
            ended.finisher.finish_alone()
            self._ended.append(ended.finisher)
        self._tell_saved()
        response.success = True
        response.message = (
            f"results so far are in {ended.finisher.folder}, new ones go to "
            f"{self._run.finisher.folder}"
        )
        self._log(response.message)
        self._events.publish("run", Notice("restart", OK, response.message))
        return response

    def _set(self, changes: list[Any]) -> Any:
        """Answer to parameters that are set while it runs."""
        from rcl_interfaces.msg import SetParametersResult

        known = {each.name: each for each in parameters.PARAMETERS}
        try:
            new = {
                each.name: parameters.converted(known[each.name], each.value)
                for each in changes
                if each.name in known
            }
            values = {**self._values, **new}
            settings = parameters.settings_of(values)
        except SettingsError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._values, self._settings = values, settings
        for outputs in self._outputs.values():
            outputs.advertise_lengths(self._lengths)
        self._run.change(settings, parameters.words_of(values))
        return SetParametersResult(successful=True)

    # What is said.

    def _log(self, text: str, *, warn: bool = False) -> None:
        self._line.clear()
        logger, line = self.get_logger(), one_line(text)
        if warn:  # rclpy wants one severity of each line of code
            logger.warning(line)
        else:
            logger.info(line)

    def _log_error(self, text: str) -> None:
        self._line.clear()
        self.get_logger().error(one_line(text))

    def _complain(self) -> None:
        """Say once what is wrong with the disk, and that it is well again."""
        troubles = [each.writer.trouble for each in self._run.estimates if each.writer.trouble]
        if self._run.has_pairs and self._run.finisher.trouble:
            troubles.append(self._run.finisher.trouble)
        complaint = troubles[0] if troubles else ""
        if complaint != self._complaint:
            folder = self._run.finisher.folder
            said = f"results can't be written to {folder}: {complaint}" if complaint else ""
            self._log(said or f"results are written to {folder} again", warn=bool(complaint))
        self._complaint = complaint

    def _tell_of_jump(self, estimate: LiveEstimate, jump: Jump) -> None:
        said = (
            f"{estimate.name} jumps by {jump.position_m:.2f} m and {jump.rotation_deg:.0f} deg at "
            f"{seconds(jump.stamp)}: has it restarted with a new origin? One alignment can't fit "
            "the parts on both sides; ~/reset begins anew"
        )
        values = {
            "stamp_ns": jump.stamp,
            "position_m": jump.position_m,
            "rotation_deg": jump.rotation_deg,
        }
        self._log(said, warn=True)
        self._events.publish(estimate.name, Notice("jump", WARN, said, values=values))

    def _warn_of_unknown_parameters(self) -> None:
        """Name what a parameter file sets and nobody declares, a misspelt name above all."""
        names = [each.name for each in parameters.PARAMETERS]
        for name in getattr(self, "_parameter_overrides", {}):
            if self.has_parameter(name) or name.startswith("qos_overrides."):
                continue
            near = get_close_matches(name, names, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            self._log(f"there is no parameter {name}{hint}", warn=True)

    def _simulated_ns(self) -> int | None:
        """Return the time on /clock; None where time isn't simulated."""
        if not self.get_parameter("use_sim_time").value:
            return None
        return int(self.get_clock().now().nanoseconds)
