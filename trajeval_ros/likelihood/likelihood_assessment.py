"""Assessment of an estimate against continuous groundtruth: likelihoods and supported ATE."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.continuous_time.continuous_trajectory import ContinuousTrajectory
from trajeval_ros.continuous_time.samples import WITHOUT_UNCERTAINTY, Belief, Noise
from trajeval_ros.exceptions import DegenerateGeometryError, InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie, se3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.covariance_frames import world_from_body_twists
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood import relative_density
from trajeval_ros.likelihood.correlated_groundtruth import (
    CorrelatedGroundtruth,
    joint_log_likelihood,
)
from trajeval_ros.likelihood.marginal import AbsoluteErrorDensity, generalised_absolute_error
from trajeval_ros.likelihood.observable_directions import GaugeScores, gauge_scores
from trajeval_ros.likelihood.residuals import Residuals
from trajeval_ros.likelihood.uncertain_ate import UncertainAte, uncertain_ate

if TYPE_CHECKING:
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.metrics.evaluation import Evaluation


# Least errors between two sensors: timestamps and mounting. They are added to the model's
# covariance and keep likelihoods finite where that is very small.
TOLERANCE = Noise(0.005, math.radians(0.2))
_FEWEST_COMMON = 10
# Number of poses per groundtruth sample above which they share errors.
_POSES_PER_SAMPLE = 1.5


@dataclass(frozen=True, eq=False)
class LikelihoodAssessment:
    """Assessment of one estimate with N poses."""

    continuous: ContinuousTrajectory  # the groundtruth's model
    stamps: NDArray[np.int64]  # (N,), nanoseconds, of the pairs
    belief: Belief  # the groundtruth at these times, including the tolerance
    error: AbsoluteErrorDensity  # the generalised absolute error
    # Its parts by edge, re-linearised at the most likely alignment; None for positions without
    # orientations.
    edges: relative_density.RelativeErrorDensity | None
    # Scores including scale and tilt; None if the gauge has no rotation, or the poses do not
    # determine it.
    gauge_scores: GaugeScores | None
    ate: UncertainAte  # the position ATE
    # Log Bayes factors against the other estimates by name, nats, with the joint covariance of the
    # groundtruth.
    log_bayes: dict[str, float]
    statements: tuple[str, ...]  # remarks about the validity of the numbers, one sentence each


def assess_likelihood(evaluation: Evaluation) -> LikelihoodAssessment:
    """Assess an estimate that was associated with a continuous groundtruth.

    Raises:
        InputError: The association is not continuous, or there are fewer than two pairs.
        SettingsError: The gauge is planar.
        DegenerateGeometryError: The poses do not determine the alignment.

    Example:
        >>> from trajeval_ros import AssociationRule, Protocol, assess_likelihood
        >>> from trajeval_ros import evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> rule = AssociationRule("continuous", model="wnoa")
        >>> protocol = Protocol(gauge="yaw", association=rule, lengths=())
        >>> evaluation = evaluate(flight.groundtruth[::100], flight.estimate, protocol)
        >>> result = assess_likelihood(evaluation)
        >>> 0.0 <= result.ate.supported_share <= 1.0
        True
    """
    pairs, protocol = evaluation.association, evaluation.protocol
    continuous = pairs.continuous
    if continuous is None:
        how = "by row index, without timestamps" if pairs.rule.method == "index" else "otherwise"
        raise InputError(
            f"likelihoods need association continuous; these pairs are associated {how}"
        )
    if len(pairs) < 2:
        raise InputError("the likelihood of a single pose is constant in this gauge")
    stamps = pairs.groundtruth.stamps
    known = continuous.at(stamps)
    oriented = pairs.groundtruth.quaternions is not None and pairs.estimate.quaternions is not None
    belief = _with_tolerance(known, oriented)
    residuals = Residuals(belief, _poses_of(pairs, oriented), protocol.gauge, oriented)
    error = generalised_absolute_error(residuals)
    edges = None
    if oriented:
        steps = relative_density.transports(belief.poses)
        missed = residuals.at(error.mode.element)
        edges = relative_density.decomposed(belief, relative_density.stepwise(steps, missed))
    ate = uncertain_ate(
        continuous.samples.seconds(stamps),
        known.poses[:, :3, 3],
        world_from_body_twists(known.covariances, known.poses[:, :3, :3])[:, :3, :3],
        pairs.estimate.positions
        if protocol.align_states is None
        else evaluation.aligned.positions,
        protocol.gauge if protocol.align_states is None else None,
        continuous.samples,
    )
    assessment = LikelihoodAssessment(
        continuous, stamps, belief, error, edges, _gauge_scores_of(residuals), ate, {}, ()
    )
    return dataclasses.replace(assessment, statements=_statements(assessment))


def with_bayes_factors(
    names: Sequence[str], assessments: Sequence[LikelihoodAssessment]
) -> list[LikelihoodAssessment]:
    """Add log Bayes factors between named estimates at their common timestamps.

    A positive number supports the estimate that it belongs to. All have the same groundtruth and
    gauge. The factors use the joint covariance of the groundtruth, so that they do not grow with
    the estimates' rate.
    """
    if len(assessments) < 2:
        return list(assessments)
    common: NDArray[np.int64] = reduce(
        lambda first, second: np.intersect1d(first, second),
        [assessment.stamps for assessment in assessments],
    )
    if len(common) < _FEWEST_COMMON:
        why = (
            f"no Bayes factor: the estimates have only {counted(len(common), 'common timestamp')}"
        )
        return [
            dataclasses.replace(assessment, statements=(*assessment.statements, why))
            for assessment in assessments
        ]
    continuous = assessments[0].continuous
    markov = continuous.markov
    if not all(assessment.error.residuals.oriented for assessment in assessments):
        markov = dataclasses.replace(markov, rotations=None)
    times = continuous.samples.seconds(common)
    groundtruth = CorrelatedGroundtruth.of(markov, times, TOLERANCE)
    scores = []
    for assessment in assessments:
        rows = np.searchsorted(assessment.stamps, common)
        residuals = assessment.error.residuals
        scores.append(
            joint_log_likelihood(
                groundtruth,
                residuals.estimate[rows],
                residuals.gauge,
                assessment.error.mode.element,
            )
        )
    return [
        dataclasses.replace(
            assessment,
            log_bayes={
                name: score - other
                for name, other, another in zip(names, scores, assessments, strict=True)
                if another is not assessment
            },
        )
        for assessment, score in zip(assessments, scores, strict=True)
    ]


def _poses_of(pairs: Association, oriented: bool) -> Floats:
    """Return the estimate's poses (N, 4, 4); identity rotations without orientations."""
    rotations = np.broadcast_to(np.eye(3), (len(pairs), 3, 3))
    if oriented:
        assert pairs.estimate.quaternions is not None
        rotations = lie.to_matrix(pairs.estimate.quaternions)
    return se3.poses(rotations, pairs.estimate.positions)


def _with_tolerance(known: Belief, oriented: bool) -> Belief:
    """Return a belief with the tolerance added to its covariances."""
    tolerance = np.square([TOLERANCE.position_m] * 3 + [TOLERANCE.rotation_rad * oriented] * 3)
    return Belief(known.poses, known.covariances + np.diag(tolerance))


def _gauge_scores_of(residuals: Residuals) -> GaugeScores | None:
    """Return the scores in all gauges; None if they are not defined."""
    if residuals.gauge not in (Gauge.YAW, Gauge.SE3, Gauge.SIM3):
        return None
    try:
        return gauge_scores(residuals)
    except DegenerateGeometryError:
        return None


def _statements(assessment: LikelihoodAssessment) -> tuple[str, ...]:
    """Return remarks about the validity of the numbers."""
    continuous, ate = assessment.continuous, assessment.ate
    statements = list(continuous.statements)
    if continuous.model in WITHOUT_UNCERTAINTY:
        statements.append(
            f"model {continuous.model} ignores the uncertainty of the groundtruth between "
            "samples, so its likelihoods are too low there"
        )
    scores = assessment.gauge_scores
    if scores is not None and scores.sim3 is None:
        statements.append(f"no likelihood in gauge sim3: {scores.why_no_sim3}")
    if ate.supported_m is None:
        statements.append(
            "no ATE of supported poses: the uncertainty of the groundtruth is larger than the "
            "errors everywhere"
        )
    elif ate.interval_m is None:
        statements.append(
            "no interval for the ATE of supported poses: too few of them are a groundtruth step "
            "apart"
        )
    if ate.supported_m is not None and not ate.supported.all():
        statements.append(
            f"at {100.0 * (1.0 - ate.supported_share):.1f} % of the poses the uncertainty of the "
            "groundtruth is larger than the errors; the ATE includes the error of the "
            "groundtruth there"
        )
    times = continuous.samples.seconds(assessment.stamps)
    sample_times = continuous.samples.times
    samples = np.count_nonzero((sample_times >= times.min()) & (sample_times <= times.max()))
    per_sample = len(times) / max(int(samples), 1)
    if per_sample > _POSES_PER_SAMPLE:
        statements.append(
            f"{per_sample:.1f} poses per groundtruth sample share its error, but count as "
            "independent; compare likelihoods only between estimates with the same timestamps"
        )
    return (*statements, *assessment.error.statements)
