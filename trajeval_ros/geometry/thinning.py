"""Fewer states of a trajectory: which rows to keep."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

_FIRST_LOOK = 16  # states at once


def evenly(count: int, wanted: int) -> Indices:
    """Return `wanted` of `count` rows, evenly spread, the first and the last among them."""
    if wanted >= count:
        return np.arange(count)
    return np.round(np.linspace(0, count - 1, wanted)).astype(np.int64)


def every_nth(count: int, most: int) -> slice:
    """Return a slice of every n-th of `count` > 0 rows, with the least n that leaves `most`."""
    return slice(None, None, -(-count // most))


def at_rate(stamps: Stamps, rate_hz: float) -> Indices:
    """Return the first row at or after each tick of a clock of that rate, which starts with them.

    Args:
        stamps: (N,) nanoseconds, rising.
        rate_hz: At most so many rows a second are kept.
    """
    # In long doubles a tick of years of nanoseconds is still exact to a nanosecond.
    since = (stamps - stamps[0]).astype(np.longdouble)
    ticks = np.floor(since * rate_hz / NANOSECONDS).astype(np.int64)
    return np.flatnonzero(np.diff(ticks, prepend=-1) > 0)


def by_motion(trajectory: Trajectory, distance_m: float, angle_rad: float) -> Indices:
    """Return the first row, and each that is far or turned enough from the one kept before it.

    Noise of a body at rest doesn't add up, as it would in the length of its path.

    Args:
        trajectory: N states; without orientations the distance alone decides.
        distance_m: Least distance between two that are kept.
        angle_rad: Least angle between their orientations; either suffices.
    """
    positions, quaternions = trajectory.positions, trajectory.quaternions
    count = len(positions)
    kept, at, look = [0], 1, _FIRST_LOOK
    # A loop over what is kept: each decides about those behind it.
    while at < count:
        last, ahead = kept[-1], slice(at, at + look)
        steps = positions[ahead] - positions[last]
        enough = np.einsum("ni,ni->n", steps, steps) >= distance_m**2
        if quaternions is not None:
            turns = lie.multiply(lie.conjugate(quaternions[last]), quaternions[ahead])
            enough |= lie.angle(turns) >= angle_rad
        found = int(enough.argmax())
        if enough[found]:
            look = max(_FIRST_LOOK, 2 * (at + found - last))
            kept.append(at + found)
            at = kept[-1] + 1
        else:
            at, look = at + len(enough), 2 * look
    return np.array(kept)
