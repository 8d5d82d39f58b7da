"""Selection of a recording's keyframes, with the measurements at and between them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps, at_rows
from trajeval_ros.geometry.inertial import ImuNoise, Preintegrated, preintegrate
from trajeval_ros.geometry.interpolation import columns_at
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.reprojection_errors import Camera
from trajeval_ros.papers.sensor_recording import SAME_INSTANT_NS, SensorRecording, at_instants
from trajeval_ros.papers.state import State
from trajeval_ros.papers.visibility import FEWEST_VIEWS

FEWEST_KEYFRAMES = 3
NEAREST_M, FARTHEST_M = 0.2, 30.0
_LONGEST_GAP_S = 0.1


@dataclass(frozen=True, eq=False)
class KeyframeSelection:
    """N keyframes, K landmarks and M observations.

    Pixels are those of an ideal pinhole camera of the same focal length. `weights`, d measured
    pixel / d ideal pixel, transform their errors to errors in the measured image.
    """

    camera: Camera  # the ideal camera; its noise is that of measured pixels
    camera_in_body: Floats  # (3, 3) rotation
    lever_arm: Floats  # (3,) the camera's centre in the body, metres
    groundtruth: State  # groundtruth of the keyframes, without landmarks
    pixels: Floats  # (M, 2)
    weights: Floats  # (M, 2, 2)
    keyframe_of: Indices  # (M,)
    landmark_of: Indices  # (M,)
    landmarks: int  # K
    preintegrated: Preintegrated  # IMU measurements of the N - 1 intervals
    gravity: Floats  # (3,) in the world, m/s^2
    notes: tuple[str, ...]  # sentences that state what was left out

    def problem(self) -> Problem:
        """Return the estimation problem."""
        return Problem(
            self.camera,
            self.camera_in_body,
            self.pixels,
            self.keyframe_of,
            self.landmark_of,
            self.landmarks,
            self.preintegrated,
            lever_arm=self.lever_arm,
            weights=self.weights,
            gravity=self.gravity,
        )

    def with_noise(self, pixel_noise: float) -> KeyframeSelection:
        """Return the same measurements with another standard deviation of pixels."""
        return dataclasses.replace(
            self, camera=dataclasses.replace(self.camera, noise_px=pixel_noise)
        )

    def kept(self, observed: Booleans) -> tuple[KeyframeSelection, Indices]:
        """Return the selected observations, and the indices (K',) of the remaining landmarks.

        Landmarks with too few observing keyframes are dropped, too.
        """
        views = np.bincount(self.landmark_of[observed], minlength=self.landmarks)
        observed = observed & (views >= FEWEST_VIEWS)[self.landmark_of]
        left, landmark_of = np.unique(self.landmark_of[observed], return_inverse=True)
        names, other = ("pixels", "weights", "keyframe_of"), {"landmark_of": landmark_of}
        return at_rows(self, names, observed, **other, landmarks=len(left)), left

    @property
    def gravity_felt(self) -> Floats:
        """Gravity (3,) in the world from groundtruth and IMU, m/s^2.

        It is groundtruth's change of velocity minus the IMU's, per time: a simple check of frames,
        biases and extrinsics.
        """
        felt = np.diff(self.groundtruth.velocities, axis=0) - np.einsum(
            "nij,nj->ni", self.groundtruth.rotations[:-1], self.preintegrated.velocities
        )
        mean: Floats = (felt / self.preintegrated.durations_s[:, None]).mean(axis=0)
        return mean

    @property
    def drift_against_gyroscope_deg(self) -> float:
        """Angle between the rotations from first to last keyframe by groundtruth and gyroscope."""
        rotated = np.eye(3)
        for step in self.preintegrated.rotations:
            rotated = rotated @ step
        rotations = self.groundtruth.rotations
        return float(np.degrees(np.linalg.norm(so3.log(rotations[-1].T @ rotations[0] @ rotated))))


def select(
    recording: SensorRecording,
    every: int,
    most: int,
    pixel_noise: float,
    imu_noise: ImuNoise,
    gravity: Floats,
) -> KeyframeSelection:
    """Return keyframes of a recording with all tracks that at least three of them see.

    Every `every`th image is a keyframe, and after `most` of them the others are dropped. Biases
    are those of the groundtruth. Gravity (3,) is in the world, m/s^2.
    """
    images, outside = _usable_images(recording)
    chosen = images[::every][:most]
    if len(chosen) < FEWEST_KEYFRAMES:
        raise InputError(
            f"{recording.name}: only {counted(len(chosen), 'keyframe')} ({len(images)} of "
            f"{len(recording.image_stamps)} images are within the time span of IMU and "
            f"groundtruth, one in {every} is used); at least {FEWEST_KEYFRAMES} are required"
        )
    stamps = recording.image_stamps[chosen]
    groundtruth = recording.groundtruth
    poses = groundtruth[at_instants(groundtruth.stamps, stamps, "groundtruth")]
    joined = np.count_nonzero(poses.stamps != stamps)
    assert poses.quaternions is not None
    assert poses.velocities is not None
    rotations = lie.to_matrix(poses.quaternions)
    states = State.at(poses.positions, rotations, poses.velocities, np.zeros((0, 3)))

    order = np.full(len(recording.image_stamps), -1)
    order[chosen] = np.arange(len(chosen))
    keyframe_of = order[recording.image_of]
    at_keyframe = keyframe_of >= 0
    pixels, (names, landmark_of) = (
        recording.pixels[at_keyframe],
        np.unique(recording.track_of[at_keyframe], return_inverse=True),
    )
    device = recording.camera
    plane, derivative = device.lens.undistorted(pixels)
    focal_px = float(np.sqrt(np.prod(device.lens.focal_px)))
    camera = Camera(focal_px, device.width, device.height, pixel_noise, NEAREST_M, FARTHEST_M)
    invertible: Booleans = np.isfinite(plane[:, 0])
    notes = []
    if joined:
        notes.append(f"keyframes with timestamps less than 1 us from the groundtruth: {joined}")
    if outside:
        notes.append(f"images outside the time span of IMU or groundtruth, dropped: {outside}")
    if not invertible.all():
        notes.append(
            "observations without invertible distortion, dropped: "
            f"{np.count_nonzero(~invertible)} of {len(plane)}"
        )
    whole = KeyframeSelection(
        camera=camera,
        camera_in_body=device.rotation,
        lever_arm=device.lever_arm,
        groundtruth=states,
        pixels=plane * focal_px + camera.centre,
        weights=derivative / focal_px,
        keyframe_of=keyframe_of[at_keyframe],
        landmark_of=landmark_of,
        landmarks=len(names),
        preintegrated=_between(recording, stamps, imu_noise),
        gravity=gravity,
        notes=tuple(notes),
    )
    return whole.kept(invertible)[0]


def _usable_images(recording: SensorRecording) -> tuple[Indices, int]:
    """Return the images within the time of IMU and groundtruth, and the number of others."""
    stamps = recording.image_stamps
    known = (recording.imu_stamps, recording.groundtruth.stamps)
    first = max(int(column[0]) for column in known) - SAME_INSTANT_NS
    last = min(int(column[-1]) for column in known) + SAME_INSTANT_NS
    inside = np.flatnonzero((stamps >= first) & (stamps <= last))
    return inside, len(stamps) - len(inside)


def _between(recording: SensorRecording, keyframes: Stamps, noise: ImuNoise) -> Preintegrated:
    """Return the preintegrated samples between keyframes, without the groundtruth's biases.

    The measurement of a step is the mean of the samples at both ends, since a delay of half a step
    is visible in the residuals. Keyframes between samples add steps.
    """
    stamps = recording.imu_stamps
    begin, end = keyframes[:-1], keyframes[1:]
    # Indices of the samples inside an interval, without those at the keyframes' timestamps.
    first = np.searchsorted(stamps, begin + SAME_INSTANT_NS, side="right")
    last = np.searchsorted(stamps, end - SAME_INSTANT_NS, side="left")
    places = first[:, None] + np.arange(int((last - first).max()))
    inner = np.where(
        places < last[:, None], stamps[np.minimum(places, len(stamps) - 1)], end[:, None]
    )
    seconds = (np.column_stack([begin, inner, end]) - keyframes[0]) / NANOSECONDS
    during = stamps[max(int(first[0]) - 1, 0) : int(last[-1]) + 1]
    gaps = np.diff(during) / NANOSECONDS
    if gaps.max() > _LONGEST_GAP_S:
        raise InputError(
            f"{recording.name}: IMU gap of {gaps.max():.2f} s after {during[gaps.argmax()]} ns; "
            "choose another part"
        )
    sampled = (stamps - keyframes[0]) / NANOSECONDS
    groundtruth = recording.groundtruth
    known = (groundtruth.stamps - keyframes[0]) / NANOSECONDS
    held = []
    for samples, biases in (
        (recording.angular_velocities, groundtruth.gyroscope_biases),
        (recording.accelerations, groundtruth.accelerometer_biases),
    ):
        if biases is not None:
            samples = samples - columns_at(known, biases, sampled)
        nodes = columns_at(sampled, samples, seconds.ravel()).reshape(*seconds.shape, 3)
        held.append((nodes[:, :-1] + nodes[:, 1:]) / 2.0)
    return preintegrate(held[0], held[1], np.diff(seconds, axis=1), noise)
