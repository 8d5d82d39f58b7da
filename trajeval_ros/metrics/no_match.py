"""Likely cause when two trajectories have no pairs, as a sentence."""

from __future__ import annotations

import math
from datetime import datetime, timezone

import numpy as np

from trajeval_ros.formatting.numbers import significant
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association_rule import LATEST_CLOCK_S, AssociationRule
from trajeval_ros.metrics.statistics import median

_GPS_START_S = 315_964_782  # start of GPS time since 1970, less the 18 leap seconds since 2017
_WEEK_S = 604_800
_DAY_S = 86_400.0
_AUTO = "--time-offset auto"
# Wrong time zones and clocks that start at zero differ by less.
_OTHER_RECORDING_S = 2.0 * _DAY_S


def _gps_offset(
    groundtruth_s: tuple[float, float], estimate_s: tuple[float, float]
) -> tuple[str, int] | None:
    """Return the GPS time that one side has, and the time offset with which both overlap.

    The other side counts from 1970. None if GPS time is not the difference.
    """
    clock, other = max(groundtruth_s, estimate_s), min(groundtruth_s, estimate_s)
    weeks = (clock[0] - _GPS_START_S) // _WEEK_S
    for name, start in (
        ("GPS seconds of the week", _GPS_START_S + int(weeks) * _WEEK_S),
        ("GPS seconds since 1980", _GPS_START_S),
    ):
        overlaps = clock[0] - start <= other[1] and other[0] <= clock[1] - start
        if overlaps and other[1] - other[0] < _WEEK_S:
            return name, -start if clock == estimate_s else start
    return None


def explain_no_match(
    groundtruth: Trajectory,
    estimate: Trajectory,
    dropped: dict[str, int],
    rule: AssociationRule,
) -> str:
    """Return both time ranges and the likely cause, as one sentence.

    The estimate has the time offset applied. `dropped` counts the states without a pair.
    """

    def span(trajectory: Trajectory) -> tuple[float, float]:
        return trajectory.stamps.min() / NANOSECONDS, trajectory.stamps.max() / NANOSECONDS

    groundtruth_s, estimate_s = span(groundtruth), span(estimate)
    covered = (
        f"the groundtruth covers {_clock(*groundtruth_s)}, the estimate {_clock(*estimate_s)}"
    )
    text = f"no pairs: {covered}"
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
    if groundtruth_s[0] <= estimate_s[1] and estimate_s[0] <= groundtruth_s[1]:
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
    thousands = math.log10(max(groundtruth_s[1], 1e-9) / max(estimate_s[1], 1e-9)) / 3.0
    as_other_unit = abs(thousands) > 0.5 and abs(thousands - round(thousands)) < 0.01
    if as_other_unit or max(groundtruth_s[1], estimate_s[1]) > LATEST_CLOCK_S:
        return f"{text}; the units of the timestamps probably differ (seconds, milliseconds)"
    if gps := _gps_offset(groundtruth_s, estimate_s):
        return (
            f"{text}; one has {gps[0]}, the other is a system clock; set the time offset to "
            f"{gps[1]} s"
        )
    is_from_zero = min(groundtruth_s[1], estimate_s[1]) < 1e7
    is_from_zero = is_from_zero and max(groundtruth_s[1], estimate_s[1]) > 1e8
    if is_from_zero:
        who = "estimate" if estimate_s[1] < groundtruth_s[1] else "groundtruth"
        stamps = {"estimate": estimate, "groundtruth": groundtruth}[who].stamps
        steps = np.unique(np.diff(stamps))
        if len(steps) == 1 and steps[0] > 0 and not (stamps % NANOSECONDS).any():
            cause = f"the {who} probably has numbers of frames instead of times"
            return f"{text}; {cause}; write the times of all frames to times.txt next to it"
    shift = groundtruth_s[0] - estimate_s[0]
    if is_from_zero:
        return (
            f"{text}; one counts from zero (simulated time), the other is a system clock; if both "
            f"start together, set the time offset to {shift:.6f} s; otherwise, {_AUTO} searches it"
        )
    apart = max(groundtruth_s[0] - estimate_s[1], estimate_s[0] - groundtruth_s[1])
    if apart > _OTHER_RECORDING_S:
        days = f"{apart / _DAY_S:.0f} days"
        return (
            f"{text}, {days} apart; the estimate is probably of another recording, or a clock was "
            f"wrong, and {_AUTO} searches the offset"
        )
    return (
        f"{text}, {significant(apart, 6)} s apart; for a constant clock difference, set the time "
        f"offset (for a common start: {shift:.6f} s), or {_AUTO} searches it"
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
