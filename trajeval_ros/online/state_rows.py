"""Rows of ten columns for decoded states, or of 46 with covariances, and their trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.reading import NOT_READ, Reading
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.geometry.valid_poses import LARGEST, count_up, judge_poses

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


def usable_rows(rows: Floats) -> tuple[Booleans, dict[str, int]]:
    """Return which states (N, k) are usable, (N,), and the number of the others by reason."""
    # `states` sets all four columns to infinity.
    no_length = rows[:, QUATERNION.start] == np.inf
    finite = np.isfinite(rows[:, POSITION]).all(axis=1)
    usable = finite & ~no_length
    dropped: dict[str, int] = {}
    if not usable.all():
        count_up(dropped, "not_finite", int(np.count_nonzero(~finite)))
        count_up(dropped, "zero_quaternion", int(np.count_nonzero(finite & no_length)))
    return usable, dropped


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


def trajectory(stamps: Stamps, rows: Floats, up: UpAxis = Z_UP) -> Trajectory:
    """Return rows (N, 7 or more) as a trajectory, without quantities that some of them lack.

    Unusable states are dropped and counted in the trajectory's reading.
    """
    usable, dropped = usable_rows(rows)
    if dropped:
        stamps, rows = stamps[usable], rows[usable]
    quaternions, velocities = rows[:, QUATERNION], rows[:, VELOCITY]
    covariances = rows[:, COVARIANCE]
    is_oriented = len(rows) and not np.isnan(quaternions[:, 0]).any()
    is_moving = velocities.size and (np.abs(velocities) <= LARGEST).all()
    return Trajectory(
        stamps=np.array(stamps),
        positions=np.array(rows[:, POSITION]),
        quaternions=lie.normalized(quaternions) if is_oriented else None,
        velocities=np.array(velocities) if is_moving else None,
        covariances=covariances.reshape(-1, 6, 6).copy() if covariances.any() else None,
        up=up,
        reading=Reading(dropped=dropped) if dropped else NOT_READ,
    )


def rows_of(source: Trajectory) -> Floats:
    """Return states as rows (N, 10), or (N, 46) with covariances."""
    rows = np.full((len(source), WIDTH), np.nan)
    rows[:, POSITION] = source.positions
    for columns, values in ((QUATERNION, source.quaternions), (VELOCITY, source.velocities)):
        if values is not None:
            rows[:, columns] = values
    if source.covariances is None:
        return rows
    return np.hstack([rows, source.covariances.reshape(-1, 36)])
