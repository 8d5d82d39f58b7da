"""A simulated flight: true keyframes, landmarks, and the sensors' noise (gauge paper, IV-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import DegenerateGeometryError, SettingsError, require_one_of
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.inertial import GRAVITY, ImuNoise, preintegrate
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.reprojection_errors import Camera
from trajeval_ros.papers.state import State, initial_state
from trajeval_ros.papers.visibility import FEWEST_VIEWS
from trajeval_ros.simulation.motion import Motion

LAYOUTS = ("plane", "random")
_DEPTHS_M = (1.5, 7.0)
_FRONT_WALL_M, _SIDE_WALLS_M, _FLOOR_M, _FARTHEST_WALL_M = 4.0, 3.0, 1.5, 12.0
_SCATTER_M = 0.05
_MARGIN = 0.05
_ROUNDS = 100


def draw_landmarks(
    generator: np.random.Generator,
    layout: str,
    count: int,
    positions: Floats,
    cameras: Floats,
    camera: Camera,
    track: int,
) -> tuple[Floats, Indices, Indices, Floats]:
    """Draw K landmarks that at least three keyframes see.

    With layout `plane` they are on walls and a floor around the motion, with `random` anywhere in
    view. The keyframes have positions (N, 3) and rotations (N, 3, 3) from the camera to the world.
    `track` is the largest number of keyframes for which a landmark is tracked, before and after
    the keyframe that it was drawn from.

    Returns:
        Landmarks (K, 3), and of M observations the keyframe (M,), the landmark (M,) and the
        noise-free pixels (M, r), in order of landmarks.
    """
    require_one_of(layout, LAYOUTS, "layout of landmarks")
    keyframes = len(positions)
    batches: list[tuple[Floats, Booleans, Indices]] = []
    kept = 0
    for _ in range(_ROUNDS):
        origin = generator.integers(0, keyframes, 4 * count)
        size = [camera.width, camera.height]
        pixels = generator.uniform(_MARGIN, 1.0 - _MARGIN, (4 * count, 2)) * size
        rays = np.einsum("nij,nj->ni", cameras[origin], camera.rays(pixels))
        if layout == "random":
            depths = generator.uniform(*_DEPTHS_M, 4 * count)
            points = positions[origin] + depths[:, None] * rays
        else:
            depths = _depths_of_walls(positions, cameras, origin, rays)
            points = positions[origin] + depths[:, None] * rays
            points += generator.normal(0.0, _SCATTER_M, points.shape)
        seen, near = _sightings(points, origin, positions, cameras, camera, track)
        good = (seen.sum(axis=1) >= FEWEST_VIEWS) & (depths < _FARTHEST_WALL_M)
        batches.append((points[good], seen[good], near[good]))
        kept += int(np.count_nonzero(good))
        if kept >= count:
            break
    else:
        raise DegenerateGeometryError(
            f"only {kept} of {count} landmarks are observed by {FEWEST_VIEWS} keyframes; use "
            "closer keyframes or a wider camera"
        )
    points, seen, near = (
        np.concatenate(columns)[:count] for columns in zip(*batches, strict=True)
    )
    landmark_of, place = np.nonzero(seen)
    keyframe_of = near[landmark_of, place]
    in_camera = _in_camera(points[landmark_of], positions[keyframe_of], cameras[keyframe_of])
    return points, keyframe_of, landmark_of, camera.pixels(in_camera)


def _sightings(
    points: Floats, origin: Indices, positions: Floats, cameras: Floats, camera: Camera, track: int
) -> tuple[Booleans, Indices]:
    """Return which keyframes of a point's track see it (mask), and these keyframes' indices."""
    keyframes = len(positions)
    span = min(2 * track + 1, keyframes)
    first = np.clip(origin - track, 0, keyframes - span)
    near = first[:, None] + np.arange(span)
    in_camera = _in_camera(points[:, None], positions[near], cameras[near])
    return camera.in_view(in_camera) & (np.abs(near - origin[:, None]) <= track), near


def _in_camera(points: Floats, positions: Floats, cameras: Floats) -> Floats:
    moved: Floats = np.einsum("...ji,...j->...i", cameras, points - positions)
    return moved


def _depths_of_walls(positions: Floats, cameras: Floats, origin: Indices, rays: Floats) -> Floats:
    """Return the depths at which rays meet a wall ahead, at the sides, or the floor."""
    centre = positions.mean(axis=0)
    ahead = cameras[:, :, 2].mean(axis=0) * [1.0, 1.0, 0.0]
    ahead /= np.linalg.norm(ahead)
    left = np.cross([0.0, 0.0, 1.0], ahead)
    normals = np.stack([ahead, left, -left, [0.0, 0.0, -1.0]])
    distances = np.array(
        [
            ahead @ centre + _FRONT_WALL_M,
            left @ centre + _SIDE_WALLS_M,
            -left @ centre + _SIDE_WALLS_M,
            _FLOOR_M - positions[:, 2].min(),
        ]
    )
    towards = rays @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        depths = (distances - positions[origin] @ normals.T) / towards
    # Excludes walls that are parallel to the ray, behind the camera, or too close.
    depths[~(depths > 0.5)] = np.inf
    nearest: Floats = np.where(np.isfinite(depths), depths, _FARTHEST_WALL_M).min(axis=1)
    return nearest


IMU_RATE_HZ = 200.0


@dataclass(frozen=True)
class SensorProfile:
    """Sensors, and whether the estimator's model of them is exact."""

    camera: Camera  # intrinsics and noise
    imu: ImuNoise  # noise densities
    landmarks: int  # default number of landmarks
    # True: samples and integration match exactly, so all errors are noise that the covariance
    # includes. False: the IMU is sampled at the start of steps and integrated by Euler's rule,
    # which adds errors that the covariance doesn't include. The smaller the IMU's noise, the more
    # they matter.
    is_exact: bool = True

    @property
    def scheme(self) -> str:
        """Scheme of the preintegration: `middle` or `start`."""
        return "middle" if self.is_exact else "start"


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
    "overconfident": SensorProfile(Camera(315.0, 640, 480), _GOOD_IMU, 50, is_exact=False),
}


def profile_named(name: str) -> SensorProfile:
    """Return a profile by name."""
    require_one_of(name, PROFILES, "profile")
    return PROFILES[name]


@dataclass(frozen=True, eq=False)
class Scene:
    """True states, and the noise-free measurements of the sensors."""

    profile: SensorProfile  # the sensors
    times_s: Floats  # (N,), times of the keyframes
    groundtruth: State  # True keyframes and landmarks
    flown: State  # True states at the IMU's rate, from 0 s to the last keyframe, without landmarks
    keyframe_of: NDArray[np.int64]  # (M,) keyframe of each observation
    landmark_of: NDArray[np.int64]  # (M,) landmark of each observation
    pixels: Floats  # (M, r)
    angular_velocities: Floats  # (N - 1, m, 3) between keyframes, rad/s
    accelerations: Floats  # (N - 1, m, 3), m/s^2
    camera_in_body: Floats  # (3, 3)

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
            len(self.groundtruth.landmarks),
            preintegrated,
        )

    def disturbed(self, generator: np.random.Generator) -> State:
        """Return a random initial state (gauge paper, section V-B)."""
        return initial_state(self.groundtruth, generator)


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

    By default, landmarks have the profile's number and are tracked in all keyframes; see
    `draw_landmarks`.
    """
    samples = int(motion.duration_s * IMU_RATE_HZ / max(keyframes - 1, 1) + 1e-9)
    if keyframes < 3 or samples < 1:
        raise SettingsError(
            f"{keyframes} keyframes in {motion.duration_s:g} s are "
            f"{'too many for the IMU' if samples < 1 else 'too few'}; use at least 3 and fewer "
            f"than {int(motion.duration_s * IMU_RATE_HZ)}"
        )
    count = profile.landmarks if landmarks is None else landmarks
    if count < 8:
        raise SettingsError(
            f"{count} landmarks are too few to determine a camera pose; use at least 8"
        )
    times = np.arange((keyframes - 1) * samples + 1) / IMU_RATE_HZ
    rates, forces = _perfect_samples(motion, times, is_exact=profile.is_exact)
    rates, forces = (column.reshape(keyframes - 1, samples, 3) for column in (rates, forces))
    flown = _flown(motion, times, is_exact=profile.is_exact)
    positions, rotations = flown.positions[::samples], flown.rotations[::samples]
    points, keyframe_of, landmark_of, pixels = draw_landmarks(
        np.random.default_rng(seed),
        layout,
        count,
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


def _perfect_samples(motion: Motion, times: Floats, *, is_exact: bool) -> tuple[Floats, Floats]:
    """Return the measurements of a noise-free IMU over the steps between `times`."""
    rotations = motion.rotations(times)
    if not is_exact:
        rotated = np.swapaxes(rotations[:-1], 1, 2)
        forces = motion.accelerations(times[:-1]) - GRAVITY
        return motion.angular_velocities(times[:-1]), np.einsum("nij,nj->ni", rotated, forces)
    # The constant rates and specific forces that integrate from one state to the next.
    step_s = 1.0 / IMU_RATE_HZ
    rates = so3.log(np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]) / step_s
    middle = rotations[:-1] @ so3.exp(rates * (step_s / 2.0))
    forces = np.diff(motion.velocities(times), axis=0) / step_s - GRAVITY
    return rates, np.einsum("nji,nj->ni", middle, forces)


def _flown(motion: Motion, times: Floats, *, is_exact: bool) -> State:
    """Return the true motion at the IMU's rate, as a state without landmarks.

    For an exact model it is the integral of the perfect samples, so that measurements have no
    errors except noise: attitudes and velocities are those of the motion, positions are the sum of
    the velocities, within about 10 um of the motion in a flight of the paper's length.
    """
    positions, velocities = motion.positions(times), motion.velocities(times)
    if is_exact:
        steps = (velocities[:-1] + velocities[1:]) / (2.0 * IMU_RATE_HZ)
        positions = positions[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return State.at(positions, motion.rotations(times), velocities, np.zeros((0, 3)))
