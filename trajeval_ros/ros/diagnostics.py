"""The status of an evaluation, as a `diagnostic_msgs/DiagnosticStatus`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from trajeval_ros.formatting.numbers import counted, whole_percent, with_unit
from trajeval_ros.formatting.remarks import Level, Remark, most_severe_first, warning
from trajeval_ros.geometry.valid_poses import (
    MOST_UNUSABLE,
    NO_STATE,
    add_counts,
    in_words,
    reasons,
)
from trajeval_ros.metrics.premises import Premise
from trajeval_ros.metrics.stream_health import FEWEST_RECENT
from trajeval_ros.online.alarms import (
    LIMITED_QUANTITIES,
    AlarmLimits,
    Peak,
    about_loss,
    alarm_below,
    alarms,
)
from trajeval_ros.online.error_topics import status_values, stream_values
from trajeval_ros.online.reports import Snapshot
from trajeval_ros.ros.clock_remarks import about_clock_faults, about_clock_offset, sync_risk_m
from trajeval_ros.ros.event_remarks import SUMMARY, about_frozen, about_steps
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_outputs import EstimateOutputs
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.recorded_state import groundtruth_dropped, missing_source
from trajeval_ros.ros.slow_evaluation import FIRST_HINTS_S
from trajeval_ros.ros.status_topics import DiagnosticsTopic, EventTopic, status_message
from trajeval_ros.ros.terminal import summary
from trajeval_ros.ros.watching import Watching

if TYPE_CHECKING:
    from rclpy.node import Node

_START_S = 3.0  # publishers and topics are discovered within this time
_MANY = f"over {whole_percent(MOST_UNUSABLE)}"
_LATE_S = 1.0  # a longer delay than that of the groundtruth is a warning
_FEWEST_FAULTS = 10  # fewer faulty messages are no warning, whatever their share


class Status(NamedTuple):
    """The status of one estimate."""

    level: Level
    text: str
    values: dict[str, Any]  # by name and unit; None if not available

    @classmethod
    def of(
        cls,
        run: LiveRun,
        estimate: LiveEstimate,
        snapshot: Snapshot,
        remarks: Sequence[Remark],
        peaks: Mapping[str, Peak],
        undrawn: int,
    ) -> Status:
        """Return the present status; numbers in its text change every 10 s at most."""
        reported = most_severe_first(estimate.standing.kept_texts(remarks))
        values = _values(run, estimate, snapshot)
        values |= {
            f"{words}, largest since the last status [{unit}]": peaks[name].value
            for name, words, unit in LIMITED_QUANTITIES
            if name in peaks
        }
        values["updates not drawn in Rerun"] = undrawn or None
        text = "; ".join(item.text for item in reported) or "evaluating"
        return cls(reported[0].level if reported else Level.NOTE, text, values)


def remarks_about(
    run: LiveRun,
    estimate: LiveEstimate,
    snapshot: Snapshot,
    peaks: Mapping[str, Peak],
    limits: Mapping[str, AlarmLimits],
) -> list[Remark]:
    """Return the current remarks about one estimate.

    Peaks are the largest values since the last status. Limits are by name of the quantity.
    """
    faults = list(about_clock_faults(run, estimate))
    # Clocks that differ measure no delay, and pair poses of different times, which look like other
    # mistakes.
    is_clear = not faults and estimate.suspected_step is None
    frozen = [*about_frozen(estimate, snapshot)]
    return [
        *_about_data(run, estimate),
        *_about_coverage(snapshot, limits["coverage"]),
        *_about_rate(estimate, limits["rate_hz"]),
        *(_about_lateness(run, estimate) if is_clear else []),
        *([] if estimate.availability is None else estimate.availability.remarks),
        *(about_loss(snapshot) if is_clear else []),
        *alarms(peaks, limits),
        *about_integrity(snapshot),
        *_about_start(run),
        *faults,
        *(about_clock_offset(run, estimate) if is_clear else []),
        *(about_steps(estimate) if is_clear else []),
        *frozen,
        *_about_run(run, estimate, snapshot, has_hints=is_clear and not (frozen or snapshot.loss)),
    ]


def _about_data(run: LiveRun, estimate: LiveEstimate) -> Iterator[Remark]:
    for what, side in (("groundtruth", run.groundtruth), ("estimate", estimate.source)):
        silent_s = side.silent_s
        if silent_s is None:
            level = Level.WARNING if side.waits_s > _START_S else Level.NOTE
            yield Remark(level, "silence", f"no {what} yet on {side.source}", what)
        elif silent_s > side.stream.patience_s:
            text = f"no {what} for {silent_s:.0f} s on {side.source}"
            yield Remark(Level.ERROR, "silence", text, what)
        if side.stream.trouble is not None:
            yield replace(side.stream.trouble, subject=what)
        if side.mixed:
            yield warning("publishers", side.mixed, what)
    buffer, source = estimate.evaluator.buffer, estimate.source.source
    dropped, used = groundtruth_dropped(run, estimate), buffer.groundtruth_count
    yield from _about_unusable(run.groundtruth.source, "groundtruth", dropped, used)
    dropped = add_counts(estimate.status.dropped, buffer.dropped)
    used = buffer.estimate_count + buffer.waiting
    yield from _about_unusable(source, "estimate", dropped, used)


def _about_unusable(
    source: str, what: str, dropped: Mapping[str, int], used: int
) -> Iterator[Remark]:
    unusable = {reason: count for reason, count in dropped.items() if reason in NO_STATE}
    count = sum(unusable.values())
    if _are_many(count, used):
        text = (
            f"{source}: {_MANY} of the poses are unusable and dropped: "
            f"{', '.join(map(in_words, unusable))}"
        )
        yield warning("data", text, f"unusable_{what}", {"value": count / (count + used)})


def _are_many(count: int, others: int) -> bool:
    """Return whether so many messages are of a fault that the user is warned."""
    return count >= _FEWEST_FAULTS and count > MOST_UNUSABLE * (count + others)


def _about_coverage(snapshot: Snapshot, limits: AlarmLimits) -> list[Remark]:
    coverage, what = snapshot.estimate_coverage, "poses have groundtruth"
    if coverage is None and snapshot.coverage is not None:  # pairs at groundtruth's times
        coverage, what = snapshot.coverage.covered, "fixes or points have an estimate"
    if coverage is None:
        return []
    text = f"only {whole_percent(coverage)} of the {what}"
    late = snapshot.dropped.get("too_late", 0)
    if 2 * late > sum(snapshot.dropped.values()):
        text += ": the others arrive too late, after more than max_delay"
    return alarm_below("coverage", coverage, limits, text)


def _about_rate(estimate: LiveEstimate, limits: AlarmLimits) -> list[Remark]:
    recent = estimate.status.stream.recent()
    rate_hz = recent.rate_hz
    if rate_hz is None or recent.messages < FEWEST_RECENT:
        return []
    text = f"rate {with_unit(rate_hz, 'Hz')} is below {{limit:g}} Hz"
    return alarm_below("rate_hz", rate_hz, limits, text)


def _about_lateness(run: LiveRun, estimate: LiveEstimate) -> Iterator[Remark]:
    """Warn of poses that arrive later than the groundtruth of their time.

    In a replay, both arrive long after their timestamps.
    """
    late_s = estimate.status.stream.arrival_after(run.groundtruth_status.stream)
    if late_s is None or late_s <= _LATE_S:
        return
    text = (
        f"poses arrive {late_s:.1f} s (95th percentile) after the groundtruth of the same time: "
        "the estimator or its sensor is too slow"
    )
    yield warning("late", text, values={"value": late_s, "limit": _LATE_S})


def about_integrity(snapshot: Snapshot) -> list[Remark]:
    """Report the region of the Stanford diagram of the newest pair, unless it is nominal."""
    parts = () if snapshot.integrity is None else snapshot.integrity.parts
    remarks = []
    for part in parts:
        error, level, limit = float(part.errors[-1]), float(part.levels[-1]), part.alert_limit
        if max(error, level) <= limit and error <= level:
            continue
        is_hazardous = level <= limit < error
        misleading = "hazardously misleading" if is_hazardous else "misleading"
        state = "unavailable" if error <= level else misleading
        text = (
            f"integrity, {part.part}: {state}: error {error:.3g}, protection level {level:.3g}, "
            f"alert limit {limit:g} {part.unit}"
        )
        values: dict[str, float | str] = {"value": error, "level": level}
        values |= {"limit": limit, "unit": part.unit}
        severity = Level.ERROR if is_hazardous else Level.WARNING
        remarks.append(Remark(severity, "alarm", text, f"integrity_{part.part}", values))
    return remarks


def _about_start(run: LiveRun) -> Iterator[Remark]:
    body = run.body
    if run.idle:
        yield Remark(Level.NOTE, "run", f"{run.idle}; call ~/start")
    if run.start.waits_for:
        yield Remark(Level.NOTE, "alignment", f"evaluation waits for {run.start.waits_for}")
    if body.why_not and (not run.holds or body.transform is not None):
        text = f"hand_eye:={body.source} is not applied: {body.why_not}"
        yield warning("hint", text, "hand_eye")


def _about_run(
    run: LiveRun, estimate: LiveEstimate, snapshot: Snapshot, *, has_hints: bool
) -> Iterator[Remark]:
    if snapshot.warming_up:
        yield Remark(Level.NOTE, "alignment", "warming up")
    elif snapshot.alignment is not None and snapshot.alignment.freedom is not None:
        misleading = snapshot.alignment.freedom.misleading
        is_early = estimate.thinned.span_s < FIRST_HINTS_S  # the first errors rotate a short path
        if misleading and has_hints and not is_early:
            yield warning("hint", misleading, "alignment")
    if has_hints and not run.holds:
        yield from estimate.slow.hints
    if snapshot.why_not_consistency and not snapshot.warming_up:
        why, _, advice = snapshot.why_not_consistency.partition("; ")
        # The evaluation of files has one more option, a joint covariance.
        text = f"no NEES: {why}" + ("; use covariance:=none" if "--covariance" in advice else "")
        yield warning("hint", text, "covariance")
    if snapshot.about_yaw is not None:
        yield snapshot.about_yaw
    if doubt := snapshot.doubts.reasons.get(Premise.UP_AXIS):
        yield warning("hint", doubt.replace("--up=", "up:="), "up")
    lost = run.groundtruth.lost + estimate.source.lost
    if lost:
        yield warning("loss", f"{counted(lost, 'message')} lost")
    if forgotten := estimate.evaluator.buffer.why_forgotten:
        yield warning("delay", forgotten)
    if trouble := run.states_file.trouble or estimate.states_file.trouble:
        text = f"results can't be written to {run.folder}: {trouble}"
        yield Remark(Level.ERROR, "disk", text)
    elif snapshot.pairs and run.finisher.trouble:
        yield warning("result", f"no result: {run.finisher.trouble}")


def _about_twins(node: Node) -> list[Remark]:
    """Report other nodes with the same name, because their topics have equal names."""
    name = node.get_fully_qualified_name()
    everybody = node.get_node_names_and_namespaces()
    names = [f"{namespace.rstrip('/')}/{item}" for item, namespace in everybody]
    if names.count(name) < 2:
        return []
    text = (
        f"{names.count(name)} nodes have the name {name} and publish on the same topics; start "
        "them with different names, as in --ros-args -r __node:=evaluator_2"
    )
    return [warning("hint", text, "name")]


def _values(run: LiveRun, estimate: LiveEstimate, snapshot: Snapshot) -> dict[str, Any]:
    return {
        "groundtruth": run.groundtruth.source,
        "estimate": estimate.source.source,
        "warming up": snapshot.warming_up or None,
        **status_values(snapshot, estimate.newest),
        "dropped": reasons(add_counts(estimate.status.dropped, snapshot.dropped)) or None,
        "groundtruth dropped": reasons(groundtruth_dropped(run, estimate)) or None,
        f"waiting for {estimate.evaluator.buffer.interpolated}": snapshot.waiting,
        "messages lost": estimate.source.lost,
        "groundtruth messages lost": run.groundtruth.lost,
        **stream_values(estimate.status.stream.recent()),
        **stream_values(run.groundtruth_status.stream.recent(), "groundtruth "),
        "clock offset [s]": estimate.clock.report.offset_s,
        "clock offset, sigma [s]": estimate.clock.report.sigma_s,
        "clock offset, status": estimate.clock.report.status,
        "time offset applied [s]": None if run.holds else estimate.evaluator.settings.offset_s,
        "hand eye": run.body.source if run.body.hand_eye is not None else None,
        "sync risk [m]": sync_risk_m(run, estimate),
        **({} if estimate.availability is None else estimate.availability.values),
        "arrival to publication, p95 [s]": estimate.latency.p95_s,
        "results": run.folder,
    }


class StatusReports:
    """Publishes the status of a run and the events about its changes."""

    def __init__(
        self, node: Node, events: EventTopic, watching: Watching, log: Callable[[str, Level], None]
    ) -> None:
        """Create it; `log` writes a sentence to the log."""
        self._node, self._events, self._watching, self._log = node, events, watching, log
        self._diagnostics = DiagnosticsTopic(node)
        self.newest: dict[str, Status] = {}  # by name of the estimate
        self.remarks: dict[str, list[Remark]] = {}  # the newest published ones, by estimate

    def publish(
        self,
        run: LiveRun,
        outputs: Mapping[str, EstimateOutputs],
        limits: Mapping[str, AlarmLimits],
        window: str,
        undrawn: int,
    ) -> list[str]:
        """Publish diagnostics and new events; return the estimates' parts of the status line."""
        twins, parts, self.newest = _about_twins(self._node), [], {}
        news: dict[tuple[Level, str], list[str]] = {}  # names of estimates by new remark
        for estimate in run.estimates:
            snapshot = estimate.newest_snapshot
            if snapshot is None:
                continue
            peaks = estimate.peaks.take()
            remarks = remarks_about(run, estimate, snapshot, peaks, limits)
            remarks += [*twins, *outputs[estimate.name].remarks]
            self.remarks[estimate.name] = remarks
            # A source logs unusable messages itself, once.
            troubles = run.groundtruth.stream.trouble, estimate.source.stream.trouble
            logged = {trouble.text for trouble in troubles if trouble is not None}
            self._publish_changes(estimate, remarks, news, logged)
            self.newest[estimate.name] = Status.of(
                run, estimate, snapshot, remarks, peaks, undrawn
            )
            missing, newest_m = missing_source(run, estimate), estimate.newest.position_m
            about = estimate.name, snapshot, window, newest_m, missing
            parts.append(summary(*about, unpaired_s=estimate.unpaired_s))
        for (level, text), names in news.items():
            # A remark about the groundtruth concerns all estimates.
            self._log(f"{', '.join(names)}: {text}", level)
        statuses = [
            status_message(self._node, item.level, name, item.text, item.values)
            for name, item in self.newest.items()
        ]
        self._diagnostics.publish([*statuses, *self._watching.statuses()])
        return parts

    def _publish_changes(
        self,
        estimate: LiveEstimate,
        remarks: Sequence[Remark],
        news: dict[tuple[Level, str], list[str]],
        logged: set[str],
    ) -> None:
        """Publish the remarks that are new, more severe, or no longer true.

        They are added to `news`, unless their text was logged.
        """
        # Every discontinuity was published as an event.
        reported = estimate.standing.renew(
            remark for remark in remarks if remark.subject != SUMMARY
        )
        for item in reported:
            if self._events.publish(estimate.name, item) and item.text not in logged:
                news.setdefault((item.level, item.text), []).append(estimate.name)
        self._watching.see(reported)
