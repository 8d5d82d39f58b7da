"""Conventions of poses, and the cost of each in closed form.

Displacements rotate with the world, and so do the rotation vectors of R_end R_start^T. If the
convention is right, one rotation W of the world maps the estimate's to the groundtruth's.
With H_p and H_r their moments (`short_motions.moment`), J = 2 - max over W of tr W^T (H_p + H_r)
is 0 for a perfect fit, and about 1 if one of the two does not fit. A hypothesis changes a moment,
so it costs one decomposition of a 3x3 matrix.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.diagnosis.motion_track import lengths
from trajeval_ros.diagnosis.short_motions import (
    ShortMotions,
    best_rotations,
    bound_of,
    bounded,
    moment,
    turned_in_body,
    turned_in_world,
)
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats

ESTIMATE, GROUNDTRUTH, BOTH = "estimate", "groundtruth", "both"
AS_READ = "as_read"
WXYZ, TRANSPOSED, WXYZ_TRANSPOSED = "wxyz", "transposed", "wxyz_transposed"
MIRRORED, AXES_MIXED, INVERSE = "mirrored", "axes_mixed", "inverse"
_CHANGES = {AS_READ: 0, WXYZ: 1, TRANSPOSED: 1, WXYZ_TRANSPOSED: 2}
_WRITTEN = tuple(_CHANGES)
# Columns that were read as x, y, z, w and are w, x, y, z.
W_FIRST = [1, 2, 3, 0]


def _signed_permutations() -> Floats:
    """Return the 48 matrices that exchange and flip axes, the identity first, by trace."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            found.append(matrix)
    return np.array(sorted(found, key=lambda m: (-float(np.trace(m)), -float(np.linalg.det(m)))))


_PERMUTATIONS = _signed_permutations()
_PROPER = np.linalg.det(_PERMUTATIONS) > 0.0


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A convention with its fit.

    Attributes:
        cause: `as_read`, or the name of a cause.
        side: Side with the mistake; "" if it is unknown.
        changes: Number of mistakes.
        cost: J, 0 for a perfect fit.
        turned: The rotation W (3, 3) from the estimate's world to the groundtruth's.
        moving: Correlation of the displacements.
        turning: Correlation of the rotations; 0 without orientations.
        axes: Signed permutation (3, 3) of the estimate's positions.
    """

    cause: str
    side: str
    changes: int
    cost: float
    turned: Floats
    moving: float
    turning: float
    axes: Floats


def fit_hypotheses(moving: ShortMotions, turning: ShortMotions) -> list[Hypothesis]:
    """Return all hypotheses; the first one is the convention that was read.

    Args:
        moving: Motions for displacements.
        turning: Motions for rotations.
    """
    steps = moment(bounded(moving.true_steps), bounded(moving.steps))
    if turning.truth_turned is None or turning.estimate_turned is None:
        nothing = np.zeros((3, 3))
        return _solved(
            [_Moments(AS_READ, "", 0, steps, nothing), _mirrored(steps, nothing)], perfect=1.0
        )
    true, ours = _as_written(turning.truth_turned, turning.estimate_turned)
    turns = moment(true[:, None], ours)
    as_read = turns[0, 0]
    todo = [_Moments(AS_READ, "", 0, steps, as_read)]
    for row, cause in enumerate(_WRITTEN):
        if row:
            changes = _CHANGES[cause]
            todo += [
                _Moments(cause, ESTIMATE, changes, steps, turns[0, row]),
                _Moments(cause, GROUNDTRUTH, changes, steps, turns[row, 0]),
                _Moments(cause, BOTH, changes, steps, turns[row, row]),
            ]
    # Poses mirrored as a whole, M p and M R M, equal positions times -1: M rotates the rotation
    # vectors by -M, which is a rotation.
    permuted = steps @ np.swapaxes(_PERMUTATIONS, 1, 2)
    todo += [
        _Moments(AXES_MIXED if proper else MIRRORED, "", 1, permuted[row], as_read, permutation)
        for row, (permutation, proper) in enumerate(zip(_PERMUTATIONS, _PROPER, strict=True))
        if row
    ]
    inverse = _WRITTEN.index(TRANSPOSED)
    inverted = bounded(_steps_if_inverted(moving.estimate, moving.estimate_turned))
    steps_of_inverse = moment(bounded(moving.true_steps), inverted)
    todo.append(_Moments(INVERSE, ESTIMATE, 1, steps_of_inverse, turns[0, inverse]))
    inverted = bounded(_steps_if_inverted(moving.truth, moving.truth_turned))
    steps_of_inverse = moment(inverted, bounded(moving.steps))
    todo.append(_Moments(INVERSE, GROUNDTRUTH, 1, steps_of_inverse, turns[inverse, 0]))
    return _solved(todo, perfect=2.0)


class _Moments(NamedTuple):
    cause: str
    side: str
    changes: int
    steps: Floats
    turns: Floats
    axes: Floats = np.eye(3)


def _mirrored(steps: Floats, turns: Floats) -> _Moments:
    return _Moments(MIRRORED, "", 1, -steps, turns, -np.eye(3))


def _as_written(truth: Floats, estimate: Floats) -> Floats:
    """Return bounded rotation vectors (2, 4, N, 3) of both sides, by convention of quaternions.

    Args:
        truth: (2, N, 4) quaternions of the groundtruth at starts and ends.
        estimate: (2, N, 4) of the estimate.

    Returns:
        In the order of `_WRITTEN`.
    """
    sides = np.stack([truth, estimate], axis=1)
    orders = np.stack([sides, sides[..., W_FIRST]], axis=2)
    world = turned_in_world(orders)
    vectors = np.concatenate([world, -turned_in_body(orders)], axis=1)
    # Order of components and side of the product do not change the angle.
    bounds = np.array([bound_of(size) for size in lengths(world[:, 0])])
    written: Floats = vectors / bounds[:, None, :, None]
    return written


def _steps_if_inverted(positions: Floats, quaternions: Floats | None) -> Floats:
    """Return displacements (N, 3) of poses (2, N) under the hypothesis of inverse poses."""
    assert quaternions is not None
    steps: Floats = np.diff(lie.rotate(lie.conjugate(quaternions), -positions), axis=0)[0]
    return steps


def _solved(todo: list[_Moments], perfect: float) -> list[Hypothesis]:
    steps, turns = np.array([each.steps for each in todo]), np.array([each.turns for each in todo])
    best, turned = best_rotations(steps + turns)
    moving = np.einsum("nij,nij->n", turned, steps)
    turning = np.einsum("nij,nij->n", turned, turns)
    return [
        Hypothesis(
            each.cause,
            each.side,
            each.changes,
            perfect - float(best[row]),
            turned[row],
            float(moving[row]),
            float(turning[row]),
            each.axes,
        )
        for row, each in enumerate(todo)
    ]


def body_angle(hypothesis: Hypothesis, motions: ShortMotions) -> float:
    """Return the angle between the axes of the bodies, deg, under the hypothesis."""
    assert motions.truth_turned is not None
    assert motions.estimate_turned is not None
    true, ours = motions.truth_turned[0], motions.estimate_turned[0]
    if hypothesis.cause in (WXYZ, WXYZ_TRANSPOSED):
        ours = ours[:, W_FIRST] if hypothesis.side in (ESTIMATE, BOTH) else ours
        true = true[:, W_FIRST] if hypothesis.side in (GROUNDTRUTH, BOTH) else true
    if hypothesis.cause in (TRANSPOSED, WXYZ_TRANSPOSED, INVERSE):
        ours = lie.conjugate(ours) if hypothesis.side in (ESTIMATE, BOTH) else ours
        true = lie.conjugate(true) if hypothesis.side in (GROUNDTRUTH, BOTH) else true
    aligned = lie.multiply(lie.from_matrix(hypothesis.turned), ours)
    mean = mean_rotation(lie.multiply(lie.conjugate(aligned), true))
    # A mirrored world mirrors the body: 180 deg about one of its axes are the same axes.
    near = np.abs(mean).max() if hypothesis.cause == MIRRORED else abs(mean[3])
    return float(np.degrees(2.0 * np.arccos(min(1.0, float(near)))))


def shorter_if_inverted(motions: ShortMotions) -> str:
    """Return the side with the larger decrease of path length by inversion."""
    gains = []
    for positions, quaternions in (
        (motions.estimate, motions.estimate_turned),
        (motions.truth, motions.truth_turned),
    ):
        before = np.linalg.norm(positions[1] - positions[0], axis=1).sum()
        after = np.linalg.norm(_steps_if_inverted(positions, quaternions), axis=1).sum()
        gains.append(float(after) / max(float(before), 1e-12))
    return ESTIMATE if gains[0] < gains[1] else GROUNDTRUTH


def mean_rotation(quaternions: Floats) -> Floats:
    """Return the quaternion (4,) nearest to N of them, (N, 4), of either sign."""
    mean: Floats = np.linalg.eigh(quaternions.T @ quaternions)[1][:, -1]
    return mean


def mirrored_quaternions(quaternions: Floats, axes: Floats) -> Floats:
    """Return the quaternions (N, 4) of M R M^T, M a signed permutation (3, 3) of either hand."""
    turned = quaternions.copy()
    turned[:, :3] = np.linalg.det(axes) * quaternions[:, :3] @ axes.T
    return turned
