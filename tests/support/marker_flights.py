"""A flight whose groundtruth is of a marker: 0.12, 0.03, 0.15 m off the body, turned by 92 deg."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.hand_eye_file import hand_eye_json

_AXIS = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
MOUNTED = HandEye(
    lie.from_rotation_vector(np.radians(92.0) * _AXIS),
    np.array([0.12, 0.03, 0.15]),
    "base_link",
    "marker",
)


def of_marker(body: Trajectory) -> Trajectory:
    """Return what a motion capture system measures of the marker."""
    return MOUNTED.inverse().of_body(body, "marker")


def write_mounting(folder: Path) -> Path:
    """Write the marker's pose in the body; returns the file."""
    file = folder / "marker.yaml"
    file.write_text(json.dumps(hand_eye_json(MOUNTED)))
    return file
