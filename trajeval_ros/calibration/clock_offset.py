"""Initial clock offset from the cross-correlation of two rates of motion.

The rate is the magnitude of the angular velocity, which is independent of gauge, body and lever
arm. Without orientations it is the speed. Gaps are masked, so that the correlation at every lag is
exact for the common data (Padfield, Masked object registration in the Fourier domain, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trajeval_ros.calibration.increments import PoseInterpolator, whole_nanoseconds
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

SEARCH_S = 5.0
OVERLAP_S = 10.0
_CELL_S = 0.02
_WINDOW_S = 0.1
# Least correlation at the peak; a lever arm disturbs the speed.
_LEAST_PEAK = {"angular rate": 0.7, "speed": 0.5}
_LEAST_OVERLAP = 0.5  # relative to the longest overlap, if all lags are searched
_LARGEST_SECOND = 0.8  # largest second peak relative to the first


@dataclass(frozen=True)
class OffsetGuess:
    """The offset with the largest correlation, and whether it is usable."""

    offset_s: float  # offset to add to the estimate's timestamps
    peak: float  # correlation at the offset, in [-1, 1]
    second: float  # largest correlation outside of the peak's lobe
    peak_to_sidelobe: float  # (peak - mean) / std of the correlations outside of the lobe
    signal: str  # `angular rate` or `speed`
    overlap_s: float  # time for which both rates are known at the offset
    problem: str = ""  # why the offset is not usable; "" if it is

    @property
    def is_usable(self) -> bool:
        """Whether the peak is high, unique and within the search range."""
        return not self.problem


def masked_correlation(
    a: Floats, in_a: Floats, b: Floats, in_b: Floats, most: int | None = None
) -> tuple[Indices, Floats, Floats]:
    """Return the normalised cross-correlation of two signals with gaps at all lags, or to `most`.

    Signals `a` (..., N) and `b` (..., M) are zero in gaps; `in_a` and `in_b` are 1 where they are
    known and 0 in gaps, without leading axes if all have equal gaps. Returned are the lags k (K,),
    from 0 if `most` is given, where a[n] coincides with b[n + k]; the correlations (..., K), zero
    where a signal is constant; and the numbers of cells (..., K) that both know.
    """
    shorter, longer = a.shape[-1], b.shape[-1]
    lags = np.arange(1 - shorter, longer) if most is None else np.arange(most + 1)
    # No other lag has the same index as one of these; `b` is cut behind the last one.
    size = 1 << (shorter + int(lags[-1]) - 1).bit_length()
    left = [np.conj(np.fft.rfft(signal, size)) for signal in (a, in_a, a * a)]
    right = [np.fft.rfft(signal, size) for signal in (b, in_b, b * b)]

    def met(one: int, other: int) -> Floats:
        products = np.fft.irfft(left[one] * right[other], size)
        return np.asarray(np.roll(products, -lags[0], axis=-1)[..., : len(lags)])

    common = np.rint(met(1, 1))
    count = np.maximum(common, 1.0)
    sum_a, sum_b = met(0, 1), met(1, 0)
    covariance = met(0, 0) - sum_a * sum_b / count
    variance_a, variance_b = met(2, 1) - sum_a**2 / count, met(1, 2) - sum_b**2 / count
    spread = np.sqrt(np.maximum(variance_a, 0.0) * np.maximum(variance_b, 0.0))
    # A constant signal has a variance of rounding errors.
    varies = spread > 1e-9 * np.maximum(1.0, spread.max(axis=-1, keepdims=True))
    correlation = np.where(varies, covariance / np.where(varies, spread, 1.0), 0.0)
    return lags, np.clip(correlation, -1.0, 1.0), common


def refined_peak(correlation: Floats, peak: int) -> float:
    """Return the maximum of the parabola through a peak and its neighbours, in cells from it."""
    if not 0 < peak < len(correlation) - 1:
        return 0.0
    before, top, after = correlation[peak - 1 : peak + 2]
    curvature = before - 2.0 * top + after
    return float(0.5 * (before - after) / curvature) if curvature < 0.0 else 0.0


def guess_offset(
    groundtruth: Trajectory,
    estimate: Trajectory,
    *,
    around_s: float = 0.0,
    search_s: float | None = SEARCH_S,
) -> OffsetGuess:
    """Estimate the offset by correlation of angular rates or, if not usable, of speeds.

    The search range is `around_s` +- `search_s`; None for all overlaps. Both sides have at least
    two states.
    """
    by = partial(guess_offset_by, groundtruth, estimate, around_s, search_s)
    if groundtruth.quaternions is None or estimate.quaternions is None:
        return by("speed")
    turning = by("angular rate")
    if turning.is_usable:
        return turning
    moving = by("speed")
    return moving if moving.is_usable else turning


def guess_offset_by(
    groundtruth: Trajectory,
    estimate: Trajectory,
    around_s: float,
    search_s: float | None,
    signal: str,
) -> OffsetGuess:
    """Estimate the offset by the correlation of one signal: "angular rate" or "speed"."""
    with_rotations = signal == "angular rate"
    groundtruth_poses = PoseInterpolator.of(groundtruth, with_rotations=with_rotations)
    estimate_poses = PoseInterpolator.of(estimate, with_rotations=with_rotations, sparse=True)
    window_s = max(_WINDOW_S, estimate_poses.step_s)
    a, in_a = _rate(estimate_poses, window_s)
    b, in_b = _rate(groundtruth_poses, window_s)
    lags, correlation, common = masked_correlation(a, in_a, b, in_b)
    start_s = int(groundtruth_poses.stamps[0] - estimate_poses.stamps[0]) / NANOSECONDS
    lags_s: Floats = start_s + lags.astype(np.float64) * _CELL_S
    guess = _highest(lags_s, correlation, common, around_s, search_s, signal)
    if guess.is_usable or search_s is None:
        return guess
    anywhere = _highest(lags_s, correlation, common, around_s, None, signal)
    if anywhere.peak >= _LEAST_PEAK[signal] and abs(anywhere.offset_s - around_s) > search_s:
        far = (
            f"the clock offset is probably {anywhere.offset_s:+.2f} s, outside the search range "
            f"of {search_s:g} s around {around_s:g} s; give it as --time-offset"
        )
        return replace(guess, problem=far)
    return guess


def _rate(poses: PoseInterpolator, window_s: float) -> tuple[Floats, Floats]:
    """Return the rate of motion on a grid that starts at the first stamp, and where it is known.

    The rate is from poses half a window before and after. Both sides use the same window, since a
    shorter one preserves more of the motion.
    """
    cells = np.arange(int(poses.stamps[0]), int(poses.stamps[-1]), whole_nanoseconds(_CELL_S))
    half = whole_nanoseconds(window_s / 2.0)
    before, after = poses.at(cells - half), poses.at(cells + half)
    known = before.usable & after.usable
    if before.quaternions is not None:
        assert after.quaternions is not None
        rotation_steps = lie.multiply(lie.conjugate(before.quaternions), after.quaternions)
        rate = lie.angle(rotation_steps) / window_s
    else:
        rate = np.linalg.norm(after.positions - before.positions, axis=1) / window_s
    if known.any():
        rate = rate - rate[known].mean()
    return np.where(known, rate, 0.0), known.astype(np.float64)


def _highest(
    lags_s: Floats,
    correlation: Floats,
    common: Floats,
    around_s: float,
    search_s: float | None,
    signal: str,
) -> OffsetGuess:
    """Return the highest correlation of a search range, with its verdict."""
    enough_s = OVERLAP_S
    if search_s is None:
        # With many lags, short overlaps match by chance.
        enough_s = max(OVERLAP_S, _LEAST_OVERLAP * float(common.max()) * _CELL_S)
    known = common * _CELL_S >= enough_s
    within = np.flatnonzero(
        known if search_s is None else known & (np.abs(lags_s - around_s) <= search_s)
    )
    where = "" if search_s is None else f" within {search_s:g} s around {around_s:g} s"
    if len(within) < 3:
        problem = f"no offset{where} gives a common time span of {OVERLAP_S:g} s without gaps"
        overlap_s = float(common.max()) * _CELL_S
        return OffsetGuess(around_s, 0.0, 0.0, 0.0, signal, overlap_s, problem)
    # Lags with enough overlap are contiguous, except for gaps.
    heights = correlation[within]
    peak = int(np.argmax(heights))
    top = float(heights[peak])
    # Noise ripples the top of a wide lobe: another offset is one beyond a lag that does not match.
    falls, low = np.diff(heights) < 0.0, heights <= _LARGEST_SECOND * top
    left = right = peak
    while left > 0 and not (falls[left - 1] and low[left]):
        left -= 1
    while right < len(heights) - 1 and (falls[right] or not low[right]):
        right += 1
    sides = np.concatenate([heights[:left], heights[right + 1 :]])
    second = float(sides.max()) if len(sides) else -1.0
    deviation = float(sides.std()) if len(sides) else 0.0
    problem = ""
    if top < _LEAST_PEAK[signal]:
        problem = (
            f"the {signal}s of groundtruth and estimate do not correlate at any offset{where} "
            f"(correlation {top:.2f}, required {_LEAST_PEAK[signal]:g}): the motion is too "
            "uniform, or the offset is larger"
        )
    elif second > _LARGEST_SECOND * top:
        problem = (
            f"the {signal}s match at several offsets{where} (correlations {top:.2f} and "
            f"{second:.2f}): the motion is periodic or slow"
        )
    elif peak in (0, len(heights) - 1):
        problem = f"the best match of the {signal}s is at the limit of the search range{where}"
    return OffsetGuess(
        offset_s=float(lags_s[within[peak]] + _CELL_S * refined_peak(heights, peak)),
        peak=top,
        second=second,
        peak_to_sidelobe=(top - float(sides.mean())) / deviation if deviation > 0.0 else 0.0,
        signal=signal,
        overlap_s=float(common[within[peak]]) * _CELL_S,
        problem=problem,
    )
