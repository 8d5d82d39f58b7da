"""Alignment weighted by position covariances.

A pair has the weight 1 / (tr Sigma / 3 + e^2 / 3). The weights include the size e of the errors,
which depends on the alignment. Therefore weights and alignment are computed alternately.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.alignment import Alignment, align

_ROUNDS = 2
_MOST_ROUNDS = 20
_SETTLED = 1e-3
_AT_REST = 1e-12


def position_weights(covariances: Floats, error_m: float) -> Floats:
    """Return the weights of states, (N,), 1/m^2: 1 / (tr Sigma / 3 + e^2 / 3).

    This is the inverse mean variance of an axis. The size e of the errors is a floor, so that an
    overconfident state does not dominate the alignment.

    Args:
        covariances: (N, 3, 3) of positions or (N, 6, 6) of poses, position first, m^2; (N, 2, 2)
            for positions in a plane.
        error_m: RMSE of the positions, metres.
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
    """Align with weights from the estimate's covariances, starting from equal weights.

    Args:
        gauge: Group of the alignment.
        groundtruth: (N, 3), metres.
        estimate: (N, 3), in units of the estimate.
        covariances: (N, 3, 3) or (N, 6, 6) of the estimate, in squared units of the estimate.
        orientations: As for `align`.
        align_with: As for `align`.

    Raises:
        DegenerateGeometryError: As for `align`.
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
    """Align with weights from the groundtruth's covariances, iterated to convergence.

    The size e of the estimate's own errors is the part of the residuals that the covariances do
    not explain: e^2 = max(0, mean |r|^2 - mean tr Sigma).

    Args:
        gauge: Group of the alignment.
        groundtruth: (N, 3), metres.
        estimate: (N, 3), in units of the estimate.
        covariances: (N, k, k) of the groundtruth's positions along k axes, m^2.
        orientations: As for `align`.
        align_with: As for `align`.

    Raises:
        DegenerateGeometryError: As for `align`.
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

    Args:
        gauge: Group of the alignment; None if the estimate is aligned already.
        groundtruth: (N, 3), metres.
        estimate: (N, 3), in units of the estimate.
        covariances: (N, 3, 3) of the groundtruth, m^2.
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
