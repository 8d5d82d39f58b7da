"""Reads the text files of a case into arrays, for adapters of libraries without a reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def rows(file: Path) -> Floats:
    """Return timestamp, position and quaternion xyzw (N, 8), sorted, without repetitions."""
    table = np.loadtxt(file, ndmin=2)
    return table[np.unique(table[:, 0], return_index=True)[1]]


def matrices(table: Floats) -> Floats:
    """Return poses (N, 4, 4)."""
    x, y, z, w = (table[:, 4:] / np.linalg.norm(table[:, 4:], axis=1, keepdims=True)).T
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3, 3] = table[:, 1:4]
    poses[:, 0, :3] = np.stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1
    )
    poses[:, 1, :3] = np.stack(
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1
    )
    poses[:, 2, :3] = np.stack(
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1
    )
    return poses
