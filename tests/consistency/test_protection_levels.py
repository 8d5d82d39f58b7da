"""Protection levels of equal covariances."""

from __future__ import annotations

import numpy as np
import pytest

from trajeval_ros.consistency.constant_covariances import constant_covariances

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
    said = constant_covariances(covariances)
    assert bool(said) == named
    assert not named or "all are equal (3 m^2, 0.2 rad^2)" in said
    for row in (2, count - 1):
        other = covariances.copy()
        other[row, 4, 4] += 1e-9
        assert not constant_covariances(other)
