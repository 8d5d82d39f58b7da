"""Orientations at any time, and products of many rotations."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats


def running_products(first: Floats, steps: Floats) -> Floats:
    """Return first * steps[0] * ... * steps[n] for n = 0 ... N - 1, (N, 4), in log2 N passes.

    Args:
        first: (4,), xyzw.
        steps: (N, 4), xyzw.
    """
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
    after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    before = after - 1
    fraction = (at - times[before]) / (times[after] - times[before])
    return lie.slerp(quaternions[before], quaternions[after], np.clip(fraction, 0.0, 1.0))


def between(start: Floats, end: Floats) -> Floats:
    """Return the rotations start^-1 * end of unit quaternions, (N, 4)."""
    return lie.multiply(lie.conjugate(start), end)


def angles_deg(quaternions: Floats, axis: Floats | None = None) -> Floats:
    """Return rotation angles (N,), degrees; with an axis (3,) the angles about this axis."""
    if axis is None:
        return np.degrees(lie.angle(quaternions))
    about = 2.0 * np.arctan2(quaternions[:, :3] @ axis, quaternions[:, 3])
    angles: Floats = np.degrees(np.abs((about + np.pi) % (2.0 * np.pi) - np.pi))
    return angles
