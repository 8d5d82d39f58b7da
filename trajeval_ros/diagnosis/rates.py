"""Rates of motion over time: how fast a body turns and moves, whatever frame it is told in.

Neither the gauge nor the body changes how fast a body turns, nor does any order or sign of the
components of its quaternions. So clocks are found before conventions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.clock_offset import masked_correlation, refined_peak
from trajeval_ros.diagnosis.motion_track import MotionTrack, lengths
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices

_LEAST_CELL_S, _CELLS = 0.05, 4000
_LEAST_WINDOW_S, _SHORT_WINDOW_S = 0.4, 0.2
_LEAST_OVERLAP_S, _SHARE_OF_OVERLAP = 8.0, 0.5
# Of the ratio of unlikeness: what another clock must achieve.
LEAST_LIKELY = 0.8
_LOBE_S = 3.0  # to both sides of a peak
_SEARCH_S = 3.0  # of parts of a run


@dataclass(frozen=True, eq=False)
class MotionRates:
    """Rates on a grid of cells that both sides share.

    Attributes:
        start: The first cell's place on the common grid.
        known: (N,) 1 where the rates are known, 0 in holes.
        turning: (N,) angular speeds, rad/s; None without orientations.
        speed: (N,) speeds, in units of the source.
    """

    start: int
    known: Floats
    turning: Floats | None
    speed: Floats

    @classmethod
    def of(cls, track: MotionTrack, cell_s: float, window_s: float, epoch_s: float) -> MotionRates:
        """Sample a track in order, by poses half a window before and after each cell."""
        half = max(1, round(window_s / cell_s / 2.0))
        count = int(track.span_s / cell_s)
        start = round((float(track.seconds[0]) - epoch_s) / cell_s)
        cells = np.arange(start - half, start + count + half, dtype=np.float64)
        grid: Floats = epoch_s + cell_s * cells
        between = track.at(grid, max(4.0 * track.usual_step_s, 0.3))
        before, after = slice(None, -2 * half), slice(2 * half, None)
        known = between.known[before] & between.known[after]
        wide_s = 2.0 * half * cell_s
        turning = None
        if between.quaternions is not None:
            q = between.quaternions
            cosine = np.abs(np.einsum("ni,ni->n", q[before], q[after]))
            turning = 2.0 * np.arccos(np.clip(cosine, 0.0, 1.0)) / wide_s
        speed = lengths(between.positions[after] - between.positions[before]) / wide_s
        return cls(start, known.astype(np.float64), turning, speed)


@dataclass(frozen=True, eq=False)
class ClockMatch:
    """Where the rates of both sides resemble each other the most.

    Attributes:
        offset_s: To be added to the estimate's stamps.
        peak: Mean correlation of turning and speed there.
        zero: The same as stamped.
        second: The highest one elsewhere.
        overlap_s: The longest time that any offset lets both know their rates.
        turning: Correlation of the angular speeds at the peak; NaN without orientations.
        speed: That of the speeds.
        cell_s: Width of a cell.
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
        """Whether the peak is high, and no other is nearly as high."""
        return self.peak > 0.6 and self.second < 0.85 * self.peak


def match_clocks(truth: MotionTrack, estimate: MotionTrack) -> ClockMatch | None:
    """Correlate at all lags that let the two overlap for long; None if none does.

    Args:
        truth: In order.
        estimate: In order.
    """
    cell_s = max(_LEAST_CELL_S, max(truth.span_s, estimate.span_s) / _CELLS)
    window_s = max(_LEAST_WINDOW_S, 2.0 * truth.usual_step_s, 2.0 * estimate.usual_step_s)
    epoch_s = float(truth.seconds[0])
    ours, true = (MotionRates.of(each, cell_s, window_s, epoch_s) for each in (estimate, truth))
    lags, speed, common = masked_correlation(
        tamed(ours.speed, ours.known), ours.known, tamed(true.speed, true.known), true.known
    )
    turning = None
    if ours.turning is not None and true.turning is not None:
        turning = masked_correlation(
            tamed(ours.turning, ours.known),
            ours.known,
            tamed(true.turning, true.known),
            true.known,
        )[1]
    mean = speed if turning is None else (speed + turning) / 2.0
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
        turning=np.nan if turning is None else float(turning[at]),
        speed=float(speed[at]),
        cell_s=cell_s,
        sides=(ours, true),
    )


def unlikeness_ratio(truth: MotionTrack, before: MotionTrack, after: MotionTrack) -> float:
    """Return how much of the difference of two rates other stamps leave: less than 1 if they help.

    Under drift, offsets that are found by chance don't help.

    Args:
        truth: In order.
        before: An estimate, in order.
        after: The same with other stamps.

    Returns:
        NaN where the two overlap for less than 8 s.
    """
    return _unlikeness(truth, after) / max(_unlikeness(truth, before), 1e-12)


def _unlikeness(truth: MotionTrack, estimate: MotionTrack) -> float:
    """Return 1 - the correlation of turning, or of speed without orientations, as stamped."""
    cell_s = max(_LEAST_CELL_S, estimate.span_s / _CELLS)
    window_s = max(_SHORT_WINDOW_S, 2.0 * truth.usual_step_s, 2.0 * estimate.usual_step_s)
    epoch_s = float(truth.seconds[0])
    ours, true = (MotionRates.of(each, cell_s, window_s, epoch_s) for each in (estimate, truth))
    begin = max(ours.start, true.start)
    end = min(ours.start + len(ours.known), true.start + len(true.known))
    rows, others = (
        slice(begin - each.start, max(end, begin) - each.start) for each in (ours, true)
    )
    known = ours.known[rows] * true.known[others]
    if known.sum() * cell_s < _LEAST_OVERLAP_S:
        return np.nan
    turns = ours.turning is not None and true.turning is not None
    mine, theirs = (ours.turning, true.turning) if turns else (ours.speed, true.speed)
    assert mine is not None
    assert theirs is not None
    a, b = tamed(mine[rows], known), tamed(theirs[others], known)
    return 1.0 - float(a @ b) / max(float(np.sqrt((a @ a) * (b @ b))), 1e-12)


def offsets_of_parts(match: ClockMatch, offset_s: float, parts: int) -> tuple[Floats, Floats]:
    """Return the offsets of parts of a run, where they show one, and the parts' middles, seconds.

    Args:
        match: Of the whole run.
        offset_s: Around which to search.
        parts: How many.
    """
    ours, true = match.sides
    size, reach = len(ours.known) // parts, int(_SEARCH_S / match.cell_s)
    cells = round(offset_s / match.cell_s)
    middles, offsets = [], []
    for part in range(parts):
        rows = np.arange(part * size, (part + 1) * size)
        others = rows[0] + ours.start - true.start + cells - reach + np.arange(size + 2 * reach)
        inside = (others >= 0) & (others < len(true.known))
        others = np.clip(others, 0, len(true.known) - 1)
        heights = _part_heights(ours, true, rows, others, inside, 2 * reach)
        at = int(np.argmax(heights))
        if 0 < at < len(heights) - 1 and heights[at] > 0.6:
            middles.append((rows[0] + size / 2.0) * match.cell_s)
            found = at - reach + cells + refined_peak(heights, at)
            offsets.append(found * match.cell_s)
    return np.array(middles), np.array(offsets)


def _part_heights(
    ours: MotionRates,
    true: MotionRates,
    rows: Indices,
    others: Indices,
    inside: Booleans,
    widest: int,
) -> Floats:
    """Return the mean correlation of a part at lags 0 to `widest`, -1 where little is known."""
    total: Floats = np.zeros(widest + 1)
    count = 0
    known, others_known = ours.known[rows], np.where(inside, true.known[others], 0.0)
    for mine, theirs in ((ours.turning, true.turning), (ours.speed, true.speed)):
        if mine is None or theirs is None:
            continue
        lags, correlation, common = masked_correlation(
            tamed(mine[rows], known),
            known,
            tamed(np.where(inside, theirs[others], 0.0), others_known),
            others_known,
        )
        within = (lags >= 0) & (lags <= widest)
        enough = common[within] > 0.6 * len(rows)
        total, count = total + np.where(enough, correlation[within], -1.0), count + 1
    return total / count


def tamed(rate: Floats, known: Floats) -> Floats:
    """Return a rate without its outliers, its mean and its unit; zero in holes."""
    here = known > 0.0
    if not here.any():
        return np.zeros(len(rate))
    high = float(np.quantile(rate[here], 0.98))
    low = np.minimum(rate, high)
    low = low - low[here].mean()
    spread = max(float(low[here].std()), 1e-9 * high, 1e-12)
    return np.where(here, low / spread, 0.0)


def _inside(enough: Booleans, at: int) -> bool:
    return 0 < at < len(enough) - 1 and bool(enough[at - 1] and enough[at + 1])
