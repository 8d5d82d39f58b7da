"""Overlapping segments of samples, each in coordinates about a pose of its own.

Section IV-B of the probabilistic paper. Its coordinates are those of se(3). There a rotation bends
the path of the translation, which costs a factor of two to four in gaps; so positions and
rotations are coordinates apart, unless the paper's are asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros import lie, se3
from trajeval_ros.continuous_time.samples import Samples

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SIZE = 20
_SMALLEST = 6
# Rotation vectors bend more the longer they are, and are of no use beyond pi.
MOST_TURN_RAD = 2.0


@dataclass(frozen=True, eq=False)
class Segments:
    """S segments of n samples, each overlapping its neighbours by half.

    Attributes:
        rows: (S, n), indices of samples.
        times: (S, n), seconds.
        references: (S, 4, 4), the pose in the middle of each.
        coordinates: (S, n, 6) of the samples, about their segment's reference.
        joint: Whether coordinates are those of se(3).
    """

    rows: Indices
    times: Array
    references: Array
    coordinates: Array
    joint: bool

    @classmethod
    def of(cls, samples: Samples, size: int = SIZE, *, joint: bool = False) -> Segments:
        """Cut samples into segments, smaller ones where rotations would grow too large.

        Args:
            samples: At least two.
            size: n, even; all samples are one segment where there are no more.
            joint: Use coordinates of se(3), as the paper does.
        """
        while True:
            rows = _rows(len(samples), size)
            middle = rows[:, rows.shape[1] // 2]
            turns = lie.log(
                se3.transposed(samples.poses[middle, None, :3, :3]) @ samples.poses[rows, :3, :3]
            )
            if size <= _SMALLEST or np.linalg.norm(turns, axis=-1).max() < MOST_TURN_RAD:
                break
            size = max(size * 3 // 4 // 2 * 2, _SMALLEST)
        references, poses = samples.poses[middle], samples.poses[rows]
        if joint:
            coordinates = se3.log(se3.inverse(references)[:, None] @ poses)
        else:
            moved = poses[..., :3, 3] - references[:, None, :3, 3]
            coordinates = np.concatenate([moved, turns], axis=-1)
        return cls(rows, samples.times[rows], references, coordinates, joint)

    def __len__(self) -> int:
        """Return their number."""
        return len(self.rows)

    def poses_at(self, segment: Indices, means: Array, variances: Array) -> tuple[Array, Array]:
        """Turn coordinates into poses.

        Args:
            segment: (Q,), of each.
            means: (Q, 6), coordinates.
            variances: (Q, 6), of the coordinates, independent.

        Returns:
            Poses (Q, 4, 4) and covariances (Q, 6, 6) of perturbations on the right.
        """
        references = self.references[segment]
        if self.joint:
            poses = references @ se3.exp(means)
            jacobian = se3.left_jacobian(-means)
        else:
            rotations = references[:, :3, :3] @ lie.exp(means[:, 3:])
            poses = se3.poses(rotations, references[:, :3, 3] + means[:, :3])
            jacobian = np.zeros((len(means), 6, 6))
            jacobian[:, :3, :3] = se3.transposed(rotations)
            jacobian[:, 3:, 3:] = lie.left_jacobian(-means[:, 3:])
        spread = jacobian * np.sqrt(variances)[:, None, :]
        return poses, spread @ se3.transposed(spread)

    def around(self, times: Array) -> tuple[Indices, Indices, Array]:
        """Return the two segments (Q,) that know of each time, and the weight (Q,) of the second.

        From the start of a segment, its predecessor's say fades and its own grows, until the
        predecessor or the next segment's turn ends it: `min` keeps the last segment, which begins
        out of step, from making a jump.
        """
        starts, ends = self.times[:, 0], self.times[:, -1]
        second = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, len(self) - 1)
        first = np.maximum(second - 1, 0)
        following = np.append(starts[1:], np.inf)
        begin = starts[second]
        end = np.minimum(ends[first], following[second])
        weight = smooth_step((times - begin) / np.where(end > begin, end - begin, 1.0))
        return first, second, np.where(first == second, 1.0, weight)


def smooth_step(share: Array) -> Array:
    """Return 0 to 1 over [0, 1] with two derivatives that vanish at both ends."""
    u = np.clip(share, 0.0, 1.0)
    step: Array = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    return step


def _rows(count: int, size: int) -> Indices:
    """Return the rows (S, n) of the segments; the last one is shifted back to be full."""
    size = min(size, count)
    starts = np.arange(0, count - size + 1, max(size // 2, 1))
    if starts[-1] != count - size:
        starts = np.append(starts, count - size)
    return starts[:, None] + np.arange(size)
