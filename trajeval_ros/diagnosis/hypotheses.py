"""Short motions of both sides: over two seconds drift is small, and a mistake is not.

They start and end at poses of the estimate, because interpolation of a sparse estimate cuts its
curves. The groundtruth is interpolated.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trajeval_ros.diagnosis.input_pair import TimedPoses, lengths
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.pose_conventions import W_FIRST
from trajeval_ros.geometry.trajectory_edits import evenly
from trajeval_ros.metrics.statistics import median

_COUNT = 600
_FEWEST = 12
# A jump is longer than this multiple of the median step; more jumps are normal for the estimate.
_JUMP, _MOST_JUMPS = 30.0, 20


@dataclass(frozen=True, eq=False)
class ShortMotions:
    """N short motions of both sides."""

    rows: Indices  # (N, 2) rows of the estimate at starts and ends
    groundtruth: Floats  # (2, N, 3) positions of the groundtruth at starts and ends
    estimate: Floats  # (2, N, 3) positions of the estimate
    # (2, N, 4) quaternions of the groundtruth; None unless both have them.
    groundtruth_turned: Floats | None
    # (2, N, 4) quaternions of the estimate; None unless both have them.
    estimate_turned: Floats | None

    @classmethod
    def between(
        cls, groundtruth: TimedPoses, estimate: TimedPoses, apart_s: float, max_gap_s: float
    ) -> ShortMotions:
        """Return evenly sampled motions of a recording with equal clocks."""
        times = estimate.seconds
        first = int(np.searchsorted(times, groundtruth.seconds[0]))
        count = max(0, int(np.searchsorted(times, groundtruth.seconds[-1], side="right")) - first)
        start = first + evenly(count, min(count, _COUNT))
        end = np.searchsorted(times, times[start] + 0.999 * apart_s)
        fits = end < first + count
        start, end = start[fits], end[fits]
        fits = times[end] - times[start] < 2.0 * apart_s + 0.2
        rows = np.stack([start[fits], end[fits]])
        true = groundtruth.at(times[rows].ravel(), max_gap_s)
        known = true.known.reshape(2, -1).all(axis=0)
        rows, positions = rows[:, known], true.positions.reshape(2, -1, 3)[:, known]
        groundtruth_turned = estimate_turned = None
        if true.quaternions is not None and estimate.quaternions is not None:
            groundtruth_turned = true.quaternions.reshape(2, -1, 4)[:, known]
            estimate_turned = estimate.quaternions[rows]
        sides = positions, estimate.positions[rows], groundtruth_turned, estimate_turned
        return cls(rows.T, *sides)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def enough(self) -> bool:
        """Whether there are enough motions for a test."""
        return len(self) >= _FEWEST

    @property
    def true_steps(self) -> Floats:
        """Displacements of the groundtruth, (N, 3)."""
        return np.asarray(self.groundtruth[1] - self.groundtruth[0])

    @property
    def steps(self) -> Floats:
        """Displacements of the estimate, (N, 3)."""
        return np.asarray(self.estimate[1] - self.estimate[0])

    @cached_property
    def turns(self) -> tuple[Floats, Floats] | None:
        """Rotation vectors (N, 3) of both sides, in their worlds; None unless both have them."""
        if self.groundtruth_turned is None or self.estimate_turned is None:
            return None
        return turned_in_world(self.groundtruth_turned), turned_in_world(self.estimate_turned)

    @cached_property
    def moment_of_steps(self) -> Floats:
        """The moment (3, 3) of the displacements."""
        return moment(bounded(self.true_steps), bounded(self.steps))

    @cached_property
    def moment_of_turns(self) -> Floats:
        """The moment (3, 3) of the rotations, zero without orientations."""
        return np.zeros((3, 3)) if self.turns is None else moment(*map(bounded, self.turns))

    @cached_property
    def thirds(self) -> list[ShortMotions]:
        """Three parts of the run with about equal distances travelled by the groundtruth."""
        way = np.cumsum(lengths(bounded(self.true_steps)))
        part = np.minimum(3.0 * way / max(float(way[-1]), 1e-300), 2.0).astype(np.int64)
        return [self._only(part == each) for each in range(3)]

    def world(self) -> Floats:
        """Return the rotation (3, 3) from the estimate's world that fits the motions best."""
        return best_rotations(self.moment_of_steps + self.moment_of_turns)[1]

    def without_jumps(self, estimate: TimedPoses) -> ShortMotions:
        """Return the motions without a jump of the estimate: a restart rotates its world."""
        moved = estimate.moved
        far = moved > _JUMP * median(moved[evenly(len(moved), 2000)])
        jumps = np.concatenate([[0], np.cumsum(far)])
        if not 0 < jumps[-1] <= _MOST_JUMPS:
            return self
        smooth = jumps[self.rows[:, 0]] == jumps[self.rows[:, 1]]
        return self._only(smooth) if np.count_nonzero(smooth) >= _FEWEST else self

    def without_rotations(self) -> ShortMotions:
        """Return the motions of the positions."""
        return replace(self, groundtruth_turned=None, estimate_turned=None)

    def _only(self, keep: Booleans) -> ShortMotions:
        return ShortMotions(
            self.rows[keep],
            self.groundtruth[:, keep],
            self.estimate[:, keep],
            None if self.groundtruth_turned is None else self.groundtruth_turned[:, keep],
            None if self.estimate_turned is None else self.estimate_turned[:, keep],
        )


def turned_in_world(quaternions: Floats) -> Floats:
    """Return the rotation vectors (..., 3) of R_end R_start^T, of the world, (2, ..., 4)."""
    return lie.rotation_vector(lie.multiply(quaternions[1], lie.conjugate(quaternions[0])))


def turned_in_body(quaternions: Floats) -> Floats:
    """Return the rotation vectors (..., 3) of R_start^T R_end, of the body, (2, ..., 4)."""
    return lie.rotation_vector(lie.multiply(lie.conjugate(quaternions[0]), quaternions[1]))


def bounded(vectors: Floats) -> Floats:
    """Return vectors (N, 3) with limited lengths, so that outliers have little weight."""
    return np.asarray(vectors / bound_of(lengths(vectors))[:, None])


def bound_of(size: Floats) -> Floats:
    """Return the divisors (N,) of vectors of given lengths that limit their lengths."""
    usual = median(size[size > 0.0]) if (size > 0.0).any() else 1.0
    return size + 2.0 * usual


def moment(groundtruth: Floats, estimate: Floats) -> Floats:
    """Return the normalised sums (..., 3, 3) of G E^T over N vectors G and E, (..., N, 3).

    The trace of W^T times it is the correlation of the vectors under a rotation W.
    """
    norm = np.sqrt(
        np.square(groundtruth).sum(axis=(-1, -2)) * np.square(estimate).sum(axis=(-1, -2))
    )
    summed = np.swapaxes(groundtruth, -1, -2) @ estimate
    return np.asarray(summed / np.maximum(norm, 1e-300)[..., None, None])


def best_rotations(moments: Floats) -> tuple[Floats, Floats]:
    """Return the largest trace of W^T H over rotations W, (...), and W (..., 3, 3), per H."""
    u, s, vt = np.linalg.svd(moments)
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    flipped = u.copy()
    flipped[..., :, 2] *= sign[..., None]
    return s[..., 0] + s[..., 1] + sign * s[..., 2], flipped @ vt


ESTIMATE, GROUNDTRUTH, BOTH = "estimate", "groundtruth", "both"
AS_READ = "as_read"
WXYZ, TRANSPOSED, WXYZ_TRANSPOSED = "wxyz", "transposed", "wxyz_transposed"
MIRRORED, AXES_MIXED, INVERSE = "mirrored", "axes_mixed", "inverse"
_CHANGES = {AS_READ: 0, WXYZ: 1, TRANSPOSED: 1, WXYZ_TRANSPOSED: 2}
_WRITTEN = tuple(_CHANGES)


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
    """A convention with its fit."""

    cause: str  # `as_read`, or the name of a cause
    side: str  # side with the mistake; "" if it is unknown
    changes: int  # number of mistakes
    cost: float  # J, 0 for a perfect fit
    turned: Floats  # the rotation W (3, 3) from the estimate's world to the groundtruth's
    moving: float  # correlation of the displacements
    moving_alone: float  # largest correlation of the displacements under any rotation
    turning: float  # correlation of the rotations; 0 without orientations
    axes: Floats  # signed permutation (3, 3) of the estimate's positions

    @property
    def flips(self) -> float:
        """Distance of `axes` from the identity: 0 for none."""
        return 3.0 - float(np.trace(self.axes))


def fit_as_read(moving: ShortMotions, turning: ShortMotions) -> Hypothesis:
    """Return the hypothesis that the convention is the one that was read."""
    as_read = _Moments(AS_READ, "", 0, moving.moment_of_steps, turning.moment_of_turns)
    return _solved([as_read], perfect=1.0 if turning.turns is None else 2.0)[0]


def fit_others(
    moving: ShortMotions, turning: ShortMotions, *, composed: bool = False
) -> list[Hypothesis]:
    """Return hypotheses of one mistake.

    With `composed`, they are those of a written form of the rotations and other axes of the
    positions.
    """
    steps, read = moving.moment_of_steps, turning.moment_of_turns
    if turning.groundtruth_turned is None or turning.estimate_turned is None:
        return _solved([_Moments(MIRRORED, "", 1, -steps, read, -np.eye(3))], perfect=1.0)
    true, ours = _as_written(turning.groundtruth_turned, turning.estimate_turned)
    turns = moment(true[:, None], ours)
    forms: list[_Moments] = []
    for row, cause in enumerate(_WRITTEN[1:], 1):
        sides = {ESTIMATE: turns[0, row], GROUNDTRUTH: turns[row, 0], BOTH: turns[row, row]}
        forms += [
            _Moments(cause, side, _CHANGES[cause], steps, turned) for side, turned in sides.items()
        ]
    # Poses mirrored as a whole, M p and M R M, equal positions times -1: M rotates the rotation
    # vectors by -M, which is a rotation.
    permuted = steps @ np.swapaxes(_PERMUTATIONS, 1, 2)
    others = [
        (AXES_MIXED if proper else MIRRORED, permuted[row], _PERMUTATIONS[row])
        for row, proper in enumerate(_PROPER)
        if row
    ]
    if composed:
        return _solved(
            [
                form._replace(changes=form.changes + 1, steps=moved, axes=axes)
                for form in forms
                if form.side != BOTH
                for _, moved, axes in others
            ],
            perfect=2.0,
        )
    todo = [*forms, *(_Moments(cause, "", 1, moved, read, axes) for cause, moved, axes in others)]
    inverse = _WRITTEN.index(TRANSPOSED)
    ours = _steps_if_inverted(moving.estimate, moving.estimate_turned)
    inverted = moment(bounded(moving.true_steps), bounded(ours))
    todo.append(_Moments(INVERSE, ESTIMATE, 1, inverted, turns[0, inverse]))
    true = _steps_if_inverted(moving.groundtruth, moving.groundtruth_turned)
    inverted = moment(bounded(true), bounded(moving.steps))
    todo.append(_Moments(INVERSE, GROUNDTRUTH, 1, inverted, turns[inverse, 0]))
    return _solved(todo, perfect=2.0)


def sizes_apart(one: Floats, other: Floats) -> float:
    """Return 1 - correlation of the lengths of bounded vectors (N, 3).

    No convention changes lengths, so this is the noise that remains in the right one.
    """
    a, b = lengths(bounded(one)), lengths(bounded(other))
    return 1.0 - float(a @ b) / max(float(np.sqrt((a @ a) * (b @ b))), 1e-300)


class _Moments(NamedTuple):
    cause: str
    side: str
    changes: int
    steps: Floats
    turns: Floats
    axes: Floats = np.eye(3)


def _as_written(groundtruth: Floats, estimate: Floats) -> Floats:
    """Return bounded rotation vectors (2, 4, N, 3) of both sides, in the order of `_WRITTEN`.

    The quaternions are (2, N, 4), at starts and ends.
    """
    sides = np.stack([groundtruth, estimate], axis=1)
    orders = np.stack([sides, sides[..., W_FIRST]], axis=2)
    world = turned_in_world(orders)
    vectors = np.concatenate([world, -turned_in_body(orders)], axis=1)
    # Order of components and side of the product do not change the angle.
    bounds = np.array([bound_of(size) for size in lengths(world[:, 0])])
    return np.asarray(vectors / bounds[:, None, :, None])


def _steps_if_inverted(positions: Floats, quaternions: Floats | None) -> Floats:
    """Return displacements (N, 3) of poses (2, N) under the hypothesis of inverse poses."""
    assert quaternions is not None
    return np.asarray(np.diff(lie.rotate(lie.conjugate(quaternions), -positions), axis=0)[0])


def _solved(todo: list[_Moments], perfect: float) -> list[Hypothesis]:
    steps, turns = np.array([each.steps for each in todo]), np.array([each.turns for each in todo])
    best, turned = best_rotations(steps + turns)
    moving = np.einsum("nij,nij->n", turned, steps)
    alone = best_rotations(steps)[0]
    turning = np.einsum("nij,nij->n", turned, turns)
    return [
        Hypothesis(
            each.cause,
            each.side,
            each.changes,
            perfect - float(best[row]),
            turned[row],
            float(moving[row]),
            float(alone[row]),
            float(turning[row]),
            each.axes,
        )
        for row, each in enumerate(todo)
    ]


def as_written(
    hypothesis: Hypothesis, groundtruth: Floats, estimate: Floats
) -> tuple[Floats, Floats]:
    """Return the quaternions (N, 4) of both sides under the hypothesis."""
    sides = []
    for side, quaternions in ((GROUNDTRUTH, groundtruth), (ESTIMATE, estimate)):
        if hypothesis.side in (side, BOTH):
            if hypothesis.cause in (WXYZ, WXYZ_TRANSPOSED):
                quaternions = quaternions[:, W_FIRST]
            if hypothesis.cause in (TRANSPOSED, WXYZ_TRANSPOSED, INVERSE):
                quaternions = lie.conjugate(quaternions)
        sides.append(quaternions)
    return sides[0], sides[1]


def improper_permutations() -> Floats:
    """Return the 24 matrices (24, 3, 3) that exchange and flip axes and change the handedness."""
    mirrors: Floats = _PERMUTATIONS[~_PROPER]
    # The first of equals: y, which most left-handed systems flip, then other flips.
    order = np.lexsort((mirrors[:, 1, 1], -np.einsum("nii->n", mirrors)))
    return mirrors[order]


def mean_rotation(quaternions: Floats) -> Floats:
    """Return the quaternion (4,) nearest to N of them, (N, 4), of either sign."""
    return np.asarray(np.linalg.eigh(quaternions.T @ quaternions)[1][:, -1])
