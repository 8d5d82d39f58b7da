"""Protection levels of equal covariances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from trajeval_ros.consistency.consistency_result import Consistency, PoseNees
from trajeval_ros.consistency.covariance_request import IntegrityRequest, constant_covariances
from trajeval_ros.consistency.integrity import integrity_of
from trajeval_ros.geometry.gauge import Gauge

RISK, LIMIT_M, LIMIT_DEG = 0.05, 2.0, 3.0
# Magnitudes of errors and protection levels of poses that follow each other, and their areas.
POSES = [
    (0.5, 1.0, "nominal"),
    (1.0, 1.0, "nominal"),
    (0.5, 2.5, "unavailable"),
    (1.5, 1.0, "misleading"),
    (2.0, 1.0, "misleading"),
    (2.1, 1.0, "hazardous"),
    (0.5, 2.0, "nominal"),
    (3.0, 2.0, "hazardous"),
    (4.0, 3.0, "misleading_unavailable"),
    (0.0, 1.0, "nominal"),
]
ERRORS, LEVELS = (np.array([pose[column] for pose in POSES], float) for column in (0, 1))


@pytest.mark.parametrize(("count", "named"), [(10, False), (11, True)])
def test_eleven_equal_covariances_are_a_constant(count: int, named: bool) -> None:
    covariances = np.tile(np.diag([1.0, 2.0, 6.0, 0.1, 0.2, 0.3]), (count, 1, 1))
    covariances[0] *= 5.0  # the first one may be a prior
    text = constant_covariances(covariances)
    assert bool(text) == named
    assert not named or "all are equal (3 m^2, 0.2 rad^2)" in text
    for row in (2, count - 1):
        other = covariances.copy()
        other[row, 4, 4] += 1e-9
        assert not constant_covariances(other)


def _consistency(part: slice, unit: float) -> Consistency:
    """Return errors and covariances of one part, with the levels of `POSES` at this risk."""
    count, size = len(POSES), part.stop - part.start
    errors, covariances = np.zeros((count, 6)), np.zeros((count, 6, 6))
    errors[:, part.start] = ERRORS * unit
    # A little more than the level: at the level itself, rounding would decide.
    variances = (LEVELS * (1.0 + 1e-9) * unit) ** 2 / chi2.isf(RISK, size)
    for axis in range(part.start, part.stop):
        covariances[:, axis, axis] = variances
    nees = PoseNees(np.ones(count), np.ones(count), np.ones(count))
    return Consistency(
        Gauge.YAW, "message", "bound", "", "undecided", None, None, nees, errors, covariances
    )


SECOND = 10**9


STAMPS = np.arange(len(POSES), dtype=np.int64) * SECOND


def test_the_heading_has_a_limit_of_its_own_or_no_part() -> None:
    made = _consistency(slice(5, 6), np.pi / 180.0)
    request = IntegrityRequest(LIMIT_M, LIMIT_DEG, RISK)
    [heading] = integrity_of(made, request, STAMPS).parts
    assert heading.alert_limit == LIMIT_DEG
    assert integrity_of(made, IntegrityRequest(LIMIT_M, None, RISK), STAMPS).parts == ()
