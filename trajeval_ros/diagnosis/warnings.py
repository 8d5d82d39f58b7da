"""Warnings: what a reader of the numbers must know, each with what to do about it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.few_pairs import about_few_pairs
from trajeval_ros.diagnosis.jumps import Steps
from trajeval_ros.diagnosis.rotation_hints import about_bodies, about_freedom, about_poses
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.up_axis import ASSUMED

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.metrics.evaluation import Evaluation

LOW_COVERAGE = 0.9
LARGE_TILT_DEG = 10.0
_ENOUGH = 20_000  # states, to recognise something by
# Of steps in time: their spread that is worth a look, how many are needed, and the share of it
# that steps in space follow where stamps are honest (1) or of arrivals (0).
_JITTER = 0.15
_FEWEST_STEPS = 100
_FOLLOWS = 0.2
_SPARSE_S = 0.12
_REASONS = {
    "no_groundtruth_within_max_time_difference": "no groundtruth close enough in time",
    "no_groundtruth_of_this_frame": "in frames without groundtruth",
    "before_groundtruth": "before the groundtruth",
    "after_groundtruth": "after the groundtruth",
    "in_groundtruth_gap": "in a groundtruth gap",
}


def reasons(dropped: Mapping[str, int]) -> str:
    """Return counts by reason in words: "3 not finite, 12 before the groundtruth"."""
    return ", ".join(
        f"{count} {_REASONS.get(reason, reason.replace('_', ' '))}"
        for reason, count in dropped.items()
    )


def warnings_of(evaluation: Evaluation) -> tuple[str, ...]:
    """Return the warnings about a finished evaluation, the gravest first."""
    return (
        *about_few_pairs(evaluation),
        *dict.fromkeys((*evaluation.groundtruth.damage, *evaluation.estimate.damage)),
        *evaluation.groundtruth.conflicts,
        *evaluation.estimate.conflicts,
        *_about_alignment(evaluation),
        *_about_jumps(evaluation),
        *_about_rotations(evaluation),
        *_about_coverage(evaluation),
        *_about_relative_errors(evaluation),
        *_about_inputs(evaluation),
    )


def _about_alignment(evaluation: Evaluation) -> list[str]:
    warnings = [*about_freedom(evaluation), *about_poses(evaluation)]
    protocol, alignment = evaluation.protocol, evaluation.alignment
    if protocol.align_states is not None and alignment.states_used < protocol.align_states:
        warnings.append(
            f"aligned by all {alignment.states_used} matched states, since there are fewer than "
            f"the {protocol.align_states} asked for"
        )
    if protocol.ate_form == "tutorial":
        warnings.append(
            "the tutorial's form of the ATE, eq. (23), depends on where the world's origin is; "
            "it compares only with numbers of the same form and origin"
        )
    truth_up, estimate_up = evaluation.groundtruth.up, evaluation.estimate.up
    known = ASSUMED not in (truth_up.origin, estimate_up.origin)
    if known and truth_up.name != estimate_up.name and protocol.gauge.minimum_states == 1:
        warnings.append(
            f"{truth_up} is up in the groundtruth's frame, {estimate_up} in the estimate's, and "
            f"gauge {protocol.gauge.value} doesn't turn one to the other"
        )
    if protocol.align_states == 1:
        warnings += _about_first_state(evaluation)
    return warnings


def _about_first_state(evaluation: Evaluation) -> list[str]:
    """Recognise an estimator's placeholder: a first pose from which the second one jumps away."""
    pairs = evaluation.association
    truth, other = pairs.groundtruth[:2].quaternions, pairs.estimate[:2].quaternions
    if len(pairs) < 3 or truth is None or other is None:
        return []
    turned = lie.angle(lie.multiply(lie.conjugate(other[0]), other[1]))
    true_turn = lie.angle(lie.multiply(lie.conjugate(truth[0]), truth[1]))
    jump_deg = float(np.degrees(np.abs(turned - true_turn)))
    if jump_deg < LARGE_TILT_DEG:
        return []
    return [
        f"the estimate turns {jump_deg:.0f} deg more than the groundtruth from its first to its "
        "second matched state: the first pose, by which all was aligned, looks like a placeholder"
    ]


def _about_jumps(evaluation: Evaluation) -> list[str]:
    truth, estimate = evaluation.association.groundtruth, evaluation.association.estimate
    steps = Steps.between(
        truth.positions,
        estimate.positions,
        truth.quaternions,
        estimate.quaternions,
        evaluation.alignment.similarity.scale,
    )
    if not len(steps.true_m):
        return []
    jumps = steps.jumps(float(np.median(steps.position_m)), float(np.median(steps.rotation_deg)))
    if not len(jumps):
        return []
    first = jumps[0]
    where = "once" if len(jumps) == 1 else f"at {len(jumps)} places"
    return [
        f"the estimate jumps {where}, first {truth.seconds[first + 1]:.1f} s after the first "
        f"pair: by {steps.position_m[first]:.2f} m and {steps.rotation_deg[first]:.0f} deg more "
        "than the groundtruth moved: after a restart with a new origin, one alignment can't fit "
        "the parts on both sides"
    ]


def _about_rotations(evaluation: Evaluation) -> list[str]:
    warnings = []
    pairs = evaluation.association
    without = [
        who
        for who, side in (("groundtruth", pairs.groundtruth), ("estimate", pairs.estimate))
        if side.quaternions is None
    ]
    if without:
        warnings.append(
            f"the {' and the '.join(without)} has positions only: rotation errors and relative "
            "errors are withheld"
        )
    body = about_bodies(evaluation)
    if body:
        return [*warnings, *body]
    tilt = evaluation.absolute.tilt_deg
    if evaluation.protocol.gauge is Gauge.YAW and tilt is not None:
        typical = float(np.median(tilt))
        if typical > LARGE_TILT_DEG:
            warnings.append(
                f"the vertical axes of estimate and groundtruth differ by {typical:.0f} deg "
                "(median), which a yaw alignment can't mend: are their up axes right (--up), and "
                "are both of the same body?"
            )
    return warnings


def _about_coverage(evaluation: Evaluation) -> list[str]:
    pairs = evaluation.association
    warnings = []
    if evaluation.score is not None:
        missing = evaluation.score.missing
        return [f"{missing} points have no estimate, and are worth nothing"] if missing else []
    if min(pairs.estimate_coverage, pairs.groundtruth_coverage) < LOW_COVERAGE:
        why, coverage = reasons(pairs.dropped), pairs.coverage
        warnings.append(
            f"the {coverage.of_what} cover {100 * coverage.covered:.0f} % of the groundtruth's "
            f"time and {100 * pairs.estimate_coverage:.0f} % of the estimate's poses"
            + (f" (dropped: {why})" if why else "")
            + (f", {coverage.gap_in_words}" if coverage.longest_gap else "")
            + ": errors over a part compare only with errors over the same part"
        )
    return warnings


def _about_relative_errors(evaluation: Evaluation) -> list[str]:
    empty = [str(each.length) for each in evaluation.segments or () if not len(each.errors.ends)]
    if not empty:
        return []
    path = evaluation.association.groundtruth
    return [
        f"no sub-trajectory of {', '.join(empty)}: the matched path is {path.path_length_m:.1f} m "
        f"long, in {path.duration_s:.1f} s"
    ]


def _about_inputs(evaluation: Evaluation) -> list[str]:
    truth, estimate = evaluation.groundtruth, evaluation.estimate
    warnings = []
    if truth.child_frame and estimate.child_frame and truth.child_frame != estimate.child_frame:
        warnings.append(
            f"the groundtruth is of body {truth.child_frame!r} and the estimate of "
            f"{estimate.child_frame!r}: if these are not the same point of the same body, their "
            "lever arm and rotation are in the errors"
        )
    paired = evaluation.association.estimate
    for name, side in (("groundtruth", truth), ("estimate", paired)):
        if _stamped_at_arrival(side):
            warnings.append(
                f"the {name}'s stamps jitter and its motion doesn't: they look like times of "
                "arrival; stamp at the sensor, or expect an error of speed times jitter, and a "
                "constant delay that --time-offset auto can find"
            )
    if truth.dropped:
        warnings.append(f"groundtruth poses were dropped: {reasons(truth.dropped)}")
    return warnings


def _stamped_at_arrival(side: Trajectory) -> bool:
    """Return whether steps in time vary and steps in space don't follow them.

    A body that moves smoothly goes twice as far in twice the time. Where it goes as far whatever
    the stamps say, they are not when it was there.
    """
    some = slice(_ENOUGH)
    step_s, moved = np.diff(side.stamps[some]) / 1e9, np.diff(side.positions[some], axis=0)
    distance = np.linalg.norm(moved, axis=1)
    usual_s = float(np.median(step_s)) if len(step_s) else 0.0
    # Between neighbours on both sides, none of them a lost message; a body that is hardly moving
    # shows its noise.
    whole = (step_s > 0.1 * usual_s) & (step_s < 1.9 * usual_s)
    nearby_s, nearby = (step_s[:-2] + step_s[2:]) / 2.0, (distance[:-2] + distance[2:]) / 2.0
    smooth = np.einsum("ni,ni->n", moved[:-2], moved[2:]) > 0.9 * distance[:-2] * distance[2:]
    counts = smooth & (nearby > 0.0) & whole[:-2] & whole[1:-1] & whole[2:]
    # Sparse keyframes are taken when the body has moved so far.
    if not side.stamped or usual_s > _SPARSE_S or np.count_nonzero(counts) < _FEWEST_STEPS:
        return False
    longer = step_s[1:-1][counts] / nearby_s[counts] - 1.0
    farther = distance[1:-1][counts] / nearby[counts] - 1.0
    jitter = float(np.sqrt(np.mean(longer**2)))
    follows = float(longer @ farther) / max(float(longer @ longer), 1e-12)
    return jitter > _JITTER and follows < _FOLLOWS
