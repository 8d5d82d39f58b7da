"""The state that a live run stores next to its states, and the messages that it does not use."""

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
from trajeval_ros.ros.clock_remarks import (
    about_clock_faults,
    about_clock_step,
    about_different_clocks,
    sync_risk_m,
)
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.poses import StreamStatus


def write_states(run: LiveRun) -> None:
    """Write the settings and counts that `trajeval finish` needs besides the states.

    What a full disk did not accept is written, too.
    """
    run.states_file.write()
    for estimate in run.estimates:
        estimate.states_file.describe(_recorded_state(run, estimate))


def save(run: LiveRun) -> None:
    """Start to write result.json; requires pairs and no running process."""
    write_states(run)
    for estimate in run.estimates:
        estimate.write_revised()
    run.finisher.save()


def _recorded_state(run: LiveRun, estimate: LiveEstimate) -> dict[str, Any]:
    """Return the data that `trajeval finish` needs in addition to the states, as JSON values."""
    groundtruth, evaluator = run.groundtruth_status, estimate.evaluator
    return {
        "settings": settings_of(run.request),
        "time_offset_s": evaluator.settings.offset_s,
        "aligned_by": evaluator.frozen_at,
        "until_ns": estimate.until_ns,
        "groundtruth": _side(groundtruth, run.groundtruth_up),
        "estimate": _side(estimate.status, estimate.up),
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
            "began_by": run.began_by,
            **run.plan.about,
            "clock": asdict(estimate.clock.report),
        },
        "hand_eye": run.body.state,
        "fixes": None if groundtruth.datum is None else groundtruth.datum.coordinates.tolist(),
        "warnings": [remark_json(item) for item in _warnings(run, estimate)],
    }


def _side(status: StreamStatus, up: UpAxis) -> dict[str, Any]:
    resets = about_resets(status.resets, status.first)
    return {
        "frame": status.frame,
        "child_frame": status.child_frame,
        "up": asdict(up),
        "dropped": status.dropped,
        "resets": status.resets,
        "notes": [remark_json(remark) for remark in (*status.remarks, *resets)],
    }


def _warnings(run: LiveRun, estimate: LiveEstimate) -> Iterator[Remark]:
    for source in (run.groundtruth, estimate.source):
        if source.lost:
            yield warning(
                "messages_lost",
                f"{counted(source.lost, 'message')} of {source.source} lost in transport to the "
                "live evaluator",
            )
    if estimate.stepped is not None:  # its recorded states are those after it
        yield about_clock_step(estimate.stepped)
    for remark in about_different_clocks(run, estimate):
        yield replace(remark, code=f"clock_{remark.subject}")
    for code, text in (
        ("clock_offset", run.start.about_clocks),
        ("marker", run.body.text),
    ):
        if text:
            yield warning(code, text)
    for source, file in (
        (run.groundtruth, run.states_file),
        (estimate.source, estimate.states_file),
    ):
        if file.lost:
            yield warning(
                "states_lost",
                f"{counted(file.lost, 'pose')} of {source.source} missing, since the disk could "
                f"not be written: {file.why_lost}",
            )


def missing_source(run: LiveRun, estimate: LiveEstimate) -> str:
    """Return a source of an estimate without any message so far; empty if there is none."""
    sources = (run.groundtruth, estimate.source)
    return next((source.source for source in sources if source.silent_s is None), "")


def groundtruth_dropped(run: LiveRun, estimate: LiveEstimate) -> dict[str, int]:
    """Return the number of groundtruth states that an estimate does not use, by reason."""
    dropped = run.groundtruth_status.dropped
    return add_counts(dropped, estimate.evaluator.buffer.groundtruth_counts.dropped)


def why_no_pair(run: LiveRun) -> str:
    """Return why there are no pairs: the number of poses per topic, and reasons."""
    streams = [
        (run.groundtruth, run.groundtruth_status, groundtruth_dropped(run, run.estimates[0]))
    ]
    for item in run.estimates:
        dropped = add_counts(item.status.dropped, item.evaluator.buffer.dropped)
        streams.append((item.source, item.status, dropped))
    counts = [
        f"{counted(status.poses, 'pose')} on {source.source}"
        + (f" ({reasons(dropped)})" if dropped else "")
        for source, status, dropped in streams
    ]
    clocks = (
        remark.text for estimate in run.estimates for remark in about_clock_faults(run, estimate)
    )
    text = "no pairs of estimate and groundtruth, no result: " + ", ".join(counts)
    return "; ".join([text, *clocks])
