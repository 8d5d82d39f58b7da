"""Folders of feature tracks, IMU, groundtruth and calibration, made by the simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.inertial import GRAVITY
from trajeval_ros.papers.scene import IMU_RATE_HZ, PROFILES, make_scene
from trajeval_ros.papers.sensor_recording import Lens
from trajeval_ros.simulation.motion import shape

WIDTH, HEIGHT = 752, 480
LENSES = {
    "radial-tangential": Lens(
        np.array([458.0, 457.0]),
        np.array([367.0, 248.0]),
        "radial-tangential",
        np.array([-0.28, 0.07, 2e-4, 2e-5]),
    ),
    "equidistant": Lens(
        np.array([380.0, 381.0]),
        np.array([371.0, 236.0]),
        "equidistant",
        np.array([-0.01, 0.02, -0.01, 0.003]),
    ),
}
LEVER_ARM = np.array([0.08, -0.12, 0.05])
GYROSCOPE_BIAS, ACCELEROMETER_BIAS = np.array([0.02, -0.01, 0.07]), np.array([-0.05, 0.2, 0.1])
PIXEL_NOISE = 0.2
# Keyframes of the scene are the images: 20 a second.
_IMAGES, _LANDMARKS, _STEP_NS = 47, 150, 50_000_000
_EPOCH_NS = 1_403_715_000_000_000_000


def write_tracks_folder(folder: Path, distortion: str = "radial-tangential") -> Path:
    """Write two seconds of a flight in this package's format, and return the folder."""
    folder.mkdir(parents=True)
    generator = np.random.default_rng(5)
    motion, lens = shape("arc"), LENSES[distortion]
    scene = make_scene(
        motion, "random", PROFILES["euroc"], 2, keyframes=_IMAGES, landmarks=_LANDMARKS
    )
    times = np.arange(int(motion.duration_s * IMU_RATE_HZ)) / IMU_RATE_HZ
    rotations = motion.rotations(times)
    rates = motion.angular_velocities(times) + GYROSCOPE_BIAS
    forces = np.einsum("nji,nj->ni", rotations, motion.accelerations(times) - GRAVITY)
    rates += 1.7e-4 * np.sqrt(IMU_RATE_HZ) * generator.standard_normal(rates.shape)
    forces += ACCELEROMETER_BIAS
    forces += 2e-3 * np.sqrt(IMU_RATE_HZ) * generator.standard_normal(forces.shape)
    stamps = _EPOCH_NS + np.rint(times * 1e9).astype(np.int64)
    _write(folder / "imu.csv", "stamp_ns,wx,wy,wz,ax,ay,az", stamps, rates, forces)

    images = np.arange(_IMAGES) * 0.05
    images = images[images < times[-1]]
    image_stamps = _EPOCH_NS + np.arange(len(images)) * _STEP_NS
    poses = motion.positions(images), motion.rotations(images), motion.velocities(images)
    quaternions = lie.from_matrices(poses[1])[:, [3, 0, 1, 2]]
    biases = np.tile(np.concatenate([GYROSCOPE_BIAS, ACCELEROMETER_BIAS]), (len(images), 1))
    _write(
        folder / "groundtruth.csv",
        "time(ns),px,py,pz,qw,qx,qy,qz,vx,vy,vz,bwx,bwy,bwz,bax,bay,baz",
        image_stamps,
        poses[0],
        quaternions,
        poses[2],
        biases,
    )

    rays = scene.groundtruth.landmarks - poses[0][:, None]
    in_body = np.einsum("nji,nkj->nki", poses[1], rays) - LEVER_ARM
    points = in_body @ motion.camera_in_body
    image, track = np.nonzero((points[..., 2] > 0.3) & (points[..., 2] < 30.0))
    plane = points[image, track, :2] / points[image, track, 2:]
    pixels, derivative = lens.distorted(plane)
    # Far outside of the image, a polynomial folds back into it.
    inside = (np.linalg.norm(plane, axis=1) < 1.2) & (np.linalg.det(derivative) > 0.0)
    inside &= ((pixels >= 0.0) & (pixels < [WIDTH, HEIGHT])).all(axis=1)
    pixels = pixels + PIXEL_NOISE * generator.standard_normal(pixels.shape)
    _write(
        folder / "tracks.csv",
        "stamp_ns,track,u,v",
        image_stamps[image[inside]],
        track[inside, None],
        pixels[inside],
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = motion.camera_in_body, LEVER_ARM
    (folder / "camera.yaml").write_text(
        "camera_model: pinhole\n"
        f"resolution: [{WIDTH}, {HEIGHT}]\n"
        f"intrinsics: {[*lens.focal_px.tolist(), *lens.centre_px.tolist()]}\n"
        f"distortion_model: {distortion}\n"
        f"distortion_coefficients: {lens.coefficients.tolist()}\n"
        f"T_BS: {pose.ravel().tolist()}\n"
    )
    return folder


def _write(path: Path, header: str, stamps: np.ndarray, *columns: np.ndarray) -> None:
    rows = [
        ",".join([str(stamp), *(f"{value:.12g}" for value in row)])
        for stamp, row in zip(stamps, np.column_stack(columns), strict=True)
    ]
    path.write_text("\n".join([f"#{header}", *rows]) + "\n")
