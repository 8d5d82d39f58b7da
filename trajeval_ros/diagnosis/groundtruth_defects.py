"""Tests for groundtruth that is constant or linear while the estimate moves.

The groundtruth of a simulator at rest is constant to the last digit, so the motion of the estimate
is required.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.diagnosis.motion_track import MotionTrack, lengths
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.thinning import evenly
from trajeval_ros.metrics.statistics import median

_FEWEST = 20
_STEP_S = 0.04  # 25 poses per second are sufficient
_REACH_S = 1.0  # largest step of the estimate to interpolate
_STRETCH_S = 0.15
_HELD_M, _HELD_SHARE = 0.02, 0.3
_FROZEN_S, _FROZEN_M = 1.0, 0.15
_BRIDGED_S, _BRIDGED_M = 0.4, 0.03
_HOLE_S, _HOLE_M, _MOST_HOLES = 1.0, 0.1, 20


def groundtruth_defects(truth: MotionTrack, estimate: MotionTrack, max_gap_s: float) -> Examined:
    """Test for poses that were held, for a frozen body, and for dropouts that were filled.

    Args:
        truth: Groundtruth in order of time.
        estimate: Estimate in order of time.
        max_gap_s: Longest step of the groundtruth that pairs are interpolated across.
    """
    name = "groundtruth defects"
    begin = max(truth.seconds[0], estimate.seconds[0])
    end = min(truth.seconds[-1], estimate.seconds[-1])
    if len(truth) < _FEWEST or len(estimate) < _FEWEST or end <= begin:
        return Examined(name, why_not="too few common poses")
    usual_s = truth.usual_step_s
    every = max(1, int(_STEP_S / max(usual_s, 1e-6)))
    some = truth[::every]
    steps, times = np.diff(some.positions, axis=0), np.diff(some.seconds)
    still = ~np.any(steps != 0.0, axis=1)
    velocity = steps / times[:, None]
    digits = 1e-6 * lengths(velocity[1:]) + 2e-7 / np.minimum(times[1:], times[:-1])
    gliding = np.concatenate(
        [[False], (lengths(np.diff(velocity, axis=0)) < digits) & ~still[1:] & ~still[:-1]]
    )
    scores = {"still_share": float(still.mean()), "straight_share": float(gliding.mean())}
    if not (still.any() or gliding.any() or max_gap_s > _HOLE_S):
        return Examined(name, scores)
    scale = _metres_per_unit(truth, estimate, float(begin), float(end))
    seen = [
        *_still(some, estimate, still, scale, usual_s),
        *_gliding(some, estimate, gliding, scale),
        *_holes(truth, estimate, max_gap_s, scale),
    ]
    return Examined(name, scores, tuple(seen))


def _metres_per_unit(truth: MotionTrack, estimate: MotionTrack, begin: float, end: float) -> float:
    times = np.linspace(begin, end, 200)
    paths = [
        lengths(np.diff(each.at(times).positions, axis=0)).sum() for each in (truth, estimate)
    ]
    return float(paths[0] / max(float(paths[1]), 1e-12))


def _stretches(truth: MotionTrack, flags: Booleans) -> tuple[Floats, Floats]:
    """Return start and end of intervals of flagged steps, seconds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    begin, end = truth.seconds[edges[::2]], truth.seconds[edges[1::2]]
    long = end - begin > _STRETCH_S
    return begin[long], end[long]


def _still(
    truth: MotionTrack, estimate: MotionTrack, still: Booleans, scale: float, usual_s: float
) -> list[Seen]:
    begin, end = _stretches(truth, still)
    if not len(begin):
        return []
    start, stop = estimate.at(begin, _REACH_S), estimate.at(end, _REACH_S)
    known = start.known & stop.known
    begin, long_s = begin[known], (end - begin)[known]
    moved_m = scale * lengths((stop.positions - start.positions)[known])
    share = float(long_s.sum()) / truth.span_s
    moving = moved_m > (_HELD_M if len(moved_m) > 5 else 0.1)
    held_s = float(long_s[moving].sum())
    if np.count_nonzero(moving) >= 10 and held_s > _HELD_SHARE * truth.span_s:
        held = {"held_s": median(long_s[moving]), "rate_hz": 1.0 / usual_s}
        return [Seen("truth_held", share, held)]
    frozen = (long_s > _FROZEN_S) & (moved_m > _FROZEN_M)
    if not frozen.any():
        return []
    longest = int(np.argmax(np.where(frozen, long_s, 0.0)))
    at_s = float(begin[longest] - truth.seconds[0])
    values: dict[str, Value] = {
        "frozen_s": float(long_s[longest]),
        "at_s": at_s,
        "after_s": at_s + float(long_s[longest]),
        "moved_m": float(moved_m[longest]),
    }
    return [Seen("truth_frozen", share, values)]


def _gliding(
    truth: MotionTrack, estimate: MotionTrack, gliding: Booleans, scale: float
) -> list[Seen]:
    # A velocity equals the velocity of the previous step, which is part of the interval.
    begin, end = _stretches(truth, gliding | np.append(gliding[1:], False))
    if not len(begin):
        return []
    start, middle, stop = (
        estimate.at(each, _REACH_S) for each in (begin, (begin + end) / 2.0, end)
    )
    bent_m = scale * lengths(middle.positions - (start.positions + stop.positions) / 2.0)
    long_s = end - begin
    known = start.known & middle.known & stop.known
    bridged = known & (long_s > _BRIDGED_S) & (bent_m > _BRIDGED_M)
    if not bridged.any():
        return []
    worst = int(np.argmax(np.where(bridged, bent_m, 0.0)))
    at_s = float(begin[worst] - truth.seconds[0])
    values: dict[str, Value] = {
        "bridged_s": float(long_s[worst]),
        "at_s": at_s,
        "after_s": at_s + float(long_s[worst]),
        "bent_m": float(bent_m[worst]),
        "stretches": float(np.count_nonzero(bridged)),
    }
    return [Seen("truth_bridged", float(long_s.sum()) / truth.span_s, values)]


def _holes(
    truth: MotionTrack, estimate: MotionTrack, max_gap_s: float, scale: float
) -> list[Seen]:
    """Test the gaps that the association interpolates."""
    steps_s = np.diff(truth.seconds)
    holes = np.flatnonzero((steps_s > _HOLE_S) & (steps_s <= max_gap_s))
    worst_m, inside = 0.0, 0
    # A groundtruth with a low rate has no dropouts.
    if len(holes) > 0.2 * len(steps_s):
        return []
    for hole in holes[np.argsort(-steps_s[holes])][:_MOST_HOLES]:
        ends = truth.seconds[[hole, hole + 1]]
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
    values: dict[str, Value] = {
        "max_gap_s": max_gap_s,
        "holes": float(len(holes)),
        "longest_s": float(steps_s[holes].max()),
        "bent_m": worst_m,
        "percent": 100.0 * inside / len(estimate),
    }
    return [Seen("gap_bridged", inside / len(estimate), values)]
