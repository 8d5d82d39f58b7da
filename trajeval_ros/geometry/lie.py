"""Batched rotations as quaternions, without scipy.

Quaternions are xyzw, Hamilton, unit, of shape (..., 4); all functions broadcast. Conversions are
included because the import of `scipy.spatial` takes longer than a small evaluation. Functions that
scipy's `Rotation` has, too, use its formulas and order of summation. `so3` has the
exponential map.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats, lengths

# Rows per block. Blocks of a few columns fit into a core's cache: twice as fast as whole columns.
_BLOCK = 8192
# Size of arrays below which the overhead of numpy's calls exceeds the arithmetic.
_FEW = 600
# As in scipy: angle, rad, below which the quaternion of a rotation vector is a series.
_SMALL = 1e-3
# As in scipy: distance of the pitch from a right angle, rad, below which yaw and roll are
# ambiguous.
_GIMBAL_LOCK = 1e-7
_CONJUGATION = np.array([-1.0, -1.0, -1.0, 1.0])


def by_blocks(
    function: Callable[..., tuple[NDArray[Any], ...]], *columns: NDArray[Any]
) -> list[NDArray[Any]]:
    """Return `function` of columns with N rows each, computed block by block."""
    count = len(columns[0])
    if count <= _BLOCK:
        return list(function(*columns))
    results: list[NDArray[Any]] = []
    for begin in range(0, count, _BLOCK):
        rows = slice(begin, begin + _BLOCK)
        parts = function(*(column[rows] for column in columns))
        results = results or [np.empty((count, *part.shape[1:]), part.dtype) for part in parts]
        for result, part in zip(results, parts, strict=True):
            result[rows] = part
    return results


def normalized(quaternion: Floats) -> Floats:
    """Return quaternions (..., 4) scaled to length 1; not finite for quaternions of length 0."""
    x, y, z, w = (quaternion[..., i] for i in range(4))
    with np.errstate(all="ignore"):
        # In scipy's order of summation, so that the last digits agree.
        length = np.sqrt(x * x + y * y + z * z + w * w)
        unit: Floats = quaternion / length[..., None]
    return unit


def conjugate(quaternion: Floats) -> Floats:
    """Return the inverse rotation of a unit quaternion (..., 4)."""
    inverse: Floats = quaternion * _CONJUGATION
    return inverse


def heading(quaternion: Floats) -> Floats:
    """Return the rotations about z nearest to unit quaternions (N, 4), i.e. their yaw."""
    headings: Floats = quaternion * np.array([0.0, 0.0, 1.0, 1.0])
    length = np.hypot(headings[:, 2], headings[:, 3])
    # A rotation by pi about a horizontal axis has no yaw: z and w vanish. The identity is
    # returned.
    headings[length < 1e-9], length[length < 1e-9] = [0.0, 0.0, 0.0, 1.0], 1.0
    headings /= length[:, None]
    return headings


def multiply(left: Floats, right: Floats) -> Floats:
    """Return the Hamilton product (..., 4): rotate by `right`, then by `left`."""
    if max(left.size, right.size) <= _FEW:
        return _outer(left, right) @ _PRODUCT
    return _product(left, right)


def _product(left: Floats, right: Floats) -> Floats:
    product = np.empty(np.broadcast_shapes(left.shape, right.shape))
    components = hamilton([left[..., i] for i in range(4)], [right[..., i] for i in range(4)])
    for index, component in enumerate(components):
        product[..., index] = component
    return product


def hamilton(left: Sequence[Any], right: Sequence[Any]) -> Iterator[Any]:
    """Yield x, y, z, w of the product; components are either all floats or all arrays.

    For one quaternion, floats are twenty times as fast as arrays of four.
    """
    x1, y1, z1, w1 = left
    x2, y2, z2, w2 = right
    yield w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2
    yield w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2
    yield w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2
    yield w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2


def running_products(first: Floats, steps: Floats) -> Floats:
    """Return first * steps[0] * ... * steps[n] for n = 0 ... N - 1, (N, 4), in log2 N passes."""
    if not len(steps):
        return steps
    products = np.concatenate([multiply(first[None], steps[:1]), steps[1:]])
    reach = 1
    while reach < len(products):
        products[reach:] = multiply(products[:-reach], products[reach:])
        reach *= 2
    return normalized(products)


def rotate(quaternion: Floats, vector: Floats) -> Floats:
    """Return vectors (..., 3) rotated by quaternions (..., 4)."""
    if max(quaternion.size, vector.size) <= _FEW:
        matrices = (_outer(quaternion, quaternion) @ _ROTATION).reshape(
            *quaternion.shape[:-1], 3, 3
        )
        few: Floats = (matrices @ vector[..., None])[..., 0]
        return few
    x, y, z, w = quaternion[..., 0], quaternion[..., 1], quaternion[..., 2], quaternion[..., 3]
    a, b, c = vector[..., 0], vector[..., 1], vector[..., 2]
    # v + 2 w (u x v) + 2 u x (u x v), where u is the vector part.
    d, e, f = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    rotated = np.empty((*np.broadcast_shapes(quaternion.shape[:-1], vector.shape[:-1]), 3))
    rotated[..., 0] = a + w * d + y * f - z * e
    rotated[..., 1] = b + w * e + z * d - x * f
    rotated[..., 2] = c + w * f + x * e - y * d
    return rotated


def _outer(left: Floats, right: Floats) -> Floats:
    """Return all products of a component of `left` with one of `right` (..., 16), row-major."""
    products = left[..., :, None] * right[..., None, :]
    return products.reshape(*products.shape[:-2], 16)


# Linear maps from the products of components to the quaternion product (columns from products of
# the basis i, j, k, 1), and, since q turns v to q v q*, to the rotation matrix.
_PRODUCT = _product(np.eye(4)[:, None], np.eye(4)).reshape(16, 4)
_ROTATION = np.einsum(
    "avm,mco,c->acov",
    _PRODUCT.reshape(4, 4, 4)[:, :3],
    _PRODUCT.reshape(4, 4, 4)[..., :3],
    _CONJUGATION,
).reshape(16, 9)


def from_matrix(matrix: Floats) -> Floats:
    """Return the quaternion (4,) of one rotation matrix (3, 3), w >= 0.

    The formula of `from_matrices` with floats, which takes a tenth of the time for one matrix.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    # Shepperd's method: of four formulas, the one that divides by the largest component.
    products = {
        3: (h - f, c - g, d - b, 1.0 + a + e + i),
        0: (1.0 + a - e - i, b + d, c + g, h - f),
        1: (b + d, 1.0 - a + e - i, f + h, c - g),
        2: (c + g, f + h, 1.0 - a - e + i, d - b),
    }
    largest = max(products, key=lambda index: products[index][index])
    quaternion = np.array(products[largest])
    quaternion /= np.sqrt(quaternion @ quaternion)
    return quaternion if quaternion[3] >= 0.0 else -quaternion


def from_matrices(matrices: Floats) -> Floats:
    """Return the quaternions (N, 4) of rotation matrices (N, 3, 3), of either sign.

    The matrices must be orthonormal; they are not corrected.
    """
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    trace = diagonal[:, 0] + diagonal[:, 1] + diagonal[:, 2]
    # Shepperd's method: of four formulas, the one that divides by the largest component.
    largest = np.column_stack([diagonal, trace]).argmax(axis=1)
    quaternions = np.empty((len(matrices), 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rows = np.flatnonzero(largest == i)
        block = matrices[rows]
        quaternions[rows, i] = 1.0 - trace[rows] + 2.0 * block[:, i, i]
        quaternions[rows, j] = block[:, j, i] + block[:, i, j]
        quaternions[rows, k] = block[:, k, i] + block[:, i, k]
        quaternions[rows, 3] = block[:, k, j] - block[:, j, k]
    rows = np.flatnonzero(largest == 3)
    block = matrices[rows]
    quaternions[rows, 0] = block[:, 2, 1] - block[:, 1, 2]
    quaternions[rows, 1] = block[:, 0, 2] - block[:, 2, 0]
    quaternions[rows, 2] = block[:, 1, 0] - block[:, 0, 1]
    quaternions[rows, 3] = 1.0 + trace[rows]
    return normalized(quaternions)


def to_matrix(quaternion: Floats) -> Floats:
    """Return the rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    x, y, z, w = (quaternion[..., i] for i in range(4))
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    xy, zw, xz, yw, yz, xw = x * y, z * w, x * z, y * w, y * z, x * w
    matrix = np.empty((*quaternion.shape[:-1], 3, 3))
    matrix[..., 0, 0] = xx - yy - zz + ww
    matrix[..., 0, 1] = 2.0 * (xy - zw)
    matrix[..., 0, 2] = 2.0 * (xz + yw)
    matrix[..., 1, 0] = 2.0 * (xy + zw)
    matrix[..., 1, 1] = -xx + yy - zz + ww
    matrix[..., 1, 2] = 2.0 * (yz - xw)
    matrix[..., 2, 0] = 2.0 * (xz - yw)
    matrix[..., 2, 1] = 2.0 * (yz + xw)
    matrix[..., 2, 2] = -xx - yy + zz + ww
    return matrix


def sum_of_matrices(quaternions: Floats, weights: Floats | None = None) -> Floats:
    """Return the weighted sum (3, 3) of the rotation matrices of N unit quaternions.

    Rotation matrices are linear in the products of a quaternion's components, which are summed.
    """
    weighted = quaternions if weights is None else quaternions * weights[:, None]
    total: Floats = ((weighted.T @ quaternions).ravel() @ _ROTATION).reshape(3, 3)
    return total


def angle(quaternion: Floats) -> Floats:
    """Return the rotation angle (...) in [0, pi] rad; accurate near 0 and near pi."""
    half: Floats = np.arctan2(
        lengths(quaternion[..., :3]),
        np.abs(quaternion[..., 3]),
    )
    return 2.0 * half


def rotation_vector(quaternion: Floats) -> Floats:
    """Return the rotation vectors (..., 3), rad, length at most pi, of quaternions (..., 4)."""
    vector, w = quaternion[..., :3], quaternion[..., 3:]
    length = np.sqrt(np.sum(vector * vector, axis=-1, keepdims=True))
    small = length < 1e-9
    # Of q and -q, the one with w >= 0. For small angles, the vector is twice the vector part.
    per_sine = 2.0 * np.arctan2(length, np.abs(w)) / np.where(small, 1.0, length)
    vectors: Floats = np.where(small, 2.0, per_sine) * np.where(w < 0.0, -vector, vector)
    return vectors


def from_rotation_vector(vector: Floats) -> Floats:
    """Return the quaternions (..., 4) of rotation vectors (..., 3), rad."""
    x, y, z = (vector[..., i] for i in range(3))
    angle = np.sqrt(x * x + y * y + z * z)
    squared = angle * angle
    small = angle <= _SMALL
    factor = np.where(
        small,
        0.5 - squared / 48.0 + squared * squared / 3840.0,
        np.sin(angle / 2.0) / np.where(small, 1.0, angle),
    )
    quaternion: Floats = np.concatenate(
        [factor[..., None] * vector, np.cos(angle / 2.0)[..., None]], axis=-1
    )
    return quaternion


def euler_angles(quaternion: Floats) -> Floats:
    """Return yaw, pitch and roll (..., 3), rad, of R = Rz(yaw) Ry(pitch) Rx(roll).

    Bernardes and Viollet, "Quaternion to Euler angles conversion" (2022), as in scipy. At a pitch
    of +-90 deg the roll is set to zero.
    """
    x, y, z, w = (quaternion[..., i] for i in range(4))
    a, b, c, d = w - y, x + z, y + w, z - x
    half_sum, half_difference = np.arctan2(b, a), np.arctan2(d, c)
    above_nadir = 2.0 * np.arctan2(np.hypot(c, d), np.hypot(a, b))
    nadir, zenith = above_nadir <= _GIMBAL_LOCK, np.pi - above_nadir <= _GIMBAL_LOCK
    yaw = half_sum + half_difference
    yaw = np.where(nadir, 2.0 * half_sum, np.where(zenith, 2.0 * half_difference, yaw))
    roll = np.where(nadir | zenith, 0.0, half_sum - half_difference)
    angles: Floats = np.stack([yaw, above_nadir - np.pi / 2.0, roll], axis=-1)
    angles[angles > np.pi] -= 2.0 * np.pi
    angles[angles < -np.pi] += 2.0 * np.pi
    return angles


def yaw(quaternion: Floats) -> Floats:
    """Return the signed twist (...) about the z axis (gravity), in [-pi, pi] rad."""
    z, w = quaternion[..., 2], quaternion[..., 3]
    # Of q and -q, the one with w >= 0, whose twist is at most pi.
    twist: Floats = 2.0 * np.arctan2(np.where(w < 0.0, -z, z), np.abs(w))
    return twist


def tilt(quaternion: Floats) -> Floats:
    """Return the angle (...) in [0, pi] rad between the z axis and its image: roll and pitch."""
    x, y, z, w = quaternion[..., 0], quaternion[..., 1], quaternion[..., 2], quaternion[..., 3]
    half: Floats = np.arctan2(np.sqrt(x * x + y * y), np.sqrt(z * z + w * w))
    return 2.0 * half


def slerp(start: Floats, end: Floats, fraction: Floats) -> Floats:
    """Interpolate unit quaternions (N, 4) at fractions (N,) in [0, 1], along the shorter arc."""
    differences = np.array([start - end, start + end])
    apart, together = np.sqrt(np.einsum("kni,kni->kn", differences, differences))
    # 2 atan2(|a-b|, |a+b|) is accurate for the small angles between consecutive poses, arccos is
    # not. Of +-end, the one nearer to `start` is used.
    half_angle = 2.0 * np.arctan2(np.minimum(apart, together), np.maximum(apart, together))
    weights = np.array([1.0 - fraction, fraction])
    # sin(f a) / sin(a) without the denominator, because the result is normalised.
    weights = np.where(half_angle < 1e-9, weights, np.sin(weights * half_angle))
    weights[1] = np.copysign(weights[1], together - apart)
    mixed = weights[0, :, None] * start + weights[1, :, None] * end
    unit: Floats = mixed / lengths(mixed)[:, None]
    return unit
