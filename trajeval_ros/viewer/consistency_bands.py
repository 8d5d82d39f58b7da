"""Consistency of an estimate: errors with their bands, NEES, and ellipsoids."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajeval_ros.consistency.consistency_result import Consistency
from trajeval_ros.geometry.arrays import Floats, extents
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.statistics import round_below
from trajeval_ros.viewer import appearance, entity_data, scene_entities
from trajeval_ros.viewer.paths import peaks, spread

_MOST_ROWS = 5000  # of a band
_ELLIPSOIDS = 24
# Ellipsoids are enlarged until the largest is this share of the flight.
_LARGEST = 0.15
_UNITS = np.repeat([1.0, 180.0 / np.pi], 3)


def send_consistency(
    recording: Any,
    evaluation: Evaluation,
    consistency: Consistency,
    entities: scene_entities.EstimateEntities,
    origin: Floats,
) -> float:
    """Draw errors with bands of three standard deviations, NEES with its limit, and ellipsoids.

    The origin (3,), metres, is subtracted from the groundtruth's coordinates. Returns the factor
    by which the ellipsoids are enlarged.
    """
    appearance.declare_consistency(recording, entities)
    assert consistency.sigmas is not None
    assert consistency.nees is not None
    assert consistency.per_pose is not None
    stamps = evaluation.association.estimate.stamps
    some = spread(len(stamps), _MOST_ROWS)
    errors, limits = consistency.errors[some], scene_entities.SIGMAS * consistency.sigmas[some]
    for axis, quantity in enumerate(scene_entities.ERRORS_WITHIN):
        bands = _UNITS[axis] * np.stack(
            [errors[:, axis], limits[:, axis], -limits[:, axis]], axis=1
        )
        numbers = entity_data.numbers(bands.ravel())
        numbers.send(recording, entities.metric(quantity), stamps[some], np.full(len(some), 3))
    known = np.flatnonzero(np.isfinite(consistency.nees))
    some = known[peaks(consistency.nees[known], _MOST_ROWS)]
    drawn = [(scene_entities.NEES, some, consistency.nees[some])]
    limit = consistency.per_pose.limit_95
    if limit is not None:
        drawn.append((scene_entities.NEES_LIMIT, known[[0, -1]], np.full(2, limit)))
    for quantity, at, values in drawn:
        entity_data.numbers(values).send(recording, entities.metric(quantity), stamps[at])
    assert consistency.covariances is not None
    positions = consistency.covariances[:, :3, :3]
    return _send_ellipsoids(recording, entities.uncertainty, evaluation, positions, origin)


def _send_ellipsoids(
    recording: Any, entity: str, evaluation: Evaluation, covariances: Floats, origin: Floats
) -> float:
    """Draw ellipsoids evenly along the path, in the gauge of the alignment, like the errors."""
    groundtruth, aligned = evaluation.association.groundtruth, evaluation.aligned
    along = groundtruth.travelled
    evenly = np.searchsorted(along, np.linspace(0.0, along[-1], _ELLIPSOIDS))
    rows = np.unique(np.minimum(evenly, len(along) - 1))
    half_axes, _ = entity_data.ellipsoid_axes(covariances[rows])
    extent = float(extents(groundtruth.positions).max())
    largest = max(2.0 * float(half_axes.max()), 1e-12)
    factor = max(1.0, round_below(_LARGEST * extent / largest))
    ellipsoids = entity_data.ellipsoids(
        aligned.positions[rows] - origin, covariances[rows], factor
    )
    stamps = evaluation.association.estimate.stamps[rows]
    ellipsoids.send(recording, entity, stamps)
    return factor
