"""A body rotation that one kind of rows contradicts isn't applied, and the reason is said."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from calibration_flights import Fault, fly
from scipy.spatial.transform import Rotation

from trajeval_ros import simulate
from trajeval_ros.calibration import significance
from trajeval_ros.calibration.apply import evaluate_calibrated
from trajeval_ros.calibration.calibrate import calibrate
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.calibration.increments import COLUMNS, Increments
from trajeval_ros.calibration.robust_fit import fit
from trajeval_ros.calibration.significance import chance_of
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.report.requested_lines import calibration_lines

AUTO = CalibrationRequest(offset=True, hand_eye=True)
YAW = dataclasses.replace(Protocol(), gauge=Gauge.YAW)


def mirrored(poses: Trajectory, axis: int) -> Trajectory:
    """Return what an estimator with one axis of world and body inverted would report."""
    assert poses.rotations is not None
    flip = np.diag(np.where(np.arange(3) == axis, -1.0, 1.0))
    rotated = Rotation.from_matrix(flip @ poses.rotations.as_matrix() @ flip)
    return dataclasses.replace(
        poses, positions=poses.positions @ flip, quaternions=rotated.as_quat()
    )


def jumping(poses: Trajectory, seed: int, deg: float) -> Trajectory:
    """Return poses whose attitude jumps every 4 s or so, by Student's t2; positions don't know."""
    assert poses.rotations is not None
    random = np.random.default_rng(seed)
    jumps = random.standard_t(2, (len(poses), 3)) * np.radians(deg)
    jumps *= (random.random(len(poses)) < 0.05 / 4.0)[:, None]
    rotated = Rotation.from_rotvec(np.cumsum(jumps, axis=0)) * poses.rotations
    return dataclasses.replace(poses, quaternions=rotated.as_quat())


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_marker_that_flips_is_judged(axis: int, seed: int) -> None:
    """Then only the body's rotation is observable, and the fit without it has no parameter."""
    flight = simulate(seed=seed, duration_s=40.0)
    groundtruth = flight.groundtruth
    assert groundtruth.rotations is not None
    flip = Rotation.from_rotvec(np.pi * np.eye(3)[axis])
    late = groundtruth.seconds > 18.0
    rotated = np.where(
        late[:, None], (groundtruth.rotations * flip).as_quat(), groundtruth.quaternions
    )
    flipping = dataclasses.replace(groundtruth, quaternions=rotated)
    result = calibrate(flipping, flight.estimate, "yaw")
    assert result.offset.reason
    assert result.rotation.reason


def test_a_fit_without_free_directions_stays_at_its_start() -> None:
    flight = simulate(seed=1, duration_s=40.0)
    increments = Increments(flight.groundtruth, flight.estimate)
    start = increments.start(0.01, with_scale=False, about_z=True)
    fitted = fit(increments, start, np.zeros((COLUMNS, 0)))
    assert fitted is not None
    assert fitted.settled
    assert fitted.free == 0
    assert fitted.unknowns.offset_s == start.offset_s
    np.testing.assert_array_equal(fitted.unknowns.rotation, start.rotation)
    np.testing.assert_array_equal(fitted.covariance, np.zeros((COLUMNS, COLUMNS)))
    expected = increments.linearise(start).residual
    np.testing.assert_array_equal(fitted.linearised.residual, expected)


@pytest.mark.slow
@pytest.mark.parametrize(
    "axis", [0, *(pytest.param(axis, marks=pytest.mark.slow) for axis in (1, 2))]
)
def test_nothing_is_applied_to_mirrored_axes(axis: int) -> None:
    truth, estimate = fly(axis, 60.0)
    result = evaluate_calibrated(truth, mirrored(estimate, axis), YAW, AUTO)
    assert result.calibration is not None
    rotation = result.calibration.rotation
    assert rotation.chance is not None
    assert rotation.chance < 1e-6  # by all rows together it would be there
    assert rotation.value is not None
    assert np.degrees(np.linalg.norm(rotation.value)) > 170.0
    assert rotation.status == "insignificant"
    assert rotation.reason == significance.POSITIONS_WORSE
    assert result.hand_eye is None
    assert not result.offset_applied
    assert result.after == result.before
    (line,) = (
        calibration_line
        for calibration_line in calibration_lines("", result)
        if "body rotation" in calibration_line
    )
    assert "not significant, not applied; it reduces the rotation error" in line


# Of the first 30 flights those in which the fit of all rows finds a rotation of 1 and of 5 deg.
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["road", "car"])
@pytest.mark.parametrize("seed", [7, 27])
def test_attitude_that_drifts_on_its_own_is_no_rotation_of_the_body(kind: str, seed: int) -> None:
    truth, estimate = fly(seed, 60.0, kind)
    rotation = calibrate(truth, jumping(estimate, seed, 0.5)).rotation
    assert rotation.chance is not None
    assert rotation.chance < 0.0027
    assert rotation.status == "insignificant"
    assert rotation.reason == significance.POSITIONS_ALONE


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["drone", "road"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_rotation_that_both_kinds_of_rows_show_is_kept(kind: str, seed: int) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    axis[:2] += np.sign(axis[:2])  # on a road, not about its only axis
    vector = np.radians(5.0) * axis / np.linalg.norm(axis)
    truth, estimate = fly(seed, 120.0, kind, Fault(rotation_vector=vector))
    rotation = calibrate(truth, estimate).rotation
    assert rotation.is_significant
    assert rotation.value is not None
    np.testing.assert_allclose(rotation.value, vector, atol=np.radians(1.0))


def test_chance_is_that_of_hotellings_test() -> None:
    """With one component it is Student's t, both sides; of normal values, uniform."""
    from scipy.stats import t

    assert chance_of(np.array([0.3]), np.array([[0.01]]), 12) == pytest.approx(2.0 * t.sf(3.0, 11))


def test_a_position_ate_that_grows_is_explained() -> None:
    truth, estimate = fly(1, 60.0, fault=Fault(offset_s=0.1))
    result = evaluate_calibrated(truth, estimate, YAW, AUTO)
    assert result.offset_applied
    assert result.before is not None
    smaller = dataclasses.replace(result.before, position_m=result.after.position_m / 1.04)
    grown = dataclasses.replace(result, before=smaller, lever_applied=False)
    assert "the position ATE increases by 4 %" in calibration_lines("", grown)[-1]
    assert "with the lever arm" not in calibration_lines("", grown)[-1]
    anyway = dataclasses.replace(result.after, position_m=0.9 * smaller.position_m)
    better = dataclasses.replace(grown, if_applied=anyway)
    assert f"it is {anyway.position_m:.4g} m" in calibration_lines("", better)[-1]
    for unchanged in (
        dataclasses.replace(grown, before=result.after),
        dataclasses.replace(grown, offset_applied=False, rotation_applied=False),
    ):
        assert "grows" not in "".join(calibration_lines("", unchanged))
