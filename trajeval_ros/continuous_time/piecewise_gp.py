"""A trajectory as a piecewise Gaussian process: section IV of the probabilistic paper.

Overlapping segments share their hyperparameters and are blended, so that the mean and the
covariance are continuous everywhere, which shared hyperparameters alone don't achieve.
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
    """Six processes for each segment, conditioned on its samples, eq. (31).

    Attributes:
        segments: With their samples.
        kernels: Of the three translations, and of the three rotations where there are any.
        hyperparameters: Likewise.
        roots: For each of these, L^-1 (S, n, n) of K = L L^T.
        weights: For each of these, K^-1 y (S, n, 3).
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
        """Fit the processes: the most likely hyperparameters, then as of `conditioned`.

        Args:
            samples: Of the trajectory.
            kernels: Forms to choose from, by the likelihood of the samples.
            joint: Use coordinates of se(3), as the paper does.
            breaks: Samples after which no segment goes on, as of `GPSegments.of`.
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
            segments: With their samples.
            chosen: Kernel and hyperparameters of translations, and of rotations if there are any.
        """
        roots, weights = [], []
        for block, (kernel, each) in enumerate(chosen):
            root = _inverse_roots(kernel, segments.times, each)
            roots.append(root)
            target = _axes(segments.coordinates, block)
            weights.append(se3.transposed(root) @ (root @ target))
        forms, numbers = zip(*chosen, strict=True)
        return cls(segments, forms, numbers, tuple(roots), tuple(weights))

    def at(self, times: Floats) -> Belief:
        """Return what is known at times (Q,), seconds, within those of the samples."""
        return Belief(*lie.by_blocks(self._at, times))

    def in_segment(self, segment: Indices, times: Floats) -> Belief:
        """Return what one segment for each time knows, eq. (31).

        Args:
            segment: (Q,).
            times: (Q,), seconds.
        """
        means, variances = np.zeros((len(times), 6)), np.zeros((len(times), 6))
        lags = times[:, None] - self.segments.times[segment]
        for block, each in enumerate(self.hyperparameters):
            axes = slice(3 * block, 3 * block + 3)
            prior = each.sigma**2
            near = prior * self.kernels[block].between(lags, each.length)
            means[:, axes] = np.einsum("qn,qnc->qc", near, self.weights[block][segment])
            explained = np.square(se3.times(self.roots[block][segment], near)).sum(axis=1)
            # Rounding must not make a variance negative where samples explain all of it.
            variances[:, axes] = np.maximum(prior - explained, 1e-14 * prior)[:, None]
        return Belief(*self.segments.poses_at(segment, means, variances))

    def _at(self, times: Floats) -> tuple[Floats, Floats]:
        first, second, weight = self.segments.around(times)
        belief = self.in_segment(second, times)
        if len(self.segments) > 1:
            belief = blended(self.in_segment(first, times), belief, weight)
        return belief.poses, belief.covariances


def _axes(coordinates: Floats, block: int) -> Floats:
    return coordinates[..., 3 * block : 3 * block + 3]


def _inverse_roots(kernel: Kernel, times: Floats, each: Hyperparameters) -> Floats:
    """Return L^-1 (S, n, n) of K + noise, some segments at a time, which stay in the cache."""
    roots = np.empty((*times.shape, times.shape[1]))
    for begin in range(0, len(times), _BLOCK):
        some = slice(begin, begin + _BLOCK)
        lags = times[some, :, None] - times[some, None, :]
        roots[some] = _inverse_root(each.sigma**2 * kernel.between(lags, each.length), each)
    return roots


def _inverse_root(prior: Floats, each: Hyperparameters) -> Floats:
    """Return L^-1 of a prior with noise; a smooth one may need more than that on its diagonal."""
    diagonal = np.eye(prior.shape[-1])
    for jitter in (0.0, 1e-10, 1e-8, 1e-6):
        try:
            root = np.linalg.cholesky(prior + (each.noise**2 + jitter * each.sigma**2) * diagonal)
        except np.linalg.LinAlgError:
            continue
        return np.asarray(np.linalg.inv(root))
    raise AssertionError("a kernel with a share of 1e-6 on its diagonal is positive definite")
