"""Batched rotation matrices and vectors: exponential, logarithm, Jacobians and best fits in SO(3).

Series replace the closed forms where these cancel.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, lengths


def skew(vector: Floats) -> Floats:
    """Return the matrices S (..., 3, 3) of the cross product: S x is `vector` cross x."""
    matrix = np.zeros((*vector.shape, 3))
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def exp(rotation_vector: Floats) -> Floats:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad (Rodrigues)."""
    sine, cosine, _ = _rodrigues(rotation_vector)
    matrix = skew(rotation_vector)
    squared = matrix @ matrix
    squared *= cosine  # in place: without new arrays it takes less than half of the time
    matrix *= sine
    matrix += np.eye(3)
    matrix += squared
    return matrix


def log(matrix: Floats) -> Floats:
    """Return rotation vectors (..., 3), rad, length at most pi, of matrices (..., 3, 3)."""
    cosine = 0.5 * (np.trace(matrix, axis1=-2, axis2=-1) - 1.0)
    axis = 0.5 * np.stack(
        [
            matrix[..., 2, 1] - matrix[..., 1, 2],
            matrix[..., 0, 2] - matrix[..., 2, 0],
            matrix[..., 1, 0] - matrix[..., 0, 1],
        ],
        axis=-1,
    )
    sine = lengths(axis)
    factor = np.where(sine < 1e-9, 1.0, np.arctan2(sine, cosine) / np.maximum(sine, 1e-9))
    vectors: Floats = factor[..., None] * axis
    far = cosine < -0.9  # there the sine is inaccurate and quaternions are used
    if far.any():
        vectors[far] = lie.rotation_vector(lie.from_matrices(matrix[far]))
    return vectors


def yaw_of_matrix(matrix: Floats) -> Floats:
    """Return the signed twist (...) about the z axis, rad, of rotation matrices (..., 3, 3).

    It equals `yaw` of the quaternions: it maximises tr(Rz(a)^T R), and the z component of
    Log(Rz(a)^T R) is zero.
    """
    twist: Floats = np.arctan2(
        matrix[..., 1, 0] - matrix[..., 0, 1], matrix[..., 0, 0] + matrix[..., 1, 1]
    )
    return twist


def rot_z(angle: float) -> Floats:
    """Return the rotation matrix (3, 3) about the z axis (gravity) by an angle, rad."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def left_jacobian(rotation_vector: Floats) -> Floats:
    """Return J_l (..., 3, 3) with Exp(v + dv) = Exp(J_l dv) Exp(v). J_r(v) = J_l(-v)."""
    _, cosine, remainder = _rodrigues(rotation_vector)
    cross = skew(rotation_vector)
    jacobian: Floats = np.eye(3) + cosine * cross + remainder * (cross @ cross)
    return jacobian


def inverse_left_jacobian(rotation_vector: Floats) -> Floats:
    """Return the inverse of J_l (..., 3, 3), for angles below 2 pi."""
    sine, cosine, _ = _rodrigues(rotation_vector)
    squared = np.sum(rotation_vector * rotation_vector, axis=-1)[..., None, None]
    small = squared < 1e-3
    series = 1.0 / 12.0 + squared / 720.0 + squared**2 / 30240.0 + squared**3 / 1209600.0
    factor = np.where(small, series, (1.0 - sine / (2.0 * cosine)) / np.where(small, 1.0, squared))
    cross = skew(rotation_vector)
    jacobian: Floats = np.eye(3) - 0.5 * cross + factor * (cross @ cross)
    return jacobian


def _rodrigues(rotation_vector: Floats) -> tuple[Floats, Floats, Floats]:
    """Return sin t / t, (1 - cos t) / t^2 and (t - sin t) / t^3 of the angle t, (..., 1, 1)."""
    squared = np.sum(rotation_vector * rotation_vector, axis=-1)[..., None, None]
    small = squared < 1e-2
    t = np.sqrt(np.where(small, 1.0, squared))
    s = squared
    sine = np.where(
        small,
        1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110)))),
        np.sin(t) / t,
    )
    cosine = np.where(
        small,
        0.5 * (1 - s / 12 * (1 - s / 30 * (1 - s / 56 * (1 - s / 90)))),
        2.0 * (np.sin(t / 2.0) / t) ** 2,
    )
    remainder = np.where(
        small,
        (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110)))) / 6,
        (t - np.sin(t)) / t**3,
    )
    return sine, cosine, remainder


def best_rotations(moments: Floats) -> tuple[Floats, Floats]:
    """Return the largest trace of W^T H over rotations W (...), and W (..., 3, 3), by moment H.

    With H = sum a b^T, W minimises sum |a - W b|^2 (Kabsch, 1976). `moments`: (..., 3, 3).
    """
    u, sizes, vt = np.linalg.svd(moments)
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    flipped = u.copy()
    flipped[..., :, 2] *= sign[..., None]
    return sizes[..., 0] + sizes[..., 1] + sign * sizes[..., 2], flipped @ vt
