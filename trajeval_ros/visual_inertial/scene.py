"""A simulated flight: true keyframes, landmarks, and the sensors' noise (gauge paper, IV-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.visual_inertial.camera import Camera
from trajeval_ros.visual_inertial.initial_state import initial_state
from trajeval_ros.visual_inertial.landmarks import draw_landmarks
from trajeval_ros.visual_inertial.motion import Motion
from trajeval_ros.visual_inertial.preintegration import (
    GRAVITY,
    ImuNoise,
    preintegrate,
)
from trajeval_ros.visual_inertial.problem import Problem
from trajeval_ros.visual_inertial.state import State

IMU_RATE_HZ = 200.0


@dataclass(frozen=True)
class SensorProfile:
    """Sensors, and whether the estimator's model of them is exact.

    Attributes:
        camera: Intrinsics and noise.
        imu: Noise densities.
        landmarks: Default number of landmarks.
        honest: True: samples and integration match exactly, so all errors are noise that the
            covariance includes. False: the IMU is sampled at the start of steps and integrated by
            Euler's rule, which adds errors that the covariance doesn't include. The smaller the
            IMU's noise, the more they matter.
    """

    camera: Camera
    imu: ImuNoise
    landmarks: int
    honest: bool = True

    @property
    def scheme(self) -> str:
        """Scheme of the preintegration: `middle` or `start`."""
        return "middle" if self.honest else "start"


# The densities of EuRoC's IMU, an ADIS16448, from its sensor.yaml.
_EUROC_IMU = ImuNoise(1.6968e-4, 2.0e-3)
# A quarter of that, like the best small IMUs.
_GOOD_IMU = ImuNoise(4.2e-5, 5.0e-4)

PROFILES = {
    # Reproduces errors and iterations of the paper's Table II; the paper doesn't state its noise.
    "paper": SensorProfile(Camera(150.0, 320, 240), ImuNoise(7e-4, 1e-2), 50),
    "euroc": SensorProfile(Camera(458.0, 752, 480), _EUROC_IMU, 100),
    # The baseline is EuRoC's.
    "stereo": SensorProfile(Camera(150.0, 320, 240, baseline_m=0.11), ImuNoise(7e-4, 1e-2), 50),
    "overconfident": SensorProfile(Camera(315.0, 640, 480), _GOOD_IMU, 50, honest=False),
}


def profile_named(name: str) -> SensorProfile:
    """Return a profile by name.

    Raises:
        SettingsError: Unknown name.
    """
    if name not in PROFILES:
        raise SettingsError(f"unknown profile {name!r}; use one of {', '.join(PROFILES)}")
    return PROFILES[name]


@dataclass(frozen=True, eq=False)
class Scene:
    """True states, and the noise-free measurements of the sensors.

    Attributes:
        profile: The sensors.
        times_s: (N,), times of the keyframes.
        truth: True keyframes and landmarks.
        flown: True states at the IMU's rate, from 0 s to the last keyframe, without landmarks.
        keyframe_of: (M,) keyframe of each observation.
        landmark_of: (M,) landmark of each observation.
        pixels: (M, r).
        angular_velocities: (N - 1, m, 3) between keyframes, rad/s.
        accelerations: (N - 1, m, 3), m/s^2.
        camera_in_body: (3, 3).
    """

    profile: SensorProfile
    times_s: Floats
    truth: State
    flown: State
    keyframe_of: NDArray[np.int64]
    landmark_of: NDArray[np.int64]
    pixels: Floats
    angular_velocities: Floats
    accelerations: Floats
    camera_in_body: Floats

    def measured(self, generator: np.random.Generator) -> Problem:
        """Return the estimation problem of one set of noisy measurements."""
        noise = self.profile.imu
        rate = np.sqrt(IMU_RATE_HZ)
        pixels = self.profile.camera.noise_px * generator.standard_normal(self.pixels.shape)
        gyroscope = noise.gyroscope * rate * generator.standard_normal(self.accelerations.shape)
        accelerometer = (
            noise.accelerometer * rate * generator.standard_normal(self.accelerations.shape)
        )
        return self._problem(
            self.pixels + pixels,
            self.angular_velocities + gyroscope,
            self.accelerations + accelerometer,
        )

    def noise_free(self) -> Problem:
        """Return the estimation problem of perfect measurements."""
        return self._problem(self.pixels, self.angular_velocities, self.accelerations)

    def _problem(
        self, pixels: Floats, angular_velocities: Floats, accelerations: Floats
    ) -> Problem:
        preintegrated = preintegrate(
            angular_velocities,
            accelerations,
            1.0 / IMU_RATE_HZ,
            self.profile.imu,
            self.profile.scheme,
        )
        return Problem(
            self.profile.camera,
            self.camera_in_body,
            pixels,
            self.keyframe_of,
            self.landmark_of,
            len(self.truth.landmarks),
            preintegrated,
        )

    def disturbed(self, generator: np.random.Generator) -> State:
        """Return a random initial state (gauge paper, section V-B)."""
        return initial_state(self.truth, generator)


def make_scene(
    motion: Motion,
    layout: str,
    profile: SensorProfile,
    seed: int,
    keyframes: int = 10,
    landmarks: int | None = None,
    track: int | None = None,
) -> Scene:
    """Return a scene: keyframes evenly over a motion, with landmarks drawn from a seed.

    Args:
        motion: Motion of the body.
        layout: Layout of the landmarks, `plane` or `random`.
        profile: Sensors.
        seed: Seed of the landmarks.
        keyframes: Number of keyframes N.
        landmarks: Number of landmarks K; the profile's by default.
        track: Largest number of keyframes for which a landmark is tracked, before and after the
            keyframe that it was drawn from; all by default.

    Raises:
        SettingsError: Too few keyframes or landmarks, or keyframes closer than the IMU's samples.
        DegenerateGeometryError: Too few landmarks are observed by several keyframes.
    """
    samples = int(motion.duration_s * IMU_RATE_HZ / max(keyframes - 1, 1) + 1e-9)
    if keyframes < 3 or samples < 1:
        raise SettingsError(
            f"{keyframes} keyframes in {motion.duration_s:g} s are "
            f"{'too many for the IMU' if samples < 1 else 'too few'}; use at least 3 and fewer "
            f"than {int(motion.duration_s * IMU_RATE_HZ)}"
        )
    wanted = profile.landmarks if landmarks is None else landmarks
    if wanted < 8:
        raise SettingsError(
            f"{wanted} landmarks are too few to determine a camera pose; use at least 8"
        )
    times = np.arange((keyframes - 1) * samples + 1) / IMU_RATE_HZ
    rates, forces = _perfect_samples(motion, times, honest=profile.honest)
    rates, forces = (column.reshape(keyframes - 1, samples, 3) for column in (rates, forces))
    flown = _flown(motion, times, honest=profile.honest)
    positions, rotations = flown.positions[::samples], flown.rotations[::samples]
    points, keyframe_of, landmark_of, pixels = draw_landmarks(
        np.random.default_rng(seed),
        layout,
        wanted,
        positions,
        rotations @ motion.camera_in_body,
        profile.camera,
        keyframes if track is None else track,
    )
    return Scene(
        profile,
        times[::samples],
        State.at(positions, rotations, flown.velocities[::samples], points),
        flown,
        keyframe_of,
        landmark_of,
        pixels,
        rates,
        forces,
        motion.camera_in_body,
    )


def _perfect_samples(motion: Motion, times: Floats, *, honest: bool) -> tuple[Floats, Floats]:
    """Return the measurements of a noise-free IMU over the steps between `times`."""
    rotations = motion.rotations(times)
    if not honest:
        turned = np.swapaxes(rotations[:-1], 1, 2)
        forces = motion.accelerations(times[:-1]) - GRAVITY
        return motion.angular_velocities(times[:-1]), np.einsum("nij,nj->ni", turned, forces)
    # The constant rates and specific forces that integrate from one state to the next.
    step_s = 1.0 / IMU_RATE_HZ
    rates = so3.log(np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]) / step_s
    middle = rotations[:-1] @ so3.exp(rates * (step_s / 2.0))
    forces = np.diff(motion.velocities(times), axis=0) / step_s - GRAVITY
    return rates, np.einsum("nji,nj->ni", middle, forces)


def _flown(motion: Motion, times: Floats, *, honest: bool) -> State:
    """Return the truth at the IMU's rate, as a state without landmarks.

    For an honest profile it is the integral of the perfect samples, so that measurements have no
    errors except noise: attitudes and velocities are those of the motion, positions are the sum of
    the velocities, within about 10 um of the motion in a flight of the paper's length.
    """
    positions, velocities = motion.positions(times), motion.velocities(times)
    if honest:
        steps = (velocities[:-1] + velocities[1:]) / (2.0 * IMU_RATE_HZ)
        positions = positions[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return State.at(positions, motion.rotations(times), velocities, np.zeros((0, 3)))
