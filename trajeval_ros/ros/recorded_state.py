"""The state that a live run stores next to its pairs, and the messages that it does not use."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import Any

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, remark_json, warning
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.valid_poses import add_counts, reasons
from trajeval_ros.io.bags.declared_resets import about_resets
from trajeval_ros.io.requests.settings_table import settings_of
from trajeval_ros.online.state_buffer import StateCounts
from trajeval_ros.ros.clock_remarks import about_clock_faults, sync_risk_m
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.poses import StreamStatus


def write_states(run: LiveRun) -> None:
    """Write the state of all estimates that `trajeval finish` needs besides pairs."""
    for each in run.estimates:
        each.write_state(_recorded_state(run, each))


def save(run: LiveRun) -> None:
    """Start to write result.json; requires pairs and no running process."""
    write_states(run)
    for each in run.estimates:
        each.write_revised()
    run.finisher.save()


def _recorded_state(run: LiveRun, estimate: LiveEstimate) -> dict[str, Any]:
    """Return the data that `trajeval finish` needs in addition to the pairs, as JSON values."""
    return {
        "settings": run.protocol_values,
        "stated": settings_of(run.request),
        "groundtruth": _groundtruth(run, estimate),
        "live": {
            "messages_lost": estimate.source.lost,
            "groundtruth_messages_lost": run.groundtruth.lost,
            "losses_are_exact": estimate.source.loss_is_exact and run.groundtruth.loss_is_exact,
            "streams": {
                "groundtruth": asdict(run.groundtruth_status.stream.whole()),
                "estimate": asdict(estimate.status.stream.whole()),
            },
            "sync_risk_m": sync_risk_m(run, estimate),
            "latency_p95_s": estimate.latency.p95_s,
            "jumps": estimate.jumps.count,
            "began_by": run.began_by,
            **run.about,
            "clock": asdict(estimate.clock.report),
        },
        "hand_eye": run.body.state,
        "fixes": _fixes(run),
        "warnings": [remark_json(each) for each in _warnings(run, estimate)],
        **_estimate(estimate),
    }


def _side(counts: StateCounts, status: StreamStatus, up: UpAxis) -> dict[str, Any]:
    told = about_resets(status.resets, status.first)
    return {
        "poses": counts.poses,
        "duration_s": counts.duration_s,
        "frame": status.frame,
        "child_frame": status.child_frame,
        "up": asdict(up),
        "notes": [remark_json(each) for each in (*status.remarks, *told)],
    }


def _groundtruth(run: LiveRun, estimate: LiveEstimate) -> dict[str, Any]:
    status, buffer = run.groundtruth_status, estimate.evaluator.buffer
    return {
        **_side(buffer.groundtruth_counts, status, run.groundtruth_up),
        "states": buffer.groundtruth_count,
        "path_length_m": buffer.groundtruth_path_m,
        "time_without_gaps_ns": buffer.groundtruth_time,
        "dropped": groundtruth_dropped(run, estimate),
    }


def _estimate(estimate: LiveEstimate) -> dict[str, Any]:
    status, evaluator = estimate.status, estimate.evaluator
    covariances, buffer = evaluator.settings.covariances, evaluator.buffer
    between = buffer.interpolation
    return {
        "estimate": {
            **_side(buffer.estimate_counts, status, estimate.up),
            "states": buffer.estimate_count,
            "first_stamp_ns": buffer.estimate_counts.first,
            "resets": status.resets,
            "interpolation": None if between is None else asdict(between),
        },
        "covariances": {
            "source": covariances.source,
            "rotation_frame": covariances.rotation_frame,
            "groundtruth_noise": covariances.groundtruth_noise,
        },
        "dropped": add_counts(estimate.status.dropped, buffer.dropped),
        "aligned_by": evaluator.frozen_at,
    }


def _fixes(run: LiveRun) -> dict[str, Any] | None:
    datum = run.groundtruth_status.datum
    if datum is None:
        return None
    rule = run.groundtruth.stream.fixes.rule
    return {"datum": datum.coordinates.tolist(), "correlation_s": rule.correlation_s}


def _warnings(run: LiveRun, estimate: LiveEstimate) -> Iterator[Remark]:
    for source in (run.groundtruth, estimate.source):
        if source.lost:
            yield warning(
                "messages_lost",
                f"{counted(source.lost, 'message')} of {source.source} lost in transport to the "
                "live evaluator",
            )
    for each in about_clock_faults(run, estimate):
        yield replace(each, code=f"clock_{each.subject}")
    for code, said in (
        ("clock_offset", run.start.about_clocks),
        ("not_revised", estimate.why_not_revised),
        ("marker", run.body.said),
        ("memory", estimate.evaluator.buffer.why_forgotten),
    ):
        if said:
            yield warning(code, said)
    if estimate.pairs_file.lost:
        yield warning(
            "pairs_lost",
            f"{counted(estimate.pairs_file.lost, 'pair')} missing, since the disk could not be "
            f"written: {estimate.pairs_file.why_lost}",
        )


def missing_source(run: LiveRun, estimate: LiveEstimate) -> str:
    """Return a source of an estimate without any message so far; empty if there is none."""
    sources = (run.groundtruth, estimate.source)
    return next((each.source for each in sources if each.silent_s is None), "")


def groundtruth_dropped(run: LiveRun, estimate: LiveEstimate) -> dict[str, int]:
    """Return the number of groundtruth states that an estimate does not use, by reason."""
    dropped = run.groundtruth_status.dropped
    return add_counts(dropped, estimate.evaluator.buffer.groundtruth_counts.dropped)


def why_no_pair(run: LiveRun) -> str:
    """Return why there are no pairs: the number of poses per topic, and reasons."""
    found = [(run.groundtruth, run.groundtruth_status, groundtruth_dropped(run, run.estimates[0]))]
    for each in run.estimates:
        dropped = add_counts(each.status.dropped, each.evaluator.buffer.dropped)
        found.append((each.source, each.status, dropped))
    counts = [
        f"{counted(status.poses, 'pose')} on {source.source}"
        + (f" ({reasons(dropped)})" if dropped else "")
        for source, status, dropped in found
    ]
    clocks = (
        each.text for estimate in run.estimates for each in about_clock_faults(run, estimate)
    )
    said = "no pairs of estimate and groundtruth, no result: " + ", ".join(counts)
    return "; ".join([said, *clocks])
