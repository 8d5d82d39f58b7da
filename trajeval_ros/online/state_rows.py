"""States of a stream as rows of ten columns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import Trajectory, judge_poses
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis

# Columns of a state: position, quaternion xyzw, velocity; NaN where there is none.
POSITION, QUATERNION, VELOCITY = slice(0, 3), slice(3, 7), slice(7, 10)
WIDTH = 10


class Pairs(NamedTuple):
    """N pairs in order of their stamps.

    Attributes:
        stamps: (N,) nanoseconds.
        groundtruth: (N, 10): position, quaternion xyzw, velocity; NaN where there is none.
        estimate: (N, 10), in the estimate's own frame.
    """

    stamps: Stamps
    groundtruth: Floats
    estimate: Floats


def states(
    positions: Floats, quaternions: Floats | None = None, velocities: Floats | None = None
) -> Floats:
    """Return rows (N, 10) of positions (N, 3), xyzw (N, 4) and velocities (N, 3).

    What is no pose for the readers is dropped by `PairingBuffer`: rows that aren't finite have no
    position here (NaN), and infinity stands for quaternions of no length.
    """
    finite, turned = judge_poses(positions, quaternions)
    rows = np.full((len(positions), WIDTH), np.nan)
    rows[finite, POSITION] = positions[finite]
    if quaternions is not None:
        with np.errstate(all="ignore"):
            lengths = np.sqrt(np.einsum("ni,ni->n", quaternions, quaternions))
            rows[:, QUATERNION] = np.where(turned[:, None], quaternions / lengths[:, None], np.inf)
    if velocities is not None:
        rows[:, VELOCITY] = velocities
    return rows


def upright_rows(rows: Floats, up: UpAxis) -> Floats:
    """Return states (N, 10) in a world whose z axis is up, as `geometry.upright` has them."""
    if up.name == "z":
        return rows
    turned: Floats = rows.copy()
    turned[:, POSITION] = up.turned(rows[:, POSITION])
    turned[:, VELOCITY] = up.turned(rows[:, VELOCITY])
    turned[:, QUATERNION] = lie.multiply(lie.from_matrices(up.matrix[None]), rows[:, QUATERNION])
    return turned


def on_plane(rows: Floats, up: UpAxis) -> Floats:
    """Return states (N, 10) projected on the level plane, as the planar gauge compares them."""
    flat: Floats = rows.copy()
    heights = [POSITION.start + up.index, VELOCITY.start + up.index]
    flat[:, heights] *= 0.0  # what is not finite stays so
    turned = np.isfinite(rows[:, QUATERNION]).all(axis=1)
    headings = lie.heading(upright_rows(rows[turned], up)[:, QUATERNION])
    if up.name != "z":
        headings = lie.multiply(lie.from_matrices(up.matrix.T[None]), headings)
    flat[turned, QUATERNION] = headings
    return flat


def trajectory(stamps: Stamps, rows: Floats, up: UpAxis = Z_UP) -> Trajectory:
    """Return rows (N, 10) as a trajectory, without the columns that are not measured."""
    quaternions, velocities = rows[:, QUATERNION], rows[:, VELOCITY]
    measured = len(rows) and not np.isnan(quaternions[0, 0])
    moving = len(rows) and not np.isnan(velocities).any()
    return Trajectory(
        stamps=np.array(stamps),
        positions=np.array(rows[:, POSITION]),
        quaternions=lie.normalized(quaternions) if measured else None,
        velocities=np.array(velocities) if moving else None,
        up=up,
    )
