"""Models without uncertainty between samples: nearest sample, and linear with slerp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.continuous_time.samples import Belief, Samples
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Floats


@dataclass(frozen=True, eq=False)
class LinearInterpolation:
    """Linear positions and slerp, with the covariance of a sample everywhere."""

    samples: Samples

    def at(self, times: Floats) -> Belief:
        """Return the belief at times (Q,), seconds, within those of the samples."""
        samples = self.samples
        before, share = _before(samples, times)
        start, end = samples.poses[before], samples.poses[before + 1]
        turns = so3.log(se3.transposed(start[:, :3, :3]) @ end[:, :3, :3])
        rotations = start[:, :3, :3] @ so3.exp(share * turns)
        positions = (1.0 - share) * start[:, :3, 3] + share * end[:, :3, 3]
        return Belief(se3.poses(rotations, positions), sample_covariances(samples, len(times)))


@dataclass(frozen=True, eq=False)
class NearestSample:
    """The nearest sample in time, with its covariance."""

    samples: Samples

    def at(self, times: Floats) -> Belief:
        """Return the belief at times (Q,), seconds, within those of the samples."""
        before, share = _before(self.samples, times)
        nearest = before + (share[:, 0] > 0.5)
        return Belief(self.samples.poses[nearest], sample_covariances(self.samples, len(times)))


def sample_covariances(samples: Samples, count: int) -> Floats:
    """Return the covariance of a sample `count` times, (count, 6, 6)."""
    noise = samples.noise
    rotation = noise.rotation_rad if samples.oriented else 0.0
    variances = np.square([noise.position_m] * 3 + [rotation] * 3)
    return np.tile(np.diag(variances), (count, 1, 1))


def _before(samples: Samples, times: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the sample before every time, and the elapsed share (Q, 1) of its step."""
    last = len(samples) - 2
    before = np.clip(np.searchsorted(samples.times, times, side="right") - 1, 0, last)
    start, end = samples.times[before], samples.times[before + 1]
    return before, ((times - start) / (end - start))[:, None]
