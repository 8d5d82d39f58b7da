"""Short motions of both sides: over two seconds drift is small, and a mistake is not.

They start and end at poses of the estimate, because interpolation of a sparse estimate cuts its
curves. The groundtruth is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.diagnosis.motion_track import MotionTrack, lengths
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.thinning import evenly
from trajeval_ros.metrics.statistics import median

_COUNT = 600
_FEWEST = 12
# A jump is longer than this multiple of the median step; more jumps are normal for the estimate.
_JUMP, _MOST_JUMPS = 30.0, 20


@dataclass(frozen=True, eq=False)
class ShortMotions:
    """N short motions of both sides.

    Attributes:
        rows: (N, 2) rows of the estimate at starts and ends.
        truth: (2, N, 3) positions of the groundtruth at starts and ends.
        estimate: (2, N, 3) positions of the estimate.
        truth_turned: (2, N, 4) quaternions of the groundtruth; None unless both sides have them.
        estimate_turned: (2, N, 4) quaternions of the estimate; None unless both sides have them.
    """

    rows: Indices
    truth: Floats
    estimate: Floats
    truth_turned: Floats | None
    estimate_turned: Floats | None

    @classmethod
    def between(
        cls, truth: MotionTrack, estimate: MotionTrack, apart_s: float, max_gap_s: float
    ) -> ShortMotions:
        """Return evenly sampled motions of a recording with equal clocks.

        Args:
            truth: Groundtruth in order of time.
            estimate: Estimate in order of time.
            apart_s: Least duration of a motion, seconds.
            max_gap_s: Longest step of the groundtruth to interpolate, seconds.
        """
        times = estimate.seconds
        first = int(np.searchsorted(times, truth.seconds[0]))
        count = max(0, int(np.searchsorted(times, truth.seconds[-1], side="right")) - first)
        start = first + evenly(count, min(count, _COUNT))
        end = np.searchsorted(times, times[start] + 0.999 * apart_s)
        fits = end < first + count
        start, end = start[fits], end[fits]
        fits = times[end] - times[start] < 2.0 * apart_s + 0.2
        start, end = start[fits], end[fits]
        begun, ended = (truth.at(times[each], max_gap_s) for each in (start, end))
        known = begun.known & ended.known
        start, end = start[known], end[known]
        truth_turned = estimate_turned = None
        if begun.quaternions is not None and ended.quaternions is not None:
            truth_turned = np.stack([begun.quaternions[known], ended.quaternions[known]])
        if truth_turned is not None and estimate.quaternions is not None:
            estimate_turned = np.stack([estimate.quaternions[start], estimate.quaternions[end]])
        else:
            truth_turned = None
        return cls(
            np.column_stack([start, end]),
            np.stack([begun.positions[known], ended.positions[known]]),
            np.stack([estimate.positions[start], estimate.positions[end]]),
            truth_turned,
            estimate_turned,
        )

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.rows)

    @property
    def enough(self) -> bool:
        """Whether there are enough motions for a test."""
        return len(self) >= _FEWEST

    @property
    def true_steps(self) -> Floats:
        """Displacements of the groundtruth, (N, 3)."""
        steps: Floats = self.truth[1] - self.truth[0]
        return steps

    @property
    def steps(self) -> Floats:
        """Displacements of the estimate, (N, 3)."""
        steps: Floats = self.estimate[1] - self.estimate[0]
        return steps

    @property
    def thirds(self) -> list[ShortMotions]:
        """Three parts of the run with about equal distances travelled by the groundtruth."""
        way = np.cumsum(lengths(bounded(self.true_steps)))
        part = np.minimum(3.0 * way / max(float(way[-1]), 1e-300), 2.0).astype(np.int64)
        return [self._only(part == each) for each in range(3)]

    def world(self) -> Floats:
        """Return the rotation (3, 3) from the estimate's world that fits the motions best."""
        fitted = moment(bounded(self.true_steps), bounded(self.steps))
        if self.truth_turned is not None and self.estimate_turned is not None:
            turns = (turned_in_world(each) for each in (self.truth_turned, self.estimate_turned))
            fitted = fitted + moment(*(bounded(each) for each in turns))
        return best_rotations(fitted)[1]

    def without_jumps(self, estimate: MotionTrack) -> ShortMotions:
        """Return the motions without a jump of the estimate: a restart rotates its world."""
        moved = estimate.moved
        far = moved > _JUMP * median(moved[evenly(len(moved), 2000)])
        jumps = np.concatenate([[0], np.cumsum(far)])
        if not 0 < jumps[-1] <= _MOST_JUMPS:
            return self
        smooth = jumps[self.rows[:, 0]] == jumps[self.rows[:, 1]]
        return self._only(smooth) if np.count_nonzero(smooth) >= _FEWEST else self

    def _only(self, keep: Booleans) -> ShortMotions:
        return ShortMotions(
            self.rows[keep],
            self.truth[:, keep],
            self.estimate[:, keep],
            None if self.truth_turned is None else self.truth_turned[:, keep],
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
    short: Floats = vectors / bound_of(lengths(vectors))[:, None]
    return short


def bound_of(size: Floats) -> Floats:
    """Return the divisors (N,) of vectors of given lengths that limit their lengths."""
    usual = median(size[size > 0.0]) if (size > 0.0).any() else 1.0
    return size + 2.0 * usual


def moment(truth: Floats, estimate: Floats) -> Floats:
    """Return the normalised sums (..., 3, 3) of truth estimate^T over N vectors, (..., N, 3).

    The trace of W^T times it is the correlation of the vectors under a rotation W.
    """
    norm = np.sqrt(np.square(truth).sum(axis=(-1, -2)) * np.square(estimate).sum(axis=(-1, -2)))
    summed: Floats = np.swapaxes(truth, -1, -2) @ estimate
    summed /= np.maximum(norm, 1e-300)[..., None, None]
    return summed


def best_rotations(moments: Floats) -> tuple[Floats, Floats]:
    """Return the largest trace of W^T H over rotations W, (...), and W (..., 3, 3), per H."""
    u, s, vt = np.linalg.svd(moments)
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    flipped = u.copy()
    flipped[..., :, 2] *= sign[..., None]
    return s[..., 0] + s[..., 1] + sign * s[..., 2], flipped @ vt
