"""Thinning of trajectories: the rows to keep."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

_FIRST_LOOK = 16  # states that are compared at once


def evenly(count: int, wanted: int) -> Indices:
    """Return `wanted` of `count` rows, evenly spread, including the first and the last."""
    if wanted >= count:
        return np.arange(count)
    return np.round(np.linspace(0, count - 1, wanted)).astype(np.int64)


def every_nth(count: int, most: int) -> slice:
    """Return the slice of every n-th of `count` > 0 rows, with the least n for at most `most`."""
    return slice(None, None, -(-count // most))


def at_rate(stamps: Stamps, rate_hz: float) -> Indices:
    """Return the first row at or after every tick of a clock that starts with the first stamp.

    Args:
        stamps: (N,) nanoseconds, increasing.
        rate_hz: Rate of the clock.
    """
    # Long doubles are exact to a nanosecond over years.
    since = (stamps - stamps[0]).astype(np.longdouble)
    ticks = np.floor(since * rate_hz / NANOSECONDS).astype(np.int64)
    return np.flatnonzero(np.diff(ticks, prepend=-1) > 0)


def by_motion(trajectory: Trajectory, distance_m: float, angle_rad: float) -> Indices:
    """Return the first row, and every row at a given distance or angle from the previous kept one.

    Unlike the length of the path, this measure does not accumulate noise of a body at rest.

    Args:
        trajectory: N states; without orientations only the distance is used.
        distance_m: Least distance between kept states, metres.
        angle_rad: Least angle between their orientations, rad; one of the two is sufficient.
    """
    positions, quaternions = trajectory.positions, trajectory.quaternions
    count = len(positions)
    kept, at, look = [0], 1, _FIRST_LOOK
    # One iteration per kept state or block, with a vectorised search for the next one.
    while at < count:
        last, ahead = kept[-1], slice(at, at + look)
        steps = positions[ahead] - positions[last]
        enough = np.einsum("ni,ni->n", steps, steps) >= distance_m**2
        if quaternions is not None:
            turns = lie.multiply(lie.conjugate(quaternions[last]), quaternions[ahead])
            enough |= lie.angle(turns) >= angle_rad
        first = int(enough.argmax())
        if enough[first]:
            look = max(_FIRST_LOOK, 2 * (at + first - last))
            kept.append(at + first)
            at = kept[-1] + 1
        else:
            at, look = at + len(enough), 2 * look
    return np.array(kept)
