"""Sums over pairs of positions: all that alignment and the position error need to know of them.

They can be added to, removed from and merged, so that batches, sliding windows and shards of a
run share one solver, and a live update costs the same however long the run is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.similarity import Similarity

Array = NDArray[np.float64]

# Pairs to sum at once: what stays in a core's cache.
_BLOCK = 8192


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums over pairs (groundtruth position p, estimated position q) that alignment needs.

    Kept are the moments of (q, r), where r = p - (anchor of q) is the residual under an anchor
    alignment: sums of p and q themselves cancel when coordinates are large and errors small
    (3e-5 relative at 5 km; of residuals 3e-12). `+` merges, `-` removes; both operands must have
    the same anchor.

    Attributes:
        anchor: Alignment under which residuals are taken.
        weight: Sum of weights; the number of pairs where no weights were given.
        mean_q: (3,) mean estimated position, metres.
        mean_r: (3,) mean residual, metres.
        scatter_qq: (3, 3) sum of w (q - mean_q)(q - mean_q)^T.
        scatter_rq: (3, 3) sum of w (r - mean_r)(q - mean_q)^T.
        scatter_rr: Sum of w |r - mean_r|^2.
    """

    anchor: Similarity
    weight: float
    mean_q: Array
    mean_r: Array
    scatter_qq: Array
    scatter_rq: Array
    scatter_rr: float

    @classmethod
    def empty(cls, anchor: Similarity) -> Moments:
        """Return the moments of no pair at all."""
        return cls(anchor, 0.0, np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), 0.0)

    @classmethod
    def of_pairs(
        cls,
        groundtruth: Array,
        estimate: Array,
        weights: Array | None = None,
        anchor: Similarity | None = None,
    ) -> Moments:
        """Return the moments of N pairs of positions, (N, 3) each.

        Args:
            groundtruth: (N, 3) positions p, metres.
            estimate: (N, 3) positions q, metres.
            weights: (N,) positive weights; None weighs all pairs alike.
            anchor: Alignment for residuals; by default a shift of the first mean to the other.
        """
        if anchor is None and len(groundtruth):
            first = slice(_BLOCK)
            shift = groundtruth[first].mean(axis=0) - estimate[first].mean(axis=0)
            anchor = Similarity(np.eye(3), shift)
        anchor = anchor or Similarity.identity()
        moments = cls.empty(anchor)
        for begin in range(0, len(groundtruth), _BLOCK):
            rows = slice(begin, begin + _BLOCK)
            w = None if weights is None else weights[rows]
            moments += cls._of_block(groundtruth[rows], estimate[rows], w, anchor)
        return moments

    @classmethod
    def _of_block(
        cls, groundtruth: Array, estimate: Array, weights: Array | None, anchor: Similarity
    ) -> Moments:
        w = np.ones(len(groundtruth)) if weights is None else weights
        residuals = groundtruth - anchor.positions(estimate)
        total = float(w.sum())
        mean_q, mean_r = w @ estimate / total, w @ residuals / total
        q, r = estimate - mean_q, residuals - mean_r
        weighted_q, weighted_r = q * w[:, None], r * w[:, None]
        return cls(
            anchor=anchor,
            weight=total,
            mean_q=mean_q,
            mean_r=mean_r,
            scatter_qq=weighted_q.T @ q,
            scatter_rq=weighted_r.T @ q,
            scatter_rr=float(np.einsum("ni,ni->", weighted_r, r)),
        )

    def __add__(self, other: Moments) -> Moments:
        """Return the moments of both sets of pairs (Chan, Golub and LeVeque's merge)."""
        return self._combined(other, 1.0)

    def __sub__(self, other: Moments) -> Moments:
        """Return the moments without a part of the pairs that is in them."""
        return self._combined(other, -1.0)

    def _combined(self, other: Moments, sign: float) -> Moments:
        if self.anchor is not other.anchor:
            raise ValueError("moments combine only if their residuals have the same anchor")
        weight = self.weight + sign * other.weight
        if weight <= 0.0:
            return Moments.empty(self.anchor)
        share = sign * other.weight / weight
        step_q, step_r = other.mean_q - self.mean_q, other.mean_r - self.mean_r
        # For removal `share` is negative, and the same formulas hold.
        between = share * self.weight
        return Moments(
            anchor=self.anchor,
            weight=weight,
            mean_q=self.mean_q + share * step_q,
            mean_r=self.mean_r + share * step_r,
            scatter_qq=self.scatter_qq
            + sign * other.scatter_qq
            + between * (step_q[:, None] * step_q),
            scatter_rq=self.scatter_rq
            + sign * other.scatter_rq
            + between * (step_r[:, None] * step_q),
            scatter_rr=self.scatter_rr
            + sign * other.scatter_rr
            + between * float(step_r @ step_r),
        )

    def with_anchor(self, anchor: Similarity) -> Moments:
        """Return the moments of the same pairs with residuals under another anchor."""
        # r' = p - A' q = r + (A - A') q + (t - t').
        linear = self.anchor.scale * self.anchor.rotation - anchor.scale * anchor.rotation
        shift = self.anchor.translation - anchor.translation
        scatter_rr = (
            self.scatter_rr
            + 2.0 * float(np.sum(linear * self.scatter_rq))
            + float(np.sum((linear @ self.scatter_qq) * linear))
        )
        return Moments(
            anchor=anchor,
            weight=self.weight,
            mean_q=self.mean_q,
            mean_r=self.mean_r + linear @ self.mean_q + shift,
            scatter_qq=self.scatter_qq,
            scatter_rq=self.scatter_rq + linear @ self.scatter_qq,
            scatter_rr=max(scatter_rr, 0.0),
        )

    @property
    def mean_p(self) -> Array:
        """Mean groundtruth position, (3,), metres."""
        mean: Array = self.anchor.positions(self.mean_q[None])[0] + self.mean_r
        return mean

    @property
    def covariance_pq(self) -> Array:
        """The matrix Sigma of Alg. 1, (3, 3), square metres."""
        linear = self.anchor.scale * self.anchor.rotation
        return (linear @ self.scatter_qq + self.scatter_rq) / self.weight

    @property
    def variance_q(self) -> float:
        """sigma^2 of the estimated positions in Alg. 1, square metres."""
        return float(np.trace(self.scatter_qq)) / self.weight

    def rmse(self, alignment: Similarity) -> float:
        """Return the root mean square of |p - (alignment of q)|, metres: the ATE, eq. (24)."""
        # p - S q = (A - S) q + r + (t_a - t), with small A - S and small r: nothing cancels.
        linear = self.anchor.scale * self.anchor.rotation - alignment.scale * alignment.rotation
        mean = linear @ self.mean_q + self.mean_r + self.anchor.translation - alignment.translation
        scatter = (
            np.trace(linear @ self.scatter_qq @ linear.T)
            + 2.0 * np.trace(linear @ self.scatter_rq.T)
            + self.scatter_rr
        )
        return float(np.sqrt(mean @ mean + max(float(scatter), 0.0) / self.weight))
