"""Gaps: an additional coarse process for gaps that are longer than a segment of samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.blending import blended
from trajeval_ros.continuous_time.gp_segments import runs_between, smooth_step
from trajeval_ros.continuous_time.kernels import Kernel
from trajeval_ros.continuous_time.piecewise_gp import PiecewiseGP
from trajeval_ros.continuous_time.samples import Belief, Samples
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices

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

    Attributes:
        fine: Process of all samples.
        coarse: Process of thinned samples; None without gaps, or if samples are sparse.
        times: (N,), seconds, of the samples.
        gaps: Indices of the samples before a gap that the coarse process covers.
        short: (N,), whether a sample is in a run shorter than a segment.
        ramp_s: Longest transition between the two, seconds.
    """

    fine: PiecewiseGP
    coarse: PiecewiseGP | None
    times: Floats
    gaps: Indices
    short: Booleans
    ramp_s: float

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
        own = Belief(belief.poses[inside], belief.covariances[inside])
        mixed = blended(own, self.coarse.at(times[inside]), weight)
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
