"""The diagnosis of a request: mistakes, and evaluations with their corrections."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.diagnose import diagnose as diagnose_evaluation
from trajeval_ros.diagnosis.diagnose import diagnose_inputs
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.diagnosis.verification import Reevaluate, verified
from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.vertical_axis import up_axis_doubt
from trajeval_ros.metrics.discontinuities.parts import parts_of
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.statistics import median
from trajeval_ros.pipeline.evaluation_remarks import remarks_on, require_same_body
from trajeval_ros.pipeline.measurement import measured
from trajeval_ros.pipeline.preparation import Inputs, corrected_and_cut
from trajeval_ros.pipeline.request import OF_PAIRS, Request

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Calibrated
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.metrics.discontinuities.events import Event, Loss

_OF_EVENTS = {"correct", "drop_groundtruth_outliers"}  # corrections of discontinuities


def diagnose(
    groundtruth: Trajectory,
    estimate: Trajectory,
    request: Request,
    pairs: Association | None = None,
    losses: Sequence[Loss] | None = None,
) -> tuple[Diagnosis, str]:
    """Search for mistakes, and try their corrections.

    The `pairs` of a live run are given, and its `losses` of tracking if they are known.

    Returns:
        The diagnosis, and the reason if nothing can be evaluated, else "".
    """
    given = Inputs(groundtruth, estimate, pairs)
    reevaluate = reevaluation(given, request)
    try:
        inputs, _, evaluation = measured(given, request)
    except TrajevalError as error:
        if pairs is not None:
            return Diagnosis(), str(error)
        inputs = corrected_and_cut(given, request)
        diagnosis = diagnose_inputs(inputs.groundtruth, inputs.estimate, request.protocol)
        return verified(diagnosis, None, reevaluate), str(error)
    sides = inputs.groundtruth, inputs.estimate
    paired = inputs.pairs is not None
    evaluation, diagnosis = diagnose_evaluation(evaluation, *sides, paired=paired, losses=losses)
    return verified(diagnosis, evaluation, _with_events_of(evaluation, reevaluate)), ""


def diagnosed(
    evaluation: Evaluation,
    groundtruth: Trajectory,
    estimate: Trajectory,
    reevaluate: Callable[..., Evaluation],
    *,
    paired: bool = False,
    hand_eye_calibrated: bool = False,
) -> tuple[Evaluation, Diagnosis]:
    """Return an evaluation with remarks and without meaningless errors, and its diagnosis.

    `reevaluate` evaluates with corrections. An alignment by orientations of another body is
    refused.
    """
    evaluation, diagnosis = diagnose_evaluation(evaluation, groundtruth, estimate, paired=paired)
    if hand_eye_calibrated:
        diagnosis = diagnosis.after_hand_eye_calibration()
    diagnosis = verified(diagnosis, evaluation, _with_events_of(evaluation, reevaluate))
    require_same_body(evaluation, diagnosis)
    remarks = (*remarks_on(evaluation, diagnosis, paired=paired), *evaluation.remarks)
    return dataclasses.replace(evaluation, remarks=remarks), diagnosis


def _with_events_of(evaluation: Evaluation, reevaluate: Callable[..., Evaluation]) -> Reevaluate:
    """Return what evaluates again with the discontinuities of an evaluation."""
    return functools.partial(reevaluate, events=evaluation.events)


def reevaluation(
    given: Inputs, request: Request, same_as: Calibrated | None = None
) -> Callable[..., Evaluation]:
    """Return what evaluates again with corrections, without relative errors.

    It does not search for `events` that it knows, and cuts the run at them.
    """
    is_whole = given.pairs is None and not request.discontinuities.changes_inputs

    def reevaluate(
        corrections: Sequence[Mapping[str, str]], events: Sequence[Event] | None = None
    ) -> Evaluation:
        protocol = dataclasses.replace(request.protocol, lengths=())
        changed, sides = dataclasses.replace(request, protocol=protocol), given
        if is_whole and all(correction.keys() <= _OF_EVENTS for correction in corrections):
            sides = dataclasses.replace(given, events=events)
        for correction in corrections:
            changed = changed.corrected(correction)
            if given.pairs is not None and correction.keys() & OF_PAIRS:
                sides = _by_their_clocks(given.pairs)
                changed = _with_gaps_of(given.pairs, changed)
        after = measured(sides, changed, same_as, compares=False)[2]
        parts = parts_of(after.association, sides.events or (), protocol)
        return dataclasses.replace(after, parts=parts)

    return reevaluate


def _by_their_clocks(pairs: Association) -> Inputs:
    """Return the states of pairs with the timestamps of their own clocks."""
    stamps = pairs.estimate.stamps - round(pairs.rule.time_offset_s * NANOSECONDS)
    return Inputs(pairs.groundtruth, dataclasses.replace(pairs.estimate, stamps=stamps))


def _with_gaps_of(pairs: Association, request: Request) -> Request:
    """Return a request that interpolates between thinned pairs."""
    steps = np.diff(pairs.groundtruth.stamps) / NANOSECONDS
    rule = request.protocol.association
    rule = rule.bridging(3.0 * median(steps)) if len(steps) else rule
    protocol = dataclasses.replace(request.protocol, association=rule)
    return dataclasses.replace(request, protocol=protocol)


def explained(error: InputError, given: Inputs, request: Request) -> InputError:
    """Return the error of an evaluation, or the wrong convention that causes a wrong up axis.

    Inverse poses of the groundtruth rotate about no vertical axis.
    """
    inputs = corrected_and_cut(given, request)
    gauge = request.protocol.gauge
    if not gauge.yaw_only or not up_axis_doubt(inputs.groundtruth):
        return error
    diagnosis = diagnose_inputs(inputs.groundtruth, inputs.estimate, request.protocol)
    causes = [finding for finding in diagnosis.findings if finding.cause == "inverse"]
    if not causes or request.calibration.hand_eye:
        return error
    return InputError(f"gauge {gauge.value} is not possible: {causes[0].text}")
