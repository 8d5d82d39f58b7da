"""Test for timestamps that are arrival times instead of times of measurement."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.statistics import median

_SAMPLE = 20_000  # states of a sample
_JITTER = 0.15  # least spread of steps in time, relative to the steps; less has no effect
_FEWEST_SMOOTH = 100  # steps of smooth motion for a slope
# Slope of steps in space over steps in time: 1 for sensor timestamps, and 0 for arrival times.
_FOLLOWS = 0.2
_SPARSE_S = 0.12  # usual step from which on poses are keyframes, at a constant distance


def stamped_at_arrival(side: Trajectory) -> bool:
    """Return whether steps in time vary, and steps in space do not depend on them.

    A body with smooth motion moves twice as far in twice the time. If the distance does not depend
    on the timestamps, they are not the times of the poses.
    """
    some = slice(_SAMPLE)
    step_s = np.diff(side.stamps[some]) / NANOSECONDS
    is_regular = np.ptp(step_s) <= _JITTER * step_s.min() if len(step_s) else True
    # The distance between sparse keyframes is constant.
    if is_regular or not side.reading.stamped or (usual_s := median(step_s)) > _SPARSE_S:
        return False
    moved = np.diff(side.positions[some], axis=0)
    distance = np.linalg.norm(moved, axis=1)
    # Steps with neighbours on both sides and without lost messages. A body at rest moves by noise.
    whole = (step_s > 0.1 * usual_s) & (step_s < 1.9 * usual_s)
    nearby_s, nearby = (step_s[:-2] + step_s[2:]) / 2.0, (distance[:-2] + distance[2:]) / 2.0
    smooth = np.einsum("ni,ni->n", moved[:-2], moved[2:]) > 0.9 * distance[:-2] * distance[2:]
    counts = smooth & (nearby > 0.0) & whole[:-2] & whole[1:-1] & whole[2:]
    if np.count_nonzero(counts) < _FEWEST_SMOOTH:
        return False
    longer = step_s[1:-1][counts] / nearby_s[counts] - 1.0
    farther = distance[1:-1][counts] / nearby[counts] - 1.0
    jitter = float(np.sqrt(np.mean(longer**2)))
    follows = float(longer @ farther) / max(float(longer @ longer), 1e-12)
    return jitter > _JITTER and follows < _FOLLOWS
