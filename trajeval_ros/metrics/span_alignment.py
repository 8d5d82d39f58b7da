"""Alignments of many spans of one trajectory in O(N + K)."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices


def align_spans(
    groundtruth: Floats, estimate: Floats, starts: Indices, ends: Indices
) -> tuple[Floats, Floats, Floats]:
    """Align K spans by yaw and position over all states of a span, eq. (18).

    The sums of a span are differences of running sums. These are about the trajectory's mean, to
    avoid cancellation.

    Args:
        groundtruth: (N, 3), metres.
        estimate: (N, 3), metres.
        starts: (K,) index of the first state of a span.
        ends: (K,) index of the last state of a span, inclusive.

    Returns:
        Rotations about z (K, 4), xyzw, and the means of groundtruth and estimate (K, 3), which
        the alignment maps to each other.
    """
    middle_p, middle_q = groundtruth.mean(axis=0), estimate.mean(axis=0)
    p, q = groundtruth - middle_p, estimate - middle_q
    count = (ends - starts + 1).astype(np.float64)[:, None]

    def mean(columns: Floats) -> Floats:
        running = np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(columns, axis=0)])
        spans: Floats = (running[ends + 1] - running[starts]) / count
        return spans

    mean_p, mean_q = mean(p), mean(q)
    dot = p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1]
    cross = p[:, 1] * q[:, 0] - p[:, 0] * q[:, 1]
    both = mean(np.column_stack([dot, cross]))
    cosine = both[:, 0] - mean_p[:, 0] * mean_q[:, 0] - mean_p[:, 1] * mean_q[:, 1]
    sine = both[:, 1] - mean_p[:, 1] * mean_q[:, 0] + mean_p[:, 0] * mean_q[:, 1]
    half = np.arctan2(sine, cosine) / 2.0
    rotations = np.zeros((len(starts), 4))
    rotations[:, 2], rotations[:, 3] = np.sin(half), np.cos(half)
    return rotations, mean_p + middle_p, mean_q + middle_q
