"""Tests for groundtruth that is constant or linear while the estimate moves.

The groundtruth of a simulator at rest is constant to the last digit, so the motion of the estimate
is required.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.findings import Detection, TestResult
from trajeval_ros.diagnosis.input_pair import FEWEST, TimedPoses, lengths
from trajeval_ros.geometry.arrays import Booleans, Floats, runs_of
from trajeval_ros.geometry.trajectory_edits import evenly
from trajeval_ros.geometry.travelled import step_lengths
from trajeval_ros.metrics.statistics import median

_STEP_S = 0.04  # 25 poses per second are sufficient
_LONG_S = 1.0  # of gaps, frozen intervals, and steps of the estimate to interpolate
_STRETCH_S = 0.15  # least duration of an interval; shorter ones are rounding
_HELD_M, _HELD_SHARE = 0.02, 0.3  # motion of the estimate, and share of the time
_FROZEN_M = 0.15  # least motion of the estimate
_BRIDGED_S, _BRIDGED_M = 0.4, 0.03  # of a line, and distance of the estimate from it
_HOLE_M, _MOST_HOLES = 0.1, 20  # the same of gaps, and number that is compared


def groundtruth_defects(
    groundtruth: TimedPoses, estimate: TimedPoses, max_gap_s: float
) -> TestResult:
    """Test for held poses, a frozen body, and dropouts that were filled up to `max_gap_s`."""
    test = "groundtruth defects"
    begin = max(groundtruth.seconds[0], estimate.seconds[0])
    end = min(groundtruth.seconds[-1], estimate.seconds[-1])
    if len(groundtruth) < FEWEST or len(estimate) < FEWEST or end <= begin:
        return TestResult(test, why_not="too few common poses")
    some = _thinned(groundtruth)
    still, gliding = _constant(some)
    scores = {"still_share": float(still.mean()), "straight_share": float(gliding.mean())}
    if not (still.any() or gliding.any() or max_gap_s > _LONG_S):
        return TestResult(test, scores)
    # Metres per unit of the estimate.
    times = np.linspace(begin, end, 200)
    paths = [step_lengths(side.at(times).positions).sum() for side in (groundtruth, estimate)]
    scale = float(paths[0] / max(float(paths[1]), 1e-12))
    seen = [
        *_still(groundtruth, estimate, _stretches(some, still), scale),
        *_gliding(groundtruth, estimate, _stretches(some, _with_previous(gliding)), scale),
        *_holes(groundtruth, estimate, max_gap_s, scale),
    ]
    return TestResult(test, scores, tuple(seen))


def _thinned(groundtruth: TimedPoses) -> TimedPoses:
    return groundtruth[:: max(1, int(_STEP_S / max(groundtruth.usual_step_s, 1e-6)))]


def _with_previous(gliding: Booleans) -> Booleans:
    """Return flags of steps: a velocity equals that of the previous one, which is included."""
    return np.asarray(gliding | np.append(gliding[1:], False))


def _constant(groundtruth: TimedPoses) -> tuple[Booleans, Booleans]:
    """Return which steps (N - 1,) are exactly zero, and which have the previous velocity."""
    columns, times = np.ascontiguousarray(groundtruth.positions.T), np.diff(groundtruth.seconds)
    velocity = np.diff(columns) / times
    still = ~np.any(velocity != 0.0, axis=0)
    speed, change = (np.sqrt((rows * rows).sum(axis=0)) for rows in (velocity, np.diff(velocity)))
    alike = change < 1e-6 * speed[1:] + 2e-7 / np.minimum(times[1:], times[:-1])
    return still, np.concatenate([[False], alike & ~still[1:] & ~still[:-1]])


def without_defects(groundtruth: TimedPoses) -> TimedPoses:
    """Return the poses outside of long intervals that are constant or linear."""
    some, keep = _thinned(groundtruth), np.ones(len(groundtruth), dtype=bool)
    still, gliding = _constant(some)
    for flags in (still, _with_previous(gliding)):
        for begin, end in zip(*_stretches(some, flags), strict=True):
            if end - begin > _LONG_S:
                keep &= (groundtruth.seconds <= begin) | (groundtruth.seconds >= end)
    return groundtruth[keep] if np.count_nonzero(keep) > FEWEST else groundtruth


def _stretches(groundtruth: TimedPoses, flags: Booleans) -> tuple[Floats, Floats]:
    """Return start and end of intervals of flagged steps, seconds."""
    begin, end = groundtruth.seconds[runs_of(flags)].T
    long = end - begin > _STRETCH_S
    return begin[long], end[long]


def _longest(
    groundtruth: TimedPoses, begin: Floats, long_s: Floats, sizes: Floats
) -> tuple[dict[str, float], int]:
    """Return when the interval of the largest size begins and ends, and its row."""
    row = int(np.argmax(sizes))
    at_s = float(begin[row] - groundtruth.seconds[0])
    return {"at_s": at_s, "after_s": at_s + float(long_s[row])}, row


def _still(
    groundtruth: TimedPoses,
    estimate: TimedPoses,
    stretches: tuple[Floats, Floats],
    scale: float,
) -> list[Detection]:
    begin, end = stretches
    start, stop = (estimate.at(times, _LONG_S) for times in stretches)
    known = start.known & stop.known
    begin, long_s = begin[known], (end - begin)[known]
    moved_m = scale * lengths((stop.positions - start.positions)[known])
    moving = moved_m > _HELD_M
    held_s = float(long_s[moving].sum())
    if np.count_nonzero(moving) >= FEWEST and held_s > _HELD_SHARE * groundtruth.span_s:
        rate_hz = 1.0 / groundtruth.usual_step_s
        return [Detection.of("groundtruth_held", held_s=median(long_s[moving]), rate_hz=rate_hz)]
    frozen = (long_s > _LONG_S) & (moved_m > _FROZEN_M)
    if not frozen.any():
        return []
    when, row = _longest(groundtruth, begin, long_s, np.where(frozen, long_s, 0.0))
    values = {"frozen_s": float(long_s[row]), "moved_m": float(moved_m[row])}
    return [Detection("groundtruth_frozen", {**when, **values})]


def _gliding(
    groundtruth: TimedPoses,
    estimate: TimedPoses,
    stretches: tuple[Floats, Floats],
    scale: float,
) -> list[Detection]:
    begin, end = stretches
    start, middle, stop = (
        estimate.at(times, _LONG_S) for times in (begin, (begin + end) / 2.0, end)
    )
    bent_m = scale * lengths(middle.positions - (start.positions + stop.positions) / 2.0)
    long_s = end - begin
    known = start.known & middle.known & stop.known
    bridged = known & (long_s > _BRIDGED_S) & (bent_m > _BRIDGED_M)
    if not bridged.any():
        return []
    when, row = _longest(groundtruth, begin, long_s, np.where(bridged, bent_m, 0.0))
    values = {"bridged_s": float(long_s[row]), "bent_m": float(bent_m[row])}
    number = float(np.count_nonzero(bridged))
    return [Detection("groundtruth_bridged", {**when, **values, "stretches": number})]


def _holes(
    groundtruth: TimedPoses, estimate: TimedPoses, max_gap_s: float, scale: float
) -> list[Detection]:
    """Test the gaps that the association interpolates."""
    steps_s = np.diff(groundtruth.seconds)
    holes = np.flatnonzero((steps_s > _LONG_S) & (steps_s <= max_gap_s))
    worst_m, inside = 0.0, 0
    # A groundtruth with a low rate has no dropouts.
    if len(holes) > 0.2 * len(steps_s):
        return []
    for hole in holes[np.argsort(-steps_s[holes])][:_MOST_HOLES]:
        ends = groundtruth.seconds[[hole, hole + 1]]
        rows = np.flatnonzero((estimate.seconds > ends[0]) & (estimate.seconds < ends[1]))
        chord = estimate.at(ends, _LONG_S)
        if len(rows) < 3 or not chord.known.all():
            continue
        inside += len(rows)
        rows = rows[evenly(len(rows), 200)]
        fraction = (estimate.seconds[rows] - ends[0]) / (ends[1] - ends[0])
        straight = chord.positions[0] + fraction[:, None] * np.diff(chord.positions, axis=0)
        worst_m = max(worst_m, scale * float(lengths(estimate.positions[rows] - straight).max()))
    if worst_m <= _HOLE_M:
        return []
    longest_s, percent = float(steps_s[holes].max()), 100.0 * inside / len(estimate)
    values = {"longest_s": longest_s, "percent": percent, "holes": float(len(holes))}
    return [Detection("gap_bridged", {"max_gap_s": max_gap_s, "bent_m": worst_m, **values})]
