"""The pipeline from trajectories to an outcome, without access to files.

The command line, comparisons, live runs and Python use it, so that equal requests give equal
numbers. `_evaluated` has the steps in their order.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.diagnosis.findings import Finding, Verification
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.as_available import AsAvailable, as_available
from trajeval_ros.metrics.evaluation import Evaluation, of_same_point, on_plane
from trajeval_ros.metrics.input_summary import InputSummary
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.receive_clock import judged_receive_times
from trajeval_ros.metrics.states_table import states_table
from trajeval_ros.pipeline.diagnosing import diagnosed, explained, reevaluation
from trajeval_ros.pipeline.measurement import measured
from trajeval_ros.pipeline.outcome import (
    Outcome,
    RunOutcome,
    with_bayes_factors,
    with_noise_corrected_ates,
    with_remarks,
    with_same_estimates_named,
)
from trajeval_ros.pipeline.preparation import (
    Inputs,
    corrected_and_cut,
    named,
    with_fixes_placed,
)
from trajeval_ros.pipeline.request import Request, finding_to_correct

_MOST_CORRECTIONS = 4

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Calibrated
    from trajeval_ros.consistency.consistency_result import Consistency
    from trajeval_ros.consistency.integrity import Integrity
    from trajeval_ros.likelihood.likelihood_assessment import LikelihoodAssessment
    from trajeval_ros.metrics.stream_health import StreamHealth


def run(
    groundtruth: Trajectory, estimates: Sequence[Trajectory], request: Request | None = None
) -> Outcome:
    """Evaluate the estimates of one groundtruth, as `trajeval_ros.run` does."""
    request = request or Request()
    if not estimates:
        raise InputError("no estimate given; give at least one")
    groundtruth, estimates, request = with_fixes_placed(groundtruth, estimates, request)
    runs: list[RunOutcome] = []
    for estimate in estimates:
        testable, remarks = _testable(request, estimate, estimates)
        with named(estimate):
            given, same_as = Inputs.of(groundtruth, estimate), runs[0].calibrated if runs else None
            outcome = _evaluated(given, testable, same_as)
            if request.correct:
                outcome = _corrected(outcome, given, testable, same_as)
        runs.append(with_remarks(remarks, outcome, len(outcome.evaluation.remarks)))
    used, inputs = runs[0].evaluation.groundtruth, corrected_and_cut(given, request)
    runs = list(with_bayes_factors(with_same_estimates_named(runs)))
    runs = with_noise_corrected_ates(runs, request.fixes)
    return Outcome(request, InputSummary.of(inputs.groundtruth, used), tuple(runs))


def _testable(
    request: Request, estimate: Trajectory, estimates: Sequence[Trajectory]
) -> tuple[Request, list[Remark]]:
    """Return the request for one of several estimates, without tests that only others allow."""
    is_possible = estimate.covariances is not None or all(
        item.covariances is None for item in estimates
    )
    if request.covariances.source != "message" or is_possible:
        return request, []
    text = "the consistency test is not possible: the estimate has no covariances"
    without = dataclasses.replace(request, covariances=CovarianceRequest(), integrity=None)
    return without, [warning("no_consistency_test", text)]


def run_alone(
    groundtruth: Trajectory, estimate: Trajectory, request: Request
) -> tuple[InputSummary, RunOutcome]:
    """Evaluate one of several estimates with its own request; return the groundtruth's summary.

    What compares estimates follows: `with_same_estimates_named` and `with_noise_corrected_ates`.
    """
    groundtruth, [estimate], request = with_fixes_placed(groundtruth, [estimate], request)
    with named(estimate):
        given = Inputs.of(groundtruth, estimate)
        outcome = _evaluated(given, request)
    inputs = corrected_and_cut(given, request)
    return InputSummary.of(inputs.groundtruth, outcome.evaluation.groundtruth), outcome


def evaluate(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol | None = None
) -> Evaluation:
    """Evaluate one estimate, as `trajeval_ros.evaluate` does."""
    request = Request(protocol or Protocol())
    given = Inputs(groundtruth, estimate)
    inputs, _, evaluation = measured(given, request)
    return diagnosed(
        evaluation, inputs.groundtruth, inputs.estimate, reevaluation(given, request)
    )[0]


def _evaluated(given: Inputs, request: Request, same_as: Calibrated | None = None) -> RunOutcome:
    """Evaluate one estimate: the steps of the pipeline in their order."""
    try:
        inputs, calibrated, evaluation = measured(given, request, same_as)
    except InputError as error:
        raise explained(error, given, request) from error
    evaluation, diagnosis = diagnosed(
        evaluation,
        inputs.groundtruth,
        inputs.estimate,
        reevaluation(given, request, same_as),
        paired=inputs.pairs is not None,
        hand_eye_calibrated=request.calibration.hand_eye,
    )
    consistency = _consistency(evaluation, calibrated, request)
    available = _available(inputs, evaluation, request)
    if available is not None:
        remarks = (*evaluation.remarks, *available.numbers.remarks)
        evaluation = dataclasses.replace(evaluation, remarks=remarks)
    return RunOutcome(
        InputSummary.of(given.estimate, evaluation.estimate),
        evaluation,
        calibrated,
        consistency,
        _likelihood(evaluation, request),
        by_states=states_table(evaluation, chosen) if (chosen := request.states_table) else (),
        diagnosis=diagnosis,
        integrity=_integrity(given.estimate, evaluation, consistency, request),
        stream=_stream(given.estimate),
        available=available,
    )


def _stream(estimate: Trajectory) -> StreamHealth | None:
    """Return the health of a recorded stream; without arrivals if they can't be compared."""
    receive_times = estimate.reading.receive_times
    if receive_times is None or not len(estimate) or estimate.reading.as_received is not None:
        return None
    from trajeval_ros.metrics.stream_health import UNKNOWN, health_of

    _, clock = judged_receive_times(estimate.stamps, receive_times.times)
    unknown = np.full(len(estimate), UNKNOWN)
    return health_of(estimate.stamps, receive_times.times if clock.is_usable else unknown)


def _available(inputs: Inputs, evaluation: Evaluation, request: Request) -> AsAvailable | None:
    """Compute the as-available accuracy; None if not requested."""
    rule, protocol = request.available, evaluation.protocol
    if not rule.is_asked_for:
        return None
    groundtruth, estimate = evaluation.groundtruth, evaluation.estimate
    if inputs.streams is not None:
        groundtruth, estimate = inputs.streams
        estimate = of_same_point(estimate, protocol)
        if protocol.gauge is Gauge.PLANAR:
            groundtruth = on_plane(groundtruth)
    return as_available(
        groundtruth.in_order(),
        estimate,
        evaluation.alignment.similarity,
        rule,
        evaluation.association.rule,
    )


def _consistency(
    evaluation: Evaluation, calibrated: Calibrated | None, request: Request
) -> Consistency | None:
    """Test the covariances; None if there are none."""
    covariances = request.covariances
    if covariances.source == "none":
        return None
    from trajeval_ros.consistency.consistency_assessment import assess_consistency

    if calibrated is not None and calibrated.hand_eye is not None and not calibrated.of_marker:
        covariances = covariances.of_moved_groundtruth(calibrated.hand_eye)
    return assess_consistency(evaluation, covariances.once_turned)


def _likelihood(evaluation: Evaluation, request: Request) -> LikelihoodAssessment | None:
    """Compute the likelihoods; None unless the association is continuous."""
    if not request.is_continuous:
        return None
    from trajeval_ros.likelihood.likelihood_assessment import assess_likelihood

    return assess_likelihood(evaluation)


def _integrity(
    estimate: Trajectory, evaluation: Evaluation, tested: Consistency | None, request: Request
) -> Integrity | None:
    """Compare errors with protection levels; None if not requested."""
    if request.integrity is None or tested is None:
        return None
    from trajeval_ros.consistency.integrity import integrity_of

    alerts = _watchdog_errors(estimate, evaluation, request.watch_factor)
    stamps = evaluation.association.estimate.stamps
    return integrity_of(tested, request.integrity, stamps, alerts)


def _watchdog_errors(
    estimate: Trajectory, evaluation: Evaluation, factor: float | None
) -> list[tuple[int, int]]:
    """Return the time spans of errors of a watchdog, by the clock of the pairs."""
    if factor is None:
        return []
    from trajeval_ros.watchdog.recording import WatchedRun, error_spans

    offset_ns = round(evaluation.association.rule.time_offset_s * NANOSECONDS)
    spans = error_spans(WatchedRun(estimate), factor)
    return [(begin + offset_ns, end + offset_ns) for begin, end in spans]


def _corrected(
    outcome: RunOutcome, given: Inputs, request: Request, same_as: Calibrated | None
) -> RunOutcome:
    """Evaluate again with the corrections of findings, and keep the errors without them."""
    corrected: list[Finding] = []
    while len(corrected) < _MOST_CORRECTIONS:
        finding = finding_to_correct(outcome.diagnosis, request.correct, is_first=not corrected)
        if finding is None:
            break
        changed = request.corrected(finding.correction)
        after = _evaluated(given, changed, same_as)
        tried = Verification.of(outcome.evaluation, after.evaluation)
        is_hidden = finding.tried is not None and bool(finding.tried.then)
        if not finding.is_confirmed_by(tried) and not is_hidden:
            if corrected:
                break
            raise InputError(
                f"the errors do not confirm {finding.option}; correct the first finding, with "
                "--correct suggested"
            )
        corrected.append(dataclasses.replace(finding, tried=tried))
        outcome, request = after, changed
    return dataclasses.replace(outcome, corrected=tuple(corrected))
