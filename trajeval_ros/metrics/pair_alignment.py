"""The alignment of paired states by all settings of a protocol, weights included.

With weights by position covariances Sigma, a pair has the weight 1 / (tr Sigma / 3 + e^2 / 3). The
weights include the size e of the errors, which depends on the alignment. Therefore weights and
alignment are computed alternately.
"""

from __future__ import annotations

import math

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError, InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.alignment import Alignment, align, align_first
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.protocol import GROUNDTRUTH_WEIGHTS, Protocol


def align_pairs(pairs: Association, protocol: Protocol) -> Alignment:
    """Return the alignment by all pairs or by the first ones (tutorial, Table I).

    With `apply="scale"` only its scale is kept.
    """
    alignment = _alignment_of(pairs, protocol)
    if protocol.apply == "scale":
        return alignment.scale_alone
    if alignment.states_used < len(pairs) and _is_open(alignment):
        p, q = pairs.groundtruth.positions, pairs.estimate.positions
        if not _is_open(align(protocol.gauge, p, q)):
            raise DegenerateGeometryError(
                f"the first {alignment.states_used} states do not determine the rotation of the "
                "later ones, because they are on a line or do not move; align by more states, or "
                "by the first one alone (align states 1)"
            )
    return alignment


def _is_open(alignment: Alignment) -> bool:
    """Return whether a rotation of the alignment is undetermined up to rounding."""
    return alignment.freedom is not None and math.isinf(alignment.freedom.std_deg)


def _alignment_of(pairs: Association, protocol: Protocol) -> Alignment:
    groundtruth, estimate = pairs.groundtruth, pairs.estimate
    if protocol.align_states == 1:
        return align_first(
            protocol.gauge,
            groundtruth.positions[0],
            None if groundtruth.quaternions is None else groundtruth.quaternions[0],
            estimate.positions[0],
            None if estimate.quaternions is None else estimate.quaternions[0],
        )
    first, way = slice(protocol.align_states), protocol.align_with
    p, q = groundtruth.positions[first], estimate.positions[first]
    orientations = None
    if groundtruth.quaternions is not None and estimate.quaternions is not None:
        orientations = groundtruth.quaternions[first], estimate.quaternions[first]
    elif way == "poses":
        raise InputError(
            "align with poses needs orientations on both sides, and one side has none; use "
            "align with positions"
        )
    if protocol.align_weights == "covariance":
        covariances = _known_covariances(estimate, "the estimate")[first]
        return align_weighted(protocol.gauge, p, q, covariances, orientations, way)
    if protocol.align_weights == GROUNDTRUTH_WEIGHTS:
        axes = slice(2 if protocol.gauge is Gauge.PLANAR else 3)
        covariances = _known_covariances(groundtruth, "the groundtruth")[first, axes, axes]
        return align_by_groundtruth(protocol.gauge, p, q, covariances, orientations, way)
    return align(protocol.gauge, p, q, orientations=orientations, align_with=way)


def _known_covariances(side: Trajectory, who: str) -> Floats:
    """Return the covariances of a trajectory, all of which must have a position."""
    covariances = side.covariances
    if covariances is not None:
        variances = np.diagonal(covariances[:, :3, :3], axis1=1, axis2=2)
        if (np.isfinite(variances) & (variances > 0.0)).all():
            return covariances
    raise InputError(
        f"{side.name or who} has pairs without a position covariance, which the weighting of the "
        "alignment needs; use alignment weighting none"
    )


_ROUNDS = 2
_MOST_ROUNDS = 20
_SETTLED = 1e-3
_AT_REST = 1e-12


def position_weights(covariances: Floats, error_m: float) -> Floats:
    """Return the weights of states, (N,), 1/m^2: 1 / (tr Sigma / 3 + e^2 / 3).

    This is the inverse mean variance of an axis. The size e of the errors (`error_m`, the RMSE) is
    a floor, so that an overconfident state does not dominate the alignment. Covariances are (N, 3,
    3) of positions, (N, 6, 6) of poses, or (N, 2, 2) in a plane, m^2.
    """
    variance = np.trace(covariances[:, :3, :3], axis1=1, axis2=2) / 3.0
    weights: Floats = 1.0 / (variance + error_m**2 / 3.0)
    return weights


def align_weighted(
    gauge: Gauge,
    groundtruth: Floats,
    estimate: Floats,
    covariances: Floats,
    orientations: tuple[Floats, Floats] | None,
    align_with: str,
) -> Alignment:
    """Align as `align` with weights from the estimate's covariances, starting from equal weights.

    Covariances are (N, 3, 3) or (N, 6, 6), in squared units of the estimate.
    """
    alignment = align(
        gauge, groundtruth, estimate, orientations=orientations, align_with=align_with
    )
    for _ in range(_ROUNDS):
        moved = alignment.similarity.positions(estimate)
        error = float(np.sqrt(np.mean(np.sum(np.square(groundtruth - moved), axis=1))))
        in_metres = alignment.similarity.scale**2 * covariances
        weights = position_weights(in_metres, error)
        alignment = align(
            gauge, groundtruth, estimate, weights, orientations, align_with=align_with
        )
    return alignment


def align_by_groundtruth(
    gauge: Gauge,
    groundtruth: Floats,
    estimate: Floats,
    covariances: Floats,
    orientations: tuple[Floats, Floats] | None,
    align_with: str,
) -> Alignment:
    """Align as `align` with weights from the groundtruth's covariances, iterated to convergence.

    The size e of the estimate's own errors is the part of the residuals that the covariances (N,
    k, k), m^2, along k axes do not explain: e^2 = max(0, mean |r|^2 - mean tr Sigma).
    """
    traces = np.trace(covariances, axis1=1, axis2=2)
    weights, before = None, np.inf
    for _ in range(_MOST_ROUNDS):
        alignment = align(
            gauge, groundtruth, estimate, weights, orientations, align_with=align_with
        )
        errors = groundtruth - alignment.similarity.positions(estimate)
        square = max(0.0, float(np.mean(np.square(errors).sum(axis=1) - traces)))
        if abs(square - before) <= _AT_REST * max(1.0, square):
            break
        before, weights = square, position_weights(covariances, float(np.sqrt(square)))
    return alignment


def weighted_errors(
    gauge: Gauge | None, groundtruth: Floats, estimate: Floats, covariances: Floats
) -> tuple[Floats, float]:
    """Return errors (N, 3) after a weighted alignment and their weighted RMSE, both in metres.

    Covariances (N, 3, 3) are the groundtruth's, m^2. Without a gauge the estimate is aligned
    already.
    """
    weights = np.ones(len(estimate))
    aligned, rmse = estimate, np.inf
    for _ in range(_MOST_ROUNDS):
        if gauge is not None:
            similarity = align(gauge, groundtruth, estimate, weights).similarity
            aligned = similarity.positions(estimate)
        errors = aligned - groundtruth
        before, rmse = rmse, _rmse(errors, weights)
        if abs(before - rmse) <= _SETTLED * rmse:
            break
        weights = position_weights(covariances, rmse)
    return errors, rmse


def _rmse(errors: Floats, weights: Floats) -> float:
    return float(np.sqrt(weights @ np.square(errors).sum(axis=1) / weights.sum()))
