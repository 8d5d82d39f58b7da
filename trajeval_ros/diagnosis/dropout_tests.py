"""Tests for groundtruth that is constant or linear while the estimate moves.

The groundtruth of a simulator at rest is constant to the last digit, so the motion of the estimate
is required.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.findings import Examined, Seen
from trajeval_ros.diagnosis.input_pair import TimedPoses, lengths
from trajeval_ros.geometry.arrays import Booleans, Floats, runs_of
from trajeval_ros.geometry.trajectory_edits import evenly
from trajeval_ros.metrics.statistics import median

_FEWEST = 20
_STEP_S = 0.04  # 25 poses per second are sufficient
_REACH_S = 1.0  # largest step of the estimate to interpolate
_STRETCH_S = 0.15
_HELD_M, _HELD_SHARE = 0.02, 0.3
_FROZEN_S, _FROZEN_M = 1.0, 0.15
_BRIDGED_S, _BRIDGED_M = 0.4, 0.03
_HOLE_S, _HOLE_M, _MOST_HOLES = 1.0, 0.1, 20


def groundtruth_defects(
    groundtruth: TimedPoses, estimate: TimedPoses, max_gap_s: float
) -> Examined:
    """Test for held poses, a frozen body, and dropouts that were filled up to `max_gap_s`."""
    name = "groundtruth defects"
    begin = max(groundtruth.seconds[0], estimate.seconds[0])
    end = min(groundtruth.seconds[-1], estimate.seconds[-1])
    if len(groundtruth) < _FEWEST or len(estimate) < _FEWEST or end <= begin:
        return Examined(name, why_not="too few common poses")
    usual_s = groundtruth.usual_step_s
    every = max(1, int(_STEP_S / max(usual_s, 1e-6)))
    some = groundtruth[::every]
    still, gliding = _constant(some)
    scores = {"still_share": float(still.mean()), "straight_share": float(gliding.mean())}
    if not (still.any() or gliding.any() or max_gap_s > _HOLE_S):
        return Examined(name, scores)
    scale = _metres_per_unit(groundtruth, estimate, float(begin), float(end))
    seen = [
        *_still(some, estimate, still, scale, usual_s),
        *_gliding(some, estimate, gliding, scale),
        *_holes(groundtruth, estimate, max_gap_s, scale),
    ]
    return Examined(name, scores, tuple(seen))


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
    every = max(1, int(_STEP_S / max(groundtruth.usual_step_s, 1e-6)))
    some = groundtruth[::every]
    still, gliding = _constant(some)
    keep = np.ones(len(groundtruth), dtype=bool)
    for flags in (still, gliding | np.append(gliding[1:], False)):
        for begin, end in zip(*_stretches(some, flags), strict=True):
            if end - begin > _FROZEN_S:
                keep &= (groundtruth.seconds <= begin) | (groundtruth.seconds >= end)
    return groundtruth[keep] if np.count_nonzero(keep) > _FEWEST else groundtruth


def _metres_per_unit(
    groundtruth: TimedPoses, estimate: TimedPoses, begin: float, end: float
) -> float:
    times = np.linspace(begin, end, 200)
    paths = [
        lengths(np.diff(side.at(times).positions, axis=0)).sum()
        for side in (groundtruth, estimate)
    ]
    return float(paths[0] / max(float(paths[1]), 1e-12))


def _stretches(groundtruth: TimedPoses, flags: Booleans) -> tuple[Floats, Floats]:
    """Return start and end of intervals of flagged steps, seconds."""
    begin, end = groundtruth.seconds[runs_of(flags)].T
    long = end - begin > _STRETCH_S
    return begin[long], end[long]


def _still(
    groundtruth: TimedPoses, estimate: TimedPoses, still: Booleans, scale: float, usual_s: float
) -> list[Seen]:
    begin, end = _stretches(groundtruth, still)
    if not len(begin):
        return []
    start, stop = estimate.at(begin, _REACH_S), estimate.at(end, _REACH_S)
    known = start.known & stop.known
    begin, long_s = begin[known], (end - begin)[known]
    moved_m = scale * lengths((stop.positions - start.positions)[known])
    moving = moved_m > _HELD_M
    held_s = float(long_s[moving].sum())
    if np.count_nonzero(moving) >= 10 and held_s > _HELD_SHARE * groundtruth.span_s:
        held_s = median(long_s[moving])
        return [Seen.of("groundtruth_held", held_s=held_s, rate_hz=1.0 / usual_s)]
    frozen = (long_s > _FROZEN_S) & (moved_m > _FROZEN_M)
    if not frozen.any():
        return []
    longest = int(np.argmax(np.where(frozen, long_s, 0.0)))
    at_s, frozen_s = float(begin[longest] - groundtruth.seconds[0]), float(long_s[longest])
    return [
        Seen.of(
            "groundtruth_frozen",
            frozen_s=frozen_s,
            at_s=at_s,
            after_s=at_s + frozen_s,
            moved_m=float(moved_m[longest]),
        )
    ]


def _gliding(
    groundtruth: TimedPoses, estimate: TimedPoses, gliding: Booleans, scale: float
) -> list[Seen]:
    # A velocity equals the velocity of the previous step, which is part of the interval.
    begin, end = _stretches(groundtruth, gliding | np.append(gliding[1:], False))
    if not len(begin):
        return []
    start, middle, stop = (
        estimate.at(times, _REACH_S) for times in (begin, (begin + end) / 2.0, end)
    )
    bent_m = scale * lengths(middle.positions - (start.positions + stop.positions) / 2.0)
    long_s = end - begin
    known = start.known & middle.known & stop.known
    bridged = known & (long_s > _BRIDGED_S) & (bent_m > _BRIDGED_M)
    if not bridged.any():
        return []
    worst = int(np.argmax(np.where(bridged, bent_m, 0.0)))
    at_s, bridged_s = float(begin[worst] - groundtruth.seconds[0]), float(long_s[worst])
    return [
        Seen.of(
            "groundtruth_bridged",
            bridged_s=bridged_s,
            at_s=at_s,
            after_s=at_s + bridged_s,
            bent_m=float(bent_m[worst]),
            stretches=float(np.count_nonzero(bridged)),
        )
    ]


def _holes(
    groundtruth: TimedPoses, estimate: TimedPoses, max_gap_s: float, scale: float
) -> list[Seen]:
    """Test the gaps that the association interpolates."""
    steps_s = np.diff(groundtruth.seconds)
    holes = np.flatnonzero((steps_s > _HOLE_S) & (steps_s <= max_gap_s))
    worst_m, inside = 0.0, 0
    # A groundtruth with a low rate has no dropouts.
    if len(holes) > 0.2 * len(steps_s):
        return []
    for hole in holes[np.argsort(-steps_s[holes])][:_MOST_HOLES]:
        ends = groundtruth.seconds[[hole, hole + 1]]
        rows = np.flatnonzero((estimate.seconds > ends[0]) & (estimate.seconds < ends[1]))
        chord = estimate.at(ends, _REACH_S)
        if len(rows) < 3 or not chord.known.all():
            continue
        inside += len(rows)
        rows = rows[evenly(len(rows), 200)]
        fraction = (estimate.seconds[rows] - ends[0]) / (ends[1] - ends[0])
        straight = chord.positions[0] + fraction[:, None] * np.diff(chord.positions, axis=0)
        worst_m = max(worst_m, scale * float(lengths(estimate.positions[rows] - straight).max()))
    if worst_m <= _HOLE_M:
        return []
    return [
        Seen.of(
            "gap_bridged",
            max_gap_s=max_gap_s,
            holes=float(len(holes)),
            longest_s=float(steps_s[holes].max()),
            bent_m=worst_m,
            percent=100.0 * inside / len(estimate),
        )
    ]
