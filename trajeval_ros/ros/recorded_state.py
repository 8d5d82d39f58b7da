"""The state that a live run stores next to its pairs, for `trajeval finish`.

It has the settings, counts and warnings.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.dropped_counts import add_counts
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_fixes import LiveFixes
from trajeval_ros.ros.sides import Side
from trajeval_ros.ros.unused_messages import groundtruth_dropped

if TYPE_CHECKING:
    from trajeval_ros.ros.live_run import LiveRun

_SAME_CLOCK_S = 60.0


def recorded_state(run: LiveRun, estimate: LiveEstimate) -> dict[str, Any]:
    """Return the data that `trajeval finish` needs in addition to the pairs, as JSON values."""
    buffer = estimate.evaluator.buffer
    return {
        "settings": run.words,
        "groundtruth": _groundtruth(run, estimate),
        "live": {
            "messages_lost": estimate.side.lost,
            "groundtruth_messages_lost": run.groundtruth.lost,
            "losses_are_exact": estimate.side.loss_is_exact and run.groundtruth.loss_is_exact,
            "arrival_offset_s": estimate.stream.arrivals.offset_s,
            "groundtruth_arrival_offset_s": run.groundtruth.stream.arrivals.offset_s,
            "sync_risk_m": sync_risk_m(run.groundtruth, estimate.side, buffer),
            "latency_p95_s": estimate.latency.p95_s,
            "jumps": estimate.jumps.count,
            "segment": estimate.segment,
            "clock": asdict(estimate.clock.report),
        },
        "hand_eye": run.body.state,
        "fixes": _fixes(run.groundtruth.stream.fixes),
        "warnings": _warnings(run, estimate),
        **_estimate(estimate),
    }


def _groundtruth(run: LiveRun, estimate: LiveEstimate) -> dict[str, Any]:
    status, buffer = run.groundtruth.stream.status, estimate.evaluator.buffer
    return {
        "poses": buffer.groundtruth_intake.poses,
        "states": buffer.groundtruth_count,
        "duration_s": buffer.groundtruth_intake.duration_s,
        "path_length_m": buffer.groundtruth_path_m,
        "time_without_gaps_ns": buffer.groundtruth_time,
        "frame": status.frame,
        "child_frame": status.child_frame,
        "up": asdict(run.groundtruth_up),
        "dropped": groundtruth_dropped(run, estimate),
        "notes": list(status.notes),
    }


def _estimate(estimate: LiveEstimate) -> dict[str, Any]:
    status, evaluator = estimate.stream.status, estimate.evaluator
    covariances, buffer = evaluator.settings.covariances, evaluator.buffer
    between = buffer.interpolation
    return {
        "estimate": {
            "poses": buffer.estimate_intake.poses,
            "states": buffer.estimate_count,
            "duration_s": buffer.estimate_intake.duration_s,
            "first_stamp_ns": buffer.estimate_intake.first,
            "frame": status.frame,
            "child_frame": status.child_frame,
            "up": asdict(estimate.up),
            "notes": list(status.notes),
            "interpolation": None if between is None else asdict(between),
        },
        "covariances": {
            "source": covariances.source,
            "rotation_frame": covariances.rotation_frame,
            "groundtruth_noise": covariances.groundtruth_noise,
        },
        "dropped": add_counts(estimate.dropped_since_begun(estimate.stream), buffer.dropped),
        "aligned_by": evaluator.frozen_at,
    }


def _fixes(fixes: LiveFixes) -> dict[str, Any] | None:
    """Return how GNSS fixes are used; None for other groundtruth."""
    if fixes.datum is None:
        return None
    datum = fixes.datum.coordinates.tolist()
    return {"datum": datum, "correlation_s": fixes.rule.correlation_s}


def _warnings(run: LiveRun, estimate: LiveEstimate) -> list[str]:
    warnings = [
        f"{counted(side.lost, 'message')} of {side.source} lost in transport to the live evaluator"
        for side in (run.groundtruth, estimate.side)
        if side.lost
    ]
    if estimate.began_by:
        warnings.append(
            f"segment {estimate.segment} of {estimate.side.source}: {estimate.began_by}"
        )
    forgotten = estimate.evaluator.buffer.why_forgotten
    known = run.about_clocks, estimate.why_not_revised, run.body.said, forgotten
    warnings += filter(None, known)
    if estimate.files.pairs.lost:
        warnings.append(
            f"{counted(estimate.files.pairs.lost, 'pair')} missing, since the disk could not be "
            f"written: {estimate.files.pairs.why_lost}"
        )
    return warnings


def sync_risk_m(groundtruth: Side, estimate: Side, buffer: Pairing) -> float | None:
    """Return the position error that unsynchronised clocks may cause, metres.

    This is the groundtruth's mean speed times the difference of the offsets between timestamp and
    arrival. It is an upper bound: the estimator's own delay is part of the difference. None if
    timestamps and arrivals are of different clocks, as in a replay without simulated time.
    """
    one, other = groundtruth.stream.arrivals.offset_s, estimate.stream.arrivals.offset_s
    if one is None or other is None or not buffer.groundtruth_time:
        return None
    if max(abs(one), abs(other)) > _SAME_CLOCK_S:
        return None
    speed = buffer.groundtruth_path_m / (buffer.groundtruth_time / NANOSECONDS)
    return speed * abs(one - other)
