"""Batched quaternion arithmetic: what scipy lacks, or does slower than a memory-bound loop.

Quaternions are xyzw, Hamilton, unit, of shape (..., 4); all functions broadcast.
`Rotation` stays the type that the package passes around. These functions serve the two places
where it costs too much: products of long batches and spherical interpolation.
The functions from `skew` on are of rotation matrices and vectors: the exponential and its
Jacobians, series where the closed forms cancel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
# Rows of a few columns that stay in a core's cache: twice as fast as whole columns at a time.
_BLOCK = 8192
# Numbers in arrays so short that a call costs more than the arithmetic.
_FEW = 600
_CONJUGATION = np.array([-1.0, -1.0, -1.0, 1.0])


def by_blocks(function: Callable[..., tuple[Array, ...]], *columns: NDArray[Any]) -> list[Array]:
    """Return what `function` returns for columns of N rows each, worked out block by block."""
    count = len(columns[0])
    if count <= _BLOCK:
        return list(function(*columns))
    results: list[Array] = []
    for begin in range(0, count, _BLOCK):
        rows = slice(begin, begin + _BLOCK)
        parts = function(*(column[rows] for column in columns))
        results = results or [np.empty((count, *part.shape[1:])) for part in parts]
        for result, part in zip(results, parts, strict=True):
            result[rows] = part
    return results


def conjugate(quaternion: Array) -> Array:
    """Return the inverse rotation of a unit quaternion (..., 4)."""
    inverse: Array = quaternion * _CONJUGATION
    return inverse


def heading(quaternion: Array) -> Array:
    """Return the rotations about z nearest to unit quaternions (N, 4): their yaw alone."""
    turned: Array = quaternion * np.array([0.0, 0.0, 1.0, 1.0])
    length = np.hypot(turned[:, 2], turned[:, 3])
    # Half a turn about a level axis leaves the yaw open: z and w vanish together, and none is as
    # good as any.
    turned[length < 1e-9], length[length < 1e-9] = [0.0, 0.0, 0.0, 1.0], 1.0
    turned /= length[:, None]
    return turned


def multiply(left: Array, right: Array) -> Array:
    """Return the Hamilton product (..., 4): rotate by `right`, then by `left`."""
    if max(left.size, right.size) <= _FEW:
        return _outer(left, right) @ _PRODUCT
    return _product(left, right)


def _product(left: Array, right: Array) -> Array:
    product = np.empty(np.broadcast_shapes(left.shape, right.shape))
    components = hamilton([left[..., i] for i in range(4)], [right[..., i] for i in range(4)])
    for index, component in enumerate(components):
        product[..., index] = component
    return product


def hamilton(left: Sequence[Any], right: Sequence[Any]) -> Iterator[Any]:
    """Yield x, y, z, w of a product; components x, y, z, w are floats or arrays, one as the other.

    Of single quaternions, floats are twenty times as fast as arrays of four.
    """
    x1, y1, z1, w1 = left
    x2, y2, z2, w2 = right
    yield w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2
    yield w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2
    yield w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2
    yield w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2


def rotate(quaternion: Array, vector: Array) -> Array:
    """Return the vectors (..., 3) rotated by the quaternions (..., 4)."""
    if max(quaternion.size, vector.size) <= _FEW:
        matrices = (_outer(quaternion, quaternion) @ _ROTATION).reshape(
            *quaternion.shape[:-1], 3, 3
        )
        few: Array = (matrices @ vector[..., None])[..., 0]
        return few
    x, y, z, w = quaternion[..., 0], quaternion[..., 1], quaternion[..., 2], quaternion[..., 3]
    a, b, c = vector[..., 0], vector[..., 1], vector[..., 2]
    # v + 2 w (u x v) + 2 u x (u x v), u the vector part.
    d, e, f = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    rotated = np.empty((*np.broadcast_shapes(quaternion.shape[:-1], vector.shape[:-1]), 3))
    rotated[..., 0] = a + w * d + y * f - z * e
    rotated[..., 1] = b + w * e + z * d - x * f
    rotated[..., 2] = c + w * f + x * e - y * d
    return rotated


def _outer(left: Array, right: Array) -> Array:
    """Return the products of all components (..., 16), those of `left` slowest."""
    products = left[..., :, None] * right[..., None, :]
    return products.reshape(*products.shape[:-2], 16)


# What makes the product of the products of all components, read off those of i, j, k and 1; and
# what makes the rotation matrix of the products of q's own components, since q turns v to q v q*.
_PRODUCT = _product(np.eye(4)[:, None], np.eye(4)).reshape(16, 4)
_ROTATION = np.einsum(
    "avm,mco,c->acov",
    _PRODUCT.reshape(4, 4, 4)[:, :3],
    _PRODUCT.reshape(4, 4, 4)[..., :3],
    _CONJUGATION,
).reshape(16, 9)


def from_matrix(matrix: Array) -> Array:
    """Return the quaternion (4,) of one rotation matrix (3, 3), w >= 0.

    scipy's takes batches and repairs what is no rotation, at twenty times the cost for one.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    # Shepperd: of the four ways, the one that divides by the largest component.
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


def angle(quaternion: Array) -> Array:
    """Return the rotation angle (...) in [0, pi] rad; exact for tiny angles and near pi."""
    half: Array = np.arctan2(
        np.sqrt(np.einsum("...i,...i->...", quaternion[..., :3], quaternion[..., :3])),
        np.abs(quaternion[..., 3]),
    )
    return 2.0 * half


def rotation_vector(quaternion: Array) -> Array:
    """Return the rotation vectors (..., 3), at most pi long, of unit quaternions (..., 4)."""
    vector, w = quaternion[..., :3], quaternion[..., 3:]
    length = np.sqrt(np.sum(vector * vector, axis=-1, keepdims=True))
    small = length < 1e-9
    # Of q and -q the one with w >= 0; there the angle is 2 sin(angle / 2) to first order.
    turned = 2.0 * np.arctan2(length, np.abs(w)) / np.where(small, 1.0, length)
    vectors: Array = np.where(small, 2.0, turned) * np.where(w < 0.0, -vector, vector)
    return vectors


def yaw(quaternion: Array) -> Array:
    """Return the signed twist about gravity, the z axis (...), in [-pi, pi] rad."""
    z, w = quaternion[..., 2], quaternion[..., 3]
    # q and -q are one rotation; of the two, the one with w >= 0 twists by at most half a turn.
    twist: Array = 2.0 * np.arctan2(np.where(w < 0.0, -z, z), np.abs(w))
    return twist


def tilt(quaternion: Array) -> Array:
    """Return the angle (...) in [0, pi] rad between the z axis and its image: roll and pitch."""
    x, y, z, w = quaternion[..., 0], quaternion[..., 1], quaternion[..., 2], quaternion[..., 3]
    half: Array = np.arctan2(np.sqrt(x * x + y * y), np.sqrt(z * z + w * w))
    return 2.0 * half


def slerp(start: Array, end: Array, fraction: Array) -> Array:
    """Interpolate (N, 4) unit quaternions at the fractions (N,) in [0, 1], the short way round."""
    differences = np.array([start - end, start + end])
    apart, together = np.sqrt(np.einsum("kni,kni->kn", differences, differences))
    # 2 atan2(|a-b|, |a+b|) instead of arccos: consecutive poses are a tiny angle apart. Of the
    # two quaternions of the end, the nearer one.
    half_angle = 2.0 * np.arctan2(np.minimum(apart, together), np.maximum(apart, together))
    weights = np.array([1.0 - fraction, fraction])
    # sin(f a) / sin(a), but that the length is taken out at the end anyway.
    weights = np.where(half_angle < 1e-9, weights, np.sin(weights * half_angle))
    weights[1] = np.copysign(weights[1], together - apart)
    mixed = weights[0, :, None] * start + weights[1, :, None] * end
    unit: Array = mixed / np.sqrt(np.einsum("ni,ni->n", mixed, mixed))[:, None]
    return unit


def skew(vector: Array) -> Array:
    """Return the matrices (..., 3, 3) whose product with x is the cross product `vector` x x."""
    matrix = np.zeros((*vector.shape, 3))
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def exp(rotation_vector: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3): Rodrigues."""
    sine, cosine, _ = _rodrigues(rotation_vector)
    cross = skew(rotation_vector)
    matrix: Array = np.eye(3) + sine * cross + cosine * (cross @ cross)
    return matrix


def log(matrix: Array) -> Array:
    """Return the rotation vectors (..., 3), at most pi long, of rotation matrices (..., 3, 3)."""
    cosine = 0.5 * (np.trace(matrix, axis1=-2, axis2=-1) - 1.0)
    axis = 0.5 * np.stack(
        [
            matrix[..., 2, 1] - matrix[..., 1, 2],
            matrix[..., 0, 2] - matrix[..., 2, 0],
            matrix[..., 1, 0] - matrix[..., 0, 1],
        ],
        axis=-1,
    )
    sine = np.sqrt(np.einsum("...i,...i->...", axis, axis))
    factor = np.where(sine < 1e-9, 1.0, np.arctan2(sine, cosine) / np.maximum(sine, 1e-9))
    vectors: Array = factor[..., None] * axis
    far = cosine < -0.9  # where the sine has lost digits; quaternions haven't
    if far.any():
        vectors[far] = Rotation.from_matrix(matrix[far]).as_rotvec()
    return vectors


def yaw_of_matrix(matrix: Array) -> Array:
    """Return the signed twist about gravity (...), rad, of rotation matrices (..., 3, 3).

    The same angle as `yaw` of their quaternions: it maximises tr(Rz(a)^T R), and the z component
    of Log(Rz(a)^T R) vanishes.
    """
    twist: Array = np.arctan2(
        matrix[..., 1, 0] - matrix[..., 0, 1], matrix[..., 0, 0] + matrix[..., 1, 1]
    )
    return twist


def about_gravity(angle: float) -> Array:
    """Return the rotation matrix (3, 3) about gravity, the z axis, by an angle in rad."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def left_jacobian(rotation_vector: Array) -> Array:
    """Return J_l (..., 3, 3) with Exp(v + dv) = Exp(J_l dv) Exp(v); J_r(v) is J_l(-v)."""
    _, cosine, remainder = _rodrigues(rotation_vector)
    cross = skew(rotation_vector)
    jacobian: Array = np.eye(3) + cosine * cross + remainder * (cross @ cross)
    return jacobian


def inverse_left_jacobian(rotation_vector: Array) -> Array:
    """Return the inverse of J_l (..., 3, 3), for angles below 2 pi."""
    sine, cosine, _ = _rodrigues(rotation_vector)
    squared = np.sum(rotation_vector * rotation_vector, axis=-1)[..., None, None]
    small = squared < 1e-3
    series = 1.0 / 12.0 + squared / 720.0 + squared**2 / 30240.0 + squared**3 / 1209600.0
    factor = np.where(small, series, (1.0 - sine / (2.0 * cosine)) / np.where(small, 1.0, squared))
    cross = skew(rotation_vector)
    jacobian: Array = np.eye(3) - 0.5 * cross + factor * (cross @ cross)
    return jacobian


def _rodrigues(rotation_vector: Array) -> tuple[Array, Array, Array]:
    """Return sin t / t, (1 - cos t) / t^2 and (t - sin t) / t^3, each (..., 1, 1)."""
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
