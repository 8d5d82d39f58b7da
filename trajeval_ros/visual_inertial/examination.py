"""Tests of measured keyframes, to decide whether their errors can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.visual_inertial.covariance_tests import groundtruth_nees, split_half_nees
from trajeval_ros.visual_inertial.gauge_covariance import fixed_covariance
from trajeval_ros.visual_inertial.inertial_errors import BiasNoise
from trajeval_ros.visual_inertial.keyframe_selection import select
from trajeval_ros.visual_inertial.measured_scene import MeasuredScene
from trajeval_ros.visual_inertial.outliers import Rejection, reject_outliers
from trajeval_ros.visual_inertial.preintegration import ImuNoise
from trajeval_ros.visual_inertial.residual_groups import (
    ResidualGroup,
    residual_groups,
    track_correlation,
)
from trajeval_ros.visual_inertial.sensor_recording import SensorRecording
from trajeval_ros.visual_inertial.state import MOTION_WIDTH

LAGS = (1, 2, 5, 10)
# Assumed noise of groundtruth per axis, which is unknown: m, deg, m/s.
GROUNDTRUTH_NOISES = ((0.0, 0.0, 0.0), (1e-3, 0.1, 5e-3), (1e-3, 0.2, 5e-3), (2e-3, 0.3, 1e-2))
_SPLITS = 10
_GRAVITY_TOLERANCE, _TILT_TOLERANCE_DEG = 0.1, 2.0
_DRIFT_TOLERANCE_DEG_PER_S = 1.0


@dataclass(frozen=True, eq=False)
class MeasurementModel:
    """Settings of a recording's examination.

    Attributes:
        every: Number of images from one keyframe to the next.
        keyframes: Largest number of keyframes.
        pixel_noise: Standard deviation of a measured coordinate, pixels.
        imu_noise: Noise densities of the IMU.
        bias_noise: Prior of the biases, to estimate them; None to use groundtruth's biases.
        gravity: m/s^2.
        is_split: Whether to test the covariance by halves of the landmarks.
    """

    every: int
    keyframes: int
    pixel_noise: float
    imu_noise: ImuNoise
    bias_noise: BiasNoise | None
    gravity: float
    is_split: bool


@dataclass(frozen=True, eq=False)
class Examination:
    """Measured keyframes, with tests of their data and residuals.

    Attributes:
        scene: The problem for the gauge study.
        rejection: The measurements without outliers, and their solution.
        duration_s: From first to last keyframe.
        notes: What reader and selection joined, inserted or dropped.
        gravity: (3,) from groundtruth and IMU, m/s^2.
        drift_deg: Angle between groundtruth's and the gyroscope's rotation from the first to the
            last keyframe.
        groups: Chi-square by group of residuals.
        correlation: (lags,) of reprojection errors along tracks.
        nees: NEES of the poses over its degrees of freedom, for each of `GROUNDTRUTH_NOISES`.
        biases_sigma: (6,) standard deviations of the last keyframe's biases; (0,) where biases are
            known.
        split_half: (splits,), NEES of the differences of two halves, without groundtruth; None
            if not requested.
    """

    scene: MeasuredScene
    rejection: Rejection
    duration_s: float
    notes: tuple[str, ...]
    gravity: Floats
    drift_deg: float
    groups: list[ResidualGroup]
    correlation: Floats
    nees: list[float]
    biases_sigma: Floats
    split_half: Floats | None


def examine(recording: SensorRecording, model: MeasurementModel) -> Examination:
    """Select keyframes, reject outliers, and test data and residuals.

    Raises:
        InputError: The recording can't be used: no groundtruth at a keyframe, a gap in the IMU's
            samples, too few tracks, or gravity or a rotation that shows wrong biases, extrinsics
            or frames.
        DegenerateGeometryError: More than the gauge's four directions are undetermined.
    """
    gravity = np.array([0.0, 0.0, -model.gravity])
    whole = select(
        recording,
        model.every,
        model.keyframes,
        model.pixel_noise,
        model.imu_noise,
        gravity,
        model.bias_noise,
    )
    felt = whole.gravity_felt
    off = abs(float(np.linalg.norm(felt)) - model.gravity)
    tilt_deg = tilt_of(felt)
    if off > _GRAVITY_TOLERANCE or tilt_deg > _TILT_TOLERANCE_DEG:
        raise InputError(
            f"{recording.name}: gravity from groundtruth and IMU is {np.linalg.norm(felt):.3f} "
            f"m/s^2, {tilt_deg:.1f} deg from the vertical, expected {model.gravity:g} m/s^2; "
            "check the expected value, biases, extrinsics and frames"
        )
    duration_s = float(whole.preintegrated.durations_s.sum())
    drift_deg = whole.drift_against_gyroscope_deg
    if drift_deg > _DRIFT_TOLERANCE_DEG_PER_S * duration_s:
        raise InputError(
            f"{recording.name}: groundtruth and gyroscope differ by {drift_deg:.1f} deg after "
            f"{duration_s:.2f} s; check the gyroscope's biases, extrinsics and frames"
        )
    rejection = reject_outliers(whole)
    selection, state = rejection.selection, rejection.state
    scene = MeasuredScene.of(rejection)
    covariance = fixed_covariance(scene.problem, state)
    split_half = None
    if model.is_split:
        split_half = split_half_nees(selection, state, _SPLITS, np.random.default_rng(0))
    return Examination(
        scene=scene,
        rejection=rejection,
        duration_s=duration_s,
        notes=recording.notes + whole.notes,
        gravity=felt,
        drift_deg=drift_deg,
        groups=residual_groups(scene.problem, state),
        correlation=track_correlation(scene.problem, state, LAGS),
        nees=[
            groundtruth_nees(scene.truth, state, covariance, (p, float(np.radians(phi)), v))
            for p, phi, v in GROUNDTRUTH_NOISES
        ],
        biases_sigma=np.sqrt(np.diagonal(covariance)[-state.width :][MOTION_WIDTH:]),
        split_half=split_half,
    )


def tilt_of(gravity: Floats) -> float:
    """Return the angle between a gravity vector (3,) and -z, deg."""
    return float(np.degrees(np.arctan2(np.linalg.norm(gravity[:2]), -gravity[2])))
