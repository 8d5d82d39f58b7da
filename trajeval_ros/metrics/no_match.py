"""The error message for trajectories without a common pair, with the likely cause."""

from __future__ import annotations

import math
from datetime import datetime, timezone
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.numbers import significant
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.statistics import median

if TYPE_CHECKING:
    from trajeval_ros.metrics.association import AssociationRule

LATEST_CLOCK_S = 5e9  # the year 2128


def explain_no_match(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule, dropped: dict[str, int]
) -> str:
    """Return both time ranges and the likely cause, as one sentence.

    Args:
        groundtruth: States with timestamps.
        estimate: States with timestamps, time offset applied.
        rule: The rule that made no pair.
        dropped: Number of states without a pair, by reason.
    """

    def span(trajectory: Trajectory) -> tuple[float, float]:
        return trajectory.stamps.min() / NANOSECONDS, trajectory.stamps.max() / NANOSECONDS

    truth, other = span(groundtruth), span(estimate)
    text = f"no pairs: the groundtruth covers {_clock(*truth)}, the estimate {_clock(*other)}"
    if dropped.get("in_groundtruth_gap"):
        return (
            f"{text}; all common timestamps are in groundtruth gaps longer than "
            f"{rule.max_gap_s:g} s (median step {_step_s(groundtruth):.3g} s); increase the max "
            "gap, or use association continuous"
        )
    if dropped.get("in_estimate_gap"):
        return (
            f"{text}; all common timestamps are in estimate gaps longer than {rule.max_gap_s:g} "
            f"s (median step {_step_s(estimate):.3g} s); use association linear, or increase the "
            "max gap"
        )
    if truth[0] <= other[1] and other[0] <= truth[1]:
        if "no_groundtruth_within_max_time_difference" not in dropped:
            return (
                f"{text}; they overlap, but no timestamp of one side is within the other; check "
                "the number of digits of the timestamps"
            )
        return (
            f"{text}; they overlap, but all time differences exceed "
            f"{rule.max_time_difference_s:g} s; use association linear, or increase the max "
            "time difference"
        )
    thousands = math.log10(max(truth[1], 1e-9) / max(other[1], 1e-9)) / 3.0
    as_other_unit = abs(thousands) > 0.5 and abs(thousands - round(thousands)) < 0.01
    if as_other_unit or max(truth[1], other[1]) > LATEST_CLOCK_S:
        return f"{text}; the units of the timestamps probably differ (seconds, milliseconds)"
    if min(truth[1], other[1]) < 1e7 and max(truth[1], other[1]) > 1e8:
        return f"{text}; one counts from zero (simulated time), the other is a system clock"
    apart = max(truth[0] - other[1], other[0] - truth[1])
    shift = truth[0] - other[0]
    return (
        f"{text}, {significant(apart, 6)} s apart; for a constant clock difference, set the time "
        f"offset (for a common start: {shift:.6f} s)"
    )


def _step_s(trajectory: Trajectory) -> float:
    """Return the median step between timestamps, seconds."""
    return median(np.diff(np.sort(trajectory.stamps))) / NANOSECONDS


def _clock(start: float, end: float) -> str:
    """Return a time range in seconds, with the date if the clock is a Unix clock."""
    text = f"{start:.3f} to {end:.3f} s"
    if 1e8 < start < 2e10:
        day = datetime.fromtimestamp(start, tz=timezone.utc).strftime("%Y-%m-%d %H:%M:%S")
        text += f" ({day} UTC)"
    return text
