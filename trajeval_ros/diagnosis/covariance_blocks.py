"""Test for exchanged blocks or another unit of the covariances of the estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.statistics import median

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation

_NAME = "covariance blocks"
_FEWEST = 50
# Of decimal logarithms: least difference between the blocks, and largest of equal ones.
_APART, _SAME = 1.0, 0.25
_NEAR = 0.5
_DEGREES = float(np.log10(180.0 / np.pi))


def covariance_blocks(evaluation: Evaluation) -> Examined:
    """Compare errors with standard deviations, of positions and of rotations."""
    pairs, errors = evaluation.association, evaluation.absolute
    covariances = pairs.estimate.covariances
    if covariances is None or errors.rotation_deg is None or len(pairs) < _FEWEST:
        return Examined(_NAME, why_not="no covariances in use, or too few pairs")
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    usable = np.isfinite(variances).all(axis=1) & (variances > 0.0).all(axis=1)
    if np.count_nonzero(usable) < _FEWEST:
        return Examined(_NAME, why_not="the covariances are not positive")
    first, second = variances[usable, :3].sum(axis=1), variances[usable, 3:].sum(axis=1)
    position, rotation = errors.position_m[usable], np.radians(errors.rotation_deg[usable])
    as_read = _too_small(position, first), _too_small(rotation, second)
    exchanged = _too_small(position, second), _too_small(rotation, first)
    scores = {
        "position": as_read[0],
        "rotation": as_read[1],
        "position_if_exchanged": exchanged[0],
        "rotation_if_exchanged": exchanged[1],
    }
    if not min(*as_read, *exchanged) > 0.0:
        return Examined(_NAME, scores, why_not="the errors are zero")
    logs, others = np.log10(as_read), np.log10(exchanged)
    explained = float(1.0 - np.ptp(others) / max(float(np.ptp(logs)), 1e-9))
    if np.ptp(logs) > _APART and np.ptp(others) < _SAME and np.abs(others).max() < _NEAR:
        values: dict[str, Value] = {
            "as_read": as_read[0],
            "as_read_rotation": as_read[1],
            "exchanged": exchanged[0],
            "exchanged_rotation": exchanged[1],
        }
        return Examined(_NAME, scores, (Seen("covariance_order", explained, values),))
    if abs(logs[0]) < _SAME and abs(logs[1] + _DEGREES) < _SAME:
        seen = Seen("covariance_degrees", 1.0, {"times": 1.0 / as_read[1]})
        return Examined(_NAME, scores, (seen,))
    return Examined(_NAME, scores)


def _too_small(errors: Floats, variances: Floats) -> float:
    """Return the ratio of errors and standard deviations, median over N states of three axes."""
    return float(np.sqrt(median(errors**2 / variances)))
