"""Whether a parameter can be seen at all, or only noise that looks like it.

A small standard deviation doesn't tell: on a static recording, differentiated noise passes for
information. But every column of the Jacobian can be computed from either trajectory, and their
noises are independent: where the two agree there is motion behind it. Their correlation, the
reliability, is 0.89 or more on recordings that show an offset and 0.05 or less where none can be
seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.increments import LEVER, OFFSET, SKEW, TURN, Increments
from trajeval_ros.calibration.robust_fit import Fit
from trajeval_ros.geometry.arrays import Booleans, Floats

LEAST_RELIABILITY = 0.5
# Rms of (R_j - R_i) v, for increments whose lever arm one side alone can tell.
_LEAST_TURN = 0.02


@dataclass(frozen=True, eq=False)
class Directions:
    """The principal directions of one parameter and whether each can be seen.

    Attributes:
        directions: (k, k), orthonormal rows.
        reliability: (k,), in [-1, 1].
    """

    directions: Floats
    reliability: Floats

    @property
    def seen(self) -> Booleans:
        """(k,) whether a direction is observable."""
        seen: Booleans = self.reliability >= LEAST_RELIABILITY
        return seen


def observability(increments: Increments, fitted: Fit) -> dict[str, Directions]:
    """Return the directions of `offset`, `skew`, `turn` and `lever` at a solution."""
    rows = fitted.linearised.rows
    twin, known = increments.twin(fitted.unknowns, rows)
    size = twin.shape[1]
    weights = np.repeat(fitted.weights, 3, axis=1)[known, :size]
    own, twin = fitted.linearised.jacobian[known], twin[known]
    blocks = {"offset": OFFSET, "skew": SKEW}
    if increments.has_turns:
        blocks |= {"turn": TURN, "lever": LEVER}
    found = {
        name: _directions(own[..., columns], twin[..., columns], weights)
        for name, columns in blocks.items()
    }
    if not increments.has_turns and increments.turned is not None:
        found["lever"] = _turning(increments.turned[rows])
    return found


def _directions(own: Floats, twin: Floats, weights: Floats) -> Directions:
    def product(left: Floats, right: Floats) -> Floats:
        weighted = left * weights[..., None]
        summed: Floats = np.tensordot(weighted, right, axes=([0, 1], [0, 1]))
        return summed

    mine, theirs, both = product(own, own), product(twin, twin), product(own, twin)
    directions = np.linalg.eigh(mine + theirs)[1].T
    along = [
        np.einsum("ka,ab,kb->k", directions, each, directions) for each in (mine, theirs, both)
    ]
    size = np.sqrt(np.maximum(along[0], 0.0) * np.maximum(along[1], 0.0))
    reliability = np.where(size > 0.0, along[2] / np.where(size > 0.0, size, 1.0), 0.0)
    return Directions(directions, np.clip(reliability, -1.0, 1.0))


def _turning(turned: Floats) -> Directions:
    """Judge lever arms by how much their directions turn: 1 if enough, else 0."""
    values, vectors = np.linalg.eigh(
        np.einsum("nab,nac->bc", turned, turned) / max(len(turned), 1)
    )
    enough = np.sqrt(np.maximum(values, 0.0)) >= _LEAST_TURN
    return Directions(vectors.T, enough.astype(np.float64))
