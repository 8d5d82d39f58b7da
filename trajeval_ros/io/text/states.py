"""Conversion of the columns of a text file to positions, orientations and other quantities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Remark, note
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.array_input import quaternions_of
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.text.names import BODY_TWISTS, EXAMPLE, FAST_LIO, GROUPS, Layout

_LARGEST_ANGLE = 2.0 * np.pi + 0.01  # rad, with a margin for rounded digits
_LARGEST_SUM = 1e9  # rad; larger sums of angles have too few digits for the angle itself
_COVARIANCES = {
    *("covariance", "covariance_upper", "covariance_lower", "variances"),
    *("rotation_covariance", "position_covariance"),
}
ORTHONORMAL = 1e-2  # largest error of a rotation matrix times its transpose
_METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3}
_NO_Z = note("no_height", "no column z: assumed 0")


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
    remarks = []
    if layout.unit not in _METRES:
        raise InputError(
            f"{path}: its positions are in {layout.unit}, not all in m, mm, cm or km; convert "
            f"them, and name the columns with {EXAMPLE}"
        )
    matrices = None
    if "matrix" in groups:
        whole = groups["matrix"].reshape(-1, 3, 4)
        matrices, positions = whole[:, :, :3], np.ascontiguousarray(whole[:, :, 3])
        rotations = quaternions_of(matrices)
        if layout.checks:  # its first rows are rotations; a damaged one is dropped
            with np.errstate(over="ignore", invalid="ignore"):
                products = matrices @ np.swapaxes(matrices, 1, 2)
                wrong = ~(np.abs(products - np.eye(3)).max(axis=(1, 2)) < ORTHONORMAL)
            if wrong.any():
                rotations = np.where(wrong[:, None], np.nan, rotations)
        quaternions: Floats | None = rotations
    else:
        quaternions = groups.get("quaternion")
        if quaternions is None and "rotation_vector" in groups:
            vectors = groups["rotation_vector"]
            longest = np.linalg.norm(vectors, axis=1).max(initial=0.0)
            if layout.name == FAST_LIO and longest > np.pi + 1e-3:
                raise InputError(
                    f"{path}: columns 2 to 4 are longer than pi, so no rotation vectors; those of "
                    f"Point-LIO are angles: --columns 't roll pitch yaw x y z {'_ ' * 17}_'"
                )
            quaternions = lie.from_rotation_vector(vectors)
        if quaternions is None:
            quaternions = _of_angles(path, layout, groups, count)
        if "position" in groups:
            positions = groups["position"]
        else:
            positions = np.column_stack([groups["planar"], np.zeros(count)])
            remarks.append(_NO_Z)
    if layout.unit != "m":
        positions = positions * _METRES[layout.unit]
        remarks.append(note("unit", f"positions converted from {layout.unit} to m"))
    if layout.inverse and quaternions is not None:
        quaternions = quaternions * [-1.0, -1.0, -1.0, 1.0]
        positions = -lie.rotate(_usable(quaternions), positions)
    velocities = groups.get("velocity")
    if velocities is None and "body_velocity" in groups and quaternions is not None:
        velocities = lie.rotate(_usable(quaternions), groups["body_velocity"])
    covariances = None
    if quaternions is not None and _COVARIANCES & groups.keys():
        covariances, notes = _covariances(layout, groups, _usable(quaternions))
        remarks += notes
    return States(positions, quaternions, velocities, covariances, matrices, tuple(remarks))


def _usable(quaternions: Floats) -> Floats:
    """Return unit quaternions (N, 4); invalid ones become the identity."""
    usable = np.isfinite(quaternions).all(axis=1) & quaternions.any(axis=1)
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(quaternions), 1))
    rotations[usable] = lie.normalized(quaternions[usable])
    return rotations


def _of_angles(
    path: Path, layout: Layout, groups: Mapping[str, Floats], count: int
) -> Floats | None:
    """Return the quaternions (N, 4) of R = Rz(yaw) Ry(pitch) Rx(roll); None without angles."""
    group = next(
        (name for name in ("angles", "angles_deg", "heading", "heading_deg") if name in groups),
        None,
    )
    if group is None:
        return None
    angles = groups[group]
    if group.endswith("_deg"):
        angles = np.radians(angles)
    elif layout.name != "g2o":  # its angles can be sums of several turns
        beyond = np.abs(angles) > _LARGEST_ANGLE
        if beyond.any():
            row, column = np.argwhere(beyond)[0]
            name = GROUPS[group][column]
            raise InputError(
                f"{path}, row {row + 1}: {name} is {angles[row, column]:g}, which is not in "
                f"radians; if it is in degrees, name the column {name}_deg"
            )
    angles = np.where(np.abs(angles) < _LARGEST_SUM, angles, np.nan)  # NaN: the row is dropped
    roll, pitch, yaw = angles.T if angles.shape[1] == 3 else (0.0, 0.0, angles[:, 0])
    vectors = np.zeros((3, count, 3))
    for axis, angle in enumerate((roll, pitch, yaw)):
        vectors[axis, :, axis] = angle
    about_x, about_y, about_z = map(lie.from_rotation_vector, vectors)
    return lie.normalized(lie.multiply(lie.multiply(about_z, about_y), about_x))


def _covariances(
    layout: Layout, groups: Mapping[str, Floats], quaternions: Floats
) -> tuple[Floats | None, list[Remark]]:
    """Return covariances (N, 6, 6) about the axes of the fixed frame, and remarks on them.

    The covariances are None if only one of position and rotation covariance is present.
    """
    count = len(quaternions)
    covariances = np.zeros((count, 6, 6))
    if "rotation_covariance" in groups and "position_covariance" in groups:
        from trajeval_ros.geometry.covariance_frames import world_from_body_rotations

        rows, columns = np.triu_indices(3)
        for first, group in ((0, "position_covariance"), (3, "rotation_covariance")):
            covariances[:, rows + first, columns + first] = groups[group]
            covariances[:, columns + first, rows + first] = groups[group]
        axes = "rotation covariances rotated from the body frame (OpenVINS) to the fixed frame"
        rotated = world_from_body_rotations(covariances, lie.to_matrix(quaternions))
        return rotated, [note("covariance_axes", axes)]
    if "covariance" in groups:
        covariances = groups["covariance"].reshape(-1, 6, 6)
    elif "covariance_upper" in groups or "covariance_lower" in groups:
        upper = "covariance_upper" in groups
        rows, columns = np.triu_indices(6) if upper else np.tril_indices(6)
        values = groups["covariance_upper" if upper else "covariance_lower"]
        covariances[:, rows, columns] = covariances[:, columns, rows] = values
    elif "variances" in groups:
        covariances[:, range(6), range(6)] = groups["variances"]
    else:
        return None, []
    if layout.covariances == BODY_TWISTS:
        from trajeval_ros.geometry.covariance_frames import world_from_body_twists

        return world_from_body_twists(covariances, lie.to_matrix(quaternions)), []
    axes = "covariances read as position first, in the fixed frame"
    return np.ascontiguousarray(covariances), [note("covariance_axes", axes)]
