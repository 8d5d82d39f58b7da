"""Distances and angles along a path."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats


def travelled_distance(positions: Floats) -> Floats:
    """Return the path length up to every position (N, 3), (N,), metres."""
    travelled = np.zeros(len(positions))
    np.cumsum(step_lengths(positions), out=travelled[1:])
    return travelled


def step_lengths(positions: Floats) -> Floats:
    """Return the distances (N,) between consecutive positions (N + 1, 3), metres."""

    def at(begins: Floats, ends: Floats) -> tuple[Floats]:
        steps = ends - begins
        return (np.sqrt(np.einsum("ni,ni->n", steps, steps)),)

    return lie.by_blocks(at, positions[:-1], positions[1:])[0]


def turned_angle(quaternions: Floats) -> Floats:
    """Return the accumulated rotation up to every orientation (N, 4), xyzw, (N,), radians."""
    turned = np.zeros(len(quaternions))
    np.cumsum(step_angles(quaternions), out=turned[1:])
    return turned


def step_angles(quaternions: Floats) -> Floats:
    """Return the angles (N,) between consecutive orientations (N + 1, 4), xyzw, radians."""

    def at(begins: Floats, ends: Floats) -> tuple[Floats]:
        return (lie.angle(lie.multiply(lie.conjugate(begins), ends)),)

    return lie.by_blocks(at, quaternions[:-1], quaternions[1:])[0]
