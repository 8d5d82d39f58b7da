"""What a bare script needs for two numbers that `trajeval evaluate --protocol evo` gives.

It reads two TUM files, pairs the nearest stamps, aligns by SE(3) and prints the rmse of position
and rotation. It recognises no format, checks no input, and computes no coverage, warnings or
statistics. So its cost is about the least that an evaluation can have in Python. The parser is
pyarrow's.

Usage: python benchmarks/limit.py GROUNDTRUTH ESTIMATE
"""

from __future__ import annotations

import os

# As the command line has it: a second thread would only spin.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import sys

import numpy as np
from numpy.typing import NDArray
from pyarrow import csv

Array = NDArray[np.float64]
MOST_APART_S = 0.01
COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


def read(path: str) -> tuple[Array, Array, Array]:
    """Return stamps (N,), positions (N, 3) and quaternions (N, 4) of a TUM file."""
    table = csv.read_csv(
        path,
        csv.ReadOptions(use_threads=False, column_names=COLUMNS),
        csv.ParseOptions(delimiter=" ", quote_char=False),
    )
    columns = [
        np.concatenate(
            [np.frombuffer(part.buffers()[1], count=len(part)) for part in column.chunks]
        )
        for column in table.columns
    ]
    return columns[0], np.stack(columns[1:4], axis=1), np.stack(columns[4:], axis=1)


def nearest(times: Array, stamps: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows of the nearest of sorted times and of stamps that lie close enough."""
    after = np.clip(times.searchsorted(stamps), 1, len(times) - 1)
    closer_before = stamps - times[after - 1] <= times[after] - stamps
    rows = np.where(closer_before, after - 1, after)
    close = np.flatnonzero(np.abs(times[rows] - stamps) <= MOST_APART_S)
    return rows[close], close


def aligned(p: Array, q: Array) -> tuple[Array, Array]:
    """Return the rotation (3, 3) from q (N, 3) to p, and q aligned: Umeyama without scale."""
    mean_p, mean_q = p.mean(axis=0), q.mean(axis=0)
    u, _, vt = np.linalg.svd((p - mean_p).T @ (q - mean_q))
    u[:, -1] *= np.sign(np.linalg.det(u @ vt))
    rotation: Array = u @ vt
    moved: Array = (q - mean_q) @ rotation.T + mean_p
    return rotation, moved


def angles_deg(rotation: Array, truth: Array, other: Array) -> Array:
    """Return the angles (N,) between quaternions (N, 4) and others, turned by a rotation."""
    # The rotation as a quaternion w, a, b, c from its matrix: alignments turn by less than pi.
    w = np.sqrt(1.0 + np.trace(rotation)) / 2.0
    a, b, c = (rotation - rotation.T)[[2, 0, 1], [1, 2, 0]] / (4.0 * w)
    left = np.array([[w, -c, b, a], [c, w, -a, b], [-b, a, w, c], [-a, -b, -c, w]])
    rotated = other @ left.T
    rotated /= np.linalg.norm(rotated, axis=1)[:, None]
    # Of q and -q the nearer one; differences keep the digits of small angles.
    apart = np.linalg.norm(truth - rotated, axis=1)
    together = np.linalg.norm(truth + rotated, axis=1)
    angles: Array = 4.0 * np.arctan2(np.minimum(apart, together), np.maximum(apart, together))
    return np.degrees(angles)


def rmse(errors: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(errors**2)))


def main() -> None:
    """Print both numbers."""
    (times, p, truth), (stamps, q, other) = map(read, sys.argv[1:3])
    truth_rows, rows = nearest(times, stamps)
    p, q, truth, other = p[truth_rows], q[rows], truth[truth_rows], other[rows]
    rotation, moved = aligned(p, q)
    truth /= np.linalg.norm(truth, axis=1)[:, None]
    result = rmse(np.linalg.norm(p - moved, axis=1)), rmse(angles_deg(rotation, truth, other))
    print(json.dumps(dict(zip(("position_m", "rotation_deg"), result, strict=True))))


if __name__ == "__main__":
    main()
