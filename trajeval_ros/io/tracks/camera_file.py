"""Reading of a camera's calibration in the format of EuRoC's sensor.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.yaml_file import read_mapping
from trajeval_ros.visual_inertial.lens import Lens
from trajeval_ros.visual_inertial.sensor_recording import CalibratedCamera

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
    """Read intrinsics (pixels), distortion, and the camera's pose in the IMU frame (metres).

    Raises:
        InputError: The file can't be read, a value is missing or not valid, or the model of the
            camera or of the distortion is not supported.
    """
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
