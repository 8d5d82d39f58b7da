"""Where the groundtruth quality check's fit starts, and the steps of its IMU, in cases by hand."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from examined_rigs import START_NS, rig
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration.groundtruth_quality import start
from trajeval_ros.calibration.groundtruth_quality.inertial_steps import (
    ImuSeconds,
    InertialSteps,
    turns_about_one_axis,
)
from trajeval_ros.calibration.groundtruth_quality.sample_rows import TruthSamples


def test_steps_of_an_imu_that_are_doubtful() -> None:
    seconds = np.array([0.0, 0.01, 0.0599, 0.11, 0.12, 0.13, 0.14, 0.15, 0.16])
    generator = np.random.default_rng(0)
    rates, forces = generator.uniform(0.1, 0.9, size=(2, 9, 3))
    imu = ImuSeconds(seconds, rates, forces)
    assert np.flatnonzero(imu.gaps).tolist() == [2]  # 50.1 ms
    assert not imu.saturated.any()
    rates[3:6, 1] = -1.0  # three readings at the extreme may be chance
    assert not imu.saturated.any()
    rates[6, 1] = 1.0
    assert np.flatnonzero(imu.saturated).tolist() == [2, 3, 4, 5, 6]
    # Zeros are no saturation.
    still = ImuSeconds(seconds, np.zeros((9, 3)), forces)
    assert not still.saturated.any()
    steps = InertialSteps(np.array([0.005, 0.05, 0.155]), ImuSeconds(seconds, rates * 0, forces))
    assert steps.doubtful.tolist() == [False, True]
    covariances, _ = steps.uncertainty(np.zeros(3), rig_noise())
    quiet = InertialSteps(np.array([0.005, 0.05]), ImuSeconds(seconds, rates * 0, forces))
    sure, _ = quiet.uncertainty(np.zeros(3), rig_noise())
    np.testing.assert_allclose(covariances[0], sure[0], rtol=1e-12)
    assert covariances[1, 0, 0] > 1e3 * sure[0, 0, 0]


def rig_noise() -> Any:
    from trajeval_ros.geometry.inertial import ImuNoise

    return ImuNoise(1e-3, 1e-2)


def test_steps_between_knots_are_means_of_interpolated_readings() -> None:
    seconds = np.array([0.0, 1.0, 2.0, 3.0])
    rates = np.outer([0.0, 1.0, 4.0, 5.0], [1.0, 0.0, -1.0])
    forces = np.outer([2.0, 0.0, 1.0, 1.0], [0.0, 1.0, 0.0])
    steps = InertialSteps(np.array([0.5, 2.5, 3.0]), ImuSeconds(seconds, rates, forces))
    np.testing.assert_allclose(steps.times, [0.5, 1.0, 2.0, 2.5, 3.0])
    assert steps.first.tolist() == [0, 3, 4]
    np.testing.assert_allclose(steps.durations_s, [2.0, 0.5])
    np.testing.assert_allclose(steps.held, [[0.5, 1.0, 0.5], [0.5, 0.0, 0.0]])
    np.testing.assert_allclose(steps.starts, [[0.0, 0.5, 1.5, 2.0], [0.0, 0.5, 0.5, 0.5]])
    np.testing.assert_allclose(steps.rates[0, :, 0], [0.75, 2.5, 4.25])
    assert steps.rates[1, 0, 2] == pytest.approx(-4.75)
    np.testing.assert_allclose(steps.accelerations[0, :, 1], [0.5, 0.5, 1.0])


def test_knots_are_a_tenth_of_a_second_inside_both() -> None:
    own = np.arange(0.0, 2.0, 0.01)
    samples = TruthSamples(own, np.zeros((200, 3)), np.zeros((200, 4)), True)
    imu = ImuSeconds(0.5 + own, np.zeros((200, 3)), np.zeros((200, 3)))
    knots = start.knots_of(samples, imu, 0.25)
    np.testing.assert_allclose(knots, [0.6, 0.85, 1.1, 1.35, 1.6, 1.85])
    assert samples.middle_s == pytest.approx(0.995)


def test_the_first_rig_is_near_the_true_one() -> None:
    made = rig(3, turn_deg=(20.0, -10.0, 5.0), noise=(1e-6, 1e-6))
    truth, readings = made.groundtruth, made.readings
    assert truth.quaternions is not None
    assert readings.accelerations is not None
    own = (truth.stamps - START_NS) / 1e9
    samples = TruthSamples(own, truth.positions, truth.quaternions, True)
    imu = ImuSeconds((readings.stamps - START_NS) / 1e9, readings.rates, readings.accelerations)
    knots = start.knots_of(samples, imu, 0.1)
    result = start.first_rig(samples, imu, knots)
    body = Rotation.from_euler("xyz", [0, 0, 0]) * Rotation.from_rotvec([20, -10, 5], degrees=True)
    apart = (body.inv() * Rotation.from_matrix(result.body)).magnitude()
    assert np.degrees(apart) < 0.2
    rotated = made.motion.rotations(knots).inv() * Rotation.from_matrix(result.rotations)
    assert np.degrees(rotated.magnitude().max()) < 0.5
    np.testing.assert_allclose(result.positions, made.motion.positions(knots), atol=1e-3)
    # Of differences over 0.2 s, the error is a sixth of the third derivative times 0.01 s^2.
    jerk = np.abs(made.motion.positions(knots, 3)).max()
    error = np.abs(result.velocities - made.motion.positions(knots, 1)).max()
    assert error < 0.01 * jerk / 6.0 + 2e-5
    assert np.linalg.norm(result.gravity) == pytest.approx(9.81)
    assert result.gravity[2] < -9.7
    # The gyroscope's bias is drawn with 0.01 rad/s, and its noise averages out.
    generator = np.random.default_rng([3, 38])
    generator.uniform(size=(5, 6)), generator.uniform(size=(5, 6)), generator.uniform(size=(5, 6))
    bias = generator.normal(0.0, 0.01, 3)
    np.testing.assert_allclose(result.biases[0, :3], bias, atol=1.5e-3)
    assert not result.biases[:, 3:].any()
    same = start.first_rig(dataclasses.replace(samples, has_rotations=False), imu, knots)
    np.testing.assert_array_equal(same.body, np.eye(3))
    assert not same.biases.any()


@pytest.mark.parametrize("turn_deg", [0.0, 100.0])
def test_the_first_rig_of_a_car_is_turned_by_its_accelerations(turn_deg: float) -> None:
    """Turns about the vertical alone do not determine the body's rotation about it."""
    made = rig(2, "car", duration_s=60.0, turn_deg=(0.0, 0.0, turn_deg))
    case = start.prepared(made.groundtruth, made.readings, 0.0)
    assert turns_about_one_axis(case.imu.rates)
    result = start.first_rig(case.samples, case.imu, start.knots_of(case.samples, case.imu, 0.1))
    body = Rotation.from_rotvec([0.0, 0.0, turn_deg], degrees=True)
    apart = (body.inv() * Rotation.from_matrix(result.body)).magnitude()
    # Accelerations give it up to the drift of the gyroscope within five seconds: its bias is
    # drawn with 0.01 rad/s.
    assert np.degrees(apart) < 5.0


def test_noise_of_a_rig_at_rest_is_no_other_unit() -> None:
    made = rig(1, "rest", noise=(0.2, 2e-3))
    case = start.prepared(made.groundtruth, made.readings, 0.0)
    assert len(case.samples.seconds) == len(made.groundtruth)


def test_rough_orientations_are_found_from_positions() -> None:
    made = rig(5, noise=(1e-5, 1e-5))
    readings, truth = made.readings, made.groundtruth
    imu = start.imu_of(readings)
    own = (truth.stamps - START_NS) / 1e9
    result = start.rough_orientations(own, truth.positions, imu)
    apart = made.motion.rotations(own).inv() * Rotation.from_quat(result)
    # Good enough for a start: the gyroscope's drift within windows of 5 s is about 3 deg.
    assert np.degrees(np.median(apart.magnitude())) < 6.0
    guess = start.guess_of(truth, imu)
    assert guess.signal == "angular rate"
    assert guess.offset_s == pytest.approx(0.0, abs=5e-3)
    late = dataclasses.replace(truth, stamps=truth.stamps - 700_000_000)
    assert start.guess_of(late, imu).offset_s == pytest.approx(0.7, abs=5e-3)
    bare = dataclasses.replace(late, quaternions=None)
    swings = start.guess_of(bare, imu)
    assert swings.signal == "speed"
    assert swings.offset_s == pytest.approx(0.7, abs=0.02)
    far = dataclasses.replace(truth, stamps=truth.stamps - 700 * 10**9)
    assert start.guess_of(far, imu).offset_s == pytest.approx(700.0, abs=5e-3)
