"""Increments: relative motions over about one second, which are independent of gauge and drift.

Clock and body parameters are estimated from increments only. In a fit of absolute positions, drift
appears as calibration: on EuRoC MH_01, whose clocks are synchronous, it gives 27 to 65 ms.

The clock model is tau(s) = s + offset + skew (s - mid), with s a timestamp of the estimate and tau
one of the groundtruth. With T_B_M = (R_X, l), the pose of the marker in the body, the residuals
are

    r_p = R_X dq - c dp - (dR - I) l        r_R = Log(R_X dQ R_X^T dR^T)

in the body's axes at the start. Without orientations on both sides, the rotation R_S between the
two worlds takes the place of R_X: r_p = dq - R_S (c dp + (R_j - R_i) l).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.calibration.hand_eye import lever_arm, robust_rotation
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.interpolation import bracket_stamps, mix, slerp
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.trajectory_edits import every_nth

_GAP_S = 0.5
_USUAL_STEPS = 4.0  # sparse keyframes: a gap is longer than this number of median steps


class InterpolatedPoses(NamedTuple):
    """Poses at N stamps."""

    positions: Floats  # (N, 3), metres
    quaternions: Floats | None  # (N, 4), xyzw; None for a position-only sensor
    usable: Booleans  # (N,) whether the stamp is between two states without a gap


@dataclass(frozen=True, eq=False)
class PoseInterpolator:
    """The states of a trajectory in order of time, and their gaps."""

    stamps: Stamps  # (N,) int64, nanoseconds, increasing
    positions: Floats  # (N, 3), metres
    quaternions: Floats | None  # (N, 4), xyzw, or None
    step_s: float  # median time between states
    gap_s: float  # longest time between states that is no gap

    @classmethod
    def of(
        cls, trajectory: Trajectory, *, with_rotations: bool, sparse: bool = False
    ) -> PoseInterpolator:
        """Sort at least two states; gaps between sparse keyframes are relative to their steps."""
        ordered = trajectory.in_order()
        step_s = float(np.median(np.diff(ordered.stamps))) / NANOSECONDS
        return cls(
            ordered.stamps,
            ordered.positions,
            ordered.quaternions if with_rotations else None,
            step_s,
            max(_GAP_S, _USUAL_STEPS * step_s) if sparse else _GAP_S,
        )

    def at(self, stamps: Stamps) -> InterpolatedPoses:
        """Return the poses at N stamps."""
        bracket = bracket_stamps(self.stamps, stamps, self.gap_s)
        between = bracket.start, bracket.end, bracket.fraction
        quaternions = self.quaternions
        return InterpolatedPoses(
            mix(self.positions, *between),
            None if quaternions is None else slerp(quaternions, *between),
            bracket.usable,
        )


def nearest_rows(stamps: Stamps, targets: Stamps) -> NDArray[np.int64]:
    """Return the row of the stamp nearest to every requested one (N,); the stamps are sorted."""
    after = np.minimum(np.searchsorted(stamps, targets), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(
        np.abs(stamps[before] - targets) < np.abs(stamps[after] - targets), before, after
    )


def whole_nanoseconds(seconds: float) -> int:
    """Return a duration in whole nanoseconds."""
    return round(seconds * NANOSECONDS)


# Columns of a Jacobian.
OFFSET, SKEW, SCALE = slice(0, 1), slice(1, 2), slice(8, 9)
BODY_ROTATION, LEVER = slice(2, 5), slice(5, 8)
COLUMNS = 9
# Rows of a residual.
POSITION, ROTATION = slice(0, 3), slice(3, 6)

HORIZON_S = 1.0
# The derivative is over +-20 ms; over one step of the groundtruth it would be noise.
_REACH_S = 0.02
_TOLERANCE = 0.25  # largest relative deviation from the horizon
MOST_INCREMENTS = 20_000


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The parameters of the fit."""

    offset_s: float  # offset to add to the estimate's timestamps, at the middle of the run, s
    skew: float  # relative drift of the clocks, s/s
    rotation: Floats  # (3, 3), R_X; or R_S for increments without orientations
    lever_m: Floats  # (3,), the marker's origin in the body, metres
    scale: float  # c, groundtruth metres per unit of the estimate

    def moved(self, step: Floats) -> Unknowns:
        """Return the parameters after a step (9,); the rotation is updated on the left."""
        return Unknowns(
            self.offset_s + float(step[0]),
            self.skew + float(step[1]),
            so3.exp(step[BODY_ROTATION]) @ self.rotation,
            self.lever_m + step[LEVER],
            self.scale + float(step[8]),
        )


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals and Jacobian at a point."""

    residual: Floats  # (N, 3) positions, or (N, 6) positions and rotations; metres, radians
    jacobian: Floats  # (N, 3 or 6, 9)
    seconds: Floats  # (N,) timestamps of the first states, since the start of the run
    rows: NDArray[np.int64]  # (N,) indices of the increments


@dataclass(frozen=True, eq=False)
class MotionIncrements:
    """Increments of one side, in the body's axes; in the world's axes without orientations."""

    rotations: Floats | None  # (N, 4), xyzw, or None
    steps: Floats  # (N, 3), metres
    usable: Booleans  # (N,), False across gaps


class Increments:
    """Pairs of estimated states one horizon apart, and the groundtruth's motion between them."""

    def __init__(
        self, groundtruth: Trajectory, estimate: Trajectory, most: int = MOST_INCREMENTS
    ) -> None:
        """Choose at most `most` pairs without a gap between them, from two states or more each."""
        self.has_rotations = (
            groundtruth.quaternions is not None and estimate.quaternions is not None
        )
        self._groundtruth = PoseInterpolator.of(groundtruth, with_rotations=self.has_rotations)
        # The lever arm rotates with the estimate, also if the marker has no orientation.
        self.has_lever = estimate.quaternions is not None
        self._estimate = poses = PoseInterpolator.of(estimate, with_rotations=True, sparse=True)
        self.horizon_s = max(HORIZON_S, 3.0 * poses.step_s)  # of sparse keyframes
        stamps = poses.stamps
        first = np.arange(len(stamps))[every_nth(len(stamps), most)]
        last = nearest_rows(stamps, stamps[first] + whole_nanoseconds(self.horizon_s))
        stretch = np.concatenate(
            [[0], np.cumsum(np.diff(stamps) > whole_nanoseconds(poses.gap_s))]
        )
        length_s = (stamps[last] - stamps[first]) / NANOSECONDS
        whole = (np.abs(length_s - self.horizon_s) <= _TOLERANCE * self.horizon_s) & (
            stretch[first] == stretch[last]
        )
        self._first, self._last = first[whole], last[whole]
        self._since = (stamps[self._first] - stamps[0]) / NANOSECONDS
        self._till = (stamps[self._last] - stamps[0]) / NANOSECONDS
        self._mid_s = (int(stamps[-1]) - int(stamps[0])) / NANOSECONDS / 2.0
        self._body = self._motion(poses, stamps[self._first], stamps[self._last])
        self.body_rotation_change = self._rotated()

    def __len__(self) -> int:
        return len(self._first)

    def start(self, offset_s: float, *, with_scale: bool, about_z: bool) -> Unknowns:
        """Return initial parameters of the fit: closed forms at a given offset."""
        marker = self._marker(offset_s, 0.0)
        known = marker.usable
        steps, marker_steps = self._body.steps[known], marker.steps[known]
        start = Unknowns(offset_s, 0.0, np.eye(3), np.zeros(3), 1.0)
        if not known.any():
            return start
        if marker.rotations is None:
            rotation = robust_rotation(marker_steps, steps, about_z=about_z)
            moved = float(np.linalg.norm(steps))
            scale = float(np.linalg.norm(marker_steps)) / moved if with_scale and moved else 1.0
            return replace(start, rotation=rotation, scale=scale)
        assert self._body.rotations is not None
        rotation = robust_rotation(
            lie.rotation_vector(self._body.rotations[known]),
            lie.rotation_vector(marker.rotations[known]),
        )
        lever_m, scale = lever_arm(
            self.body_rotation_change[known],
            steps,
            marker_steps @ rotation.T,
            with_scale=with_scale,
        )
        return replace(start, rotation=rotation, lever_m=lever_m, scale=scale)

    def linearise(self, at: Unknowns) -> Linearised:
        """Return residuals and Jacobian of all increments inside the groundtruth."""
        marker = self._marker(at.offset_s, at.skew)
        before = self._marker(at.offset_s - _REACH_S, at.skew)
        after = self._marker(at.offset_s + _REACH_S, at.skew)
        rows = np.flatnonzero(marker.usable & before.usable & after.usable)
        residual = self._residual(at, marker, rows)
        jacobian = np.zeros((*residual.shape, COLUMNS))
        slope = self._residual(at, after, rows) - self._residual(at, before, rows)
        jacobian[..., 0] = slope / (2.0 * _REACH_S)
        jacobian[..., 1] = jacobian[..., 0] * self._from_mid(rows)[:, None]
        steps, changes = self._body.steps[rows], self.body_rotation_change[rows]
        if marker.rotations is None:
            jacobian[:, POSITION, BODY_ROTATION] = so3.skew(
                self._carried(at, rows) @ at.rotation.T
            )
            jacobian[:, POSITION, LEVER] = -at.rotation @ changes
            jacobian[:, POSITION, 8] = -steps @ at.rotation.T
        else:
            jacobian[:, POSITION, BODY_ROTATION] = -so3.skew(marker.steps[rows] @ at.rotation.T)
            in_body = at.rotation @ _matrices(marker.rotations[rows]) @ at.rotation.T
            jacobian[:, ROTATION, BODY_ROTATION] = np.eye(3) - in_body
            jacobian[:, POSITION, LEVER] = -changes
            jacobian[:, POSITION, 8] = -steps
        return Linearised(residual, jacobian, self._since[rows], rows)

    def jacobian_with_swapped_sides(
        self, at: Unknowns, rows: NDArray[np.int64]
    ) -> tuple[Floats, Booleans]:
        """Return the Jacobian (N, 3 or 6, 9) with exchanged sides, and where it is known (N,).

        At the solution, either side predicts the other's motion. The parts in which both Jacobians
        agree are not noise. For increments without orientations it has only the columns of offset,
        skew and scale.
        """
        poses, stamps = self._estimate, self._estimate.stamps
        reach_s = max(_REACH_S, poses.step_s)
        reach = whole_nanoseconds(reach_s)
        first, last = stamps[self._first[rows]], stamps[self._last[rows]]
        before = self._motion(poses, first - reach, last - reach)
        after = self._motion(poses, first + reach, last + reach)
        jacobian = np.zeros((len(rows), 6 if self.has_rotations else 3, COLUMNS))
        slope = self._marker_step(at, after) - self._marker_step(at, before)
        jacobian[:, POSITION, 0] = slope / (2.0 * reach_s)
        marker = self._marker(at.offset_s, at.skew)
        if marker.rotations is not None:
            assert before.rotations is not None
            assert after.rotations is not None
            assert self._body.rotations is not None
            inverse = lie.conjugate(self._body.rotations[rows])
            changes = lie.rotation_vector(lie.multiply(after.rotations, inverse))
            changes -= lie.rotation_vector(lie.multiply(before.rotations, inverse))
            jacobian[:, ROTATION, 0] = changes / (2.0 * reach_s)
            jacobian[:, POSITION, BODY_ROTATION] = -so3.skew(self._carried(at, rows))
            jacobian[:, ROTATION, BODY_ROTATION] = -self.body_rotation_change[rows]
            marker_rotation = at.rotation @ _matrices(
                marker.rotations[rows]
            ) @ at.rotation.T - np.eye(3)
            jacobian[:, POSITION, LEVER] = -marker_rotation
            steps = marker.steps[rows] @ at.rotation.T - marker_rotation @ at.lever_m
            jacobian[:, POSITION, 8] = -steps / at.scale
        else:
            jacobian[:, POSITION, 8] = -marker.steps[rows] / at.scale
        jacobian[..., 1] = jacobian[..., 0] * self._from_mid(rows)[:, None]
        return jacobian, before.usable & after.usable

    def _marker(self, offset_s: float, skew: float) -> MotionIncrements:
        """Return the groundtruth's increments for a clock model."""
        stamps, groundtruth = self._estimate.stamps, self._groundtruth
        first_s = offset_s + skew * (self._since - self._mid_s)
        last_s = offset_s + skew * (self._till - self._mid_s)
        return self._motion(
            groundtruth,
            stamps[self._first] + np.rint(first_s * NANOSECONDS).astype(np.int64),
            stamps[self._last] + np.rint(last_s * NANOSECONDS).astype(np.int64),
        )

    def _motion(self, poses: PoseInterpolator, first: Stamps, last: Stamps) -> MotionIncrements:
        """Return the increments of a side between timestamps (N,), (N,)."""
        start, end = poses.at(first), poses.at(last)
        steps = end.positions - start.positions
        usable = start.usable & end.usable
        if not self.has_rotations:
            return MotionIncrements(None, steps, usable)
        assert start.quaternions is not None
        assert end.quaternions is not None
        back = lie.conjugate(start.quaternions)
        return MotionIncrements(
            lie.multiply(back, end.quaternions), lie.rotate(back, steps), usable
        )

    def _rotated(self) -> Floats:
        """Return dR - I, or R_j - R_i for increments without orientations, (N, 3, 3)."""
        if self._body.rotations is not None:
            return _matrices(self._body.rotations) - np.eye(3)
        quaternions = self._estimate.quaternions
        if quaternions is None:
            return np.zeros((len(self), 3, 3))
        return _matrices(quaternions[self._last]) - _matrices(quaternions[self._first])

    def _residual(self, at: Unknowns, marker: MotionIncrements, rows: NDArray[np.int64]) -> Floats:
        """Return the residuals (N, 3 or 6) of the equations above."""
        carried = self._carried(at, rows)
        if marker.rotations is None:
            return marker.steps[rows] - carried @ at.rotation.T
        assert self._body.rotations is not None
        rotation = lie.from_matrix(at.rotation)
        residual = np.empty((len(rows), 6))
        residual[:, POSITION] = marker.steps[rows] @ at.rotation.T - carried
        in_body = lie.multiply(
            lie.multiply(rotation, marker.rotations[rows]), lie.conjugate(rotation)
        )
        residual[:, ROTATION] = lie.rotation_vector(
            lie.multiply(in_body, lie.conjugate(self._body.rotations[rows]))
        )
        return residual

    def _carried(self, at: Unknowns, rows: NDArray[np.int64]) -> Floats:
        """Return c dp + (dR - I) l of the body, (N, 3)."""
        carried: Floats = (
            at.scale * self._body.steps[rows] + self.body_rotation_change[rows] @ at.lever_m
        )
        return carried

    def _marker_step(self, at: Unknowns, body: MotionIncrements) -> Floats:
        """Return the marker's step for a motion of the body, for the offset's column."""
        if body.rotations is None:
            # The lever arm contributes little to the derivative and is omitted.
            return at.scale * body.steps @ at.rotation.T
        changes = _matrices(body.rotations) - np.eye(3)
        return at.scale * body.steps + changes @ at.lever_m

    def _from_mid(self, rows: NDArray[np.int64]) -> Floats:
        """Return the times of increments relative to the middle of the run, (N,), s."""
        middle: Floats = (self._since[rows] + self._till[rows]) / 2.0 - self._mid_s
        return middle


def _matrices(quaternions: Floats) -> Floats:
    """Return the rotation matrices (N, 3, 3) of quaternions (N, 4)."""
    return lie.to_matrix(lie.normalized(quaternions))
