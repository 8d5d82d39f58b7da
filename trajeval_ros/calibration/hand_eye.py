"""Closed-form rotation and lever arm between two bodies that move together."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats

_PASSES = 3


def closest_rotation(
    targets: Floats, vectors: Floats, weights: Floats | None = None, *, about_z: bool = False
) -> Floats:
    """Return the R (3, 3) that minimises sum w |target - R vector|^2 (Wahba's problem).

    Targets and vectors are (N, 3), weights (N,). `about_z` restricts R to rotations about z.
    """
    weighted = targets if weights is None else targets * weights[:, None]
    scatter = weighted.T @ vectors
    if about_z:
        return so3.rot_z(float(so3.yaw_of_matrix(scatter)))
    left, _, right = np.linalg.svd(scatter)
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation: Floats = left @ proper @ right
    return rotation


def robust_rotation(targets: Floats, vectors: Floats, *, about_z: bool = False) -> Floats:
    """Return the closest rotation (3, 3) with Cauchy weights, in three passes.

    For body rotations, targets and vectors (N, 3) are rotation vectors of the increments of the
    estimate, and of the groundtruth in the marker's axes.
    """
    weights = np.ones(len(targets))
    rotation = np.eye(3)
    for _ in range(_PASSES):
        rotation = closest_rotation(targets, vectors, weights, about_z=about_z)
        misfit = np.linalg.norm(targets - vectors @ rotation.T, axis=1)
        weights = 1.0 / (1.0 + np.square(misfit / (2.0 * np.median(misfit) + 1e-9)))
    return rotation


def lever_arm(
    rotation_changes: Floats, steps: Floats, marker_steps: Floats, *, with_scale: bool
) -> tuple[Floats, float]:
    """Return the lever arm (3,), metres, and the scale: R_X dq = c dp + (dR - I) l.

    `turned` (N, 3, 3) is dR - I of the body, `steps` (N, 3) is dp in the body's axes at the start,
    and `marker_steps` (N, 3) is R_X dq in the same axes, metres. The scale is 1 if not estimated.
    """
    design = rotation_changes.reshape(-1, 3)
    target = marker_steps.reshape(-1)
    if not with_scale:
        target = target - steps.reshape(-1)
    else:
        design = np.column_stack([design, steps.reshape(-1)])
    solution = np.linalg.lstsq(design, target, rcond=1e-6)[0].tolist()
    return np.array(solution[:3]), solution[3] if with_scale else 1.0
