"""Areas, episodes and times to an alert, counted by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from trajeval_ros.consistency.consistency_result import Consistency, PoseNees
from trajeval_ros.consistency.constant_covariances import constant_covariances
from trajeval_ros.consistency.covariance_request import IntegrityRequest
from trajeval_ros.consistency.integrity import effective_number, integrity_of, share_interval
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.gauge import Gauge

SECOND = 10**9
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
STAMPS = np.arange(len(POSES), dtype=np.int64) * SECOND


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


@pytest.mark.parametrize(
    ("name", "part", "unit"),
    [
        ("horizontal", slice(0, 2), 1.0),
        ("vertical", slice(2, 3), 1.0),
        ("heading", slice(5, 6), np.pi / 180.0),
    ],
)
def test_areas_and_episodes_are_counted(name: str, part: slice, unit: float) -> None:
    limit = LIMIT_M * (1.0 + 1e-6)  # so that a level of 2 is within it
    request = IntegrityRequest(limit, limit, RISK)
    [found] = integrity_of(_consistency(part, unit), request, STAMPS).parts
    assert (found.part, found.unit) == (name, "deg" if name == "heading" else "m")
    assert found.alert_limit == limit
    np.testing.assert_allclose(found.errors, ERRORS, rtol=1e-12)
    np.testing.assert_allclose(found.levels, LEVELS, rtol=1e-8)
    areas = [pose[2] for pose in POSES]
    assert found.areas == {area: areas.count(area) / 10.0 for area in found.areas}
    assert found.episodes == {
        "nominal": 3,
        "unavailable": 1,
        "misleading": 1,
        "hazardous": 2,
        "misleading_unavailable": 1,
    }
    assert found.availability == 8 / 10
    assert found.bounded == 5 / 10
    assert found.effective == effective_number(found.errors / found.levels)
    assert found.hazardous_95 == share_interval(0.2, found.effective)
    assert found.inflation == pytest.approx(np.quantile(ERRORS / LEVELS, 0.999), rel=1e-8)
    # Errors beyond the limit from 5 s to 5 s, and from 7 s to 8 s; levels at 2 s, and at 8 s.
    assert (found.time_to_alert.seconds, found.time_to_alert.missed) == ((1.0,), 1)
    assert found.time_to_alert.median == found.time_to_alert.worst == 1.0


def test_the_heading_has_a_limit_of_its_own_or_no_part() -> None:
    made = _consistency(slice(5, 6), np.pi / 180.0)
    request = IntegrityRequest(LIMIT_M, LIMIT_DEG, RISK)
    [heading] = integrity_of(made, request, STAMPS).parts
    assert heading.alert_limit == LIMIT_DEG
    assert integrity_of(made, IntegrityRequest(LIMIT_M, None, RISK), STAMPS).parts == ()


def test_poses_that_the_alignment_makes_exact_are_left_out() -> None:
    made = _consistency(slice(0, 2), 1.0)
    nees = np.where(np.arange(len(POSES)) < 2, np.nan, 1.0)
    made = dataclasses.replace(made, pose_nees=PoseNees(nees, nees, nees))
    [found] = integrity_of(made, IntegrityRequest(LIMIT_M, None, RISK), STAMPS).parts
    np.testing.assert_allclose(found.errors, ERRORS[2:], rtol=1e-12)


def test_without_covariances_of_poses_there_is_no_integrity() -> None:
    made = dataclasses.replace(_consistency(slice(0, 2), 1.0), covariances=None)
    with pytest.raises(InputError, match="use --covariance message, or a shorter run"):
        integrity_of(made, IntegrityRequest(LIMIT_M, None, RISK), STAMPS)


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
