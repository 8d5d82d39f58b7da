"""Measured keyframes for the gauge study: checks of their data, and rejection of outliers."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.inertial import ImuNoise
from trajeval_ros.papers.keyframe_selection import FARTHEST_M, NEAREST_M, KeyframeSelection, select
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.sensor_recording import SensorRecording
from trajeval_ros.papers.solver import GaugeHandling, solve
from trajeval_ros.papers.state import State, initial_state

# Typical noise of a tracker, for the outlier test only. The noise that weights the measurements in
# an estimate is usually larger, and with 1 px the test would accept errors of 3.7 px.
TRACKER_NOISE_PX = 0.3
CHI2_LIMIT = 13.816  # chi-square of two degrees of freedom, 99.9 %
FEWEST_LANDMARKS = 50
_COARSE_LIMIT_PX = 10.0
_LEAST_PARALLAX_DEG = 1.0
_ROUNDS = 20
_TOLERANCE = 1e-9
_TRIANGULATION_STEPS, _LONGEST_STEP_M, _DAMPING = 10, 0.5, 1e-3
_TINY = 1e-9


@dataclass(frozen=True, eq=False)
class Rejection:
    """A selection without outliers, and its solution."""

    selection: KeyframeSelection  # the observations without outliers
    state: State  # the solution with gauge fixation
    median_px: float  # median reprojection error at groundtruth before any rejection
    within_3px: float  # fraction of observations whose error at groundtruth is less than 3 px
    # Numbers of observations and landmarks before the first and after every round.
    rounds: list[tuple[int, int]]


def reject_outliers(selection: KeyframeSelection) -> Rejection:
    """Drop large errors at groundtruth, then solve and drop outliers until none are left."""
    noise_px = selection.camera.noise_px
    judged = selection.with_noise(TRACKER_NOISE_PX)
    state = triangulated(judged)
    errors_px = np.sqrt(_squared_errors(judged, state)) * TRACKER_NOISE_PX
    rounds = [(len(judged.pixels), judged.landmarks)]
    limit = (_COARSE_LIMIT_PX / TRACKER_NOISE_PX) ** 2
    for _ in range(_ROUNDS):
        judged, left = judged.kept(_is_good(judged, state, limit))
        state = dataclasses.replace(state, landmarks=state.landmarks[left])
        if judged.landmarks < FEWEST_LANDMARKS:
            raise InputError(
                f"only {judged.landmarks} of {rounds[0][1]} tracks have three keyframes, "
                f"parallax and no outliers, at least {FEWEST_LANDMARKS} are required (median "
                f"reprojection error at groundtruth: {np.median(errors_px):.1f} px); check "
                "calibration and timestamps, or use more keyframes"
            )
        rounds.append((len(judged.pixels), judged.landmarks))
        if rounds[-1] == rounds[-2] and limit == CHI2_LIMIT:
            break
        limit = CHI2_LIMIT
        state = solve(
            judged.problem(), state, GaugeHandling.FIXATION, function_tolerance=_TOLERANCE
        ).state
    selection = judged.with_noise(noise_px)
    solution = solve(
        selection.problem(), state, GaugeHandling.FIXATION, function_tolerance=1e-3 * _TOLERANCE
    )
    return Rejection(
        selection,
        solution.state,
        float(np.median(errors_px)),
        float(np.mean(errors_px < 3.0)),
        rounds,
    )


def triangulated(selection: KeyframeSelection) -> State:
    """Return groundtruth with landmarks: midpoints of rays, refined by least squares."""
    groundtruth, landmark_of = selection.groundtruth, selection.landmark_of
    cameras = groundtruth.rotations @ selection.camera_in_body
    centres = groundtruth.positions + groundtruth.rotations @ selection.lever_arm
    rays = selection.camera.rays(selection.pixels)
    rays = np.einsum("mij,mj->mi", cameras[selection.keyframe_of], rays)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    matrices = np.zeros((selection.landmarks, 3, 3))
    vectors = np.zeros((selection.landmarks, 3, 1))
    np.add.at(matrices, landmark_of, across)
    np.add.at(vectors, landmark_of, across @ centres[selection.keyframe_of][:, :, None])
    # Parallel rays don't determine the depth; the parallax test drops these landmarks later.
    landmarks = np.linalg.solve(matrices + _TINY * np.eye(3), vectors)[..., 0].astype(np.float64)
    problem = selection.problem()
    for _ in range(_TRIANGULATION_STEPS):
        normal = problem.normal_equations(dataclasses.replace(groundtruth, landmarks=landmarks))
        damped = normal.landmark * (1.0 + _DAMPING * np.eye(3))
        step = np.linalg.solve(damped, -normal.landmark_gradient[:, :, None])[..., 0]
        length_m = np.linalg.norm(step, axis=1, keepdims=True)
        landmarks += step * (_LONGEST_STEP_M / np.maximum(length_m, _LONGEST_STEP_M))
    return dataclasses.replace(groundtruth, landmarks=landmarks)


def _squared_errors(selection: KeyframeSelection, state: State) -> Floats:
    """Return the squared lengths (M,) of the whitened reprojection errors."""
    squares: Floats = np.square(selection.problem().residuals(state)[0]).sum(axis=1)
    return squares


def _is_good(selection: KeyframeSelection, state: State, limit: float) -> Booleans:
    """Return which observations (M,) are inliers, in range, and of landmarks with parallax."""
    depths = selection.problem().points(state)[:, 2]
    in_range = (depths > NEAREST_M) & (depths < FARTHEST_M)
    wide = _parallax(selection, state) > np.radians(_LEAST_PARALLAX_DEG)
    good: Booleans = (
        (_squared_errors(selection, state) <= limit) & in_range & wide[selection.landmark_of]
    )
    return good


def _parallax(selection: KeyframeSelection, state: State) -> Floats:
    """Return the largest angles (K,) between two rays of a landmark."""
    centres = state.positions + state.rotations @ selection.lever_arm
    rays = state.landmarks[selection.landmark_of] - centres[selection.keyframe_of]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    order = np.argsort(selection.landmark_of, kind="stable")
    ends = np.cumsum(np.bincount(selection.landmark_of, minlength=selection.landmarks))[:-1]
    cosines = [(group @ group.T).min(initial=1.0) for group in np.split(rays[order], ends)]
    angles: Floats = np.arccos(np.clip(cosines, -1.0, 1.0))
    return angles


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
