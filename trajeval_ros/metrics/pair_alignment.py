"""The alignment of paired states by all settings of a protocol."""

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
from trajeval_ros.metrics.weighted_alignment import align_by_groundtruth, align_weighted


def align_pairs(pairs: Association, protocol: Protocol) -> Alignment:
    """Return the alignment by all pairs or by the first ones (tutorial, Table I).

    With `apply="scale"` only its scale is kept.

    Raises:
        InputError: The pairs lack orientations or covariances that the protocol needs.
        DegenerateGeometryError: Too few states, or no motion, for the gauge; or first states on
            an exact line, about which later states could have any rotation.
    """
    alignment = _alignment_of(pairs, protocol)
    if protocol.apply == "scale":
        return alignment.scale_alone
    if alignment.states_used < len(pairs) and _is_open(alignment):
        p, q = pairs.groundtruth.positions, pairs.estimate.positions
        if not _is_open(align(protocol.gauge, p, q)):
            raise DegenerateGeometryError(
                f"the first {alignment.states_used} states do not determine the rotation of the "
                "later ones, because they are on a line; align by more states, or by the first "
                "one alone (align states 1)"
            )
    return alignment


def _is_open(alignment: Alignment) -> bool:
    """Return whether a rotation of the alignment is undetermined up to rounding."""
    return alignment.freedom is not None and math.isinf(alignment.freedom.std_deg)


def _alignment_of(pairs: Association, protocol: Protocol) -> Alignment:
    truth, estimate = pairs.groundtruth, pairs.estimate
    if protocol.align_states == 1:
        return align_first(
            protocol.gauge,
            truth.positions[0],
            None if truth.quaternions is None else truth.quaternions[0],
            estimate.positions[0],
            None if estimate.quaternions is None else estimate.quaternions[0],
        )
    first, way = slice(protocol.align_states), protocol.align_with
    p, q = truth.positions[first], estimate.positions[first]
    orientations = None
    if truth.quaternions is not None and estimate.quaternions is not None:
        orientations = truth.quaternions[first], estimate.quaternions[first]
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
        covariances = _known_covariances(truth, "the groundtruth")[first, axes, axes]
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
