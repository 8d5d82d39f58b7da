"""A trajectory as a piecewise Gaussian process: section IV of the probabilistic paper.

Overlapping segments share their hyperparameters and are blended. Therefore mean and covariance are
continuous everywhere; shared hyperparameters alone are not sufficient.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.blending import blended
from trajeval_ros.continuous_time.gp_segments import SIZE, GPSegments
from trajeval_ros.continuous_time.hyperparameters import Hyperparameters, most_likely
from trajeval_ros.continuous_time.kernels import MATERN_52, Kernel
from trajeval_ros.continuous_time.samples import Belief, Samples
from trajeval_ros.geometry import lie, se3
from trajeval_ros.geometry.arrays import Floats, Indices

_BLOCK = 256


@dataclass(frozen=True, eq=False)
class PiecewiseGP:
    """Six processes per segment, conditioned on its samples, eq. (31).

    Attributes:
        segments: Segments with their samples.
        kernels: Of the three translations and, if any, of the three rotations.
        hyperparameters: Likewise.
        roots: Likewise, L^-1 (S, n, n) of K = L L^T.
        weights: Likewise, K^-1 y (S, n, 3).
    """

    segments: GPSegments
    kernels: tuple[Kernel, ...]
    hyperparameters: tuple[Hyperparameters, ...]
    roots: tuple[Floats, ...]
    weights: tuple[Floats, ...]

    @classmethod
    def fit(
        cls,
        samples: Samples,
        kernels: Sequence[Kernel] = (MATERN_52,),
        *,
        joint: bool = False,
        breaks: Sequence[int] | Indices = (),
    ) -> PiecewiseGP:
        """Estimate the hyperparameters by maximum likelihood, then condition on the samples.

        Args:
            samples: Samples of the trajectory.
            kernels: Candidates; the one with the largest likelihood is chosen.
            joint: Use coordinates of se(3), as in the paper.
            breaks: Samples that end a segment, see `GPSegments.of`.
        """
        after = np.asarray(breaks, dtype=np.int64)
        segments = GPSegments.of(samples, SIZE, joint=joint, breaks=after)
        sigmas = samples.noise.per_axis(samples.oriented)
        chosen = [
            most_likely(
                kernels,
                segments.times,
                _axes(segments.coordinates, block),
                sigma,
                samples.usual_step_s,
            )
            for block, sigma in enumerate(sigmas)
        ]
        return cls.conditioned(segments, chosen)

    @classmethod
    def conditioned(
        cls, segments: GPSegments, chosen: Sequence[tuple[Kernel, Hyperparameters]]
    ) -> PiecewiseGP:
        """Condition processes on samples.

        Args:
            segments: Segments with their samples.
            chosen: Kernel and hyperparameters of translations and, if any, of rotations.
        """
        roots, weights = [], []
        for block, (kernel, parameters) in enumerate(chosen):
            root = _inverse_roots(kernel, segments.times, parameters)
            roots.append(root)
            target = _axes(segments.coordinates, block)
            weights.append(se3.transposed(root) @ (root @ target))
        forms, numbers = zip(*chosen, strict=True)
        return cls(segments, forms, numbers, tuple(roots), tuple(weights))

    def at(self, times: Floats) -> Belief:
        """Return the belief at times (Q,), seconds, within those of the samples."""
        return Belief(*lie.by_blocks(self._at, times))

    def in_segment(self, segment: Indices, times: Floats) -> Belief:
        """Return the belief of one segment per time, eq. (31).

        Args:
            segment: (Q,), the segments.
            times: (Q,), seconds.
        """
        means, variances = np.zeros((len(times), 6)), np.zeros((len(times), 6))
        lags = times[:, None] - self.segments.times[segment]
        for block, parameters in enumerate(self.hyperparameters):
            axes = slice(3 * block, 3 * block + 3)
            prior = parameters.sigma**2
            near = prior * self.kernels[block].between(lags, parameters.length)
            means[:, axes] = np.einsum("qn,qnc->qc", near, self.weights[block][segment])
            explained = np.square(se3.times(self.roots[block][segment], near)).sum(axis=1)
            # Rounding must not make a variance negative.
            variances[:, axes] = np.maximum(prior - explained, 1e-14 * prior)[:, None]
        return Belief(*self.segments.poses_at(segment, means, variances))

    def _at(self, times: Floats) -> tuple[Floats, Floats]:
        """Evaluate one block of times (Q,)."""
        first, second, weight = self.segments.around(times)
        belief = self.in_segment(second, times)
        if len(self.segments) > 1:
            belief = blended(self.in_segment(first, times), belief, weight)
        return belief.poses, belief.covariances


def _axes(coordinates: Floats, block: int) -> Floats:
    """Return the translations (block 0) or rotations (block 1) of coordinates (..., 6)."""
    return coordinates[..., 3 * block : 3 * block + 3]


def _inverse_roots(kernel: Kernel, times: Floats, parameters: Hyperparameters) -> Floats:
    """Return L^-1 (S, n, n) of K + noise, by blocks of segments that fit into the cache."""
    roots = np.empty((*times.shape, times.shape[1]))
    for begin in range(0, len(times), _BLOCK):
        chunk = slice(begin, begin + _BLOCK)
        lags = times[chunk, :, None] - times[chunk, None, :]
        roots[chunk] = _inverse_root(
            parameters.sigma**2 * kernel.between(lags, parameters.length), parameters
        )
    return roots


def _inverse_root(prior: Floats, parameters: Hyperparameters) -> Floats:
    """Return L^-1 of a prior with noise; smooth kernels can need a larger diagonal."""
    diagonal = np.eye(prior.shape[-1])
    for jitter in (0.0, 1e-10, 1e-8, 1e-6):
        try:
            root = np.linalg.cholesky(
                prior + (parameters.noise**2 + jitter * parameters.sigma**2) * diagonal
            )
        except np.linalg.LinAlgError:
            continue
        return np.asarray(np.linalg.inv(root))
    raise AssertionError("a kernel with a share of 1e-6 on its diagonal is positive definite")
