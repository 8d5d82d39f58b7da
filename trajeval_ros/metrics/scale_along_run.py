"""The scale of an estimate along the run: ratios of path lengths, and their drift.

Both paths are measured by the same chords, so that noise of the positions does not lengthen one
of them where the motion is slow. The logarithm of the ratios is modelled as a straight line, a
random walk and white noise. The ratio of the standard deviations of walk and noise is unknown:
the drift is averaged over it, which includes the walk in the drift's standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.formatting.numbers import decimals_of
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.travelled import step_lengths, travelled_distance

PARTS = 20  # more are noisier, fewer have a coarser course of the scale
CHORDS = 5  # per part: more follow the path more closely, and are noisier
FEWEST_PARTS = 8  # with fewer, the standard deviation is mostly unknown
# Steps of the random walk from part to part, in standard deviations of the white noise.
WALKS = np.concatenate([[0.0], np.geomspace(0.03, 10.0, 16)])
_BLOCK = 1024  # positions that are compared at a time


@dataclass(frozen=True, eq=False)
class ScaleAlongRun:
    """Path length of the aligned estimate, divided by the groundtruth's, for K sub-trajectories.

    Attributes:
        length_m: Mean length of the sub-trajectories.
        travelled_m: (K,), the groundtruth's path up to their middles, metres.
        ratios: (K,), 1 where the scale is that of the alignment.
        drift: Slope of the ratios' logarithm, percent per 100 m.
        drift_std: Its standard deviation.
    """

    length_m: float
    travelled_m: Floats
    ratios: Floats
    drift: float
    drift_std: float

    @property
    def is_drifting(self) -> bool:
        """Whether the drift is significant: above four standard deviations."""
        return abs(self.drift) > 4.0 * self.drift_std

    @property
    def drift_text(self) -> str:
        """The drift with its standard deviation, as text without the unit."""
        decimals = decimals_of([self.drift_std])
        return f"{self.drift:.{decimals}f} ± {self.drift_std:.{decimals}f}"


def scale_along_run(groundtruth: Floats, estimate: Floats, scale: float) -> ScaleAlongRun | None:
    """Return the scale along N paired positions (N, 3); None if they are too few or at rest.

    `scale`: that of the alignment, which multiplies the estimate's positions.
    """
    corners = _corners(groundtruth)
    chords, other_chords = step_lengths(groundtruth[corners]), step_lengths(estimate[corners])
    count = min(PARTS, len(chords) // CHORDS)
    if count < FEWEST_PARTS:
        return None
    starts = len(chords) * np.arange(count) // count
    ratios = scale * np.add.reduceat(other_chords, starts) / np.add.reduceat(chords, starts)
    if not (ratios > 0.0).all():
        return None
    # Distances are those of all tables; chords cut corners.
    bounds = travelled_distance(groundtruth)[corners[[*starts, -1]]]
    travelled = (bounds[1:] + bounds[:-1]) / 2.0
    drift, drift_std = _slope(travelled, np.log(ratios))
    percent_per_100_m = 100.0 * 100.0
    return ScaleAlongRun(
        float(bounds[-1] - bounds[0]) / count,
        travelled,
        ratios,
        percent_per_100_m * drift,
        percent_per_100_m * drift_std,
    )


def _corners(positions: Floats) -> Indices:
    """Return the indices of positions (N, 3) that are at least one chord after the previous."""
    chord_m = float(step_lengths(positions).sum()) / (PARTS * CHORDS)
    corners, begin = [0], 1
    while chord_m > 0.0 and begin < len(positions):
        steps = positions[begin : begin + _BLOCK] - positions[corners[-1]]
        far = np.flatnonzero(np.einsum("ni,ni->n", steps, steps) >= chord_m**2)
        if len(far):
            corners.append(begin + int(far[0]))
            begin = corners[-1] + 1
        else:
            begin += _BLOCK
    return np.array(corners)


def _slope(along: Floats, values: Floats) -> tuple[float, float]:
    """Return the slope of K values and its standard deviation, by generalised least squares.

    Half of the prior weight has no random walk, the rest is uniform in the walk's logarithm.
    """
    count, spacing = len(along), float(np.diff(along).mean())
    line = np.column_stack([np.ones(count), (along - along.mean()) / spacing])
    walk = np.minimum.outer(along, along) / spacing
    weights, slopes, variances = [], [], []
    for step in WALKS:
        root = np.linalg.cholesky(np.eye(count) + step**2 * walk)
        white_line, white = np.linalg.solve(root, line), np.linalg.solve(root, values)
        normal = white_line.T @ white_line
        fitted = np.linalg.solve(normal, white_line.T @ white)
        squares = float(np.sum((white - white_line @ fitted) ** 2))
        degrees = count - 2
        # Restricted likelihood; the noise's variance is integrated out, which leaves a
        # t distribution of the slope, with the variance of the last line.
        squares = max(squares, np.finfo(float).tiny)
        log_likelihood = -np.log(np.diag(root)).sum() - 0.5 * np.linalg.slogdet(normal)[1]
        weights.append(log_likelihood - 0.5 * degrees * np.log(squares))
        slopes.append(fitted[1])
        variances.append(np.linalg.inv(normal)[1, 1] * squares / (degrees - 2))
    weight = np.exp(np.array(weights) - max(weights))
    weight[0] *= len(WALKS) - 1
    weight /= weight.sum()
    mean = float(weight @ np.array(slopes))
    variance = float(weight @ (np.array(variances) + (np.array(slopes) - mean) ** 2))
    return mean / spacing, variance**0.5 / spacing
