"""The sum over pairs of orientations for the alignment; `Moments` is its counterpart."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats

# A mean square angle below this, rad^2, is rounding of the sum.
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class OrientationSum:
    """Sum over pairs (groundtruth rotation A, estimated rotation B) of w A B^T.

    From this matrix follow the rotation that aligns the orientations best, and the rotation error
    under any alignment. `+` merges, `-` removes. All terms are rotations, so that nothing cancels
    and no anchor is needed.

    Attributes:
        weight: Sum of the weights; the number of pairs without weights.
        total: (3, 3) sum of w A B^T.
    """

    weight: float
    total: Floats

    @classmethod
    def empty(cls) -> OrientationSum:
        """Return the sum over zero pairs."""
        return cls(0.0, np.zeros((3, 3)))

    @classmethod
    def of_pairs(
        cls, groundtruth: Floats, estimate: Floats, weights: Floats | None = None
    ) -> OrientationSum:
        """Return the sum over N pairs of unit quaternions.

        Args:
            groundtruth: (N, 4) xyzw, rotations A.
            estimate: (N, 4) xyzw, rotations B.
            weights: (N,) positive weights; None for equal weights.
        """
        between = lie.by_blocks(
            lambda a, b: (lie.multiply(a, lie.conjugate(b)),), groundtruth, estimate
        )[0]
        weight = float(len(between) if weights is None else weights.sum())
        return cls(weight, lie.sum_of_matrices(between, weights))

    def __add__(self, other: OrientationSum) -> OrientationSum:
        """Return the sum over both sets of pairs."""
        return OrientationSum(self.weight + other.weight, self.total + other.total)

    def __sub__(self, other: OrientationSum) -> OrientationSum:
        """Return the sum without a subset of the pairs."""
        return OrientationSum(self.weight - other.weight, self.total - other.total)

    @property
    def mean(self) -> Floats:
        """Mean of A B^T, (3, 3)."""
        mean: Floats = self.total / self.weight
        return mean

    def error(self, rotation: Floats) -> float:
        """Return the rotation error under an alignment's rotation (3, 3), rad.

        It is the angle whose chord is the root mean square of the chords of all pairs. For small
        angles it is the root mean square of the angles.
        """
        # Mean of the squared chords, (2 sin(angle / 2))^2.
        squared = 3.0 - float(np.vdot(rotation, self.mean))
        return 2.0 * math.asin(min(math.sqrt(squared) / 2.0, 1.0)) if squared > _ROUNDING else 0.0
