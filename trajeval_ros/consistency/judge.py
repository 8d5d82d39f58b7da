"""Consistency test of an evaluated estimate."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.consistency.judgement import Aligned, judge_joint, judge_marginals
from trajeval_ros.consistency.result import Consistency
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.marker import at_arms
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.evaluation import Evaluation


def judge(evaluation: Evaluation, request: CovarianceRequest) -> Consistency:
    """Test whether the errors of an evaluation fit the estimate's covariances.

    Covariances are of the estimate at its own timestamps. The time offset is therefore subtracted.
    Covariances about the body's axes are converted to the world's. If a lever arm or another up
    axis is applied to the estimate, call `CovarianceRequest.about_world` before, as `run` does.

    Args:
        evaluation: Paired states, with covariances of the estimate for source `message`.
        request: Source of the covariances, not `none`.

    Raises:
        InputError: The covariances are unknown, or belong to other poses.
        SettingsError: Covariances cannot be transformed to the gauge of the alignment.
        DegenerateGeometryError: The states do not determine the alignment.

    Example:
        >>> import numpy as np
        >>> from dataclasses import replace
        >>> from trajeval_ros import CovarianceRequest, Protocol, evaluate, judge, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> block = np.diag([0.1**2] * 3 + [0.01**2] * 3)
        >>> blocks = np.broadcast_to(block, (len(flight.estimate), 6, 6))
        >>> estimate = replace(flight.estimate, covariances=blocks)
        >>> found = evaluate(flight.groundtruth, estimate, Protocol(gauge="yaw"))
        >>> request = CovarianceRequest("message", groundtruth_noise=(0.002, 0.1))
        >>> consistency = judge(found, request)
        >>> consistency.exactness, consistency.nees.shape == (len(found.association),)
        ('bound', True)
    """
    as_published = evaluation.protocol.nees_form == "as_published"
    if as_published and request.joint is not None:
        raise SettingsError(
            "NEES form as_published (protocol ov_eval) needs covariances of single poses; use "
            "--covariance message, or another protocol for a joint covariance"
        )
    aligned = _aligned(evaluation, request)
    if request.joint is not None:
        try:
            return judge_joint(aligned, request.joint, request.name.rpartition("/")[2])
        except InputError as error:
            raise InputError(f"{request.name}: {error}") from error
    at_start = evaluation.association.from_the_start
    return judge_marginals(aligned, from_the_start=at_start, as_published=as_published)


def _aligned(evaluation: Evaluation, request: CovarianceRequest) -> Aligned:
    """Return the aligned states of an evaluation at the estimate's own timestamps."""
    protocol, pairs = evaluation.protocol, evaluation.association
    if protocol.align_weights != "none":
        raise SettingsError(
            "the consistency test needs an alignment with equal weights; use align weights none"
        )
    if protocol.align_with != "positions":
        raise SettingsError(
            "the consistency test needs an alignment by positions; use align with positions"
        )
    if evaluation.alignment.untrustworthy:
        why = evaluation.alignment.untrustworthy
        raise InputError(f"no covariance can be transformed to this gauge: {why}")
    offset = round(protocol.association.time_offset_s * NANOSECONDS)
    estimate = dataclasses.replace(pairs.estimate, stamps=pairs.estimate.stamps - offset)
    estimate = request.about_world(estimate)
    return Aligned(
        groundtruth=pairs.groundtruth,
        estimate=estimate,
        similarity=evaluation.alignment.similarity,
        gauge=protocol.gauge,
        states=protocol.align_states,
        noise=_noise(pairs.groundtruth, request),
    )


def _noise(groundtruth: Trajectory, request: CovarianceRequest) -> Floats | None:
    """Return covariances (N, 6, 6) of the groundtruth's errors; None if it has none.

    Groundtruth of the body is p_M - R l if that of its marker is p_M: errors of the rotation move
    it by s_R^2 (|l|^2 I - a a'), a = R l, and are correlated with that.
    """
    if request.groundtruth_noise is None:
        return None
    position_m, rotation_deg = request.groundtruth_noise
    variances = np.square([position_m] * 3 + [math.radians(rotation_deg)] * 3)
    noise: Floats = np.broadcast_to(np.diag(variances), (len(groundtruth), 6, 6))
    if request.marker_lever_m is None or groundtruth.quaternions is None:
        return noise
    arms = lie.rotate(groundtruth.quaternions, np.array(request.marker_lever_m))
    return at_arms(noise, -arms)
