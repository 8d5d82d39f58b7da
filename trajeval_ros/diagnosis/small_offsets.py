"""Test for a small offset between the clocks, on a finer grid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.calibration.clock_offset import OffsetGuess, guess_offset
from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.diagnosis.motion_track import MotionTrack
from trajeval_ros.diagnosis.rates import LEAST_LIKELY, unlikeness_ratio
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association import INTERPOLATING, Association
from trajeval_ros.metrics.statistics import median

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation

_NAME = "small clock offsets"
# Width of the peak of equal clocks. A lever arm moves the peak of speeds.
_LEAST_S = {"angular rate": 0.010, "speed": 0.150}
_LONGEST_S = 600.0
_FEWEST_STATES, _SHORTEST_S = 50, 8.0
# By the speed: least fraction of the squared error that the offset explains, and least offset.
_EXPLAINED = 0.5
_LATE_S = 0.020


def small_clock_offset(
    evaluation: Evaluation, truth: MotionTrack, estimate: MotionTrack
) -> Examined:
    """Test for a small offset, by rates of motion or by errors along the velocity.

    Args:
        evaluation: Evaluation of the two sides.
        truth: Groundtruth in order of time.
        estimate: All poses of the estimate in order of time.
    """
    pairs = evaluation.association
    rule = pairs.rule
    few = len(pairs) < _FEWEST_STATES or pairs.estimate.duration_s < _SHORTEST_S
    if rule.method == "index" or few:
        return Examined(_NAME, why_not="no timestamps, or too few pairs")
    guess = _guess(pairs)
    scores = {"offset_s": guess.offset_s, "peak": guess.peak}
    if guess.is_usable:
        apart_s = guess.offset_s
        step_s = median(np.diff(np.sort(pairs.estimate.stamps))) / NANOSECONDS
        # Timestamps of pairs may differ by the limit of the association.
        within_s = 0.0 if rule.method in INTERPOLATING else rule.max_time_difference_s
        if abs(apart_s) <= max(_LEAST_S[guess.signal], step_s / 2.0, within_s):
            return Examined(_NAME, scores)
        scores["unlikeness"] = unlikeness_ratio(truth, estimate, apart_s)
        if not scores["unlikeness"] < LEAST_LIKELY:
            return Examined(_NAME, scores)
        how = f"the {guess.signal}s match best"
    else:
        late_s = _late(pairs, evaluation.aligned)
        if late_s is None:
            return Examined(_NAME, scores)
        apart_s, how = late_s, "the position error is proportional to the speed, as"
    values: dict[str, Value] = {
        "offset_ms": 1e3 * apart_s,
        "how": how,
        "more": "more " if rule.time_offset_s else "",
    }
    return Examined(_NAME, scores, (Seen("small_clock_offset", _EXPLAINED, values),))


def _guess(pairs: Association) -> OffsetGuess:
    """Correlate ten minutes from the middle of the run, which limits the cost of long runs."""
    stamps = pairs.estimate.stamps
    middle = (int(stamps.min()) + int(stamps.max())) // 2
    near = np.abs(stamps - middle) <= round(_LONGEST_S / 2.0 * NANOSECONDS)
    # Several pairs may share a timestamp.
    if len(np.unique(stamps[near])) < _FEWEST_STATES:
        return OffsetGuess(0.0, 0.0, 0.0, 0.0, "speed", 0.0, "too few states")
    return guess_offset(pairs.groundtruth[near], pairs.estimate[near])


def _late(pairs: Association, aligned: Trajectory) -> float | None:
    """Return the delay of the timestamps that explains the error, seconds; else None."""
    truth = pairs.groundtruth
    steps = np.diff(truth.stamps) / NANOSECONDS
    usual = median(steps) if len(steps) else 0.0
    whole = (steps > 0.0) & (steps <= 2.0 * usual)
    both = whole[1:] & whole[:-1]
    if np.count_nonzero(both) < _FEWEST_STATES:
        return None
    moved = truth.positions[2:] - truth.positions[:-2]
    velocity = moved[both] / (steps[1:] + steps[:-1])[both, None]
    error = (aligned.positions - truth.positions)[1:-1][both]
    # The alignment contains the constant part.
    velocity = velocity - velocity.mean(axis=0)
    error = error - error.mean(axis=0)
    squared = float(np.square(velocity).sum())
    product = float((velocity * error).sum())
    total = float(np.square(error).sum())
    if squared == 0.0 or product**2 < _EXPLAINED * squared * total:
        return None
    late_s = product / squared
    return late_s if abs(late_s) > _LATE_S else None
