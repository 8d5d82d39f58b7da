"""Tests for groundtruth that is constant or linear while the estimate moves.

The groundtruth of a simulator at rest is constant to the last digit, so the motion of the estimate
is required.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.diagnosis.findings import Examined, Seen, Value
from trajeval_ros.diagnosis.input_pair import Between, TimedPoses, lengths
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, extents, runs_of
from trajeval_ros.geometry.rotation_fit import best_rotations
from trajeval_ros.geometry.trajectory_edits import evenly
from trajeval_ros.geometry.travelled import step_angles
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
    speed, change = (np.sqrt((each * each).sum(axis=0)) for each in (velocity, np.diff(velocity)))
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
        lengths(np.diff(each.at(times).positions, axis=0)).sum()
        for each in (groundtruth, estimate)
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
    share = float(long_s.sum()) / groundtruth.span_s
    moving = moved_m > _HELD_M
    held_s = float(long_s[moving].sum())
    if np.count_nonzero(moving) >= 10 and held_s > _HELD_SHARE * groundtruth.span_s:
        held = {"held_s": median(long_s[moving]), "rate_hz": 1.0 / usual_s}
        return [Seen("groundtruth_held", share, held)]
    frozen = (long_s > _FROZEN_S) & (moved_m > _FROZEN_M)
    if not frozen.any():
        return []
    longest = int(np.argmax(np.where(frozen, long_s, 0.0)))
    at_s = float(begin[longest] - groundtruth.seconds[0])
    values: dict[str, Value] = {
        "frozen_s": float(long_s[longest]),
        "at_s": at_s,
        "after_s": at_s + float(long_s[longest]),
        "moved_m": float(moved_m[longest]),
    }
    return [Seen("groundtruth_frozen", share, values)]


def _gliding(
    groundtruth: TimedPoses, estimate: TimedPoses, gliding: Booleans, scale: float
) -> list[Seen]:
    # A velocity equals the velocity of the previous step, which is part of the interval.
    begin, end = _stretches(groundtruth, gliding | np.append(gliding[1:], False))
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
    at_s = float(begin[worst] - groundtruth.seconds[0])
    values: dict[str, Value] = {
        "bridged_s": float(long_s[worst]),
        "at_s": at_s,
        "after_s": at_s + float(long_s[worst]),
        "bent_m": float(bent_m[worst]),
        "stretches": float(np.count_nonzero(bridged)),
    }
    return [Seen("groundtruth_bridged", float(long_s.sum()) / groundtruth.span_s, values)]


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
    values: dict[str, Value] = {
        "max_gap_s": max_gap_s,
        "holes": float(len(holes)),
        "longest_s": float(steps_s[holes].max()),
        "bent_m": worst_m,
        "percent": 100.0 * inside / len(estimate),
    }
    return [Seen("gap_bridged", inside / len(estimate), values)]


_RESTART = "restart"
_STRANGE, _STRANGE_DEG = 10.0, 20.0
_TIMES_TYPICAL, _SHARE_OF_EXTENT, _TIMES_TRUE, _LEAST_M = 40.0, 0.15, 1.5, 0.2
_SPUN_DEG = 25.0
_MOST = 20
_HOME = 0.05  # of the path's extent
_GAIN, _GAIN_AT_HOME = 0.9, 0.5
_OTHER_UNIT = 0.2  # of the logarithm of the scale
_OUTLIERS, _OUTLIERS_S = 5, 2.0  # longest series of outliers, in poses and in seconds
_PLACES = 16  # before and after a jump, to look for the end of a series
_MOST_GAP_S = 1.0


def restart(groundtruth: TimedPoses, estimate: TimedPoses) -> Examined:
    """Test for jumps between parts with different alignments."""
    moved = estimate.moved
    strange = moved > _STRANGE * median(moved[evenly(len(moved), 2000)])
    if estimate.quaternions is not None:
        q = estimate.quaternions
        cosine = np.abs(np.einsum("ni,ni->n", q[1:], q[:-1]))
        strange |= cosine < np.cos(np.radians(_STRANGE_DEG) / 2.0)
    number = int(np.count_nonzero(strange))
    if not 0 < number <= max(50, 0.02 * len(moved)):
        return Examined(_RESTART, {"strange_steps": float(number)})
    # These steps, and a sample of all steps for comparison.
    kept = np.zeros(len(estimate), dtype=bool)
    for rows in (np.flatnonzero(strange), evenly(len(moved), 1000)):
        kept[rows] = kept[rows + 1] = True
    some = estimate[kept]
    true = groundtruth.at(some.seconds, _MOST_GAP_S)
    both = true.known[1:] & true.known[:-1]
    if np.count_nonzero(both) < 10:
        return Examined(_RESTART, why_not="too few steps with groundtruth")
    steps, true_steps = (
        lengths(np.diff(each, axis=0)) for each in (some.positions, true.positions)
    )
    usual = np.minimum(steps[both], 20.0 * median(steps[both]) + 1e-12)
    unit = float(true_steps[both].sum()) / max(float(usual.sum()), 1e-12)
    excess = np.abs(unit * steps - true_steps)
    turned = _turned(some, true)
    oriented = some.quaternions is not None and true.quaternions is not None
    extent = float(np.linalg.norm(np.std(true.positions[true.known], axis=0)))
    limit = np.maximum(
        max(_TIMES_TYPICAL * median(excess[both]), _SHARE_OF_EXTENT * extent, _LEAST_M),
        _TIMES_TRUE * true_steps,
    )
    spun = turned > max(_SPUN_DEG, 40.0 * median(turned[both]))
    size = float(np.linalg.norm(extents(some.positions)))
    near = lengths(some.positions - some.positions[0]) < _HOME * size
    at_first = near[1:] & ~near[:-1]
    far = excess > limit
    jumps = np.flatnonzero(both & (far | (spun & at_first)))
    if not 0 < len(jumps) <= _MOST:
        return Examined(_RESTART, {"jumps": float(len(jumps))})
    scores = {"jumps": float(len(jumps))}
    sizes, rows = np.where(far, excess, 0.0), np.flatnonzero(kept)
    found = (_Jump(rows[j], rows[j + 1], sizes[j], turned[j]) for j in jumps)
    jumps = jumps[[each.stays(groundtruth, estimate, unit) for each in found]]
    if not len(jumps):
        return Examined(_RESTART, scores)
    worst = jumps[int(np.argmax(excess[jumps] / max(extent, 1e-9) + turned[jumps] / 180.0))]
    # A restart resets the position and the heading; drift and corrections change one of them.
    if oriented and not (at_first | spun)[worst]:
        return Examined(_RESTART, scores)
    cut = int(worst) + 1
    if (some.positions[cut - 1] == some.positions[max(cut - 3, 0)]).all():
        return Examined(_RESTART, why_not="the jump ends an interval of repeated poses")
    home = jumps[at_first[jumps]]
    at_home = worst in home
    # Many parts fit any error: more than two only if all of them start at the first pose.
    cuts = home + 1 if at_home else np.array([cut])
    metres = some.positions * (unit if abs(np.log(max(unit, 1e-12))) > _OTHER_UNIT else 1.0)
    gain = _gain(metres, true.positions, true.known, cuts)
    scores["gain"] = gain
    if gain <= (_GAIN_AT_HOME if at_home else _GAIN):
        return Examined(_RESTART, scores)
    values: dict[str, Value] = {
        "jump_m": unit * float(steps[worst]),
        "jump_deg": float(turned[worst]),
        "at_s": float(some.seconds[cut] - estimate.seconds[0]),
        "cut_s": float(some.seconds[[cut - 1, cut]].mean() - groundtruth.seconds[0]),
        "true_m": float(true_steps[worst]),
        "where": " at its first pose" if at_home else "",
        "left_percent": 100.0 * (1.0 - gain),
    }
    return Examined(_RESTART, scores, (Seen("restart", gain, values),))


def _turned(ours: TimedPoses, true: Between) -> Floats:
    """Return the differences of the rotation angles of steps, deg; zeros without orientations."""
    if ours.quaternions is None or true.quaternions is None:
        return np.zeros(len(ours) - 1)
    apart: Floats = np.abs(step_angles(ours.quaternions) - step_angles(true.quaternions))
    return np.degrees(apart)


@dataclass(frozen=True, eq=False)
class _Jump:
    """A step of the estimate that is no motion of the body."""

    before: int  # row of the estimate before the step
    after: int  # row of the estimate after the step
    # Difference of the lengths of the steps of both sides; 0 if only the angles differ.
    metres: float
    degrees: float  # difference of their angles

    def stays(self, groundtruth: TimedPoses, estimate: TimedPoses, unit: float) -> bool:
        """Return whether the step is not the start or the end of outliers.

        A motion over outliers, from the pose before them to the pose after them, is right. A
        motion of length d over a jump of length c is wrong by at least c - 2 d. Therefore a
        motion with d < c / 4 that is wrong by less than c / 4 proves that the jump does not stay.
        `unit` is metres per unit of the estimate.
        """
        most = max(_OUTLIERS, round(_OUTLIERS_S / estimate.usual_step_s))
        away = np.unique(np.rint(np.geomspace(1.0, most, _PLACES)).astype(np.int64))
        start = np.concatenate([np.full(len(away), self.before), self.before - away])
        end = np.concatenate([self.after + away, np.full(len(away), self.after)])
        inside = (start >= 0) & (end < len(estimate))
        ours = [estimate[each[inside]] for each in (start, end)]
        true = [groundtruth.at(each.seconds, _MOST_GAP_S) for each in ours]
        moved, true_moved = (_moved(*ends, by_angle=not self.metres) for ends in (ours, true))
        moved = moved * (unit if self.metres else 1.0)
        limit = (self.metres or self.degrees) / 4.0
        right = (true_moved < limit) & (np.abs(moved - true_moved) < limit)
        return not (right & true[0].known & true[1].known).any()


def _moved(start: TimedPoses | Between, end: TimedPoses | Between, *, by_angle: bool) -> Floats:
    """Return the lengths (N,) of motions, or their angles, deg."""
    if not by_angle or start.quaternions is None or end.quaternions is None:
        return lengths(end.positions - start.positions)
    between = lie.multiply(lie.conjugate(start.quaternions), end.quaternions)
    return np.degrees(lie.angle(between))


def _gain(ours: Floats, true: Floats, known: Booleans, cuts: Indices) -> float:
    """Return the fraction of the squared error that separate alignments remove."""
    rows = np.flatnonzero(known)
    one = _misfit(ours[rows], true[rows])
    parts = np.split(rows, np.searchsorted(rows, cuts))
    several = sum(_misfit(ours[each], true[each]) for each in parts)
    return 1.0 - several / max(one, 1e-300)


def _misfit(ours: Floats, true: Floats) -> float:
    """Return the squared error after a rigid alignment; 0 for fewer than five positions."""
    if len(ours) < 5:
        return 0.0
    a, b = ours - ours.mean(axis=0), true - true.mean(axis=0)
    best = float(best_rotations(b.T @ a)[0])
    return max(0.0, float(np.sum(a * a) + np.sum(b * b)) - 2.0 * best)
