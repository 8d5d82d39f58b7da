"""Whether a body turned about several axes, so that the rotation of another one to it is known."""

from __future__ import annotations

import numpy as np

from trajeval_ros.calibration.hand_eye import closest_rotation
from trajeval_ros.calibration.observability import LEAST_RELIABILITY
from trajeval_ros.geometry.arrays import Floats


def only_axis(turns: Floats, others: Floats) -> Floats | None:
    """Return the axis (3,) about which alone a body turned; None if it turned about several.

    Rotation about other axes may be noise. If it is not, it is in the other source, too, whose
    noise is independent: the two must correlate, as `calibration.observability` asks of
    every parameter.

    Args:
        turns: (N, 3), rotation vectors of the body's motion.
        others: (N, 3), of the same motion by another source, in axes of its own.
    """
    axis: Floats = np.linalg.svd(turns, full_matrices=False)[2][0]
    turned = others @ closest_rotation(turns, others).T
    own, other = (each - np.outer(each @ axis, axis) for each in (turns, turned))
    energy = float(np.sqrt(np.vdot(own, own) * np.vdot(other, other)))
    smallest = np.finfo(float).eps * float(np.vdot(turns, turns))
    if energy > smallest and float(np.vdot(own, other)) / energy >= LEAST_RELIABILITY:
        return None
    return axis
