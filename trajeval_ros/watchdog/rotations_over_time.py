"""Differences of rotations, and their axes."""

from __future__ import annotations

import numpy as np

from trajeval_ros.calibration.hand_eye import closest_rotation
from trajeval_ros.calibration.observability import LEAST_RELIABILITY
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats


def between(start: Floats, end: Floats) -> Floats:
    """Return the rotations start^-1 * end of unit quaternions, (N, 4)."""
    return lie.multiply(lie.conjugate(start), end)


def only_axis(turns: Floats, others: Floats) -> Floats | None:
    """Return the only axis (3,) about which a body rotated; None if there are several.

    Rotations about other axes may be noise. Real rotations are measured by both sources, and
    their noise is independent. So these rotations must correlate between the sources, by the
    criterion of `calibration.observability`. Both are rotation vectors (N, 3), rad, in the axes
    of their source.
    """
    axis: Floats = np.linalg.svd(turns, full_matrices=False)[2][0]
    rotated = others @ closest_rotation(turns, others).T
    own, other = (item - np.outer(item @ axis, axis) for item in (turns, rotated))
    energy = float(np.sqrt(np.vdot(own, own) * np.vdot(other, other)))
    smallest = np.finfo(float).eps * float(np.vdot(turns, turns))
    if energy > smallest and float(np.vdot(own, other)) / energy >= LEAST_RELIABILITY:
        return None
    return axis
