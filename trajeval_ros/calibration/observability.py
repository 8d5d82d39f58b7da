"""Observability of the parameters.

A small standard deviation is no proof: on a static recording, differentiated noise looks like
information. However, the Jacobian can be computed from either trajectory, and their noises are
independent. Where the two Jacobians agree, they show actual motion. Their correlation, the
reliability, is at least 0.89 on recordings that determine an offset, and at most 0.05 where none
is observable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.increments import LEVER, OFFSET, SKEW, TURN, Increments
from trajeval_ros.calibration.robust_fit import Fit
from trajeval_ros.geometry.arrays import Booleans, Floats

LEAST_RELIABILITY = 0.5
# Least rms of (R_j - R_i) v for an observable lever arm, for increments without orientations.
_LEAST_TURN = 0.02


@dataclass(frozen=True, eq=False)
class Directions:
    """The principal directions of one parameter and their reliability.

    Attributes:
        directions: (k, k), orthonormal rows.
        reliability: (k,), in [-1, 1].
    """

    directions: Floats
    reliability: Floats

    @property
    def seen(self) -> Booleans:
        """Which directions are observable, (k,)."""
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
    """Return the directions of a parameter from both Jacobians (N, 3 or 6, k) and weights."""

    def product(left: Floats, right: Floats) -> Floats:
        weighted = left * weights[..., None]
        summed: Floats = np.tensordot(weighted, right, axes=([0, 1], [0, 1]))
        return summed

    mine, theirs, both = product(own, own), product(twin, twin), product(own, twin)
    directions = np.linalg.eigh(mine + theirs)[1].T
    along = [
        np.einsum("ka,ab,kb->k", directions, matrix, directions) for matrix in (mine, theirs, both)
    ]
    size = np.sqrt(np.maximum(along[0], 0.0) * np.maximum(along[1], 0.0))
    reliability = np.where(size > 0.0, along[2] / np.where(size > 0.0, size, 1.0), 0.0)
    return Directions(directions, np.clip(reliability, -1.0, 1.0))


def _turning(turned: Floats) -> Directions:
    """Return the directions of a lever arm; reliability 1 if they rotate enough, else 0."""
    values, vectors = np.linalg.eigh(
        np.einsum("nab,nac->bc", turned, turned) / max(len(turned), 1)
    )
    enough = np.sqrt(np.maximum(values, 0.0)) >= _LEAST_TURN
    return Directions(vectors.T, enough.astype(np.float64))
