"""Distances and angles along a path, and speeds."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps, lengths


def travelled_distance(positions: Floats) -> Floats:
    """Return the path length up to every position (N, 3), (N,), metres."""
    return _accumulated(len(positions), step_lengths(positions))


def step_lengths(positions: Floats) -> Floats:
    """Return the distances (N,) between consecutive positions (N + 1, 3), metres."""

    def at(begins: Floats, ends: Floats) -> tuple[Floats]:
        return (lengths(ends - begins),)

    return lie.by_blocks(at, positions[:-1], positions[1:])[0]


def rotation_angle(quaternions: Floats) -> Floats:
    """Return the accumulated rotation up to every orientation (N, 4), xyzw, (N,), radians."""
    return _accumulated(len(quaternions), step_angles(quaternions))


def step_angles(quaternions: Floats) -> Floats:
    """Return the angles (N,) between consecutive orientations (N + 1, 4), xyzw, radians."""

    def at(begins: Floats, ends: Floats) -> tuple[Floats]:
        return (lie.angle(lie.multiply(lie.conjugate(begins), ends)),)

    return lie.by_blocks(at, quaternions[:-1], quaternions[1:])[0]


def _accumulated(count: int, steps: Floats) -> Floats:
    """Return the sums of the steps before each of N states, (N,)."""
    sums = np.zeros(count)
    np.cumsum(steps, out=sums[1:])
    return sums


def speeds(
    stamps: Stamps, positions: Floats, quaternions: Floats | None
) -> tuple[Floats, Floats | None]:
    """Return the speed, m/s, and the turn rate, rad/s, of the steps of N poses, (N - 1,) each.

    The stamps are increasing, in nanoseconds. Without orientations there is no turn rate.
    """
    steps_s = np.diff(stamps) / 1e9
    linear = np.linalg.norm(np.diff(positions, axis=0), axis=1) / steps_s
    if quaternions is None:
        return linear, None
    angles = lie.angle(lie.multiply(lie.conjugate(quaternions[:-1]), quaternions[1:]))
    return linear, angles / steps_s
