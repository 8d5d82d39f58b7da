"""The messages that a live run does not use, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.warnings import reasons
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.dropped_counts import add_counts
from trajeval_ros.ros.live_estimate import LiveEstimate

if TYPE_CHECKING:
    from trajeval_ros.ros.live_run import LiveRun


def missing_source(run: LiveRun, estimate: LiveEstimate) -> str:
    """Return a source of an estimate without any message so far; empty if there is none."""
    sides = (run.groundtruth, estimate.side)
    return next((each.source for each in sides if each.silent_s is None), "")


def groundtruth_dropped(run: LiveRun, estimate: LiveEstimate) -> dict[str, int]:
    """Return the number of groundtruth states that an estimate does not use, by reason."""
    dropped = estimate.dropped_since_begun(run.groundtruth.stream)
    return add_counts(dropped, estimate.evaluator.buffer.groundtruth_intake.dropped)


def why_no_pair(run: LiveRun) -> str:
    """Return why there are no pairs: the number of poses per topic, and reasons."""
    dropped = [
        groundtruth_dropped(run, run.estimates[0]),
        *(
            add_counts(each.stream.status.dropped, each.evaluator.buffer.dropped)
            for each in run.estimates
        ),
    ]
    sides = [run.groundtruth, *(each.side for each in run.estimates)]
    counts = [
        f"{counted(side.stream.status.poses, 'pose')} on {side.source}"
        + (f" ({reasons(of)})" if of else "")
        for side, of in zip(sides, dropped, strict=True)
    ]
    return "no pairs of estimate and groundtruth, no result: " + ", ".join(counts)
