"""Conversion of the columns of a text file to positions, orientations and other quantities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Remark, note
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.array_input import quaternions_of
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.text.names import BODY_TWISTS, FAST_LIO, GROUPS, ROTATIONS, Layout

_LARGEST_ANGLE = 2.0 * np.pi + 0.01  # rad, with a margin for rounded digits
ORTHONORMAL = 1e-2  # largest error of a rotation matrix times its transpose
_METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3}


@dataclass(frozen=True, eq=False)
class States:
    """N states from the columns of a file; a quantity without columns is None."""

    positions: Floats  # (N, 3), metres
    quaternions: Floats | None  # (N, 4), xyzw, NaN for invalid rotations
    velocities: Floats | None  # (N, 3), m/s, in the fixed frame
    covariances: Floats | None  # (N, 6, 6), position first, about the axes of the fixed frame
    matrices: Floats | None  # (N, 3, 3), rotation matrices of KITTI, as in the file
    remarks: tuple[Remark, ...]


def states_of(path: Path, layout: Layout, groups: Mapping[str, Floats], count: int) -> States:
    """Return the states of a file.

    `groups`: columns (N, width), by the name of their group in the layout.
    """
    if layout.unit not in _METRES:
        raise InputError(
            f"{path}: its positions are in {layout.unit}, not all in m, mm, cm or km; convert "
            "them to one unit, and write it in the header"
        )
    remarks, matrices = [], None
    if "matrix" in groups:
        whole = groups["matrix"].reshape(-1, 3, 4)
        matrices, positions = whole[:, :, :3], np.ascontiguousarray(whole[:, :, 3])
        rotations = quaternions_of(matrices)
        if layout.checks:  # its first rows are rotations; a damaged one is dropped
            with np.errstate(over="ignore", invalid="ignore"):
                products = matrices @ np.swapaxes(matrices, 1, 2)
                right = np.abs(products - np.eye(3)).max(axis=(1, 2)) < ORTHONORMAL
            rotations = np.where(right[:, None], rotations, np.nan)
        quaternions: Floats | None = rotations
    else:
        quaternions = _rotations(path, layout, groups, count)
        if "position" in groups:
            positions = groups["position"]
        else:
            positions = np.column_stack([groups["planar"], np.zeros(count)])
            remarks.append(note("no_height", "no column z: assumed 0"))
    if layout.unit != "m":
        positions = positions * _METRES[layout.unit]
        remarks.append(note("unit", f"positions converted from {layout.unit} to m"))
    if layout.inverse and quaternions is not None:
        quaternions = quaternions * [-1.0, -1.0, -1.0, 1.0]
        positions = -lie.rotate(_usable(quaternions), positions)
    velocities, covariances = groups.get("velocity"), None
    if quaternions is not None:
        if velocities is None and "body_velocity" in groups:
            velocities = lie.rotate(_usable(quaternions), groups["body_velocity"])
        covariances, axes = _covariances(layout, groups, quaternions)
        remarks += [note("covariance_axes", axes)] if axes else []
    return States(positions, quaternions, velocities, covariances, matrices, tuple(remarks))


def _usable(quaternions: Floats) -> Floats:
    """Return unit quaternions (N, 4); invalid ones become the identity."""
    usable = np.isfinite(quaternions).all(axis=1) & quaternions.any(axis=1)
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(quaternions), 1))
    rotations[usable] = lie.normalized(quaternions[usable])
    return rotations


def _rotations(
    path: Path, layout: Layout, groups: Mapping[str, Floats], count: int
) -> Floats | None:
    """Return the quaternions (N, 4) of one of `ROTATIONS`; None without one.

    Angles are those of R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    group = next((name for name in ROTATIONS if name in groups), None)
    if group is None or group == "quaternion":
        return groups.get("quaternion")
    values = groups[group]
    if group == "rotation_vector":
        longest = np.linalg.norm(values, axis=1).max(initial=0.0)
        if layout.name == FAST_LIO and longest > np.pi + 1e-3:
            raise InputError(
                f"{path}: columns 2 to 4 are longer than pi, so no rotation vectors; those of "
                f"Point-LIO are angles: --columns 't roll pitch yaw x y z {'_ ' * 17}_'"
            )
        return lie.from_rotation_vector(values)
    if group.endswith("_deg"):
        values = np.radians(values)
    elif layout.name != "g2o":  # its angles can be sums of several turns
        beyond = np.abs(values) > _LARGEST_ANGLE
        if beyond.any():
            row, column = np.argwhere(beyond)[0]
            in_degrees = {name: f"{name}_deg" for name in GROUPS[group]}
            named = layout.with_columns(in_degrees.get(name, name) for name in layout.columns)
            raise InputError(
                f"{path}, row {row + 1}: {GROUPS[group][column]} is {values[row, column]:g}, "
                f"which is not in radians; if it is in degrees: {{option}} '{named.named()}'"
            )
    # Larger sums of angles have too few digits for the angle itself: the row is dropped.
    angles = np.zeros((count, 3))
    angles[:, -values.shape[1] :] = np.where(np.abs(values) < 1e9, values, np.nan)
    vectors = np.zeros((3, count, 3))
    vectors[range(3), :, range(3)] = angles.T
    about_x, about_y, about_z = map(lie.from_rotation_vector, vectors)
    return lie.normalized(lie.multiply(lie.multiply(about_z, about_y), about_x))


def _covariances(
    layout: Layout, groups: Mapping[str, Floats], quaternions: Floats
) -> tuple[Floats | None, str]:
    """Return covariances (N, 6, 6) about the axes of the fixed frame, and what is assumed.

    The covariances are None if only one of position and rotation covariance is present.
    """
    upper = np.array(np.triu_indices(3))
    places: dict[str, Any] = {  # rows and columns of the entries
        "covariance": np.indices((6, 6)).reshape(2, -1),
        "covariance_upper": np.triu_indices(6),
        "covariance_lower": np.tril_indices(6),
        "variances": np.diag_indices(6),
        "position_covariance": upper,
        "rotation_covariance": upper + 3,
    }
    present = places.keys() & groups.keys()
    if not present or present in ({"position_covariance"}, {"rotation_covariance"}):
        return None, ""
    covariances = np.zeros((len(quaternions), 6, 6))
    for group in present:
        rows, columns = places[group]
        covariances[:, columns, rows] = covariances[:, rows, columns] = groups[group]
    is_of_openvins = "rotation_covariance" in present
    if is_of_openvins or layout.covariances == BODY_TWISTS:
        from trajeval_ros.geometry import covariance_frames

        matrices = lie.to_matrix(_usable(quaternions))
        if not is_of_openvins:
            return covariance_frames.world_from_body_twists(covariances, matrices), ""
        axes = "rotation covariances rotated from the body frame (OpenVINS) to the fixed frame"
        return covariance_frames.world_from_body_rotations(covariances, matrices), axes
    return covariances, "covariances read as position first, in the fixed frame"
