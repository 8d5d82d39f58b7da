"""Measured keyframes for the gauge study, with checks of their data."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.preintegration import ImuNoise
from trajeval_ros.papers.keyframe_selection import select
from trajeval_ros.papers.outliers import Rejection, reject_outliers
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.sensor_recording import SensorRecording
from trajeval_ros.papers.state import State, initial_state


@dataclass(frozen=True, eq=False)
class MeasuredScene:
    """The problem of the gauge study; trials only differ in their initial state."""

    problem: Problem  # the measurements
    # Groundtruth of the keyframes, and the landmarks of the solution without outliers, since their
    # true positions are unknown.
    groundtruth: State

    @classmethod
    def of(cls, rejection: Rejection) -> MeasuredScene:
        """Return the scene of the measurements without outliers."""
        groundtruth = dataclasses.replace(
            rejection.selection.groundtruth, landmarks=rejection.state.landmarks
        )
        return cls(rejection.selection.problem(), groundtruth)

    def measured(self, generator: np.random.Generator) -> Problem:  # noqa: ARG002
        """Return the problem: there is one set of measurements."""
        return self.problem

    def disturbed(self, generator: np.random.Generator) -> State:
        """Return a random initial state (gauge paper, section V-B)."""
        return initial_state(self.groundtruth, generator)


_GRAVITY_TOLERANCE, _TILT_TOLERANCE_DEG = 0.1, 2.0
_DRIFT_TOLERANCE_DEG_PER_S = 1.0


@dataclass(frozen=True, eq=False)
class MeasurementModel:
    """Settings of a recording's examination."""

    every: int  # number of images from one keyframe to the next
    keyframes: int  # largest number of keyframes
    pixel_noise: float  # standard deviation of a measured coordinate, pixels
    imu_noise: ImuNoise  # noise densities of the IMU
    gravity: float  # m/s^2


@dataclass(frozen=True, eq=False)
class Examination:
    """Measured keyframes, with checks of their data."""

    scene: MeasuredScene  # the problem for the gauge study
    rejection: Rejection  # the measurements without outliers, and their solution
    duration_s: float  # from first to last keyframe
    notes: tuple[str, ...]  # what reader and selection joined, inserted or dropped
    gravity: Floats  # (3,) from groundtruth and IMU, m/s^2
    # Angle between groundtruth's and the gyroscope's rotation from the first to the last keyframe.
    drift_deg: float


def examine(recording: SensorRecording, model: MeasurementModel) -> Examination:
    """Select keyframes, check the data, and reject outliers."""
    gravity = np.array([0.0, 0.0, -model.gravity])
    whole = select(
        recording, model.every, model.keyframes, model.pixel_noise, model.imu_noise, gravity
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
    return Examination(
        scene=MeasuredScene.of(rejection),
        rejection=rejection,
        duration_s=duration_s,
        notes=recording.notes + whole.notes,
        gravity=felt,
        drift_deg=drift_deg,
    )


def tilt_of(gravity: Floats) -> float:
    """Return the angle between a gravity vector (3,) and -z, deg."""
    return float(np.degrees(np.arctan2(np.linalg.norm(gravity[:2]), -gravity[2])))
