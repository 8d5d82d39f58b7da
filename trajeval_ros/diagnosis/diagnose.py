"""All tests of an evaluation and its inputs, in their order.

Tests of the columns and of single sides come first: some of their findings invalidate the rest.
The motions of both sides are compared by models (`motion_tests.py`). Drift is never reported as a
mistake: all tests use short motions, in which it is small.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.diagnosis.column_tests import tests_of_columns
from trajeval_ros.diagnosis.discontinuities import (
    changes_motions,
    examined_discontinuities,
    has_clock_step,
    with_divergences,
    with_events,
    without_jumps,
)
from trajeval_ros.diagnosis.evaluation_tests import (
    covariance_blocks,
    frame_offset,
    number_of_pairs,
)
from trajeval_ros.diagnosis.findings import Detection, Diagnosis, Finding
from trajeval_ros.diagnosis.input_pair import FEWEST, InputPair
from trajeval_ros.diagnosis.lost_tracking_tests import (
    begins_at_start,
    is_certain,
    is_large,
    losses_in,
    lost_tracking,
)
from trajeval_ros.diagnosis.motion_tests import DISAGREE, tests_of_motion
from trajeval_ros.exceptions import InputError
from trajeval_ros.metrics.association import Association, associate
from trajeval_ros.metrics.discontinuities.events import FROZEN, FROZEN_ROTATION

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.metrics.discontinuities.events import Event, Loss
    from trajeval_ros.metrics.evaluation import Evaluation
    from trajeval_ros.metrics.input_summary import InputSummary
    from trajeval_ros.metrics.protocol import Protocol

# These findings invalidate all other tests.
_FINAL = {
    "identical", "stands_still", "stamps_rounded", "degrees", "row_numbers", "increments",
}  # fmt: skip
_OTHER_PAIRS = {*_FINAL, "clock_offset", "clock_drift", "other_run"}
# These explain the motions of the whole run, as conventions do, or all that are unusual.
_OF_WHOLE_RUNS = {
    *_FINAL - {"identical"}, "unit", "duplicated", "groundtruth_held", "groundtruth_bridged",
    "gap_bridged",
}  # fmt: skip
# ATE by the spread of the groundtruth: paths of other runs differ by more than this.
_AGREES = 0.3


def diagnose(
    evaluation: Evaluation,
    groundtruth: Trajectory,
    estimate: Trajectory,
    *,
    paired: bool = False,
    losses: Sequence[Loss] | None = None,
) -> tuple[Evaluation, Diagnosis]:
    """Search for mistakes that affect an evaluation of two trajectories.

    These are in the order of their sources, without the time offset. They may be `paired`: contain
    only the pairs, row by row. `losses` of tracking are by default those in the pairs.

    Returns:
        The evaluation with its discontinuities, and the diagnosis. A mistake that explains all
        motions hides discontinuities: they are searched for after its correction.
    """
    protocol, pairs = evaluation.protocol, evaluation.association
    sides, offset_s = (groundtruth, estimate), protocol.association.time_offset_s
    if paired or pairs.rule.method == "index":
        sides, offset_s = (pairs.groundtruth, pairs.estimate), 0.0
        protocol = dataclasses.replace(protocol, association=pairs.rule)
    elif protocol.lever_m is not None:
        sides = evaluation.groundtruth, evaluation.estimate
    number = number_of_pairs(protocol, pairs, evaluation.groundtruth, evaluation.estimate)
    losses = losses_in(pairs) if losses is None else losses
    inputs = InputPair(*sides, protocol, offset_s)
    known, is_partial, unexplained = _tested_where_tracked(losses, pairs, inputs)
    if known.named("other_run") and _is_of_noisy_fixes(evaluation):
        known = known.without("other_run", "fixes are noisier than short motions")
    is_explained = any(map(_explains_motions, known.findings))
    if not (paired and is_explained):
        evaluation = with_events(
            evaluation, groundtruth, estimate, paired=paired, is_explained=is_explained
        )
    frozen = [event for event in evaluation.events if event.kind == FROZEN_ROTATION]
    if frozen and known.named("rotations") and not _tested(inputs, frozen).named("rotations"):
        known = known.without("rotations", "a rotation is frozen")
    # After a step of a clock, motions agree by chance with wrong conventions, too.
    if any(map(_explains_motions, known.findings)) and not has_clock_step(evaluation):
        evaluation = without_jumps(evaluation)
    evaluation = with_divergences(evaluation, unexplained)
    # A flip changes no rate of motion, by which clocks and other runs are known.
    is_apart = known.names_any(_OTHER_PAIRS) and not has_clock_step(evaluation)
    if changes_motions(evaluation) and not is_apart:
        known, is_partial = Diagnosis.of(tests_of_columns(inputs)), True
    examined = [number, *known.examined, examined_discontinuities(evaluation, known)]
    if not is_partial:
        examined.append(frame_offset(evaluation))
        # With a graver finding, the errors contain no information on covariances.
        if all(finding.rank <= CAUSES["body"].rank for finding in known.findings):
            examined.append(covariance_blocks(evaluation))
    return evaluation, Diagnosis.of(examined)


def _explains_motions(finding: Finding) -> bool:
    """Return whether a finding explains the motions of the whole run, so that none is left.

    A step of a clock looks like an offset or a rate, and a body that was flipped like rotations
    without a convention.
    """
    if finding.cause == "rotations":
        return bool(finding.evidence["is_explained"])
    return finding.is_of_conventions or finding.cause in _OF_WHOLE_RUNS


def _is_of_noisy_fixes(evaluation: Evaluation) -> bool:
    """Return whether the path agrees with GNSS fixes, whose noise hides short motions."""
    position = evaluation.ate["position_m"]
    if evaluation.groundtruth.kind != "gnss" or position is None:
        return False
    spread_m = float(np.sqrt(evaluation.association.groundtruth.positions.var(axis=0).sum()))
    return position.rmse < _AGREES * spread_m


def diagnose_inputs(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol
) -> Diagnosis:
    """Search for mistakes in two trajectories that can't be evaluated."""
    groundtruth.require_usable()
    estimate.require_usable()
    inputs = InputPair(groundtruth, estimate, protocol, protocol.association.time_offset_s)
    try:
        pairs = associate(groundtruth, estimate, protocol.association)
    except InputError:  # no pairs: their number is not the cause
        return _tested(inputs)
    number = number_of_pairs(protocol, pairs, groundtruth, estimate)
    known, *_ = _tested_where_tracked(losses_in(pairs), pairs, inputs)
    return Diagnosis.of([number, *known.examined])


def _tested_where_tracked(
    losses: Sequence[Loss], pairs: Association, inputs: InputPair
) -> tuple[Diagnosis, bool, Sequence[Loss]]:
    """Report losses, and apply the other tests to the rest, since a loss looks like most mistakes.

    Returns:
        The diagnosis, whether it names a loss, and the losses that no mistake explains. A
        divergence that stays within the size of the path may be the effect of another mistake,
        such as clocks that differ; one that is no larger than drift is no finding.
    """
    certain = [loss for loss in losses if is_certain(loss, pairs)]
    diagnosis = _tested(inputs, certain)
    # What follows from wrong pairs is no divergence, and motions agree before one.
    frozen = [loss for loss in certain if loss.kind == FROZEN]
    if len(frozen) < len(certain) and (diagnosis.names_any(_OTHER_PAIRS) or _disagrees(diagnosis)):
        whole = _tested(inputs, frozen)
        if whole.names_any(_OTHER_PAIRS):
            certain, diagnosis = frozen, whole
    unexplained: Sequence[Loss] = certain
    from_start = any(begins_at_start(loss, pairs) for loss in losses if loss not in certain)
    if not any(_explains_loss(finding, from_start) for finding in diagnosis.findings):
        large = [loss for loss in losses if loss in certain or is_large(loss, pairs)]
        without = diagnosis if len(large) == len(certain) else _tested(inputs, large)
        if not (diagnosis.named("other_run") and _disagrees(without)):
            unexplained, certain, diagnosis = losses, large, without
    if not certain:
        return diagnosis, False, unexplained
    lost = lost_tracking(certain, pairs, int(inputs.groundtruth.stamps.min()))
    # Lost messages look like keyframes.
    rest = [test for test in diagnosis.examined if test.test != "keyframes"]
    return Diagnosis.of([lost, *rest]), True, unexplained


def _disagrees(diagnosis: Diagnosis) -> bool:
    """Return whether no model explains the motions, although there are some."""
    return any(test.why_not == DISAGREE for test in diagnosis.examined)


def _explains_loss(finding: Finding, from_start: bool) -> bool:
    """Return whether a mistake makes displacements differ, from the start or later."""
    if finding.cause == "other_run":
        return from_start
    if finding.cause == "lever_arm":
        return True
    return finding.rank >= CAUSES["unit"].rank and finding.cause != "swapped"


def require_conventions(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol, pairs: Association | None
) -> None:
    """Refuse a hand-eye calibration of poses with a wrong convention.

    The calibration would confuse a mirrored axis with a body rotated by 180 deg.
    """
    if pairs is not None:
        groundtruth, estimate = pairs.groundtruth, pairs.estimate
    groundtruth.require_usable()
    estimate.require_usable()
    offset_s = protocol.association.time_offset_s if pairs is None else 0.0
    inputs = InputPair(groundtruth, estimate, protocol, offset_s)
    if (finding := _tested(inputs).of_conventions()) is not None:
        raise InputError(f"--hand-eye auto needs correct conventions, but {finding.text}")


def same_estimate(estimate: InputSummary, others: Sequence[InputSummary]) -> Finding | None:
    """Return the finding about an estimate with the same poses as another one; else None."""
    for other in others:
        if other.fingerprint == estimate.fingerprint:
            name = other.source or other.name or "another one"
            return Finding.of(Detection.of("same_estimate", other=name))
    return None


def _tested(inputs: InputPair, losses: Sequence[Event] = ()) -> Diagnosis:
    """Apply all tests of the inputs where the estimate is not lost; none if hardly any is left."""
    if losses:
        inputs = inputs.tracked(losses)
        if min(len(inputs.groundtruth), len(inputs.estimate)) < FEWEST:
            return Diagnosis()
    of_sides = Diagnosis.of(tests_of_columns(inputs))
    if of_sides.names_any(_FINAL):
        return of_sides
    is_copied = of_sides.names_any(["duplicated"])
    return Diagnosis.of([*of_sides.examined, *tests_of_motion(inputs, is_copied=is_copied)])
