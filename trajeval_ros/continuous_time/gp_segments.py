"""Overlapping segments of samples with local coordinates about a reference pose.

Section IV-B of the probabilistic paper, which uses coordinates of se(3). There, a rotation bends
the path of the translation, which increases errors in gaps by a factor of two to four. Therefore
positions and rotations have independent coordinates, unless those of the paper are requested.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.samples import Samples
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Floats, Indices

SIZE = 20
_SMALLEST = 6
# Rotation vectors become more nonlinear with their length, and are ambiguous beyond pi.
MOST_TURN_RAD = 2.0
_NOWHERE = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class GPSegments:
    """S segments of n samples. Neighbouring segments overlap by half.

    Attributes:
        rows: (S, n), indices of samples.
        times: (S, n), seconds.
        references: (S, 4, 4), the middle poses.
        coordinates: (S, n, 6), of the samples about their segment's reference.
        joint: Whether coordinates are those of se(3).
    """

    rows: Indices
    times: Floats
    references: Floats
    coordinates: Floats
    joint: bool

    @classmethod
    def of(
        cls,
        samples: Samples,
        size: int,
        *,
        joint: bool = False,
        breaks: Indices = _NOWHERE,
    ) -> GPSegments:
        """Divide samples into segments, smaller ones for large rotations.

        Args:
            samples: At least two.
            size: n, even; if there are fewer samples, they are one segment.
            joint: Use coordinates of se(3), as in the paper.
            breaks: Samples that end a segment. Runs between breaks that are shorter than n are in
                no segment, unless all are.
        """
        while True:
            rows = _rows(len(samples), size, breaks)
            middle = rows[:, rows.shape[1] // 2]
            turns = so3.log(
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
        """Return the number of segments."""
        return len(self.rows)

    def poses_at(
        self, segment: Indices, means: Floats, variances: Floats
    ) -> tuple[Floats, Floats]:
        """Convert coordinates to poses.

        Args:
            segment: (Q,), the segments of the coordinates.
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
            rotations = references[:, :3, :3] @ so3.exp(means[:, 3:])
            poses = se3.poses(rotations, references[:, :3, 3] + means[:, :3])
            jacobian = np.zeros((len(means), 6, 6))
            jacobian[:, :3, :3] = se3.transposed(rotations)
            jacobian[:, 3:, 3:] = so3.left_jacobian(-means[:, 3:])
        spread = jacobian * np.sqrt(variances)[:, None, :]
        return poses, spread @ se3.transposed(spread)

    def around(self, times: Floats) -> tuple[Indices, Indices, Floats]:
        """Return the two segments (Q,) for every time, and the weight (Q,) of the second.

        From the start of a segment, the weight of its predecessor decreases, until the predecessor
        ends or the next segment starts. The minimum of both avoids a jump at the last segment,
        which is shifted. Near a break, only the nearer segment is used.
        """
        starts, ends = self.times[:, 0], self.times[:, -1]
        begins_run = np.append(True, self.rows[1:, 0] > self.rows[:-1, -1])
        before = np.append(starts[0], ends[:-1])
        since = np.where(begins_run, 0.5 * (before + starts), starts)
        second = np.clip(np.searchsorted(since, times, side="right") - 1, 0, len(self) - 1)
        first = np.where(begins_run[second], second, second - 1)
        following = np.append(starts[1:], np.inf)
        begin = starts[second]
        end = np.minimum(ends[first], following[second])
        weight = smooth_step((times - begin) / np.where(end > begin, end - begin, 1.0))
        return first, second, np.where(first == second, 1.0, weight)


def smooth_step(share: Floats) -> Floats:
    """Return a function from 0 to 1 over [0, 1] with two zero derivatives at both ends."""
    u = np.clip(share, 0.0, 1.0)
    step: Floats = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    return step


def runs_between(count: int, breaks: Indices) -> tuple[Indices, Indices]:
    """Return the first sample of every run, and the number of its samples."""
    first = np.concatenate([[0], breaks + 1])
    return first, np.diff(np.append(first, count))


def _rows(count: int, size: int, breaks: Indices) -> Indices:
    """Return the rows (S, n) of the segments of all long runs, or of all samples if none is."""
    runs = zip(*runs_between(count, breaks), strict=True)
    long = [first + _rows_of_run(length, size) for first, length in runs if length >= size]
    return np.concatenate(long or [_rows_of_run(count, size)])


def _rows_of_run(count: int, size: int) -> Indices:
    """Return the rows (S, n) of a run's segments; the last one is shifted back to be full."""
    size = min(size, count)
    starts = np.arange(0, count - size + 1, max(size // 2, 1))
    if starts[-1] != count - size:
        starts = np.append(starts, count - size)
    return starts[:, None] + np.arange(size)
