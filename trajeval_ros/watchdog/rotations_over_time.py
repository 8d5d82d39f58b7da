"""Orientations at any time, products of many rotations, and the axes of rotations."""

from __future__ import annotations

import numpy as np

from trajeval_ros.calibration.hand_eye import closest_rotation
from trajeval_ros.calibration.observability import LEAST_RELIABILITY
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.interpolation import slerp, steps_at


def running_products(first: Floats, steps: Floats) -> Floats:
    """Return first * steps[0] * ... * steps[n] for n = 0 ... N - 1, (N, 4), in log2 N passes."""
    if not len(steps):
        return steps
    products = np.concatenate([lie.multiply(first[None], steps[:1]), steps[1:]])
    reach = 1
    while reach < len(products):
        products[reach:] = lie.multiply(products[:-reach], products[reach:])
        reach *= 2
    return lie.normalized(products)


def slerp_at(times: Floats, quaternions: Floats, at: Floats) -> Floats:
    """Interpolate orientations (N, 4) at increasing times (N,) to other times (M,): (M, 4)."""
    start, fraction = steps_at(times, at)
    return slerp(quaternions, start, start + 1, np.clip(fraction, 0.0, 1.0))


def between(start: Floats, end: Floats) -> Floats:
    """Return the rotations start^-1 * end of unit quaternions, (N, 4)."""
    return lie.multiply(lie.conjugate(start), end)


def angles_deg(quaternions: Floats) -> Floats:
    """Return rotation angles (N,), degrees."""
    return np.degrees(lie.angle(quaternions))


def only_axis(turns: Floats, others: Floats) -> Floats | None:
    """Return the only axis (3,) about which a body rotated; None if there are several.

    Rotations about other axes may be noise. Real rotations are measured by both sources, and
    their noise is independent. So these rotations must correlate between the sources, by the
    criterion of `calibration.observability`. Both are rotation vectors (N, 3), rad, in the axes
    of their source.
    """
    axis: Floats = np.linalg.svd(turns, full_matrices=False)[2][0]
    turned = others @ closest_rotation(turns, others).T
    own, other = (each - np.outer(each @ axis, axis) for each in (turns, turned))
    energy = float(np.sqrt(np.vdot(own, own) * np.vdot(other, other)))
    smallest = np.finfo(float).eps * float(np.vdot(turns, turns))
    if energy > smallest and float(np.vdot(own, other)) / energy >= LEAST_RELIABILITY:
        return None
    return axis
