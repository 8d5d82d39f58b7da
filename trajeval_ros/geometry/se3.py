"""Batched rigid motions: exponential, logarithm, adjoint and Jacobians of SE(3).

Poses are homogeneous matrices (..., 4, 4). Twists (..., 6) have the translation first and perturb
on the right, in the body frame: T' = T Exp(xi), eq. (1) of the probabilistic paper. The package's
other covariances are about the fixed frame's axes: see `covariance_frames`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats

# Squared angle, rad^2, below which series replace closed forms that cancel.
_SMALL = 0.04


def poses(rotations: Floats, positions: Floats) -> Floats:
    """Return the matrices (..., 4, 4) of rotations (..., 3, 3) and positions (..., 3)."""
    shape = np.broadcast_shapes(rotations.shape[:-2], positions.shape[:-1])
    matrices = np.zeros((*shape, 4, 4))
    matrices[..., :3, :3] = rotations
    matrices[..., :3, 3] = positions
    matrices[..., 3, 3] = 1.0
    return matrices


def inverse(pose: Floats) -> Floats:
    """Return the inverse motions (..., 4, 4)."""
    inverse_rotation = transposed(pose[..., :3, :3])
    return poses(inverse_rotation, -times(inverse_rotation, pose[..., :3, 3]))


def exp(twist: Floats) -> Floats:
    """Return the poses (..., 4, 4) of twists (..., 6)."""
    translation, rotation = twist[..., :3], twist[..., 3:]
    return poses(so3.exp(rotation), times(so3.left_jacobian(rotation), translation))


def log(pose: Floats) -> Floats:
    """Return the twists (..., 6) of poses (..., 4, 4), with angles of at most pi."""
    rotation = so3.log(pose[..., :3, :3])
    translation = times(so3.inverse_left_jacobian(rotation), pose[..., :3, 3])
    return np.concatenate([translation, rotation], axis=-1)


def adjoint(pose: Floats) -> Floats:
    """Return Ad_T (..., 6, 6), with T Exp(x) = Exp(Ad_T x) T, eq. (2); its determinant is 1."""
    rotation = pose[..., :3, :3]
    return _triangular(rotation, so3.skew(pose[..., :3, 3]) @ rotation)


def left_jacobian(twist: Floats) -> Floats:
    """Return J_l (..., 6, 6) with Exp(x + d) = Exp(J_l d) Exp(x). J_r(x) = J_l(-x)."""
    return _triangular(so3.left_jacobian(twist[..., 3:]), _coupling(twist))


def inverse_left_jacobian(twist: Floats) -> Floats:
    """Return the inverse of J_l (..., 6, 6), for angles below 2 pi."""
    rotation = so3.inverse_left_jacobian(twist[..., 3:])
    return _triangular(rotation, -rotation @ _coupling(twist) @ rotation)


def log_determinant(rotation: Floats) -> Floats:
    """Return log |det J| (...) of SO(3) at rotation vectors (..., 3); SE(3) has twice it."""
    squared = np.sum(rotation * rotation, axis=-1)
    half = np.sqrt(squared) / 2.0
    # (sin(t/2) / (t/2))^2; numpy's sinc avoids the division by zero.
    determinant: Floats = 2.0 * np.log(np.abs(np.sinc(half / np.pi)))
    return determinant


def log_determinant_gradient(rotation: Floats) -> Floats:
    """Return the gradient (..., 3) of `log_determinant`: (cot(t/2) - 2/t) / t times the vector."""
    squared = np.sum(rotation * rotation, axis=-1)[..., None]
    small = squared < 1e-2
    angle = np.sqrt(np.where(small, 1.0, squared))
    series = -(1.0 + squared / 60.0 * (1.0 + squared / 42.0 * (1.0 + squared / 40.0))) / 6.0
    closed = (1.0 / np.tan(angle / 2.0) - 2.0 / angle) / angle
    gradient: Floats = np.where(small, series, closed) * rotation
    return gradient


def transposed(matrices: Floats) -> Floats:
    """Return the matrices with their last two axes swapped."""
    return np.swapaxes(matrices, -1, -2)


def times(matrices: Floats, vectors: Floats) -> Floats:
    """Return the products (..., n) of matrices (..., n, m) and vectors (..., m)."""
    product: Floats = (matrices @ vectors[..., None])[..., 0]
    return product


def congruent(matrices: NDArray[Any], covariances: Floats) -> Floats:
    """Return A S A^T (..., n, n), exactly symmetric."""
    carried = matrices @ covariances @ transposed(matrices)
    symmetric: Floats = 0.5 * (carried + transposed(carried))
    return symmetric


def _triangular(diagonal: Floats, corner: Floats) -> Floats:
    blocks = np.zeros((*diagonal.shape[:-2], 6, 6))
    blocks[..., :3, :3] = blocks[..., 3:, 3:] = diagonal
    blocks[..., :3, 3:] = corner
    return blocks


def _coupling(twist: Floats) -> Floats:
    """Return the block Q (..., 3, 3) of J_l (Barfoot, State Estimation for Robotics, eq. 7.86)."""
    r, f = so3.skew(twist[..., :3]), so3.skew(twist[..., 3:])
    s = np.sum(np.square(twist[..., 3:]), axis=-1)[..., None, None]
    small = s < _SMALL
    # Small angles use the series; 1 replaces them in the closed forms to avoid a division by zero.
    t2 = np.where(small, 1.0, s)
    t = np.sqrt(t2)
    sine, cosine = np.sin(t), np.cos(t)
    third = np.where(
        small,
        (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110 * (1 - s / 156))))) / 6,
        (t - sine) / (t * t2),
    )
    fourth = np.where(
        small,
        (1 - s / 30 * (1 - s / 56 * (1 - s / 90 * (1 - s / 132 * (1 - s / 182))))) / 24,
        (t2 / 2 + cosine - 1) / t2**2,
    )
    fifth = np.where(
        small,
        1 / 120 - s / 2520 + s**2 / 120960 - s**3 / 9979200 + s**4 / 1245404160,
        (2 * t - 3 * sine + t * cosine) / (2 * t2**2 * t),
    )
    fr, rf = f @ r, r @ f
    frf = fr @ f
    coupling: Floats = (
        0.5 * r
        + third * (fr + rf + frf)
        + fourth * (f @ fr + rf @ f - 3.0 * frf)
        + fifth * (frf @ f + f @ frf)
    )
    return coupling
