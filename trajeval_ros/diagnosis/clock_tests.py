"""Rates of motion over time, angular speed and speed, which do not depend on the frame.

The angular speed does not depend on the gauge, on the body, or on order and sign of the components
of quaternions. Therefore clocks are tested before conventions.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from trajeval_ros.calibration.clock_offset import masked_correlation, refined_peak
from trajeval_ros.diagnosis.findings import Examined, Seen, Value
from trajeval_ros.diagnosis.input_pair import TimedPoses, lengths
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.statistics import median

_LEAST_CELL_S, _CELLS = 0.05, 4000
_LEAST_WINDOW_S, _SHORT_WINDOW_S = 0.4, 0.2
_LEAST_OVERLAP_S, _SHARE_OF_OVERLAP = 8.0, 0.5
_LEAST_LIKELY = 0.8  # of 1 - correlation: largest ratio with and without an offset
_LOBE_S = 3.0  # on both sides of a peak
_SEARCH_S = 3.0  # for parts of a run
_OUTLIERS = 0.02  # fraction of the rates that is limited to the largest of the others


@dataclass(frozen=True, eq=False)
class MotionRates:
    """Rates on a grid of cells that both sides share."""

    start: int  # index of the first cell on the common grid
    known: Floats  # (N,) 1 where the rates are known, 0 in gaps
    # (K, N) speeds, in units of the source, and angular speeds, rad/s; K is 1 without
    # orientations.
    rates: Floats

    @classmethod
    def of(cls, poses: TimedPoses, cell_s: float, window_s: float, epoch_s: float) -> MotionRates:
        """Sample poses in order, from poses half a window before and after every cell."""
        half = max(1, round(window_s / cell_s / 2.0))
        count = int(poses.span_s / cell_s)
        start = round((float(poses.seconds[0]) - epoch_s) / cell_s)
        cells = np.arange(start - half, start + count + half, dtype=np.float64)
        grid: Floats = epoch_s + cell_s * cells
        between = poses.at(grid, max(4.0 * poses.usual_step_s, 0.3))
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
    """Offset with the largest correlation of the rates of both sides."""

    offset_s: float  # offset to add to the estimate's timestamps, seconds
    peak: float  # mean correlation of angular speed and speed at this offset
    zero: float  # mean correlation without an offset
    second: float  # largest mean correlation outside of the lobe of the peak
    overlap_s: float  # longest common time span with known rates of all offsets, seconds
    turning: float  # correlation of the angular speeds at the peak; NaN without orientations
    speed: float  # correlation of the speeds at the peak
    cell_s: float  # width of a cell, seconds
    sides: tuple[MotionRates, MotionRates]  # rates of the estimate and of the groundtruth

    @property
    def is_alone(self) -> bool:
        """Whether the peak is high and unique."""
        return self.peak > 0.6 and self.second < 0.85 * self.peak

    @property
    def is_usable(self) -> bool:
        """Whether the offset is better than none: the peak is high, and clearly above zero's."""
        gain = 1.0 - self.peak < _LEAST_LIKELY * (1.0 - self.zero)
        near = abs(self.offset_s) < SMALL_S
        return self.is_alone and self.peak > USABLE and (near or gain)


def match_clocks(groundtruth: TimedPoses, estimate: TimedPoses) -> ClockMatch | None:
    """Correlate at all lags with a long common time span; None without such a lag."""
    cell_s = max(_LEAST_CELL_S, max(groundtruth.span_s, estimate.span_s) / _CELLS)
    window_s = max(_LEAST_WINDOW_S, 2.0 * groundtruth.usual_step_s, 2.0 * estimate.usual_step_s)
    epoch_s = float(groundtruth.seconds[0])
    ours, true = (
        MotionRates.of(each, cell_s, window_s, epoch_s) for each in (estimate, groundtruth)
    )
    if not (len(ours.known) and len(true.known)):  # one side is shorter than a cell of the other
        return None
    kinds = min(len(ours.rates), len(true.rates))
    lags, alike, common = masked_correlation(
        tamed(ours.rates[:kinds], ours.known),
        ours.known,
        tamed(true.rates[:kinds], true.known),
        true.known,
    )
    mean = alike.mean(axis=0)
    overlap_s = common * cell_s
    longest_s = float(overlap_s.max())
    enough = overlap_s >= max(_LEAST_OVERLAP_S, _SHARE_OF_OVERLAP * longest_s)
    if not enough.any():
        return None
    shift_s: Floats = cell_s * (lags + true.start - ours.start).astype(np.float64)
    heights = np.where(enough, mean, -1.0)
    at = int(np.argmax(heights))
    inside = 0 < at < len(enough) - 1 and enough[at - 1] and enough[at + 1]
    between = refined_peak(heights, at) if inside else 0.0
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


class _CommonRates(NamedTuple):
    """Angular speeds, or speeds without orientations, of N common cells of a fine grid."""

    groundtruth: Floats  # (N,)
    estimate: Floats  # (N,)
    known: Floats  # (N,) 1 where both are known, else 0
    seconds: Floats  # (N,) since the estimate's first pose
    cell_s: float
    turns: bool  # whether these are angular speeds

    @classmethod
    def of(
        cls, groundtruth: TimedPoses, estimate: TimedPoses, offset_s: float, rate: float
    ) -> _CommonRates:
        """Compare the rates by the clock of the estimate, if it has an offset and a rate.

        The estimate keeps its timestamps, so its poses have the same phases on the grid of cells.
        At another phase, interpolation averages the noise of two poses.
        """
        cell_s, start_s = max(_LEAST_CELL_S, estimate.span_s / _CELLS), float(estimate.seconds[0])
        own_clock = start_s + (groundtruth.seconds - start_s - offset_s) / (1.0 + rate)
        true_poses = TimedPoses(own_clock, groundtruth.positions, groundtruth.quaternions)
        sides = estimate, true_poses
        window_s = max(_SHORT_WINDOW_S, 2.0 * max(each.usual_step_s for each in sides))
        ours, true = (MotionRates.of(each, cell_s, window_s, start_s) for each in sides)
        begin = max(ours.start, true.start)
        end = max(min(each.start + len(each.known) for each in (ours, true)), begin)
        rows, others = (slice(begin - each.start, end - each.start) for each in (ours, true))
        kind = min(len(ours.rates), len(true.rates)) - 1
        known = ours.known[rows] * true.known[others]
        seconds = cell_s * np.arange(begin, end, dtype=np.float64)
        rates = true.rates[kind, others], ours.rates[kind, rows]
        return cls(*rates, known, seconds, cell_s, bool(kind))


def offsets_of_parts(match: ClockMatch, offset_s: float, parts: int) -> tuple[Floats, Floats]:
    """Return middles and offsets of the parts of a run with a peak near `offset_s`, seconds."""
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
    _, alike, common = masked_correlation(
        tamed(ours.rates[:kinds, rows], known),
        known,
        tamed(true.rates[:kinds, others], others_known),
        others_known,
        2 * reach,
    )
    heights = np.where(common > 0.6 * size, alike, -1.0).mean(axis=0)
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


SMALL_S = 0.25  # limit of the test on the finer grid
USABLE = 0.8  # least correlation of an offset that other tests apply
_LEAP_S = {18: "GPS time without leap seconds", 19: "GPS against TAI", 37: "TAI against UTC"}
_THIRDS, _SAME_OFFSET_S = 3, 0.1
_PART_S, _FEWEST_PARTS, _MOST_PARTS = 12.0, 4, 12
_LEAST_GROWTH_S = 0.06
_SIGMAS, _TIMES_NOISE = 5.0, 12.0  # of a significant rate, and of offsets by speeds
_STEPS, _BLOCK_S = 3, 1.5  # iterations; time after which residuals are independent
_OUTLYING = 3.0  # of the median residual, from which on the weight decreases
_LEAST_GAIN = 0.5  # of angular speeds, and its inverse


def clock_offset(match: ClockMatch | None, applied_s: float, rate: float) -> Examined:
    """Test for a large offset, `applied_s` being already added to the estimate's timestamps.

    With another clock rate than 1, the offset is a part of the finding about the rate.
    """
    if match is None:
        return Examined("clocks", why_not="no offset gives a common time span of 8 s")
    scores = {
        "offset_s": match.offset_s,
        "peak": match.peak,
        "as_stamped": match.zero,
        "second": match.second,
        "usable_from": USABLE,
        "cell_s": match.cell_s,
    }
    gain = 1.0 - match.peak < _LEAST_LIKELY * (1.0 - match.zero)
    far = abs(match.offset_s) > SMALL_S and gain and rate == 1.0
    if not (match.is_alone and far):
        return Examined("clocks", scores)
    if match.overlap_s > _THIRDS * _PART_S:
        _, offsets = offsets_of_parts(match, match.offset_s, _THIRDS)
        scores["thirds"] = float(len(offsets))
        if len(offsets):
            scores["thirds_apart_s"] = float(np.abs(offsets - match.offset_s).max())
        if len(offsets) < 2 or scores["thirds_apart_s"] > max(_SAME_OFFSET_S, match.cell_s):
            return Examined("clocks", scores, why_not="parts of the run have other offsets")
    whole = round(abs(match.offset_s))
    leap = _LEAP_S.get(whole, "") if abs(abs(match.offset_s) - whole) < 0.3 else ""
    values: dict[str, Value] = {
        "offset_s": match.offset_s,
        "total_s": applied_s + match.offset_s,
        "known_as": f" ({leap})" if leap else "",
        "peak": match.peak,
        "as_stamped": match.zero,
    }
    explained = 1.0 - (1.0 - match.peak) / max(1.0 - match.zero, 1e-9)
    return Examined("clocks", scores, (Seen("clock_offset", explained, values),))


def clock_rate(
    groundtruth: TimedPoses,
    estimate: TimedPoses,
    match: ClockMatch | None,
    offset_s: float,
    applied_s: float,
    found_rate: float,
) -> Examined:
    """Test for an offset that grows along the run, besides `offset_s` and `applied_s`.

    The estimate's time since its start was multiplied by `found_rate`.
    """
    name, is_found = "clock rates", found_rate != 1.0
    if match is None or not match.is_alone:
        return Examined(name, why_not="the rates of motion do not match at a common offset")
    parts = int(np.clip(estimate.span_s / _PART_S, _FEWEST_PARTS, _MOST_PARTS))
    times, offsets = offsets_of_parts(match, match.offset_s if is_found else offset_s, parts)
    if len(times) < _FEWEST_PARTS and not is_found:
        return Examined(name, why_not="too few parts of the run determine an offset")
    rate, level = 0.0, match.offset_s
    if len(times) > 2:
        rate = _slope(times, offsets)
        level = median(offsets - rate * times)
    fit = _RateFit.of(groundtruth, estimate, rate, level)
    if rate and abs(fit.rate) > _SIGMAS * fit.sigma:  # unless none is a better fit
        without = _RateFit.of(groundtruth, estimate, 0.0, match.offset_s)
        fit = min(fit, without, key=attrgetter("rest"))
    rate, level = fit.rate, fit.offset_s
    # The estimate has the first factor already.
    total = found_rate * (1.0 + rate) - 1.0
    growth_s = total * estimate.span_s / found_rate
    scores = {"ppm": 1e6 * rate, "offset_s": level, "growth_s": growth_s, "rate": found_rate}
    scores["sigmas"] = abs(total) / max(fit.sigma, 1e-12)
    least_s = _LEAST_GROWTH_S
    if np.isnan(match.turning):  # speeds are biased by noise, and depend on the scale
        noise_s = median(np.abs(offsets - level - rate * times)) if len(times) else np.inf
        least_s = max(_LEAST_WINDOW_S, _TIMES_NOISE * noise_s)
    grows = abs(growth_s) > max(least_s, estimate.usual_step_s)
    if not (grows and scores["sigmas"] > _SIGMAS):
        return Examined(name, scores)
    values: dict[str, Value] = {
        "ppm": 1e6 * total,
        "growth_ms": 1e3 * growth_s,
        "offset_s": level,
        "total_s": applied_s + level,
    }
    explained = 1.0 - scores["sigmas"] ** -2
    return Examined(name, scores, (Seen("clock_drift", explained, values),))


class _RateFit(NamedTuple):
    """A clock rate and an offset that fit the rates of motion."""

    rate: float
    offset_s: float
    sigma: float  # standard deviation of the rate; inf if it is not determined
    rest: float = np.inf  # usual residual

    @classmethod
    def of(
        cls, groundtruth: TimedPoses, estimate: TimedPoses, rate: float, offset_s: float
    ) -> _RateFit:
        """Fit from a start; angular speeds that are not those of one body determine no rate.

        If a rate r and an offset o are left, the speeds a of the estimate and b of the groundtruth
        are a = k b + c + (o + r t) b', which is linear in (o, r, k, c). Residuals are correlated
        within blocks of time only, whose sums give the covariance (White, 1980).
        """
        fit = cls(rate, offset_s, np.inf)
        for _ in range(_STEPS):
            common = _CommonRates.of(groundtruth, estimate, fit.offset_s, fit.rate)
            if float(common.known.sum()) * common.cell_s < _LEAST_OVERLAP_S:
                break
            slope = np.gradient(common.groundtruth, common.cell_s)
            terms = [slope, slope * common.seconds, common.groundtruth, np.ones_like(slope)]
            columns, weights = np.column_stack(terms), common.known
            for _ in range(_STEPS):
                weighted = columns * weights[:, None]
                inverse = np.linalg.pinv(weighted.T @ columns)
                fitted = inverse @ (weighted.T @ common.estimate)
                rest = common.estimate - columns @ fitted
                usual = median(np.abs(rest[common.known > 0.0]))
                far = np.abs(rest) / max(_OUTLYING * usual, 1e-12)
                weights = common.known / np.maximum(1.0, far)
            if common.turns and not _LEAST_GAIN < fitted[2] < 1.0 / _LEAST_GAIN:
                return cls(rate, offset_s, np.inf)
            blocks = np.arange(0, len(rest), max(1, int(_BLOCK_S / common.cell_s)))
            sums = np.add.reduceat(weighted * rest[:, None], blocks) @ inverse
            sums *= np.sqrt(len(blocks) / max(len(blocks) - len(fitted), 1))
            offset_s, rate = fit.offset_s + float(fitted[0]), fit.rate + float(fitted[1])
            fit = cls(rate, offset_s, float(np.linalg.norm(sums[:, 1])), usual)
            if abs(rate) < _SIGMAS / 2.0 * fit.sigma:
                break
        return fit


_LOWEST_RATE, _HIGHEST_RATE = 0.4, 2.5
_FIRST_SPAN_S, _COHERENT_S = 30.0, 0.7  # of a part, and the shift that its correlation allows
_REFINED = 4  # rates to refine, of a longer part
_LAST = np.linspace(-0.5, 0.5, 9)  # of a step, around the best rate
_BETTER = 0.1  # least gain of the correlation


def other_rate(
    groundtruth: TimedPoses, estimate: TimedPoses, match: ClockMatch | None
) -> tuple[float, ClockMatch | None]:
    """Search for a clock rate with a high correlation; 1 and the given match without one.

    A part from the middle of the run allows large steps of the rate. Longer parts refine it.
    """
    span_s = min(_FIRST_SPAN_S, estimate.span_s)
    if span_s <= 0.0:
        return 1.0, match
    step = 2.0 * _COHERENT_S / span_s
    count = round(np.log(_HIGHEST_RATE / _LOWEST_RATE) / step)
    rates = np.geomspace(_LOWEST_RATE, _HIGHEST_RATE, max(count, 2))
    from_middle_s = estimate.seconds - estimate.seconds[0] - estimate.span_s / 2.0
    while rates.size:
        part = estimate[np.abs(from_middle_s) <= span_s / 2.0 + 1e-9]
        best = _likeliest(groundtruth, part, rates)[-_REFINED:]
        if span_s >= estimate.span_s:
            break
        span_s, wide = min(4.0 * span_s, estimate.span_s), step
        step = 2.0 * _COHERENT_S / span_s
        half = np.ceil(wide / step / 2.0)
        near = np.exp(step * np.arange(-half, half + 1.0))
        rates = np.unique(np.outer([rate for rate, _ in best], near))
    # Fast motions correlate only within a part of this step.
    last = [rate * np.exp(step * _LAST) for rate, _ in best[-1:]]
    for rate, found in _likeliest(groundtruth, estimate, np.ravel(last))[-1:]:
        if found.is_alone and found.peak >= max(USABLE, match.peak + _BETTER if match else 0.0):
            return rate, found
    return 1.0, match


def _likeliest(
    groundtruth: TimedPoses, part: TimedPoses, rates: Floats
) -> list[tuple[float, ClockMatch]]:
    """Return rates with the match of a part of the estimate, the highest correlation last."""
    if len(part) < 2:  # a gap
        return []
    found = [(each, match_clocks(groundtruth, part.shifted(0.0, each - 1.0))) for each in rates]
    matches = [(float(rate), each) for rate, each in found if each is not None]
    return sorted(matches, key=lambda each: each[1].peak)


def _slope(times: Floats, offsets: Floats) -> float:
    """Return the median slope of all pairs of points, robust against outliers (Theil, 1950)."""
    rows = np.array(list(itertools.combinations(range(len(times)), 2)))
    steps = offsets[rows[:, 1]] - offsets[rows[:, 0]]
    return median(steps / (times[rows[:, 1]] - times[rows[:, 0]]))
