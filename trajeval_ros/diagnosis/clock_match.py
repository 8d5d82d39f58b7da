"""The offset and the rate between two clocks by the likelihood of the rates of motion.

Speeds and angular speeds depend neither on conventions nor on the alignment nor on the body's
axes. With the correlation c of n independent seconds, the logarithm of the likelihood relative to
unrelated rates is -n/2 log(1 - c^2), per kind of rate.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trajeval_ros.calibration.clock_offset import masked_correlation, refined_peak
from trajeval_ros.diagnosis.input_pair import TimedPoses
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.statistics import quantile

_CELL_S, _CELLS = 0.05, 4000  # least cell, and most cells of a run, which bounds the cost
_WINDOW_S = 0.4  # of a rate: noise matters in shorter windows
_INDEPENDENT_S = 1.0  # after which rates are independent
_LEAST_OVERLAP_S, _LEAST_OVERLAP = 8.0, 0.5  # with less common time, rates match at random
_PEAK_S = 3.0  # width of a peak of the correlation
SMALL_S = 0.25  # offsets within this are near zero: a search finds them without a prior
_LARGEST = 0.999  # correlation, for its logarithm
_BELOW_OUTLIERS = 0.98  # share of the rates that are used as they are; larger ones are reduced
_PARTS, _PART_REACH_S = 3, 6.0  # parts with their own offsets, and largest change of an offset
_SLOWEST, _FASTEST = 0.4, 2.5  # clock rates of the search
_FIRST_SPAN_S, _COHERENT_S = 30.0, 0.7  # of the search: first part, and shift at its ends
_REFINED = 4  # rates to refine with a longer part


@dataclass(frozen=True, eq=False)
class RatesOfMotion:
    """Speeds and angular speeds on a grid of time."""

    start_s: float
    known: Floats  # (N,) 1 where rates are known, and 0 in gaps
    values: Floats  # (1 or 2, N): speeds and, with orientations, angular speeds
    cell_s: float

    @classmethod
    def of(cls, poses: TimedPoses, cell_s: float, window_s: float) -> RatesOfMotion:
        """Return the rates of poses in order, by differences over a window."""
        half = max(1, round(window_s / cell_s / 2))
        count = int(poses.span_s / cell_s)
        start_s = float(np.floor(poses.seconds[0] / cell_s) * cell_s)
        grid: Floats = start_s + cell_s * np.arange(-half, count + half, dtype=np.float64)
        at = poses.at(grid, max(4.0 * poses.usual_step_s, 0.3))
        before, after = slice(None, -2 * half), slice(2 * half, None)
        wide_s = 2 * half * cell_s
        values = [np.linalg.norm(at.positions[after] - at.positions[before], axis=1) / wide_s]
        if at.quaternions is not None:
            cosine = np.abs(np.einsum("ni,ni->n", at.quaternions[before], at.quaternions[after]))
            values.append(2.0 * np.arccos(np.clip(cosine, 0.0, 1.0)) / wide_s)
        known = (at.known[before] & at.known[after]).astype(np.float64)
        return cls(start_s, known, np.array(values), cell_s)

    def by_faster_clock(self, factor: float) -> RatesOfMotion:
        """Return the rates by a clock that is `factor` times as slow: time is stretched."""
        at, cells = np.arange(int(len(self.known) * factor)) / factor, np.arange(len(self.known))
        known = (np.interp(at, cells, self.known) > _LARGEST).astype(np.float64)
        values = np.array([np.interp(at, cells, row) for row in self.values]) / factor
        return RatesOfMotion(self.start_s, known, values, self.cell_s)

    def cells(self, first: int, end: int) -> RatesOfMotion:
        """Return the rates from one cell to another, excluded."""
        start_s = self.start_s + first * self.cell_s
        return RatesOfMotion(
            start_s, self.known[first:end], self.values[:, first:end], self.cell_s
        )

    def part(self, begin: float, end: float) -> RatesOfMotion:
        """Return the rates between two fractions of the time."""
        return self.cells(int(len(self.known) * begin), int(len(self.known) * end))

    @functools.cached_property
    def standardized(self) -> Floats:
        """Values with zero mean and unit variance, without outliers, and zero in gaps."""
        inside = self.known > 0.0
        if np.count_nonzero(inside) < 4:
            return np.zeros_like(self.values)
        rows = []
        for row in self.values:
            top = quantile(np.sort(row[inside]), _BELOW_OUTLIERS)
            bounded = np.minimum(row, top)
            centred = np.where(inside, bounded - bounded[inside].mean(), 0.0)
            rows.append(centred / max(float(centred[inside].std()), 1e-9 * top, 1e-12))
        return np.array(rows)


@dataclass(frozen=True)
class ClockMatch:
    """The likeliest offset between two clocks."""

    offset_s: float  # to add to the estimate's timestamps
    log_odds: float  # logarithm of the likelihood relative to unrelated rates
    log_odds_at_zero: float  # the same without an offset, or with one below `SMALL_S`
    log_odds_of_second: float  # the same of the best other peak
    peak: float  # mean correlation
    as_stamped: float  # mean correlation without an offset
    highest: float  # the larger of the correlations of speeds and of angular speeds
    overlap_s: float
    searched_s: float  # length of the searched interval of offsets

    @classmethod
    def between(cls, groundtruth: RatesOfMotion, estimate: RatesOfMotion) -> ClockMatch | None:
        """Search all offsets with enough common time; None without any."""
        lags, correlations, common = _correlations(groundtruth, estimate)
        cell_s = estimate.cell_s
        overlap_s = common * cell_s
        enough = overlap_s >= max(_LEAST_OVERLAP_S, _LEAST_OVERLAP * float(overlap_s.max()))
        if not enough.any():
            return None
        shift_s = cell_s * lags + groundtruth.start_s - estimate.start_s
        log_odds = np.where(enough, _log_odds(correlations, overlap_s), -1.0)
        best, zero = int(log_odds.argmax()), int(np.abs(shift_s).argmin())
        mean = correlations.mean(axis=0)
        others = log_odds[enough & (np.abs(shift_s - shift_s[best]) >= _PEAK_S)]
        near = (np.abs(shift_s) <= SMALL_S) & (overlap_s > _LEAST_OVERLAP_S / 2.0)
        return cls(
            float(shift_s[best] + cell_s * refined_peak(mean, best)),
            float(log_odds[best]),
            float(max(log_odds[near].max(initial=0.0), 0.0)),
            float(others.max(initial=0.0)),
            float(mean[best]),
            float(mean[zero]) if near.any() else 0.0,
            float(correlations[:, best].max()),
            float(overlap_s[best]),
            float(np.ptp(shift_s)),
        )


def rates_of_both(
    groundtruth: TimedPoses, estimate: TimedPoses
) -> tuple[RatesOfMotion, RatesOfMotion]:
    """Return the rates of both sides on one grid, whose cells are longer for long runs."""
    cell_s = max(_CELL_S, max(groundtruth.span_s, estimate.span_s) / _CELLS)
    window_s = max(_WINDOW_S, 2.0 * groundtruth.usual_step_s, 2.0 * estimate.usual_step_s)
    return (
        RatesOfMotion.of(groundtruth, cell_s, window_s),
        RatesOfMotion.of(estimate, cell_s, window_s),
    )


def _correlations(
    groundtruth: RatesOfMotion, estimate: RatesOfMotion
) -> tuple[Floats, Floats, Floats]:
    """Return lags (K,), correlations (kinds, K), and the number of common cells (K,)."""
    kinds = min(len(estimate.values), len(groundtruth.values))
    lags, correlations, common = masked_correlation(
        estimate.standardized[:kinds],
        estimate.known,
        groundtruth.standardized[:kinds],
        groundtruth.known,
    )
    return lags.astype(np.float64), correlations, common


def _log_odds(correlations: Floats, overlap_s: Floats) -> Floats:
    """Return the sum over kinds of -n/2 log(1 - c^2) (K,) of correlations (kinds, K)."""
    bounded = np.clip(correlations, 0.0, _LARGEST)
    total: Floats = np.sum(-0.5 * overlap_s / _INDEPENDENT_S * np.log(1.0 - bounded**2), axis=0)
    return total


def parts_log_odds(
    groundtruth: RatesOfMotion, estimate: RatesOfMotion, match: ClockMatch
) -> float:
    """Return how much likelier parts of the run are with offsets of their own, as a logarithm.

    It is large if the clock rates differ, and infinite if no offset fits the whole run.
    """
    if match.log_odds <= 0.0 or match.peak < 0.6:
        return float("inf")
    apart = together = 0.0
    cell_s = estimate.cell_s
    cells = round((match.offset_s + estimate.start_s - groundtruth.start_s) / cell_s)
    reach = int(_PART_REACH_S / cell_s)
    for number in range(_PARTS):
        part = estimate.part(number / _PARTS, (number + 1) / _PARTS)
        count = len(part.known)
        first = cells + round((part.start_s - estimate.start_s) / cell_s)
        low, high = max(first - reach, 0), min(first + count + reach, len(groundtruth.known))
        if high - low < count // 2:
            continue
        lags, correlations, common = _correlations(groundtruth.cells(low, high), part)
        log_odds = np.where(common > 0.7 * count, _log_odds(correlations, common * cell_s), 0.0)
        at = int(np.abs(lags - (first - low)).argmin())
        apart += float(log_odds.max())
        together += float(log_odds[max(at - 2, 0) : at + 3].max())
    # Two more offsets, each out of this many.
    return apart - together - 2.0 * float(np.log(2.0 * _PART_REACH_S / (4.0 * _CELL_S)))


def search_rate(
    groundtruth: RatesOfMotion, estimate: RatesOfMotion
) -> tuple[float, ClockMatch] | None:
    """Return the clock rate with the largest likelihood, and its match; None without a match.

    A part from the middle of the run allows large steps of the rate. Longer parts refine it.
    """
    total_s = len(estimate.known) * estimate.cell_s
    span_s = min(_FIRST_SPAN_S, total_s)
    step = 2.0 * _COHERENT_S / span_s if span_s > 0.0 else 1.0
    count = int(np.log(_FASTEST / _SLOWEST) / step)
    factors = np.geomspace(_SLOWEST, _FASTEST, max(count, 2))
    score = _QuickLogOdds(groundtruth)
    while True:
        half = 0.5 * span_s / total_s
        part = estimate.part(0.5 - half, 0.5 + half)
        ranked = sorted(factors, key=lambda factor: score(part.by_faster_clock(factor)))
        if span_s >= total_s:
            break
        span_s, width = min(4.0 * span_s, total_s), step
        step = 2.0 * _COHERENT_S / span_s
        half_count = np.ceil(width / step / 2.0)
        near = np.exp(step * np.arange(-half_count, half_count + 1.0))
        factors = np.unique(np.outer(ranked[-_REFINED:], near))
    # Fast motions correlate only within a part of the last step.
    last = ranked[-1] * np.exp(step * np.linspace(-0.5, 0.5, 9))
    factor = max(last, key=lambda factor: score(estimate.by_faster_clock(factor)))
    match = ClockMatch.between(groundtruth, estimate.by_faster_clock(factor))
    return None if match is None else (float(factor), match)


@dataclass(frozen=True, eq=False)
class _QuickLogOdds:
    """An approximation of the likelihood of many rates: gaps count as the mean."""

    groundtruth: RatesOfMotion
    spectra: dict[int, tuple[Any, Any]] = field(default_factory=dict)  # by size

    def __call__(self, estimate: RatesOfMotion) -> float:
        """Return the largest logarithm of the likelihood over all offsets, per second."""
        a = estimate.standardized[: len(self.groundtruth.values)]
        b = self.groundtruth.standardized[: len(a)]
        least = a.shape[-1] + b.shape[-1] - 1
        # The shortest fast transform without a wrap.
        size = min(n << max((-(-least // n) - 1).bit_length(), 0) for n in (1, 3, 5, 9))
        if size not in self.spectra:
            self.spectra[size] = np.fft.rfft(b, size), np.fft.rfft(b**2, size)
        values, squares = self.spectra[size]
        product = np.fft.irfft(np.conj(np.fft.rfft(a, size)) * values, size)
        energy = np.fft.irfft(np.conj(np.fft.rfft(estimate.known, size)) * squares, size)
        count = float(estimate.known.sum())
        norm = np.sqrt(np.maximum(energy, 0.3 * count) * count + 1e-9)
        bounded = np.clip(product / norm, 0.0, _LARGEST)
        return float((-0.5 * np.log(1.0 - bounded**2)).sum(axis=0).max())
