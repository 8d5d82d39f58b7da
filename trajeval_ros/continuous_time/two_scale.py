"""Gaps: a second, coarser process where a segment of samples is too short to see across one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.continuous_time.blending import blended
from trajeval_ros.continuous_time.kernels import Kernel
from trajeval_ros.continuous_time.piecewise_gp import PiecewiseGP
from trajeval_ros.continuous_time.samples import Belief, Samples
from trajeval_ros.continuous_time.segments import smooth_step

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# A coarse segment of twenty samples spans as long as a gap, but never more than two seconds.
_STEPS_PER_GAP, _COARSEST_S = 20, 0.1
_WORTHWHILE = 1.5
_RAMP = 0.1


@dataclass(frozen=True, eq=False)
class TwoScaleGP:
    """A piecewise process, and a coarser one that takes over inside gaps.

    At 200 Hz twenty samples span 0.1 s and know nothing of the speed a second away.

    Attributes:
        fine: Of all samples.
        coarse: Of thinned ones; None without gaps, or where samples are sparse already.
        times: (N,), seconds, of the samples.
        gaps: Indices of the samples that a gap follows.
    """

    fine: PiecewiseGP
    coarse: PiecewiseGP | None
    times: Array
    gaps: Indices

    @classmethod
    def fit(cls, samples: Samples, kernels: Sequence[Kernel]) -> TwoScaleGP:
        """Fit both; arguments as of `PiecewiseGP.fit`."""
        fine = PiecewiseGP.fit(samples, kernels)
        gaps, coarse = samples.gaps, None
        if len(gaps):
            usual = samples.usual_step_s
            wanted = float(np.median(np.diff(samples.times)[gaps])) / _STEPS_PER_GAP
            step = max(min(wanted, _COARSEST_S), usual)
            if step > _WORTHWHILE * usual:
                coarse = PiecewiseGP.fit(samples[thinned(samples, step)], kernels)
        return cls(fine, coarse, samples.times, gaps)

    def at(self, times: Array) -> Belief:
        """Return what is known at times (Q,), seconds, within those of the samples."""
        belief = self.fine.at(times)
        if self.coarse is None:
            return belief
        before = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, None)
        inside = np.flatnonzero(np.isin(before, self.gaps))
        start, end = self.times[before[inside]], self.times[before[inside] + 1]
        share = (times[inside] - start) / (end - start)
        weight = smooth_step(share / _RAMP) * smooth_step((1.0 - share) / _RAMP)
        own = Belief(belief.poses[inside], belief.covariances[inside])
        mixed = blended(own, self.coarse.at(times[inside]), weight)
        belief.poses[inside], belief.covariances[inside] = mixed.poses, mixed.covariances
        return belief


def thinned(samples: Samples, step_s: float) -> Indices:
    """Return the rows to keep: the first of each step, and both edges of every gap."""
    cell = np.floor(samples.times / step_s)
    first = np.concatenate([[True], np.diff(cell) > 0.0])
    first[samples.gaps] = first[samples.gaps + 1] = True
    first[-1] = True
    return np.flatnonzero(first)
