"""Paths prepared for drawing: thinned, cut at gaps in time, and moved near the origin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.gauge import Similarity

_NEAR_M = 1000.0
_GAP_NS = 500_000_000
_USUAL_STEPS = 5.0


def origin_for(positions: Floats) -> Floats:
    """Return the origin to subtract from positions (N, 3) before float32, (3,), metres.

    Rerun's coordinates are float32: at a UTM northing of 5e6 m they step by half a metre.
    """
    first = positions[0]
    return np.round(first) if np.abs(first).max() > _NEAR_M else np.zeros(3)


def between_origins(similarity: Similarity, groundtruth: Floats, estimate: Floats) -> Similarity:
    """Return an alignment of coordinates relative to these origins, (3,) and (3,)."""
    moved = similarity.positions(estimate[None])[0] - groundtruth
    return Similarity(similarity.rotation, moved, similarity.scale)


def bounds_of(paths: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return the smallest and largest coordinates of paths (N, 3), (3,) and (3,)."""
    low = np.min([path.min(axis=0) for path in paths], axis=0)
    high = np.max([path.max(axis=0) for path in paths], axis=0)
    return low, high


def size_of(bounds: tuple[Floats, Floats]) -> float:
    """Return the distance between smallest and largest coordinates, (3,) and (3,), not zero."""
    return max(float(np.linalg.norm(bounds[1] - bounds[0])), 1e-2)


def gaps(stamps: Stamps) -> Booleans:
    """Return which of the N - 1 steps between timestamps (N,) are gaps without a line."""
    steps = np.diff(stamps)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return np.asarray(steps > _least_gap_ns(usual))


def is_gap(step_ns: int, usual_ns: float) -> bool:
    """Return whether a step is a gap without a line."""
    return step_ns > _least_gap_ns(usual_ns)


def _least_gap_ns(usual_ns: float) -> float:
    """Return the shortest gap: five usual steps, because keyframes are far apart."""
    return max(_GAP_NS, _USUAL_STEPS * usual_ns)


def pieces(count: int, is_gap: Booleans, most: int) -> Indices:
    """Cut a path of N points into equal pieces that share their ends; return their rows (M, P).

    Steps (N - 1,) that are gaps are not drawn: a piece repeats its last point instead.
    """
    steps = count - 1
    if steps < 1:
        return np.empty((0, 2), dtype=np.int64)
    size = -(-steps // most)
    rows = np.minimum(np.arange(0, steps, size)[:, None] + np.arange(size + 1), steps)
    passed = np.concatenate([[0], np.cumsum(is_gap)])
    connected = passed[rows] == passed[rows[:, :1]]
    last = connected.sum(axis=1) - 1
    return np.take_along_axis(rows, np.minimum(np.arange(size + 1), last[:, None]), axis=1)


def spread(count: int, most: int) -> Indices:
    """Return at most `most` of N rows, evenly spaced, including the first and the last."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(np.int64)


def peaks(values: Floats, most: int) -> Indices:
    """Return at most `most` rows of values (N,): the largest of each of equal blocks."""
    count = len(values)
    if count <= most:
        return np.arange(count)
    size = -(-count // most)
    runs = np.pad(values, (0, -count % size), constant_values=-np.inf).reshape(-1, size)
    return np.asarray(size * np.arange(len(runs)) + runs.argmax(axis=1), dtype=np.int64)
