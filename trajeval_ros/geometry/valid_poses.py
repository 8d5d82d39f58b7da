"""Which poses are usable: finite numbers, and quaternions of non-zero length."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats

# Largest position or velocity, m or m/s. No robot exceeds it, and its square is representable.
LARGEST = 1e12
_SHORTEST = 1e-6  # least length of a quaternion
# Largest error of the squared length of a normalised quaternion, from rounding.
_ROUNDING = 8.0 * float(np.finfo(np.float64).eps)


def judge_poses(positions: Floats, quaternions: Floats | None = None) -> tuple[Booleans, Booleans]:
    """Return which rows are finite, (N,), and which have a quaternion of non-zero length, (N,).

    A diverged estimate can have finite numbers whose squares overflow; they count as infinite.

    Args:
        positions: (N, 3), metres.
        quaternions: (N, 4), or None.
    """

    def finite_at(rows: Floats) -> tuple[Booleans]:
        return (np.logical_and.reduce(np.abs(rows) <= LARGEST, axis=1),)

    finite: Booleans = lie.by_blocks(finite_at, positions)[0]
    if quaternions is None:
        return finite, np.ones(len(positions), dtype=bool)
    with np.errstate(over="ignore", invalid="ignore"):
        squared_length = np.einsum("ni,ni->n", quaternions, quaternions)
    finite &= np.isfinite(squared_length)
    return finite, squared_length > _SHORTEST**2


def at_length_one(quaternions: Floats) -> Floats:
    """Return quaternions (N, 4) scaled to length 1, unchanged if they have this length already.

    Written quaternions are therefore read back without a change of digits.
    """

    def at(rows: Floats) -> tuple[Floats]:
        excess = np.abs(np.einsum("ni,ni->n", rows, rows) - 1.0)
        return (np.where((excess <= _ROUNDING)[:, None], rows, lie.normalized(rows)),)

    return lie.by_blocks(at, quaternions)[0]
