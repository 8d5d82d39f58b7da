"""How an evaluation goes, as a `diagnostic_msgs/DiagnosticStatus`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from trajeval_ros.diagnosis.warnings import reasons
from trajeval_ros.geometry.trajectory import add_counts
from trajeval_ros.online.alarms import LIMITED_QUANTITIES, Peak, alarms
from trajeval_ros.online.notices import ERROR, OK, STALE, WARN, Notice, gravest_first
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun, sync_risk_m
from trajeval_ros.ros.status_message import status_message

_STALE_AFTER_S = 5.0


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
        node: The node's name.
        run: The run.
        estimate: One of its estimates.
        snapshot: Its evaluation.
        newest: Of its newest pair.
        notices: What `notices_about` says.
        peaks: The largest values since the last status.
        undrawn: Number of updates that Rerun didn't get.
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
    """Return what is to be said of one estimate now.

    Args:
        run: The run.
        estimate: One of its estimates.
        snapshot: Its evaluation.
        peaks: The largest values since the last status.
        limits: The parameters.
    """
    return [
        *_about_data(run, estimate),
        *_about_coverage(snapshot.estimate_coverage, limits),
        *alarms(peaks, limits),
        *_about_clock(run, estimate),
        *_about_run(run, estimate, snapshot),
    ]


def _about_data(run: LiveRun, estimate: LiveEstimate) -> Iterator[Notice]:
    """Tell what doesn't come: no number renews itself then."""
    for what, side in (("groundtruth", run.groundtruth), ("estimate", estimate.side)):
        silent_s = side.silent_s
        if silent_s is None:
            yield Notice("silence", STALE, f"no {what} yet on {side.source}", what)
        elif silent_s > _STALE_AFTER_S:
            said = f"no {what} for {silent_s:.0f} s on {side.source}"
            yield Notice("silence", STALE, said, what)
        if side.stream.trouble:
            yield Notice("data", WARN, side.stream.trouble, what)


def _about_coverage(coverage: float | None, limits: Mapping[str, Any]) -> list[Notice]:
    for level, name in ((ERROR, "error_coverage"), (WARN, "warn_coverage")):
        if coverage is not None and coverage < limits[name]:
            said = f"only {100 * coverage:.0f} % of the poses have groundtruth"
            values = {"value": coverage, "limit": limits[name]}
            return [Notice("alarm", level, said, "coverage", values)]
    return []


def _about_clock(run: LiveRun, estimate: LiveEstimate) -> Iterator[Notice]:
    clock, applied_s = estimate.clock.report, estimate.evaluator.offset_s
    if run.holds:
        said = "nothing is evaluated until the clocks' offset is known"
        yield Notice("clock", OK, said)
    elif clock.is_significant and clock.offset_s is not None and clock.half_width_95_s is not None:
        apart_s = clock.offset_s - applied_s
        if abs(apart_s) > clock.half_width_95_s:
            yield Notice(
                "clock",
                WARN,
                f"the clocks differ by {1e3 * apart_s:+.0f} ms "
                f"+- {1e3 * clock.half_width_95_s:.2g} ms, which is not applied: "
                "time_offset:=auto",
                values={"offset_s": apart_s, "half_width_95_s": clock.half_width_95_s},
            )


def _about_run(run: LiveRun, estimate: LiveEstimate, snapshot: Snapshot) -> Iterator[Notice]:
    if snapshot.warming_up:
        yield Notice("alignment", OK, f"warming up: {snapshot.warming_up}")
    elif snapshot.alignment is not None and snapshot.alignment.freedom is not None:
        misleading = snapshot.alignment.freedom.misleading
        if misleading:
            yield Notice("hint", WARN, misleading, "alignment")
    if estimate.doubt:
        yield Notice("hint", WARN, estimate.doubt.replace("--up=", "up:="), "up")
    if estimate.jumps.count:
        said = f"{estimate.jumps.count} jumps: restarted with a new origin?"
        yield Notice("jump", WARN, said, "count")
    lost = run.groundtruth.lost + estimate.side.lost
    if lost:
        yield Notice("loss", WARN, f"{lost} messages lost")
    if forgotten := estimate.evaluator.buffer.why_forgotten:
        yield Notice("delay", WARN, forgotten)
    trouble = estimate.writer.trouble or (snapshot.pairs and run.finisher.trouble)
    if trouble:
        yield Notice("disk", ERROR, f"results can't be written: {trouble}")


def _values(
    run: LiveRun, estimate: LiveEstimate, snapshot: Snapshot, newest: Update
) -> dict[str, Any]:
    """Return what stands in the status, by name; None is left out."""
    alignment, rotation = snapshot.alignment, snapshot.ate.get("rotation_deg")
    coverage = snapshot.coverage
    return {
        "groundtruth": run.groundtruth.source,
        "estimate": estimate.side.source,
        "pairs": snapshot.pairs,
        "window pairs": snapshot.window_pairs,
        "position error [m]": newest.position_m,
        "rotation error [deg]": newest.rotation_deg,
        "ATE position, window [m]": snapshot.window_position_rmse_m,
        "ATE rotation, window [deg]": None if rotation is None else rotation.rmse,
        "ATE position, whole run [m]": snapshot.position_rmse_m,
        **{
            f"RE {length}, mean [m]": errors.position_m
            for length, errors in snapshot.relative.items()
            if errors.count
        },
        "alignment": None if alignment is None else f"{alignment.states_used} states",
        "scale": None if alignment is None else alignment.similarity.scale,
        "estimate coverage": snapshot.estimate_coverage,
        "groundtruth coverage": None if coverage is None else coverage.covered,
        "groundtruth from first to last pair": None if coverage is None else coverage.span,
        "longest gap": None
        if coverage is None or coverage.longest_gap is None
        else str(coverage.longest_gap),
        "dropped": reasons(add_counts(estimate.stream.status.dropped, snapshot.dropped)) or None,
        "groundtruth dropped": reasons(run.groundtruth_dropped(estimate)) or None,
        "waiting for groundtruth": snapshot.waiting,
        "messages lost": estimate.side.lost,
        "groundtruth messages lost": run.groundtruth.lost,
        "arrival after stamp [s]": estimate.stream.arrivals.offset_s,
        "groundtruth arrival after stamp [s]": run.groundtruth.stream.arrivals.offset_s,
        "clock offset [s]": estimate.clock.report.offset_s,
        "clock offset, sigma [s]": estimate.clock.report.sigma_s,
        "clock offset, status": estimate.clock.report.status,
        "time offset applied [s]": None if run.holds else estimate.evaluator.offset_s,
        "sync risk [m]": sync_risk_m(run.groundtruth, estimate.side, estimate.evaluator.buffer),
        "latency p95 [s]": estimate.latency.p95_s,
        "results": run.finisher.folder,
    }
