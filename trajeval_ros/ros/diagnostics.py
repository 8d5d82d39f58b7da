"""How an evaluation goes, as a `diagnostic_msgs/DiagnosticStatus`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trajeval_ros.diagnosis.warnings import reasons
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.geometry.trajectory import add_counts
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun, sync_risk_m

OK, WARN, ERROR, STALE = range(4)
_BY_GRAVITY = (OK, WARN, STALE, ERROR)  # silence must not hide an error

_STALE_AFTER_S = 5.0

Complaint = tuple[int, str]


def diagnose(
    node: str,
    run: LiveRun,
    estimate: LiveEstimate,
    snapshot: Snapshot,
    newest: Update,
    limits: Mapping[str, Any],
    undrawn: int,
) -> Any:
    """Return the status of one estimate.

    Args:
        node: The node's name.
        run: The run.
        estimate: One of its estimates.
        snapshot: Its evaluation.
        newest: Of its newest pair.
        limits: The parameters.
        undrawn: Number of updates that Rerun didn't get.
    """
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    complaints = [
        *_about_data(run, estimate),
        *_about_coverage(snapshot.estimate_coverage, limits),
        *_about_error(newest.position_m, limits),
        *_about_run(run, estimate, snapshot),
    ]
    gravest_first = sorted(complaints, key=lambda each: -_BY_GRAVITY.index(each[0]))
    level = gravest_first[0][0] if gravest_first else OK
    values = _values(run, estimate, snapshot, newest)
    values["updates not drawn in Rerun"] = undrawn or None
    return DiagnosticStatus(
        level=bytes([level]),
        name=f"{node}: {estimate.name}",
        message=one_line("; ".join(text for _, text in gravest_first)) or "evaluating",
        values=[
            KeyValue(
                key=key, value=f"{value:.6g}" if isinstance(value, float) else one_line(str(value))
            )
            for key, value in values.items()
            if value is not None
        ],
    )


def _about_data(run: LiveRun, estimate: LiveEstimate) -> list[Complaint]:
    """Tell what doesn't come: no number renews itself then."""
    complaints = []
    for what, side in (("groundtruth", run.groundtruth), ("estimate", estimate.side)):
        silent_s = side.silent_s
        if silent_s is None:
            complaints.append((STALE, f"no {what} yet on {side.source}"))
        elif silent_s > _STALE_AFTER_S:
            complaints.append((STALE, f"no {what} for {silent_s:.0f} s on {side.source}"))
        if side.stream.trouble:
            complaints.append((WARN, side.stream.trouble))
    return complaints


def _about_coverage(coverage: float | None, limits: Mapping[str, Any]) -> list[Complaint]:
    for level, name in ((ERROR, "error_coverage"), (WARN, "warn_coverage")):
        if coverage is not None and coverage < limits[name]:
            return [(level, f"only {100 * coverage:.0f} % of the poses have groundtruth")]
    return []


def _about_error(position_m: float | None, limits: Mapping[str, Any]) -> list[Complaint]:
    for level, name in ((ERROR, "error_position_error_m"), (WARN, "warn_position_error_m")):
        if position_m is not None and 0.0 < limits[name] < position_m:
            return [(level, f"position error {position_m:.3f} m is over {limits[name]:g} m")]
    return []


def _about_run(run: LiveRun, estimate: LiveEstimate, snapshot: Snapshot) -> list[Complaint]:
    complaints = []
    clock, applied_s = estimate.clock.report, estimate.evaluator.offset_s
    if run.holds:
        complaints.append((OK, "nothing is evaluated until the clocks' offset is known"))
    elif clock.is_significant and clock.offset_s is not None and clock.half_width_95_s is not None:
        apart_s = clock.offset_s - applied_s
        if abs(apart_s) > clock.half_width_95_s:
            complaints.append(
                (
                    WARN,
                    f"the clocks differ by {1e3 * apart_s:+.0f} ms "
                    f"+- {1e3 * clock.half_width_95_s:.2g} ms, which is not applied: "
                    "time_offset:=auto",
                )
            )
    if snapshot.warming_up:
        complaints.append((OK, f"warming up: {snapshot.warming_up}"))
    elif snapshot.alignment is not None and snapshot.alignment.freedom is not None:
        misleading = snapshot.alignment.freedom.misleading
        complaints += [(WARN, misleading)] if misleading else []
    if estimate.doubt:
        complaints.append((WARN, estimate.doubt.replace("--up=", "up:=")))
    if estimate.jumps.count:
        complaints.append((WARN, f"{estimate.jumps.count} jumps: restarted with a new origin?"))
    lost = run.groundtruth.lost + estimate.side.lost
    if lost:
        complaints.append((WARN, f"{lost} messages lost"))
    trouble = estimate.writer.trouble or (snapshot.pairs and run.finisher.trouble)
    if trouble:
        complaints.append((ERROR, f"results can't be written: {trouble}"))
    return complaints


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
