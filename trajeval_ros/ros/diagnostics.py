"""The status of an evaluation, as a `diagnostic_msgs/DiagnosticStatus`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from trajeval_ros.diagnosis.warnings import reasons
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.dropped_counts import add_counts
from trajeval_ros.online.alarms import LIMITED_QUANTITIES, Peak, alarms
from trajeval_ros.online.error_topics import status_values
from trajeval_ros.online.notices import ERROR, OK, STALE, WARN, Notice, gravest_first
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.recorded_state import sync_risk_m
from trajeval_ros.ros.status_message import status_message
from trajeval_ros.ros.unused_messages import groundtruth_dropped


def diagnose(
    node: str,
    run: LiveRun,
    estimate: LiveEstimate,
    snapshot: Snapshot,
    newest: Update,
    notices: Sequence[Notice],
    peaks: Mapping[str, Peak],
    undrawn: int,
) -> Any:
    """Return the status of one estimate.

    Args:
        node: Name of the node.
        run: The run.
        estimate: One of its estimates.
        snapshot: Its evaluation.
        newest: Errors of its newest pair.
        notices: Notices from `notices_about`.
        peaks: The largest values since the last status.
        undrawn: Number of updates that Rerun did not receive.
    """
    told = gravest_first(notices)
    values = _values(run, estimate, snapshot, newest)
    values |= {
        f"{words}, largest since the last status [{unit}]": peaks[name].value
        for name, words, unit in LIMITED_QUANTITIES
        if name in peaks
    }
    values["updates not drawn in Rerun"] = undrawn or None
    return status_message(
        told[0].level if told else OK,
        f"{node}: {estimate.name}",
        "; ".join(each.text for each in told) or "evaluating",
        values,
    )


def notices_about(
    run: LiveRun,
    estimate: LiveEstimate,
    snapshot: Snapshot,
    peaks: Mapping[str, Peak],
    limits: Mapping[str, Any],
) -> list[Notice]:
    """Return the current notices about one estimate.

    Args:
        run: The run.
        estimate: One of its estimates.
        snapshot: Its evaluation.
        peaks: The largest values since the last status.
        limits: The parameters.
    """
    return [
        *_about_data(run, estimate),
        *_about_coverage(snapshot, limits),
        *alarms(peaks, limits),
        *about_integrity(snapshot),
        *_about_start(run),
        *_about_clock(run, estimate),
        *_about_run(run, estimate, snapshot),
    ]


def _about_data(run: LiveRun, estimate: LiveEstimate) -> Iterator[Notice]:
    """Report missing data, without which no error is updated."""
    for what, side in (("groundtruth", run.groundtruth), ("estimate", estimate.side)):
        silent_s = side.silent_s
        if silent_s is None:
            yield Notice("silence", STALE, f"no {what} yet on {side.source}", what)
        elif silent_s > side.stream.patience_s:
            said = f"no {what} for {silent_s:.0f} s on {side.source}"
            yield Notice("silence", STALE, said, what)
        if side.stream.trouble:
            yield Notice("data", WARN, side.stream.trouble, what)


def _about_coverage(snapshot: Snapshot, limits: Mapping[str, Any]) -> list[Notice]:
    coverage, what = snapshot.estimate_coverage, "poses have groundtruth"
    if coverage is None and snapshot.coverage is not None:  # pairs at groundtruth's times
        coverage, what = snapshot.coverage.covered, "fixes or points have an estimate"
    for level, name in ((ERROR, "error_coverage"), (WARN, "warn_coverage")):
        if coverage is not None and coverage < limits[name]:
            said = f"only {100 * coverage:.0f} % of the {what}"
            values = {"value": coverage, "limit": limits[name]}
            return [Notice("alarm", level, said, "coverage", values)]
    return []


def about_integrity(snapshot: Snapshot) -> list[Notice]:
    """Report the region of the Stanford diagram of the newest pair, unless it is nominal."""
    parts = () if snapshot.integrity is None else snapshot.integrity.parts
    found = []
    for each in parts:
        error, level, limit = float(each.errors[-1]), float(each.levels[-1]), each.alert_limit
        if max(error, level) <= limit and error <= level:
            continue
        is_hazardous = level <= limit < error
        state = "hazardously misleading" if is_hazardous else "misleading"
        if error <= level:
            state = "unavailable"
        said = (
            f"integrity, {each.part}: {state}: error {error:.3g}, protection level {level:.3g}, "
            f"alert limit {limit:g} {each.unit}"
        )
        values: dict[str, float | int | str]
        values = {"value": error, "level": level, "limit": limit, "unit": each.unit}
        gravity = ERROR if is_hazardous else WARN
        found.append(Notice("alarm", gravity, said, f"integrity_{each.part}", values))
    return found


def _about_clock(run: LiveRun, estimate: LiveEstimate) -> Iterator[Notice]:
    clock, applied_s = estimate.clock.report, estimate.evaluator.settings.offset_s
    if run.holds or clock.offset_s is None or clock.half_width_95_s is None:
        return
    apart_s = clock.offset_s - applied_s
    if clock.is_significant and abs(apart_s) > clock.half_width_95_s:
        yield Notice(
            "clock",
            WARN,
            f"the clocks differ by {1e3 * apart_s:+.0f} ms +- {1e3 * clock.half_width_95_s:.2g} "
            "ms, not applied; to apply it, set time_offset:=auto",
            values={"offset_s": apart_s, "half_width_95_s": clock.half_width_95_s},
        )


def _about_start(run: LiveRun) -> Iterator[Notice]:
    """Report what the start of the evaluation waits for, and what was not found."""
    body = run.body
    if run.waits_for:
        yield Notice("alignment", OK, f"evaluation waits for {run.waits_for}")
    if body.why_not and (not run.holds or body.transform is not None):
        said = f"hand_eye:={body.source} is not applied: {body.why_not}"
        yield Notice("hint", WARN, said, "hand_eye")


def _about_run(run: LiveRun, estimate: LiveEstimate, snapshot: Snapshot) -> Iterator[Notice]:
    if snapshot.warming_up:
        yield Notice("alignment", OK, f"warming up: {snapshot.warming_up}")
    elif snapshot.alignment is not None and snapshot.alignment.freedom is not None:
        misleading = snapshot.alignment.freedom.misleading
        if misleading:
            yield Notice("hint", WARN, misleading, "alignment")
    if not run.holds:
        yield from estimate.slow.hints
    if snapshot.why_not_consistency and not snapshot.warming_up:
        said = f"no NEES: {snapshot.why_not_consistency}"
        yield Notice("hint", WARN, said, "covariance")
    if estimate.doubt:
        yield Notice("hint", WARN, estimate.doubt.replace("--up=", "up:="), "up")
    if estimate.jumps.count:
        said = f"{counted(estimate.jumps.count, 'jump')}, probably a restart with a new origin"
        yield Notice("jump", WARN, said, "count")
    lost = run.groundtruth.lost + estimate.side.lost
    if lost:
        yield Notice("loss", WARN, f"{counted(lost, 'message')} lost")
    if forgotten := estimate.evaluator.buffer.why_forgotten:
        yield Notice("delay", WARN, forgotten)
    trouble = estimate.files.pairs.trouble or (snapshot.pairs and run.folders.finisher.trouble)
    if trouble:
        yield Notice("disk", ERROR, f"results can't be written: {trouble}")


def _values(
    run: LiveRun, estimate: LiveEstimate, snapshot: Snapshot, newest: Update
) -> dict[str, Any]:
    """Return the values of the status, by name; those that are None are omitted."""
    return {
        "groundtruth": run.groundtruth.source,
        "estimate": estimate.side.source,
        "segment": estimate.segment,
        **status_values(snapshot, newest),
        "dropped": reasons(add_counts(estimate.stream.status.dropped, snapshot.dropped)) or None,
        "groundtruth dropped": reasons(groundtruth_dropped(run, estimate)) or None,
        f"waiting for {estimate.evaluator.buffer.interpolated}": snapshot.waiting,
        "messages lost": estimate.side.lost,
        "groundtruth messages lost": run.groundtruth.lost,
        "arrival after stamp [s]": estimate.stream.arrivals.offset_s,
        "groundtruth arrival after stamp [s]": run.groundtruth.stream.arrivals.offset_s,
        "clock offset [s]": estimate.clock.report.offset_s,
        "clock offset, sigma [s]": estimate.clock.report.sigma_s,
        "clock offset, status": estimate.clock.report.status,
        "time offset applied [s]": None if run.holds else estimate.evaluator.settings.offset_s,
        "hand eye": run.body.source if run.body.hand_eye is not None else None,
        "sync risk [m]": sync_risk_m(run.groundtruth, estimate.side, estimate.evaluator.buffer),
        "latency p95 [s]": estimate.latency.p95_s,
        "results": run.folders.finisher.folder,
    }
