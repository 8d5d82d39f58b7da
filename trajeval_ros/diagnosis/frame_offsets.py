"""Test for a constant offset that causes nearly all of the error, without an alignment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.geometry.gauge import Gauge

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation

_NAME = "frame offset"
_FEWEST = 10
_LEAST_M = 0.5
_SHARE = 0.98  # of the squared error
# The geoid is up to 107 m from the ellipsoid.
_VERTICAL, _GEOID_M = 0.1, (5.0, 110.0)


def frame_offset(evaluation: Evaluation) -> Examined:
    """Compare the errors with their mean, if the gauge assumes equal frames."""
    if evaluation.protocol.gauge is not Gauge.NONE:
        return Examined(_NAME, why_not="the alignment removes an offset")
    truth = evaluation.association.groundtruth.positions
    apart = truth - evaluation.aligned.positions
    mean = apart.mean(axis=0)
    total = float(np.mean(np.sum(apart**2, axis=1)))
    share = float(mean @ mean) / total if total > 0.0 else 0.0
    length = float(np.linalg.norm(mean))
    scores = {"offset_m": length, "share": share}
    # Smaller offsets are errors of the estimate.
    if len(apart) < _FEWEST or length < _LEAST_M or share < _SHARE:
        return Examined(_NAME, scores)
    up = evaluation.groundtruth.up.matrix[2]
    height = abs(float(mean @ up))
    level = float(np.sqrt(max(length**2 - height**2, 0.0)))
    kind = ""
    if level < _VERTICAL * height and _GEOID_M[0] < height < _GEOID_M[1]:
        kind = ": probably heights above the ellipsoid and above the geoid"
    values: dict[str, Value] = {
        "offset": ", ".join(f"{each:.2f}" for each in mean),
        "offset_m": length,
        "percent": 100.0 * share,
        "kind": kind,
    }
    return Examined(_NAME, scores, (Seen("frames_apart", share, values),))
