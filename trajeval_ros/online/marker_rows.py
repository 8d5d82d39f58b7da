"""Conversion of state rows between a marker and the body, as offline before the association."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.online.state_rows import (
    COVARIANCE,
    POSITION,
    QUATERNION,
    VELOCITY,
    WIDTH,
    turned_covariances,
)


def body_rows(rows: Floats, hand_eye: HandEye) -> Floats:
    """Return groundtruth states (N, 10) of the body from poses of the marker.

    A state without orientation cannot be converted; its position becomes NaN. Velocities are of
    the marker and are dropped if there is a lever arm.
    """
    moved, oriented = _moved(rows, hand_eye)
    body = hand_eye.of_body(_poses(rows[oriented]))
    moved[oriented, POSITION] = body.positions
    moved[oriented, QUATERNION] = body.quaternions
    return moved


def marker_rows(rows: Floats, hand_eye: HandEye, rotation_frame: str) -> Floats:
    """Return estimated states (N, 10) or (N, 46) with the marker's position, in metres.

    It is for groundtruth without orientations. A state without orientation and velocities are
    treated as in `body_rows`. Covariances become those of the marker's position.

    Args:
        rows: The states.
        hand_eye: Pose of the marker in the body.
        rotation_frame: Axes of rotation covariances, `world` or `body`; they stay the same.
    """
    if rotation_frame == "body":
        moved = marker_rows(turned_covariances(rows), hand_eye, "world")
        return turned_covariances(moved, to_body=True)
    moved, oriented = _moved(rows, hand_eye)
    poses = _poses(rows[oriented])
    if rows.shape[1] > WIDTH:
        covariances = rows[oriented, COVARIANCE].reshape(-1, 6, 6)
        poses = replace(poses, covariances=covariances)
    marker = hand_eye.of_marker(poses, 1.0)
    moved[oriented, POSITION] = marker.positions
    if marker.covariances is not None:
        moved[oriented, COVARIANCE] = marker.covariances.reshape(-1, 36)
    return moved


def _moved(rows: Floats, hand_eye: HandEye) -> tuple[Floats, Booleans]:
    """Return a copy with NaN for what cannot be converted, and the rows with an orientation."""
    moved: Floats = rows.copy()
    oriented: Booleans = np.logical_and.reduce(np.isfinite(rows[:, : QUATERNION.stop]), axis=1)
    moved[np.isnan(rows[:, QUATERNION.start]), POSITION] = np.nan
    if hand_eye.lever_m.any():
        moved[:, VELOCITY] = np.nan
    return moved, oriented


def _poses(rows: Floats) -> Trajectory:
    """Return the poses of rows (N, 10), all with orientations, as a trajectory."""
    stamps = np.zeros(len(rows), dtype=np.int64)
    return Trajectory(stamps, rows[:, POSITION], rows[:, QUATERNION])
