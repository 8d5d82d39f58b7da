"""Rates of motion over time, angular speed and speed, which do not depend on the frame.

The angular speed does not depend on the gauge, on the body, or on order and sign of the components
of quaternions. Therefore clocks are tested before conventions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.clock_offset import masked_correlation, refined_peak
from trajeval_ros.diagnosis.motion_track import MotionTrack, lengths
from trajeval_ros.geometry.arrays import Booleans, Floats

_LEAST_CELL_S, _CELLS = 0.05, 4000
_LEAST_WINDOW_S, _SHORT_WINDOW_S = 0.4, 0.2
_LEAST_OVERLAP_S, _SHARE_OF_OVERLAP = 8.0, 0.5
# Largest ratio of unlikeness of a clock correction that is accepted.
LEAST_LIKELY = 0.8
_LOBE_S = 3.0  # on both sides of a peak
_SEARCH_S = 3.0  # for parts of a run
_OUTLIERS = 0.02  # fraction of the rates that is limited to the largest of the others


@dataclass(frozen=True, eq=False)
class MotionRates:
    """Rates on a grid of cells that both sides share.

    Attributes:
        start: Index of the first cell on the common grid.
        known: (N,) 1 where the rates are known, 0 in gaps.
        rates: (K, N) speeds, in units of the source, and angular speeds, rad/s; K is 1 without
            orientations.
    """

    start: int
    known: Floats
    rates: Floats

    @classmethod
    def of(cls, track: MotionTrack, cell_s: float, window_s: float, epoch_s: float) -> MotionRates:
        """Sample a track in order, from poses half a window before and after every cell."""
        half = max(1, round(window_s / cell_s / 2.0))
        count = int(track.span_s / cell_s)
        start = round((float(track.seconds[0]) - epoch_s) / cell_s)
        cells = np.arange(start - half, start + count + half, dtype=np.float64)
        grid: Floats = epoch_s + cell_s * cells
        between = track.at(grid, max(4.0 * track.usual_step_s, 0.3))
        before, after = slice(None, -2 * half), slice(2 * half, None)
        known = between.known[before] & between.known[after]
        wide_s = 2.0 * half * cell_s
        rates = [lengths(between.positions[after] - between.positions[before]) / wide_s]
        if between.quaternions is not None:
            q = between.quaternions
            cosine = np.abs(np.einsum("ni,ni->n", q[before], q[after]))
            rates.append(2.0 * np.arccos(np.clip(cosine, 0.0, 1.0)) / wide_s)
        return cls(start, known.astype(np.float64), np.array(rates))


@dataclass(frozen=True, eq=False)
class ClockMatch:
    """Offset with the largest correlation of the rates of both sides.

    Attributes:
        offset_s: Offset to add to the estimate's timestamps, seconds.
        peak: Mean correlation of angular speed and speed at this offset.
        zero: Mean correlation without an offset.
        second: Largest mean correlation outside of the lobe of the peak.
        overlap_s: Longest common time span with known rates of all offsets, seconds.
        turning: Correlation of the angular speeds at the peak; NaN without orientations.
        speed: Correlation of the speeds at the peak.
        cell_s: Width of a cell, seconds.
        sides: Rates of the estimate and of the groundtruth.
    """

    offset_s: float
    peak: float
    zero: float
    second: float
    overlap_s: float
    turning: float
    speed: float
    cell_s: float
    sides: tuple[MotionRates, MotionRates]

    @property
    def is_alone(self) -> bool:
        """Whether the peak is high and unique."""
        return self.peak > 0.6 and self.second < 0.85 * self.peak


def match_clocks(truth: MotionTrack, estimate: MotionTrack) -> ClockMatch | None:
    """Correlate at all lags with a long common time span; None without such a lag.

    Args:
        truth: Groundtruth in order of time.
        estimate: Estimate in order of time.
    """
    cell_s = max(_LEAST_CELL_S, max(truth.span_s, estimate.span_s) / _CELLS)
    window_s = max(_LEAST_WINDOW_S, 2.0 * truth.usual_step_s, 2.0 * estimate.usual_step_s)
    epoch_s = float(truth.seconds[0])
    ours, true = (MotionRates.of(each, cell_s, window_s, epoch_s) for each in (estimate, truth))
    kinds = min(len(ours.rates), len(true.rates))
    lags, alike, common = masked_correlation(
        tamed(ours.rates[:kinds], ours.known),
        ours.known,
        tamed(true.rates[:kinds], true.known),
        true.known,
    )
    mean = alike.mean(axis=0)
    overlap_s = common * cell_s
    longest_s = float(overlap_s.max()) if len(overlap_s) else 0.0
    enough = overlap_s >= max(_LEAST_OVERLAP_S, _SHARE_OF_OVERLAP * longest_s)
    if not enough.any():
        return None
    shift_s: Floats = cell_s * (lags + true.start - ours.start).astype(np.float64)
    heights = np.where(enough, mean, -1.0)
    at = int(np.argmax(heights))
    between = refined_peak(heights, at) if _inside(enough, at) else 0.0
    rest = heights[enough & (np.abs(shift_s - shift_s[at]) >= _LOBE_S)]
    as_stamped = int(np.argmin(np.abs(shift_s)))
    known = abs(float(shift_s[as_stamped])) <= cell_s and overlap_s[as_stamped] > 5.0
    return ClockMatch(
        offset_s=float(shift_s[at]) + between * cell_s,
        peak=float(heights[at]),
        zero=float(mean[as_stamped]) if known else 0.0,
        second=float(rest.max()) if len(rest) else 0.0,
        overlap_s=longest_s,
        turning=float(alike[1, at]) if kinds == 2 else np.nan,
        speed=float(alike[0, at]),
        cell_s=cell_s,
        sides=(ours, true),
    )


def unlikeness_ratio(
    truth: MotionTrack,
    estimate: MotionTrack,
    offset_s: float,
    rate: float = 0.0,
    *,
    known_s: float = 0.0,
) -> float:
    """Return the ratio of the differences of two rates with and without a clock's correction.

    It is less than 1 if the correction helps. A random offset, caused by drift, does not help.

    Args:
        truth: Groundtruth in order of time.
        estimate: Estimate in order of time.
        offset_s: Correction of the estimate's timestamps, seconds.
        rate: Correction of the rate of its clock, a fraction.
        known_s: Offset that is applied without the correction, seconds.

    Returns:
        NaN if the common time span is shorter than 8 s.
    """
    before = _unlikeness(_by_clock_of(estimate, truth, known_s, 0.0), estimate)
    after = _unlikeness(_by_clock_of(estimate, truth, offset_s, rate), estimate)
    return after / max(before, 1e-12)


def _by_clock_of(
    estimate: MotionTrack, truth: MotionTrack, offset_s: float, rate: float
) -> MotionTrack:
    """Return the groundtruth with timestamps of the estimate's clock.

    The estimate keeps its timestamps, so its poses have the same phases on the grid of cells. At
    another phase, interpolation averages the noise of two poses, and the correlation increases.
    """
    start_s = float(estimate.seconds[0])
    seconds = start_s + (truth.seconds - start_s - offset_s) / (1.0 + rate)
    return MotionTrack(seconds, truth.positions, truth.quaternions)


def _unlikeness(truth: MotionTrack, estimate: MotionTrack) -> float:
    """Return 1 - correlation of the angular speeds, or of the speeds without orientations."""
    cell_s = max(_LEAST_CELL_S, estimate.span_s / _CELLS)
    window_s = max(_SHORT_WINDOW_S, 2.0 * truth.usual_step_s, 2.0 * estimate.usual_step_s)
    epoch_s = float(estimate.seconds[0])
    ours, true = (MotionRates.of(each, cell_s, window_s, epoch_s) for each in (estimate, truth))
    begin = max(ours.start, true.start)
    end = min(ours.start + len(ours.known), true.start + len(true.known))
    rows, others = (
        slice(begin - each.start, max(end, begin) - each.start) for each in (ours, true)
    )
    known = ours.known[rows] * true.known[others]
    if known.sum() * cell_s < _LEAST_OVERLAP_S:
        return np.nan
    kind = min(len(ours.rates), len(true.rates)) - 1
    a, b = tamed(ours.rates[kind, rows], known), tamed(true.rates[kind, others], known)
    return 1.0 - float(a @ b) / max(float(np.sqrt((a @ a) * (b @ b))), 1e-12)


def offsets_of_parts(match: ClockMatch, offset_s: float, parts: int) -> tuple[Floats, Floats]:
    """Return the middles and the offsets of parts of a run with a peak, seconds.

    Args:
        match: Match of the whole run.
        offset_s: Centre of the search range, seconds.
        parts: Number of parts.
    """
    ours, true = match.sides
    kinds = min(len(ours.rates), len(true.rates))
    size, reach = len(ours.known) // parts, int(_SEARCH_S / match.cell_s)
    cells = round(offset_s / match.cell_s)
    rows = np.arange(parts * size).reshape(parts, size)
    first = rows[:, :1] + ours.start - true.start + cells - reach
    others = first + np.arange(size + 2 * reach)
    inside = (others >= 0) & (others < len(true.known))
    others = np.clip(others, 0, len(true.known) - 1)
    known, others_known = ours.known[rows], inside * true.known[others]
    lags, alike, common = masked_correlation(
        tamed(ours.rates[:kinds, rows], known),
        known,
        tamed(true.rates[:kinds, others], others_known),
        others_known,
    )
    within = (lags >= 0) & (lags <= 2 * reach)
    enough = common[:, within] > 0.6 * size
    heights = np.where(enough, alike[..., within], -1.0).mean(axis=0)
    middles, offsets = [], []
    for part, height in enumerate(heights):
        at = int(np.argmax(height))
        if 0 < at < len(height) - 1 and height[at] > 0.6:
            middles.append((rows[part, 0] + size / 2.0) * match.cell_s)
            offsets.append((at - reach + cells + refined_peak(height, at)) * match.cell_s)
    return np.array(middles), np.array(offsets)


def tamed(rate: Floats, known: Floats) -> Floats:
    """Return rates (..., N) without outliers, with mean 0 and standard deviation 1; 0 in gaps."""
    here = np.broadcast_to(known > 0.0, rate.shape)
    count = here.sum(axis=-1, keepdims=True)
    # Rates are not negative: sorted, gaps come first.
    ranked = np.sort(np.where(here, rate, -1.0), axis=-1)
    place = rate.shape[-1] - 1 - _OUTLIERS * np.maximum(count - 1, 0)
    below = np.floor(place).astype(np.int64)
    above = np.minimum(below + 1, rate.shape[-1] - 1)
    low, high = (np.take_along_axis(ranked, each, axis=-1) for each in (below, above))
    high = low + (place - below) * (high - low)
    tame = np.where(here, np.minimum(rate, high), 0.0)
    number = np.maximum(count, 1)
    tame = np.where(here, tame - tame.sum(axis=-1, keepdims=True) / number, 0.0)
    spread = np.sqrt(np.square(tame).sum(axis=-1, keepdims=True) / number)
    scaled: Floats = tame / np.maximum(spread, np.maximum(1e-9 * high, 1e-12))
    return scaled


def _inside(enough: Booleans, at: int) -> bool:
    return 0 < at < len(enough) - 1 and bool(enough[at - 1] and enough[at + 1])
