"""States of a stream as rows of ten columns, or of 46 with covariances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.geometry.valid_poses import judge_poses

# Columns of a state: position, quaternion xyzw, velocity; NaN if not measured.
POSITION, QUATERNION, VELOCITY = slice(0, 3), slice(3, 7), slice(7, 10)
WIDTH = 10
# Columns of the estimate's covariance, row by row; zeros if the message has none.
COVARIANCE = slice(WIDTH, WIDTH + 36)
WIDTH_WITH_COVARIANCE = COVARIANCE.stop


class Pairs(NamedTuple):
    """N pairs in order of time."""

    stamps: Stamps  # (N,) nanoseconds
    groundtruth: Floats  # (N, 10): position, quaternion xyzw, velocity; NaN if not measured
    estimate: Floats  # (N, 10), or (N, 46) with covariances, in the estimate's own frame

    @property
    def have_rotations(self) -> bool:
        """Whether both states of the first pair, N > 0, have orientations."""
        first = QUATERNION.start
        return not np.isnan(self.groundtruth[0, first] + self.estimate[0, first])

    def picked(self, rows: NDArray[Any] | slice) -> Pairs:
        """Return the pairs of a mask, of indices or of a slice."""
        return Pairs(self.stamps[rows], self.groundtruth[rows], self.estimate[rows])

    def without_covariances(self) -> Pairs:
        """Return the pairs with estimates (N, 10)."""
        return self._replace(estimate=self.estimate[:, :WIDTH])

    @classmethod
    def none(cls) -> Pairs:
        """Return no pairs."""
        return cls(np.empty(0, np.int64), np.empty((0, WIDTH)), np.empty((0, WIDTH)))

    @classmethod
    def in_order(cls, several: Sequence[Pairs]) -> Pairs:
        """Return several groups of pairs, at least one, as one in order of their timestamps."""
        if len(several) == 1:
            return several[0]
        joined = cls(*map(np.concatenate, zip(*several, strict=True)))
        return joined.picked(np.argsort(joined.stamps, kind="stable"))


def states(
    positions: Floats, quaternions: Floats | None = None, velocities: Floats | None = None
) -> Floats:
    """Return rows (N, 10) from positions (N, 3), xyzw (N, 4) and velocities (N, 3).

    Invalid poses are marked for `StateCounts`, which drops them: NaN in the position if it is not
    finite, infinity in the quaternion if it has no length.
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


def all_columns(rows: Floats) -> Floats:
    """Return rows (N, 10) or (N, 46), also of positions and quaternions (N, 3) or (N, 7)."""
    if rows.ndim == 2 and rows.shape[1] in (WIDTH, WIDTH_WITH_COVARIANCE):
        return rows
    if rows.ndim != 2 or rows.shape[1] not in (3, 7):
        raise InputError(
            f"states are rows of 3, 7, {WIDTH} or {WIDTH_WITH_COVARIANCE} columns (position, "
            f"quaternion xyzw, velocity, covariance), not an array of shape {rows.shape}"
        )
    return states(rows[:, POSITION], rows[:, QUATERNION] if rows.shape[1] == 7 else None)


def upright_rows(rows: Floats, up: UpAxis) -> Floats:
    """Return states (N, 10) or (N, 46) in a frame with z up; see `geometry.upright`."""
    if up.name == "z":
        return rows
    turned: Floats = rows.copy()
    turned[:, POSITION] = up.turned(rows[:, POSITION])
    turned[:, VELOCITY] = up.turned(rows[:, VELOCITY])
    turned[:, QUATERNION] = lie.multiply(lie.from_matrices(up.matrix[None]), rows[:, QUATERNION])
    if rows.shape[1] > WIDTH:
        both = np.kron(np.eye(2), up.matrix)
        covariances = both @ rows[:, COVARIANCE].reshape(-1, 6, 6) @ both.T
        turned[:, COVARIANCE] = covariances.reshape(-1, 36)
    return turned


def turned_covariances(rows: Floats, *, to_body: bool = False) -> Floats:
    """Return states (N, 46) with rotation covariances converted from body axes to world axes.

    States (N, 10) have no covariances and are returned unchanged.
    """
    if rows.shape[1] == WIDTH:
        return rows
    from trajeval_ros.geometry.covariance_frames import world_from_body_rotations

    turned: Floats = rows.copy()
    oriented = np.isfinite(rows[:, QUATERNION]).all(axis=1)
    covariances = rows[oriented, COVARIANCE].reshape(-1, 6, 6)
    rotations = lie.to_matrix(lie.normalized(rows[oriented, QUATERNION]))
    if to_body:
        rotations = rotations.swapaxes(1, 2)
    covariances = world_from_body_rotations(covariances, rotations)
    turned[oriented, COVARIANCE] = covariances.reshape(-1, 36)
    return turned


def as_wide(rows: Floats, width: int) -> Floats:
    """Return states with `width` columns: covariances are cut off, or set to zero (unknown)."""
    if rows.shape[1] >= width:
        return rows[:, :width]
    return np.pad(rows, ((0, 0), (0, width - rows.shape[1])))


def on_plane(rows: Floats, up: UpAxis) -> Floats:
    """Return states (N, 10) projected on the horizontal plane, for gauge planar."""
    flat: Floats = rows.copy()
    heights = [POSITION.start + up.index, VELOCITY.start + up.index]
    flat[:, heights] *= 0.0  # NaN and infinity are kept
    turned = np.isfinite(rows[:, QUATERNION]).all(axis=1)
    headings = lie.heading(upright_rows(rows[turned], up)[:, QUATERNION])
    if up.name != "z":
        headings = lie.multiply(lie.from_matrices(up.matrix.T[None]), headings)
    flat[turned, QUATERNION] = headings
    return flat


def trajectory(stamps: Stamps, rows: Floats, up: UpAxis = Z_UP) -> Trajectory:
    """Return rows (N, 7 or more) as a trajectory, without quantities that are not measured."""
    quaternions, velocities = rows[:, QUATERNION], rows[:, VELOCITY]
    covariances = rows[:, COVARIANCE]
    measured = len(rows) and not np.isnan(quaternions[0, 0])
    moving = velocities.size and not np.isnan(velocities).any()
    return Trajectory(
        stamps=np.array(stamps),
        positions=np.array(rows[:, POSITION]),
        quaternions=lie.normalized(quaternions) if measured else None,
        velocities=np.array(velocities) if moving else None,
        covariances=covariances.reshape(-1, 6, 6).copy() if covariances.any() else None,
        up=up,
    )
