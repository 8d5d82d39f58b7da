"""How much the motions of groundtruth and estimate differ."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices, lengths

Rows: TypeAlias = Indices | slice
# Rotation, its products, lever arm, and the matrix and vector of the lever arm.
BodyState: TypeAlias = tuple[Floats | None, Floats, Floats, Floats, Floats]

# Columns of pairs (..., 15): time, seconds, and the poses of both sides, metres and xyzw.
GROUNDTRUTH_POSITION, GROUNDTRUTH_QUATERNION = slice(1, 4), slice(4, 8)
POSITION, QUATERNION = slice(8, 11), slice(11, 15)
PAIR_WIDTH = QUATERNION.stop
# Columns of pairs by the relation of both sides: positions of both, metres, the lever arm, and the
# rotation from the estimate's world to the groundtruth's.
_POINT, _SCALED, _ARM, _WORLD = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 13)

CELL_S = 0.5  # time between learned pairs: shorter learns noise, longer learns late
_MEMORY_S = 60.0  # of rotation, scale and lever arm
_LEAST_FITS, _LEAST_PATH_M = 12, 1.0  # before rotation and scale are used
_OUTLIER, _OUTLIER_M = 4.0, 0.25  # a displacement of 4 times the groundtruth's is not learned
_REGULAR = 0.05  # m^2: a lever arm without rotations is zero


class Difference(NamedTuple):
    """What the estimate moves more or less than the groundtruth between two pairs, or N times."""

    m: Floats
    deg: Floats
    groundtruth_m: Floats  # the groundtruth's displacement
    lengths_m: Floats  # difference of the lengths of the displacements

    def size(self, row: int) -> Size:
        """Return the size of one of N differences."""
        return Size(float(self.m[row]), float(self.deg[row]))


class Size(NamedTuple):
    """Size of one difference, metres and deg."""

    m: float
    deg: float


class RelativeMotion:
    """Compares motions in the body, whose rotation, scale and lever arm it learns.

    The body's rotation R is that of Wahba's problem for displacements and rotation vectors: a car
    needs both. Without orientations, R rotates the estimate's frame to the groundtruth's.
    """

    def __init__(self, *, oriented: bool) -> None:
        self.oriented = oriented
        self.scale = 1.0  # metres per unit of the estimate
        self.rotation: Floats | None = None  # (3, 3); None until enough motion is known
        self.lever_m: Floats = np.zeros(3)
        self.products: Floats = np.zeros((3, 3))
        self._lever_matrix, self._lever_vector = np.zeros((3, 3)), np.zeros(3)
        self._lengths = self._squares = self._path_m = 0.0
        self._fits = 0

    @property
    def state(self) -> BodyState:
        """What a rotation of the body changes."""
        return (
            self.rotation,
            self.products,
            self.lever_m,
            self._lever_matrix,
            self._lever_vector,
        )

    @state.setter
    def state(self, state: BodyState) -> None:
        self.rotation, self.products, self.lever_m, *lever = state
        self._lever_matrix, self._lever_vector = lever

    def rotate(self, matrix: Floats) -> None:
        """Rotate the groundtruth's body by a matrix (3, 3)."""
        rotation, products, lever, lever_matrix, lever_vector = self.state
        self.state = (
            None if rotation is None else matrix @ rotation,
            matrix @ products,
            matrix @ lever,
            matrix @ lever_matrix @ matrix.T,
            matrix @ lever_vector,
        )

    def forget_frame(self) -> None:
        """Forget the rotation between frames, which a step without orientations may change."""
        self.rotation, self._fits, self._path_m = None, 0, 0.0
        self.products = np.zeros((3, 3))
        self._lengths = self._squares = 0.0

    def between(self, begin: Floats, end: Floats, *, rotation: Floats | None = None) -> Difference:
        """Return the differences of the motions between pairs (..., 15), which broadcast.

        `rotation` (3, 3) is another rotation of the body.
        """
        rotation = self.rotation if rotation is None else rotation
        if rotation is not None and self.oriented:
            return _difference(*(self._related(pairs, rotation) for pairs in (begin, end)))
        d = end[..., GROUNDTRUTH_POSITION] - begin[..., GROUNDTRUTH_POSITION]
        e = self.scale * (end[..., POSITION] - begin[..., POSITION])
        moved_m = lengths(d)
        lengths_m = np.abs(moved_m - lengths(e))
        if not self.oriented:
            m = lengths_m if rotation is None else lengths(d - e @ rotation.T)
            return Difference(m, np.zeros_like(m), moved_m, lengths_m)
        rotated, rotated_estimate = _rotations(begin, end)
        deg = np.degrees(np.abs(lie.angle(rotated) - lie.angle(rotated_estimate)))
        return Difference(lengths_m, deg, moved_m, lengths_m)

    def among(self, pairs: Floats, begins: Rows, ends: Rows) -> Difference:
        """Return the differences of the motions between rows of pairs (M, 15)."""
        if self.rotation is None or not self.oriented:
            return self.between(pairs[begins], pairs[ends])
        related = self._related(pairs, self.rotation)
        return _difference(related[begins], related[ends])

    def _related(self, pairs: Floats, rotation: Floats) -> Floats:
        """Return columns (..., 13) of pairs (..., 15) by the relation of both sides."""
        quaternions = pairs[..., GROUNDTRUTH_QUATERNION]
        related = np.empty((*pairs.shape[:-1], _WORLD.stop))
        related[..., _POINT] = pairs[..., GROUNDTRUTH_POSITION]
        related[..., _SCALED] = self.scale * pairs[..., POSITION]
        related[..., _ARM] = lie.rotate(quaternions, self.lever_m)
        body = lie.multiply(quaternions, lie.from_matrix(rotation))
        related[..., _WORLD] = lie.multiply(body, lie.conjugate(pairs[..., QUATERNION]))
        return related

    def size(self, begin: Floats, end: Floats) -> Size:
        """Return the difference of the motions between two pairs (15,)."""
        return self.between(begin, end[None]).size(0)

    def learn(self, begin: Floats, end: Floats) -> bool:
        """Learn from N motions between pairs (N, 15), in order of time.

        Returns whether the rotation is known from now on.
        """
        d = end[:, GROUNDTRUTH_POSITION] - begin[:, GROUNDTRUTH_POSITION]
        e = end[:, POSITION] - begin[:, POSITION]
        moved_m, estimate_m = lengths(d), lengths(e)
        if self._fits > _LEAST_FITS:
            usable = self.scale * estimate_m <= _OUTLIER * np.maximum(moved_m, _OUTLIER_M)
            begin, end, d, e = begin[usable], end[usable], d[usable], e[usable]
            moved_m, estimate_m = moved_m[usable], estimate_m[usable]
        if not len(d):
            return False
        # What is left of every motion at the last one; a hover keeps the fit.
        left = np.cumprod(np.where(moved_m > 0.05, math.exp(-CELL_S / _MEMORY_S), 1.0)[::-1])
        kept, weights = float(left[-1]), np.append(left[-2::-1], 1.0)[:, None]
        x, y = d, self.scale * e
        added = np.zeros((3, 3))
        if self.oriented:
            rotated, rotated_estimate = _rotations(begin, end)
            x = lie.rotate(lie.conjugate(begin[:, GROUNDTRUTH_QUATERNION]), x)
            y = lie.rotate(lie.conjugate(begin[:, QUATERNION]), y)
            vectors = lie.rotation_vector(rotated), lie.rotation_vector(rotated_estimate)
            added = (weights * vectors[0]).T @ vectors[1]
            if self.rotation is not None:
                matrices = lie.to_matrix(rotated) - np.eye(3)
                stacked = (np.sqrt(weights)[:, :, None] * matrices).reshape(-1, 3)
                rest = (np.sqrt(weights) * (x - y @ self.rotation.T)).reshape(-1)
                self._lever_matrix = kept * self._lever_matrix + stacked.T @ stacked
                self._lever_vector = kept * self._lever_vector + stacked.T @ rest
        self.products = kept * self.products + (weights * x).T @ y + added
        self._lengths = kept * self._lengths + float(weights[:, 0] @ (moved_m * estimate_m))
        self._squares = kept * self._squares + float(weights[:, 0] @ (estimate_m * estimate_m))
        self._path_m, self._fits = self._path_m + float(moved_m.sum()), self._fits + len(d)
        if self._fits < _LEAST_FITS or self._path_m <= _LEAST_PATH_M or not self._squares > 0.0:
            return False
        was_known, self.scale = self.rotation is not None, self._lengths / self._squares
        before, _, after = np.linalg.svd(self.products)
        # Mirrored axes are another mistake: without orientations, a reflection is allowed.
        if self.oriented and np.linalg.det(before @ after) < 0.0:
            before[:, 2] *= -1.0
        self.rotation = np.asarray(before @ after)
        if self.oriented:
            regular = self._lever_matrix + _REGULAR * np.eye(3)
            self.lever_m = np.asarray(np.linalg.solve(regular, self._lever_vector))
        return not was_known


def rotation_beyond(motion: RelativeMotion, begin: Floats, end: Floats) -> Floats:
    """Return the matrix (3, 3) by which a flip between two pairs rotates vectors in the body.

    It is applied to vectors in the groundtruth's body before it, if the groundtruth flips.
    """
    assert motion.rotation is not None
    rotated, rotated_estimate = _rotations(begin, end)
    rotated_estimate[:3] = motion.rotation @ rotated_estimate[:3]
    return lie.to_matrix(lie.multiply(lie.conjugate(rotated), rotated_estimate))


def _difference(begin: Floats, end: Floats) -> Difference:
    """Return the differences between columns of `RelativeMotion._related`, which broadcast.

    The estimate's displacement is rotated to the groundtruth's world by the poses at the begin and
    by those at the end: an orientation that is wrong is at one of them.
    """
    moved = end - begin
    d, e = moved[..., _POINT], moved[..., _SCALED]
    moved_m, arms = lengths(d), moved[..., _ARM]
    m = np.minimum(
        *(lengths(d - arms - lie.rotate(side[..., _WORLD], e)) for side in (begin, end))
    )
    chords = lengths(moved[..., _WORLD]), lengths(end[..., _WORLD] + begin[..., _WORLD])
    deg = np.degrees(4.0 * np.arctan2(np.minimum(*chords), np.maximum(*chords)))
    return Difference(m, deg, moved_m, np.abs(moved_m - lengths(e)))


def _rotations(begin: Floats, end: Floats) -> list[Floats]:
    """Return the rotations (..., 4) of groundtruth and estimate between pairs (..., 15)."""
    return [
        lie.multiply(lie.conjugate(begin[..., columns]), end[..., columns])
        for columns in (GROUNDTRUTH_QUATERNION, QUATERNION)
    ]
