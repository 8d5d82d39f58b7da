"""A trajectory as a piecewise Gaussian process: section IV of the probabilistic paper.

Overlapping segments share their hyperparameters and are blended. Therefore mean and covariance are
continuous everywhere; shared hyperparameters alone are not sufficient. Gaps that are longer than a
segment have an additional coarse process.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.kernels import MATERN_52, Hyperparameters, Kernel, most_likely
from trajeval_ros.continuous_time.samples import Belief, Samples
from trajeval_ros.geometry import lie, se3, so3
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices

_BLOCK = 256
SIZE = 20
_SMALLEST = 6
# Rotation vectors become more nonlinear with their length, and are ambiguous beyond pi.
MOST_TURN_RAD = 2.0
_NOWHERE = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class PiecewiseGP:
    """Six processes per segment, conditioned on its samples, eq. (31)."""

    segments: GPSegments  # segments with their samples
    kernels: tuple[Kernel, ...]  # of the three translations and, if any, of the three rotations
    hyperparameters: tuple[Hyperparameters, ...]  # likewise
    roots: tuple[Floats, ...]  # likewise, L^-1 (S, n, n) of K = L L^T
    weights: tuple[Floats, ...]  # likewise, K^-1 y (S, n, 3)

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

        The most likely of the kernels is chosen. See `GPSegments.of` for the other arguments.
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
        """Condition processes on samples: those of translations and, if any, of rotations."""
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
        """Return the belief of one segment (Q,) per time (Q,), eq. (31)."""
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


# A coarse segment of twenty samples spans a gap, but at most two seconds.
_STEPS_PER_GAP, _COARSEST_S = 20, 0.1
_WORTHWHILE = 1.5
_RAMP = 0.1


@dataclass(frozen=True, eq=False)
class TwoScaleGP:
    """A piecewise process, and a coarser one inside gaps.

    At 200 Hz, twenty samples span 0.1 s and do not determine the velocity one second later. A
    segment across a gap would be wrong, too: its prior of millimetres does not allow metres
    between its ends. Runs shorter than a segment are in the coarse process only.
    """

    fine: PiecewiseGP  # process of all samples
    # Process of thinned samples; None without gaps, or if samples are sparse.
    coarse: PiecewiseGP | None
    times: Floats  # (N,), seconds, of the samples
    gaps: Indices  # indices of the samples before a gap that the coarse process covers
    short: Booleans  # (N,), whether a sample is in a run shorter than a segment
    ramp_s: float  # longest transition between the two, seconds

    @classmethod
    def fit(cls, samples: Samples, kernels: Sequence[Kernel]) -> TwoScaleGP:
        """Fit both; see `PiecewiseGP.fit`."""
        gaps, coarse, step = samples.gaps, None, 0.0
        if len(gaps):
            usual, lengths = samples.usual_step_s, np.diff(samples.times)[gaps]
            step = max(min(_middle(lengths) / _STEPS_PER_GAP, _COARSEST_S), usual)
            # In gaps shorter than its step, the coarse process is no better than the fine one.
            gaps = gaps[lengths > step]
            if step > _WORTHWHILE * usual:
                coarse = PiecewiseGP.fit(samples[thinned(samples, gaps, step)], kernels)
        fine = PiecewiseGP.fit(samples, kernels, breaks=() if coarse is None else gaps)
        _, counts = runs_between(len(samples), gaps)
        short = np.repeat(counts < fine.segments.rows.shape[1], counts)
        return cls(fine, coarse, samples.times, gaps, short, step)

    def at(self, times: Floats) -> Belief:
        """Return the belief at times (Q,), seconds, within those of the samples."""
        belief = self.fine.at(times)
        if self.coarse is None:
            return belief
        before = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, None)
        in_gap = np.isin(before, self.gaps)
        inside = np.flatnonzero(in_gap | self.short[before])
        weight = self._weight(before[inside], times[inside], in_gap[inside])
        fine = Belief(belief.poses[inside], belief.covariances[inside])
        mixed = blended(fine, self.coarse.at(times[inside]), weight)
        belief.poses[inside], belief.covariances[inside] = mixed.poses, mixed.covariances
        return belief

    def _weight(self, before: Indices, times: Floats, in_gap: Booleans) -> Floats:
        """Return the weight of the coarse process at times (Q,) after the samples `before`."""
        after = np.minimum(before + 1, len(self.times) - 1)
        start, end = self.times[before], self.times[after]
        # The transition is short, since the fine process is its prior beyond a segment's length.
        ramp = np.where(in_gap, np.minimum(_RAMP * (end - start), self.ramp_s), 1.0)
        rise, fall = smooth_step((times - start) / ramp), smooth_step((end - times) / ramp)
        return np.where(self.short[before], 1.0, rise) * np.where(self.short[after], 1.0, fall)


def thinned(samples: Samples, gaps: Indices, step_s: float) -> Indices:
    """Return the rows to keep: the first of every step, and both edges of gaps."""
    cell = np.floor(samples.times / step_s)
    first = np.concatenate([[True], np.diff(cell) > 0.0])
    first[gaps] = first[gaps + 1] = True
    first[-1] = True
    return np.flatnonzero(first)


def _middle(lengths: Floats) -> float:
    """Return the length of the gap at the median of the total missing time.

    Many short gaps of lost packets then have little influence next to a long dropout.
    """
    ordered = np.sort(lengths)
    missing = np.cumsum(ordered)
    return float(ordered[np.searchsorted(missing, 0.5 * missing[-1])])


@dataclass(frozen=True, eq=False)
class GPSegments:
    """S segments of n samples in local coordinates. Neighbouring segments overlap by half.

    Section IV-B uses coordinates of se(3). There, a rotation bends the path of the translation,
    which increases errors in gaps by a factor of two to four. Therefore positions and rotations
    have independent coordinates, unless those of the paper are requested.
    """

    rows: Indices  # (S, n), indices of samples
    times: Floats  # (S, n), seconds
    references: Floats  # (S, 4, 4), the middle poses
    coordinates: Floats  # (S, n, 6), of the samples about their segment's reference
    joint: bool  # whether coordinates are those of se(3)

    @classmethod
    def of(
        cls, samples: Samples, size: int, *, joint: bool = False, breaks: Indices = _NOWHERE
    ) -> GPSegments:
        """Divide samples into segments of even size, smaller ones for large rotations.

        Fewer samples than `size` are one segment. `joint` uses coordinates of se(3), as in the
        paper. `breaks` are samples that end a segment. Runs between breaks that are shorter than a
        segment are in none, unless all are.
        """
        while True:
            rows = _rows(len(samples), size, breaks)
            middle = rows[:, rows.shape[1] // 2]
            rotations = so3.log(
                se3.transposed(samples.poses[middle, None, :3, :3]) @ samples.poses[rows, :3, :3]
            )
            if size <= _SMALLEST or np.linalg.norm(rotations, axis=-1).max() < MOST_TURN_RAD:
                break
            size = max(size * 3 // 4 // 2 * 2, _SMALLEST)
        references, poses = samples.poses[middle], samples.poses[rows]
        if joint:
            coordinates = se3.log(se3.inverse(references)[:, None] @ poses)
        else:
            moved = poses[..., :3, 3] - references[:, None, :3, 3]
            coordinates = np.concatenate([moved, rotations], axis=-1)
        return cls(rows, samples.times[rows], references, coordinates, joint)

    def __len__(self) -> int:
        return len(self.rows)

    def poses_at(
        self, segment: Indices, means: Floats, variances: Floats
    ) -> tuple[Floats, Floats]:
        """Return poses (Q, 4, 4) and covariances (Q, 6, 6) of perturbations on the right.

        They are those of coordinates with means and independent variances (Q, 6) in segments (Q,).
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
        weight = smooth_step((times - begin) / (end - begin))
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


def blended(first: Belief, second: Belief, weight: Floats) -> Belief:
    """Return the moments of the mixture of two beliefs, by the weights (Q,) of the second.

    The difference between the two is a part of the covariance. An average of precisions instead
    would be overconfident where they disagree.
    """
    w = weight[:, None]
    apart = se3.log(se3.inverse(first.poses) @ second.poses)
    poses = first.poses @ se3.exp(w * apart)

    def seen(belief: Belief, offset: Floats) -> Floats:
        carried = se3.inverse_left_jacobian(-offset)
        spread = offset[:, :, None] * offset[:, None, :]
        return se3.congruent(carried, belief.covariances) + spread

    covariances = (1.0 - w)[..., None] * seen(first, -w * apart)
    covariances += w[..., None] * seen(second, (1.0 - w) * apart)
    return Belief(poses, covariances)
