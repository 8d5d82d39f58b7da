"""The rotation that fits vectors best, in closed form."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats


def best_rotations(moments: Floats) -> tuple[Floats, Floats]:
    """Return the largest trace of W^T H over rotations W (...), and W (..., 3, 3), by moment H.

    With H = sum a b^T, W minimises sum |a - W b|^2 (Kabsch, 1976). `moments`: (..., 3, 3).
    """
    u, sizes, vt = np.linalg.svd(moments)
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    flipped = u.copy()
    flipped[..., :, 2] *= sign[..., None]
    return sizes[..., 0] + sizes[..., 1] + sign * sizes[..., 2], flipped @ vt
