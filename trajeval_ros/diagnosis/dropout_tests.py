"""Tests for groundtruth that is constant or linear while the estimate moves.

The groundtruth of a simulator at rest is constant to the last digit, so the motion of the estimate
is required.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.diagnosis.findings import Detection, TestResult
from trajeval_ros.diagnosis.input_pair import FEWEST, TimedPoses
from trajeval_ros.geometry.arrays import Booleans, Floats, lengths, runs_of
from trajeval_ros.geometry.travelled import step_lengths
from trajeval_ros.metrics.statistics import median

_STEP_S = 0.04  # 25 poses per second are sufficient
_LONG_S = 1.0  # of gaps, frozen intervals, and steps of the estimate to interpolate
_STRETCH_S = 0.15  # least duration of an interval; shorter ones are rounding
_HELD_M, _HELD_SHARE = 0.02, 0.3  # motion of the estimate, and share of the time
_DEFECT_M = 0.15  # motion in a frozen interval or across a gap: less is drift
_BRIDGED_S, _BRIDGED_M = 0.4, 0.05  # of a line, and distance of the estimate from it


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
    estimate = replace(estimate, positions=estimate.positions * (paths[0] / max(paths[1], 1e-12)))
    steps_s = np.diff(groundtruth.seconds)
    holes = np.flatnonzero((steps_s > _LONG_S) & (steps_s <= max_gap_s))
    if len(holes) > 0.2 * len(steps_s):  # a groundtruth with a low rate has no dropouts
        holes = holes[:0]
    hole = _Intervals.of(estimate, groundtruth.seconds[holes], groundtruth.seconds[holes + 1])
    seen = [
        *_still(groundtruth, _Intervals.of(estimate, *_stretches(some, still))),
        *_bridged(groundtruth, _Intervals.of(estimate, *_stretches(some, _both(gliding)))),
    ]
    if (bent_m := float(hole.bent_m.max(initial=0.0))) > _DEFECT_M:
        values = {"longest_s": float(steps_s[holes].max()), "holes": float(len(holes))}
        percent = 100.0 * float(hole.rows.sum()) / len(estimate)
        values |= {"max_gap_s": max_gap_s, "bent_m": bent_m, "percent": percent}
        seen.append(Detection("gap_bridged", values))
    return TestResult(test, scores, tuple(seen))


@dataclass(frozen=True, eq=False)
class _Intervals:
    """The motion of the estimate in K intervals at whose ends it has poses."""

    begin: Floats
    long_s: Floats
    moved_m: Floats
    bent_m: Floats  # largest distance from the line between the ends
    rows: Floats  # number of poses inside

    @classmethod
    def of(cls, estimate: TimedPoses, begin: Floats, end: Floats) -> _Intervals:
        """Return intervals that do not overlap, in order; of fewer than 3 poses, none is bent."""
        ends = estimate.at(begin, _LONG_S), estimate.at(end, _LONG_S)
        known = ends[0].known & ends[1].known
        start, chord = ends[0].positions[known], (ends[1].positions - ends[0].positions)[known]
        begin, long_s = begin[known], (end - begin)[known]
        bent_m, rows = np.zeros(len(begin)), np.zeros(len(begin))
        if len(begin) > 0:
            place = np.maximum(np.searchsorted(begin, estimate.seconds) - 1, 0)
            fraction = (estimate.seconds - begin[place]) / long_s[place]
            inside = (fraction > 0.0) & (fraction < 1.0)
            place, fraction = place[inside], fraction[inside, None]
            straight = start[place] + fraction * chord[place]
            np.maximum.at(bent_m, place, lengths(estimate.positions[inside] - straight))
            rows += np.bincount(place, minlength=len(begin))
        enough = rows >= 3.0
        return cls(begin, long_s, lengths(chord), bent_m * enough, rows * enough)

    def longest(self, groundtruth: TimedPoses, sizes: Floats) -> tuple[dict[str, float], int]:
        """Return when the interval of the largest size begins and ends, and its row."""
        row = int(np.argmax(sizes))
        at_s = float(self.begin[row] - groundtruth.seconds[0])
        return {"at_s": at_s, "after_s": at_s + float(self.long_s[row])}, row


def _still(groundtruth: TimedPoses, still: _Intervals) -> list[Detection]:
    moving = still.moved_m > _HELD_M
    held_s = float(still.long_s[moving].sum())
    if np.count_nonzero(moving) >= FEWEST and held_s > _HELD_SHARE * groundtruth.span_s:
        held_s, rate_hz = median(still.long_s[moving]), 1.0 / groundtruth.usual_step_s
        return [Detection.of("groundtruth_held", held_s=held_s, rate_hz=rate_hz)]
    frozen = (still.long_s > _LONG_S) & (still.moved_m > _DEFECT_M)
    if not frozen.any():
        return []
    values, row = still.longest(groundtruth, still.long_s * frozen)
    values |= {"frozen_s": float(still.long_s[row]), "moved_m": float(still.moved_m[row])}
    return [Detection("groundtruth_frozen", values)]


def _bridged(groundtruth: TimedPoses, lines: _Intervals) -> list[Detection]:
    bridged = (lines.long_s > _BRIDGED_S) & (lines.bent_m > _BRIDGED_M)
    if not bridged.any():
        return []
    values, row = lines.longest(groundtruth, lines.bent_m * bridged)
    values |= {"bridged_s": float(lines.long_s[row]), "bent_m": float(lines.bent_m[row])}
    number = float(np.count_nonzero(bridged))
    return [Detection("groundtruth_bridged", {**values, "stretches": number})]


def _thinned(groundtruth: TimedPoses) -> TimedPoses:
    return groundtruth[:: max(1, int(_STEP_S / max(groundtruth.usual_step_s, 1e-6)))]


def _both(gliding: Booleans) -> Booleans:
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
    for flags in (still, _both(gliding)):
        for begin, end in zip(*_stretches(some, flags), strict=True):
            if end - begin > _LONG_S:
                keep &= (groundtruth.seconds <= begin) | (groundtruth.seconds >= end)
    return groundtruth[keep] if np.count_nonzero(keep) > FEWEST else groundtruth


def _stretches(groundtruth: TimedPoses, flags: Booleans) -> tuple[Floats, Floats]:
    """Return start and end of intervals of flagged steps, seconds."""
    begin, end = groundtruth.seconds[runs_of(flags)].T
    long = end - begin > _STRETCH_S
    return begin[long], end[long]
