"""The table of mistakes in how poses are written, with their prior probabilities.

A hypothesis states how the columns of a side are to be read. It is combined with the 48 signed
permutations of the axes of the positions, and with rotations of the body (`motion_models.py`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from operator import itemgetter

import numpy as np

from trajeval_ros.diagnosis.short_motions import PoseEnds
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.pose_conventions import W_FIRST, W_THIRD

ODDS = 12.0  # least logarithm of odds of a statement: alarms against missed mistakes
TIE = 3.0  # largest difference of logarithms between models that the motion can't distinguish
# Logarithms of prior probabilities: rare mistakes need more evidence than frequent ones.
MISTAKE = -3.0  # a mistake, such as quaternions with w first
_OF_GROUNDTRUTH = -0.5  # in addition, of the groundtruth; twice of both sides
_EXCHANGED_AXES, _PER_CHANGED_AXIS = -2.0, -0.25  # axes exchanged, and flipped or exchanged
_MIRROR, _MIRROR_PER_AXIS = 1.5, -0.1  # poses mirrored as a whole: most often one axis flips
OTHER_BODY = -5.0  # axes of the body exchanged or flipped, such as a camera's
ROTATED_BODY = -9.0  # axes of the body with any rotation

AS_READ, ROTATIONS = "as_read", "rotations"
ESTIMATE, GROUNDTRUTH, BOTH = "estimate", "groundtruth", "both"


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """How the columns of a side are to be read instead."""

    cause: str  # name in `causes.py`, or `AS_READ`
    side: str  # whose columns change: `ESTIMATE`, `GROUNDTRUTH`, `BOTH`, or "" for none
    log_prior: float
    # Changes quaternions (..., 4) into those of this hypothesis; None if poses are inverted.
    change: Callable[[Floats], Floats] | None = None
    with_axes: bool = False  # whether the positions may have other axes, too
    order: str = ""  # value of --quaternion-order that corrects it
    inverse: str = ""  # value of --inverse that corrects it
    detail: str = ""  # what differs, for the cause `ROTATIONS`

    def applied(self, side: str, poses: PoseEnds) -> PoseEnds:
        """Return the poses of a side as this hypothesis reads them."""
        positions, quaternions = poses.positions, poses.quaternions
        if self.side not in (side, BOTH) or quaternions is None:
            return poses
        if self.change is not None:
            return PoseEnds(positions, self.change(quaternions))
        inverse = lie.conjugate(quaternions)
        return PoseEnds(-lie.rotate(inverse, positions), inverse)


def _w_first_inverse(quaternions: Floats) -> Floats:
    return lie.conjugate(quaternions[..., W_FIRST])


def _table() -> list[Hypothesis]:
    rows = [Hypothesis(AS_READ, "", 0.0, with_axes=True)]
    for side, prior in (
        (ESTIMATE, 0.0),
        (GROUNDTRUTH, _OF_GROUNDTRUTH),
        (BOTH, 2.0 * _OF_GROUNDTRUTH),
    ):
        # With other axes on the groundtruth's side, worlds that differ by 90 deg match at random.
        axes, one = side == ESTIMATE, MISTAKE + prior
        of_side = [
            Hypothesis("wxyz", side, one, itemgetter((..., W_FIRST)), axes, order="wxyz"),
            Hypothesis("transposed", side, one, lie.conjugate, axes, inverse="rotations"),
            Hypothesis("xyzw", side, one - 0.5, itemgetter((..., W_THIRD)), order="yzwx"),
            Hypothesis("wxyz_transposed", side, one + MISTAKE, _w_first_inverse, axes,
                       order="wxyz", inverse="rotations"),
            Hypothesis("inverse", side, one, inverse="poses"),
        ]  # fmt: skip
        rows += of_side[:2] if side == BOTH else of_side
    return rows


HYPOTHESES = _table()


def euler_angles_changed(
    quaternions: Floats, read: str, written: str, factors: Floats | None = None
) -> Floats:
    """Return the rotations (..., 4) if Euler angles were read in another way than written.

    The angles about the intrinsic axes `read`, such as "ZYX", are multiplied by factors (3,),
    and applied about the axes `written`.
    """
    matrices = lie.to_matrix(quaternions)
    a, b, c = ("XYZ".index(axis) for axis in read)
    sign = -1.0 if _is_odd(read) else 1.0  # of the order of the axes
    angles = np.stack(
        [
            np.arctan2(-sign * matrices[..., b, c], matrices[..., c, c]),
            np.arcsin(np.clip(sign * matrices[..., a, c], -1.0, 1.0)),
            np.arctan2(-sign * matrices[..., a, b], matrices[..., a, a]),
        ]
    )
    if factors is not None:
        angles *= factors.reshape(3, *[1] * (angles.ndim - 1))
    first, second, third = (
        lie.from_rotation_vector(angle[..., None] * np.eye(3)["XYZ".index(axis)])
        for angle, axis in zip(angles, written, strict=True)
    )
    return lie.multiply(lie.multiply(first, second), third)


def _is_odd(order: str) -> bool:
    return bool(np.linalg.det(np.eye(3)[["XYZ".index(axis) for axis in order]]) < 0.0)


def _euler_table() -> list[Hypothesis]:
    """Return mistakes in Euler angles that are no change of axes.

    Even permutations of the order and two flipped signs are changes of axes.
    """
    orders = ["".join(axes) for axes in itertools.permutations("XYZ")]
    what = "the order of the Euler angles differs"
    rows = [
        _euler(2.0 * MISTAKE, what, read, written)
        for read, written in itertools.permutations(orders, 2)
        if _is_odd(read) != _is_odd(written)
    ]
    what = "the sign of an Euler angle differs; a compass heading is clockwise"
    flips = map(np.array, itertools.product((1.0, -1.0), repeat=3))
    rows += [_euler(MISTAKE, what, signs=s) for s in flips if s.sum() in (1.0, -3.0)]
    what = "radians were probably read as degrees"
    return [*rows, _euler(MISTAKE, what, signs=np.full(3, math.degrees(1.0)))]


def _euler(
    prior: float, detail: str, read: str = "ZYX", written: str = "ZYX", signs: Floats | None = None
) -> Hypothesis:
    change = partial(euler_angles_changed, read=read, written=written, factors=signs)
    return Hypothesis(ROTATIONS, ESTIMATE, prior, change, detail=detail)


EULER_HYPOTHESES = _euler_table()


def _signed_permutations() -> Floats:
    """Return the 48 matrices that exchange and flip axes, the identity first, by trace."""
    orders, signs = itertools.permutations(np.eye(3)), itertools.product((1.0, -1.0), repeat=3)
    rows = [np.diag(some) @ order for order, some in itertools.product(orders, signs)]
    return np.array(sorted(rows, key=lambda m: (-float(np.trace(m)), -float(np.linalg.det(m)))))


PERMUTATIONS = _signed_permutations()  # (48, 3, 3)
PROPER = np.array([axes for axes in PERMUTATIONS if np.linalg.det(axes) > 0.0])  # (24, 3, 3)
# M p and M R M with a mirror M is -1 times the positions, and the body rotated by -M.
MIRRORED = int(np.flatnonzero((-np.eye(3) == PERMUTATIONS).all(axis=(1, 2)))[0])


def _log_priors() -> tuple[Floats, Floats]:
    """Return the logarithms of priors of axes (48,), and of mirrors M = -PROPER (24,)."""
    changed = 3.0 - np.einsum("pii->p", PERMUTATIONS)
    kept, kept_of_mirror = (np.einsum("pii->p", np.abs(axes)) for axes in (PERMUTATIONS, PROPER))
    axes = MISTAKE + _EXCHANGED_AXES * (kept < 3.0) + _PER_CHANGED_AXIS * changed
    mirrors = _MIRROR + _EXCHANGED_AXES * (kept_of_mirror < 3.0)
    mirrors += _MIRROR_PER_AXIS * (3.0 + np.einsum("pii->p", PROPER))
    return np.where(changed > 0.0, axes, 0.0), mirrors


AXES_LOG_PRIORS, MIRROR_LOG_PRIORS = _log_priors()
