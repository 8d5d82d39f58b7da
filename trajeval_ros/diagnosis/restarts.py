"""Test for a restart of the estimator: a jump, and a new world frame after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.diagnosis.motion_track import Between, MotionTrack, lengths
from trajeval_ros.diagnosis.short_motions import best_rotations
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.thinning import evenly
from trajeval_ros.geometry.travelled import step_angles
from trajeval_ros.metrics.statistics import median

_NAME = "restart"
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


def restart(truth: MotionTrack, estimate: MotionTrack) -> Examined:
    """Test for jumps between parts with different alignments.

    Args:
        truth: Groundtruth in order of time, by the clock of the estimate.
        estimate: Estimate in order of time.
    """
    moved = estimate.moved
    strange = moved > _STRANGE * median(moved[evenly(len(moved), 2000)])
    if estimate.quaternions is not None:
        q = estimate.quaternions
        cosine = np.abs(np.einsum("ni,ni->n", q[1:], q[:-1]))
        strange |= cosine < np.cos(np.radians(_STRANGE_DEG) / 2.0)
    number = int(np.count_nonzero(strange))
    if not 0 < number <= max(50, 0.02 * len(moved)):
        return Examined(_NAME, {"strange_steps": float(number)})
    # These steps, and a sample of all steps for comparison.
    kept = np.zeros(len(estimate), dtype=bool)
    for rows in (np.flatnonzero(strange), evenly(len(moved), 1000)):
        kept[rows] = kept[rows + 1] = True
    some = estimate[kept]
    true = truth.at(some.seconds, _MOST_GAP_S)
    both = true.known[1:] & true.known[:-1]
    if np.count_nonzero(both) < 10:
        return Examined(_NAME, why_not="too few steps with groundtruth")
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
    size = float(np.linalg.norm(np.ptp(some.positions, axis=0)))
    near = lengths(some.positions - some.positions[0]) < _HOME * size
    at_first = near[1:] & ~near[:-1]
    far = excess > limit
    jumps = np.flatnonzero(both & (far | (spun & at_first)))
    if not 0 < len(jumps) <= _MOST:
        return Examined(_NAME, {"jumps": float(len(jumps))})
    scores = {"jumps": float(len(jumps))}
    sizes, rows = np.where(far, excess, 0.0), np.flatnonzero(kept)
    found = (_Jump(rows[j], rows[j + 1], sizes[j], turned[j]) for j in jumps)
    jumps = jumps[[each.stays(truth, estimate, unit) for each in found]]
    if not len(jumps):
        return Examined(_NAME, scores)
    worst = jumps[int(np.argmax(excess[jumps] / max(extent, 1e-9) + turned[jumps] / 180.0))]
    # A restart resets the position and the heading; drift and corrections change one of them.
    if oriented and not (at_first | spun)[worst]:
        return Examined(_NAME, scores)
    cut = int(worst) + 1
    if (some.positions[cut - 1] == some.positions[max(cut - 3, 0)]).all():
        return Examined(_NAME, why_not="the jump ends an interval of repeated poses")
    home = jumps[at_first[jumps]]
    at_home = worst in home
    # Many parts fit any error: more than two only if all of them start at the first pose.
    cuts = np.union1d(home + 1, [cut]) if at_home and len(home) > 1 else np.array([cut])
    metres = some.positions * (unit if abs(np.log(max(unit, 1e-12))) > _OTHER_UNIT else 1.0)
    gain = _gain(metres, true.positions, true.known, cuts)
    scores["gain"] = gain
    if gain <= (_GAIN_AT_HOME if at_home else _GAIN):
        return Examined(_NAME, scores)
    values: dict[str, Value] = {
        "jump_m": unit * float(steps[worst]),
        "jump_deg": float(turned[worst]),
        "at_s": float(some.seconds[cut] - estimate.seconds[0]),
        "cut_s": float(some.seconds[[cut - 1, cut]].mean() - truth.seconds[0]),
        "true_m": float(true_steps[worst]),
        "where": " at its first pose" if at_home else "",
        "left_percent": 100.0 * (1.0 - gain),
    }
    return Examined(_NAME, scores, (Seen("restart", gain, values),))


def _turned(ours: MotionTrack, true: Between) -> Floats:
    """Return the differences of the rotation angles of steps, deg; zeros without orientations."""
    if ours.quaternions is None or true.quaternions is None:
        return np.zeros(len(ours) - 1)
    apart: Floats = np.abs(step_angles(ours.quaternions) - step_angles(true.quaternions))
    return np.degrees(apart)


@dataclass(frozen=True, eq=False)
class _Jump:
    """A step of the estimate that is no motion of the body.

    Attributes:
        before: Row of the estimate before the step.
        after: Row of the estimate after the step.
        metres: Difference of the lengths of the steps of both sides; 0 if only the angles differ.
        degrees: Difference of their angles.
    """

    before: int
    after: int
    metres: float
    degrees: float

    def stays(self, truth: MotionTrack, estimate: MotionTrack, unit: float) -> bool:
        """Return whether the step is not the start or the end of outliers.

        A motion over outliers, from the pose before them to the pose after them, is right. A
        motion of length d over a jump of length c is wrong by at least c - 2 d. Therefore a
        motion with d < c / 4 that is wrong by less than c / 4 proves that the jump does not stay.

        Args:
            truth: Groundtruth in order of time.
            estimate: Estimate in order of time.
            unit: Metres per unit of the estimate.
        """
        most = max(_OUTLIERS, round(_OUTLIERS_S / estimate.usual_step_s))
        away = np.unique(np.rint(np.geomspace(1.0, most, _PLACES)).astype(np.int64))
        start = np.concatenate([np.full(len(away), self.before), self.before - away])
        end = np.concatenate([self.after + away, np.full(len(away), self.after)])
        inside = (start >= 0) & (end < len(estimate))
        ours = [estimate[each[inside]] for each in (start, end)]
        true = [truth.at(each.seconds, _MOST_GAP_S) for each in ours]
        moved, true_moved = (_moved(*ends, by_angle=not self.metres) for ends in (ours, true))
        moved = moved * (unit if self.metres else 1.0)
        limit = (self.metres or self.degrees) / 4.0
        right = (true_moved < limit) & (np.abs(moved - true_moved) < limit)
        return not (right & true[0].known & true[1].known).any()


def _moved(start: MotionTrack | Between, end: MotionTrack | Between, *, by_angle: bool) -> Floats:
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
