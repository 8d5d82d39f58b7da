"""Reading of a folder with feature tracks, IMU, groundtruth and camera (docs/consistency.md).

The layout of EuRoC is also supported: `mav0/imu0/data.csv`, `mav0/cam0/sensor.yaml`,
`mav0/state_groundtruth_estimate0/data.csv`, and the tracks in `mav0/cam0`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.text.reader import read_text
from trajeval_ros.io.text.sensor_table import read_samples
from trajeval_ros.io.yaml_file import read_mapping
from trajeval_ros.papers.sensor_recording import (
    CalibratedCamera,
    Lens,
    SensorRecording,
    one_instant_each,
)

# In order of preference: names in this package's own format, then in EuRoC's.
_NAMES = {
    "tracks": ("tracks*.csv", "mav0/cam0/tracks*.csv"),
    "IMU samples": ("imu*.csv", "mav0/imu0/data.csv"),
    "groundtruth": ("groundtruth*.csv", "mav0/state_groundtruth_estimate0/data.csv"),
    "camera": ("cam*.yaml", "mav0/cam0/sensor.yaml"),
}
_LARGEST_ID = 1 << 53  # larger whole numbers are not exact as float64


def read_tracks_folder(folder: Path) -> SensorRecording:
    """Read a recording from a folder.

    If the groundtruth has no velocities, its positions are differentiated. Biases are used only
    if the groundtruth has the biases of both sensors.
    """
    if not folder.is_dir():
        raise InputError(
            f"{folder} is not a folder; give a folder with tracks, IMU and groundtruth"
        )
    try:
        return _recording_in(folder)
    except OSError as error:
        raise InputError(f"{error.filename} can't be read: {reason_of(error)}") from error


def _recording_in(folder: Path) -> SensorRecording:
    paths = {what: _only(folder, what) for what in _NAMES}
    imu_path, tracks_path = paths["IMU samples"], paths["tracks"]
    imu_stamps, samples = read_samples(imu_path, "t_ns wx wy wz ax ay az")
    if (np.diff(imu_stamps) <= 0).any():
        place = int(np.argmax(np.diff(imu_stamps) <= 0))
        raise InputError(
            f"{imu_path}: the timestamp after {imu_stamps[place]} ns does not increase; sort the "
            "samples and remove duplicates"
        )
    seen_stamps, tracks = read_samples(tracks_path, "t_ns track u v")
    image_stamps, image_of = one_instant_each(seen_stamps)
    track_of = _track_names(tracks_path, tracks[:, 0])
    _require_once(tracks_path, np.column_stack([image_of, track_of]), seen_stamps)
    notes = []
    joined = len(np.unique(seen_stamps)) - len(image_stamps)
    if joined:
        notes.append(f"track timestamps less than 1 us apart, merged into one image: {joined}")
    groundtruth, made_up = _groundtruth(paths["groundtruth"])
    return SensorRecording(
        name=folder.resolve().name,
        camera=read_camera(paths["camera"]),
        imu_stamps=imu_stamps,
        angular_velocities=samples[:, :3],
        accelerations=samples[:, 3:],
        image_stamps=image_stamps,
        image_of=image_of,
        track_of=track_of,
        pixels=tracks[:, 1:],
        groundtruth=groundtruth,
        notes=(*notes, *made_up),
    )


def _only(folder: Path, what: str) -> Path:
    """Return the only file of the folder with the content `what`, a key of `_NAMES`."""
    for pattern in _NAMES[what]:
        files = sorted(folder.glob(pattern))
        if len(files) == 1:
            return files[0]
        if files:
            raise InputError(
                f"{folder} has more than one file of {what} ({files[0].name}, {files[1].name}); "
                "keep only one"
            )
    raise InputError(
        f"{folder} has no file of {what}; add {' or '.join(_NAMES[what])} (docs/consistency.md)"
    )


def _track_names(path: Path, column: Floats) -> Stamps:
    if (column != np.rint(column)).any() or np.abs(column).max() > _LARGEST_ID:
        raise InputError(
            f"{path}: track ids (second column) must be whole numbers up to {_LARGEST_ID}"
        )
    return column.astype(np.int64)


def _require_once(path: Path, sightings: Stamps, stamps: Stamps) -> None:
    """Check that no pair of image and track (O, 2) is repeated."""
    _, first, counts = np.unique(sightings, axis=0, return_index=True, return_counts=True)
    if counts.max() > 1:
        place = int(first[counts.argmax()])
        raise InputError(
            f"{path}: track {sightings[place, 1]} is {counts.max()} times in the image at "
            f"{stamps[place]} ns; keep one of them"
        )


def _groundtruth(path: Path) -> tuple[Trajectory, list[str]]:
    """Return the groundtruth with velocities, and notes about missing quantities."""
    read = read_text(path)
    if read.quaternions is None or not read.reading.stamped or len(read) < 3:
        raise InputError(
            f"{path} needs timestamps, positions and orientations of at least 3 poses"
        )
    order = np.argsort(read.stamps, kind="stable")
    groundtruth, notes = read[order], []
    if (np.diff(groundtruth.stamps) == 0).any():
        raise InputError(f"{path} has repeated timestamps; remove the repeated rows")
    if groundtruth.velocities is None:
        velocities = np.gradient(
            groundtruth.positions, groundtruth.seconds - groundtruth.seconds[0], axis=0
        )
        groundtruth = dataclasses.replace(groundtruth, velocities=velocities)
        notes.append("no velocity in groundtruth: positions differentiated")
    if groundtruth.gyroscope_biases is None or groundtruth.accelerometer_biases is None:
        notes.append("no biases of both sensors in groundtruth: IMU used without correction")
        groundtruth = dataclasses.replace(
            groundtruth, gyroscope_biases=None, accelerometer_biases=None
        )
    return groundtruth, notes


# Names of the two models in EuRoC, Kalibr and ROS.
_DISTORTIONS = {
    "radial-tangential": "radial-tangential",
    "radtan": "radial-tangential",
    "plumb_bob": "radial-tangential",
    "equidistant": "equidistant",
    "equi": "equidistant",
    "kannala-brandt": "equidistant",
}
_MOST_PIXELS = 1 << 16  # along an edge
_ROTATION_TOLERANCE = 1e-3


def read_camera(path: Path) -> CalibratedCamera:
    """Read intrinsics (pixels), distortion, and the camera's pose in the IMU frame (metres)."""
    values = read_mapping(path, "calibration of a camera")
    model, distortion = values.get("camera_model"), values.get("distortion_model")
    if model != "pinhole" or not isinstance(distortion, str) or distortion not in _DISTORTIONS:
        raise InputError(
            f"{path}: camera_model {model!r} with distortion_model {distortion!r} is not "
            "supported; use pinhole with radial-tangential or equidistant"
        )
    if "T_BS" not in values:
        raise InputError(
            f"{path} has no T_BS; add the camera's pose in the IMU frame (4 x 4, row by row)"
        )
    pose = _pose(path, values["T_BS"])
    width, height = _numbers(path, values, "resolution", 2)
    intrinsics = _numbers(path, values, "intrinsics", 4)
    coefficients = _numbers(path, values, "distortion_coefficients", 4)
    if not (intrinsics[:2] > 0.0).all():
        raise InputError(f"{path}: focal lengths must be greater than zero")
    if not (min(width, height) >= 1.0 and max(width, height) <= _MOST_PIXELS):
        raise InputError(f"{path}: resolution must be from 1 to {_MOST_PIXELS} pixels")
    lens = Lens(intrinsics[:2], intrinsics[2:], _DISTORTIONS[distortion], coefficients)
    return CalibratedCamera(lens, int(width), int(height), pose[:3, :3], pose[:3, 3])


def _pose(path: Path, value: Any) -> Floats:
    data = {"T_BS": value["data"] if isinstance(value, Mapping) and "data" in value else value}
    pose = _numbers(path, data, "T_BS", 16).reshape(4, 4)
    rotation = pose[:3, :3]
    if (
        np.abs(rotation @ rotation.T - np.eye(3)).max() > _ROTATION_TOLERANCE
        or np.linalg.det(rotation) < 0.0
        or (pose[3] != [0.0, 0.0, 0.0, 1.0]).any()
    ):
        raise InputError(
            f"{path}: T_BS is not a rigid transformation; give its 16 numbers row by row"
        )
    return pose


def _numbers(path: Path, values: Mapping[str, Any], name: str, count: int) -> Floats:
    try:
        numbers = np.array(values.get(name), dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise InputError(f"{path}: {name} must be {count} numbers")
    return numbers
