"""Warnings: what a reader of the numbers must know, each with what to do about it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros import lie
from trajeval_ros.gauge import Gauge
from trajeval_ros.jumps import Steps

if TYPE_CHECKING:
    from trajeval_ros.evaluation import Evaluation

LOW_COVERAGE = 0.9
LARGE_TILT_DEG = 10.0
_REASONS = {
    "no_groundtruth_within_max_time_difference": "no groundtruth close enough in time",
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
        *dict.fromkeys((*evaluation.groundtruth.damage, *evaluation.estimate.damage)),
        *_about_alignment(evaluation),
        *_about_jumps(evaluation),
        *_about_rotations(evaluation),
        *_about_coverage(evaluation),
        *_about_relative_errors(evaluation),
        *_about_inputs(evaluation),
    )


def _about_alignment(evaluation: Evaluation) -> list[str]:
    warnings = []
    protocol, alignment = evaluation.protocol, evaluation.alignment
    if alignment.undetermined:
        warnings.append(
            f"{alignment.undetermined}; rotation and velocity errors are withheld: align by the "
            "first state, or by a gauge that turns less"
        )
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
    if protocol.align_states == 1:
        warnings += _about_first_state(evaluation)
    return warnings


def _about_first_state(evaluation: Evaluation) -> list[str]:
    """Recognise an estimator's placeholder: a first pose from which the second one jumps away."""
    pairs = evaluation.association
    if len(pairs) < 3 or pairs.groundtruth.rotations is None or pairs.estimate.rotations is None:
        return []
    truth, other = pairs.groundtruth[:2].quaternions, pairs.estimate[:2].quaternions
    assert truth is not None
    assert other is not None
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
        if side.rotations is None
    ]
    if without:
        warnings.append(
            f"the {' and the '.join(without)} has positions only: rotation errors and relative "
            "errors are withheld"
        )
    tilt = evaluation.absolute.tilt_deg
    if evaluation.protocol.gauge is Gauge.YAW and tilt is not None:
        typical = float(np.median(tilt))
        if typical > LARGE_TILT_DEG:
            warnings.append(
                f"the vertical axes of estimate and groundtruth differ by {typical:.0f} deg "
                "(median), which a yaw alignment can't mend: is z up in both, and are both of "
                "the same body?"
            )
    return warnings


def _about_coverage(evaluation: Evaluation) -> list[str]:
    pairs = evaluation.association
    warnings = []
    if min(pairs.estimate_coverage, pairs.groundtruth_coverage) < LOW_COVERAGE:
        why = reasons(pairs.dropped)
        warnings.append(
            f"the pairs cover {100 * pairs.groundtruth_coverage:.0f} % of the groundtruth's time "
            f"and {100 * pairs.estimate_coverage:.0f} % of the estimate's poses"
            + (f" (dropped: {why})" if why else "")
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
    if truth.dropped:
        warnings.append(f"groundtruth poses were dropped: {reasons(truth.dropped)}")
    return warnings
