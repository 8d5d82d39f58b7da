"""The offset and the rate between two clocks by the likelihood of the rates of motion.

Speeds and angular speeds depend neither on conventions nor on the alignment nor on the body's
axes. With the correlation c of n independent seconds, the logarithm of the likelihood relative to
unrelated rates is -n/2 log(1 - c^2), per kind of rate.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.calibration.clock_offset import masked_correlation, refined_peak
from trajeval_ros.diagnosis.findings import Detection
from trajeval_ros.diagnosis.hypotheses import MISTAKE, ODDS
from trajeval_ros.diagnosis.input_pair import SHORTEST_S, TimedPoses
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.statistics import quantile

_CELL_S, _CELLS = 0.05, 4000  # least cell, and most cells of a run, which bounds the cost
_WINDOW_S = 0.4  # of a rate: noise matters in shorter windows
_LEAST_OVERLAP = 0.5  # of the longest common time: with less, rates match at random
_PEAK_S = 3.0  # width of a peak of the correlation
SMALL_S = 0.25  # offsets within this are near zero: a search finds them without a prior
_LARGEST = 0.999  # correlation, for its logarithm
_BELOW_OUTLIERS = 0.98  # share of the rates that are used as they are; larger ones are reduced
_PARTS, _PART_REACH_S = 3, 6.0  # parts with their own offsets, and largest change of an offset
_SLOWEST, _FASTEST = 0.4, 2.5  # clock rates of the search
_FIRST_SPAN_S, _COHERENT_S = 30.0, 0.7  # of the search: first part, and shift at its ends
_REFINED = 2  # rates to refine with a longer part
USABLE_PEAK = 0.6  # correlation from which on an offset is applied to other tests
_ALIKE = 0.97  # correlation from which on no other rate is searched
_LEAP_S = {18: "GPS time without leap seconds", 19: "GPS against TAI", 37: "TAI against UTC"}


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
        return replace(self, known=known, values=values)

    def coarser(self, count: int) -> RatesOfMotion:
        """Return means of `count` cells; those with a gap are not known."""
        rows = len(self.known) // count * count
        known, values = (
            side[..., :rows].reshape(*side.shape[:-1], -1, count).mean(axis=-1)
            for side in (self.known, self.values)
        )
        return RatesOfMotion(self.start_s, np.floor(known), values, self.cell_s * count)

    def cells(self, first: int, end: int) -> RatesOfMotion:
        """Return the rates from one cell to another, excluded."""
        start_s, rows = self.start_s + first * self.cell_s, slice(first, end)
        return RatesOfMotion(start_s, self.known[rows], self.values[:, rows], self.cell_s)

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
        lags, correlations, overlap_s = _correlations(groundtruth, estimate)
        enough = overlap_s >= max(SHORTEST_S, _LEAST_OVERLAP * float(overlap_s.max()))
        if not enough.any():
            return None
        shift_s = estimate.cell_s * lags + groundtruth.start_s - estimate.start_s
        log_odds = np.where(enough, _log_odds(correlations, overlap_s), -1.0)
        best, zero = int(log_odds.argmax()), int(np.abs(shift_s).argmin())
        mean = correlations.mean(axis=0)
        others = log_odds[enough & (np.abs(shift_s - shift_s[best]) >= _PEAK_S)]
        near = (np.abs(shift_s) <= SMALL_S) & (overlap_s > SHORTEST_S / 2.0)
        return cls(
            offset_s=float(shift_s[best] + estimate.cell_s * refined_peak(mean, best)),
            log_odds=float(log_odds[best]),
            log_odds_at_zero=float(max(log_odds[near].max(initial=0.0), 0.0)),
            log_odds_of_second=float(others.max(initial=0.0)),
            peak=float(mean[best]),
            as_stamped=float(mean[zero]) if near.any() else 0.0,
            highest=float(correlations[:, best].max()),
            overlap_s=float(overlap_s[best]),
            searched_s=float(np.ptp(shift_s)),
        )


def rates_of_both(
    groundtruth: TimedPoses, estimate: TimedPoses
) -> tuple[RatesOfMotion, RatesOfMotion]:
    """Return the rates of both sides on one grid, whose cells are longer for long runs."""
    cell_s = max(_CELL_S, max(groundtruth.span_s, estimate.span_s) / _CELLS)
    window_s = max(_WINDOW_S, 2.0 * groundtruth.usual_step_s, 2.0 * estimate.usual_step_s)
    one, other = (RatesOfMotion.of(side, cell_s, window_s) for side in (groundtruth, estimate))
    return one, other


def _correlations(
    groundtruth: RatesOfMotion, estimate: RatesOfMotion
) -> tuple[Floats, Floats, Floats]:
    """Return lags in cells (K,), correlations (kinds, K), and the common time (K,), seconds."""
    kinds = min(len(estimate.values), len(groundtruth.values))
    lags, correlations, common = masked_correlation(
        estimate.standardized[:kinds], estimate.known,
        groundtruth.standardized[:kinds], groundtruth.known,
    )  # fmt: skip
    return lags.astype(np.float64), correlations, common * estimate.cell_s


def _log_odds(correlations: Floats, seconds: Floats | float) -> Floats:
    """Return the sum over kinds of -n/2 log(1 - c^2) (K,) of correlations (kinds, K)."""
    bounded = np.clip(correlations, 0.0, _LARGEST)
    return np.asarray((-0.5 * seconds * np.log(1.0 - bounded**2)).sum(axis=0))


def offsets_of_parts(
    groundtruth: RatesOfMotion, estimate: RatesOfMotion, match: ClockMatch
) -> tuple[float, float]:
    """Return how much likelier parts of the run are with offsets of their own, as a logarithm.

    It is large if the clock rates differ, and infinite if no offset fits the whole run. The second
    value is the rate that follows from these offsets.
    """
    if match.log_odds <= 0.0 or match.peak < USABLE_PEAK:
        return math.inf, 1.0
    gain, cell_s = 0.0, estimate.cell_s
    moved: list[tuple[float, float]] = []  # cells of the middle of a part, and of its offset
    cells = round((match.offset_s + estimate.start_s - groundtruth.start_s) / cell_s)
    reach = int(_PART_REACH_S / cell_s)
    for number in range(_PARTS):
        part = estimate.part(number / _PARTS, (number + 1) / _PARTS)
        count = len(part.known)
        first = cells + round((part.start_s - estimate.start_s) / cell_s)
        low, high = max(first - reach, 0), min(first + count + reach, len(groundtruth.known))
        if high - low < count // 2:
            continue
        lags, correlations, overlap_s = _correlations(groundtruth.cells(low, high), part)
        enough = overlap_s > 0.7 * count * cell_s
        log_odds = np.where(enough, _log_odds(correlations, overlap_s), 0.0)
        best, at = int(log_odds.argmax()), int(np.abs(lags - (first - low)).argmin())
        gain += float(log_odds[best] - log_odds[max(at - 2, 0) : at + 3].max())
        moved.append((first + count / 2.0, float(lags[best] - lags[at])))
    middles, offsets = np.array(moved).reshape(-1, 2).T
    factor = 1.0 + float(np.polyfit(middles, offsets, 1)[0]) if len(moved) > 1 else 1.0
    # Two more offsets, each out of this many.
    return gain - 2.0 * math.log(2.0 * _PART_REACH_S / (4.0 * _CELL_S)), factor


def search_rate(
    groundtruth: RatesOfMotion, estimate: RatesOfMotion
) -> tuple[float, ClockMatch | None]:
    """Return the clock rate with the largest likelihood, and its match, if there is one.

    A part from the middle of the run allows large steps of the rate. Longer parts refine it.
    """
    fine, count = (groundtruth, estimate), max(int(_COHERENT_S / 2.0 / estimate.cell_s), 1)
    groundtruth, estimate = (side.coarser(count) for side in fine)
    total_s = len(estimate.known) * estimate.cell_s
    span_s = min(_FIRST_SPAN_S, total_s)
    step = 2.0 * _COHERENT_S / span_s if span_s > 0.0 else 1.0
    factors = np.geomspace(_SLOWEST, _FASTEST, max(int(np.log(_FASTEST / _SLOWEST) / step), 2))

    @functools.cache
    def spectra(size: int) -> NDArray[Any]:
        values = groundtruth.standardized[: len(estimate.values)]
        return np.fft.rfft(np.concatenate([values, values**2]), size)

    def score(part: RatesOfMotion, factor: float) -> float:
        """Return a value that grows with the largest log odds over all offsets.

        Gaps count as the mean.
        """
        stretched = part.by_faster_clock(factor)
        values = (stretched.values * factor * stretched.known)[: len(groundtruth.values)]
        least = values.shape[-1] + len(groundtruth.known) - 1
        # The shortest fast transform without a wrap.
        size = min(n << max((-(-least // n) - 1).bit_length(), 0) for n in (1, 3, 5, 9))
        spectrum = np.conj(np.fft.rfft(np.vstack([values, stretched.known]), size))
        kinds = len(values)
        rows = np.append(np.arange(kinds), [kinds] * kinds)  # values, and what is known for each
        products, energies = np.split(np.fft.irfft(spectrum[rows] * spectra(size), size), 2)
        count = float(stretched.known.sum())
        squared = np.maximum(products, 0.0) ** 2 / (
            np.maximum(energies, 0.3 * count) * count + 1e-9
        )
        return -float(np.prod(1.0 - np.minimum(squared, _LARGEST**2), axis=0).min())

    while True:
        half = 0.5 * span_s / total_s
        part = estimate.part(0.5 - half, 0.5 + half)
        part = replace(part, values=part.standardized)
        ranked = sorted(factors, key=functools.partial(score, part))
        if span_s >= total_s:
            break
        span_s, width = min(4.0 * span_s, total_s), step
        step = 2.0 * _COHERENT_S / span_s
        half_count = np.ceil(width / step / 2.0)
        near = np.exp(step * np.arange(-half_count, half_count + 1.0))
        factors = np.unique(np.outer(ranked[-_REFINED:], near))
    # Fast motions correlate only within a part of the last step.
    last = ranked[-1] * np.exp(step * np.linspace(-0.5, 0.5, 9))
    factor = float(max(last, key=functools.partial(score, part)))
    return factor, ClockMatch.between(fine[0], fine[1].by_faster_clock(factor))


@dataclass(frozen=True, eq=False)
class Clock:
    """The coarse clock: the estimate's time t is mapped to t0 + factor (t - t0) + offset."""

    match: ClockMatch | None = None
    offset_s: float = 0.0
    factor: float = 1.0
    is_stated: bool = False  # whether the offset or the factor is significant

    @classmethod
    def between(
        cls, groundtruth: TimedPoses, estimate: TimedPoses, *, searches_rate: bool
    ) -> Clock:
        """Return the clock of poses in order, as read if their motions do not show it."""
        rates = rates_of_both(groundtruth, estimate)
        if not all(len(side.known) for side in rates):
            return cls()
        match, prior = ClockMatch.between(*rates), MISTAKE
        is_clear = is_alike = is_small = False
        gain, factor = math.inf, 1.0
        if match is not None:
            prior -= math.log(max(match.searched_s, 1.0) / SMALL_S)
            others = max(match.log_odds_at_zero - prior, match.log_odds_of_second)
            is_clear = match.log_odds > others + ODDS
            is_small = abs(match.offset_s) <= SMALL_S
            # With a large offset, turn rates alone can match at random.
            is_alike = (match.highest if is_small else match.peak) > _ALIKE
            if not is_alike:
                gain, factor = offsets_of_parts(*rates, match)
        # No offset explains the rates, or parts of the run have different ones.
        if searches_rate and not is_alike and (not (is_clear or is_small) or gain > ODDS):
            likely = 0.0 if match is None else match.log_odds
            faster = None
            if ODDS < gain < math.inf:
                faster = ClockMatch.between(rates[0], rates[1].by_faster_clock(factor))
            if faster is None or faster.log_odds < likely + gain - ODDS:
                factor, faster = search_rate(*rates)
            least = likely + ODDS - prior - MISTAKE  # rates are rarer
            if faster is not None and faster.log_odds > least and faster.peak > USABLE_PEAK:
                return cls(faster, faster.offset_s, factor, is_stated=True)
        if match is None or match.peak <= USABLE_PEAK:
            return cls(match)
        if is_clear:
            return cls(match, match.offset_s, is_stated=not is_small)
        return cls(match, match.offset_s if is_small else 0.0)

    @property
    def is_far(self) -> bool:
        """Whether the likeliest offset is not near zero, whether it is significant or not."""
        return self.match is not None and abs(self.match.offset_s) > SMALL_S

    def seen(self, offset_s: float, rate: float, span_s: float, applied_s: float) -> Detection:
        """Return the finding of an offset, or of a rate over a span if it is not zero.

        The offset of a rate is that at the first pose. `applied_s` is added to the timestamps
        already.
        """
        assert self.match is not None
        values: dict[str, float | str] = {
            "offset_s": offset_s,
            "offset_ms": 1e3 * offset_s,
            "total_s": applied_s + offset_s,
            "peak": self.match.peak,
            "as_stamped": self.match.as_stamped,
            "more": "more " if applied_s else "",
        }
        if rate:
            values |= {"ppm": 1e6 * rate, "growth_ms": 1e3 * rate * span_s}
            return Detection("clock_drift", values)
        if abs(offset_s) < SMALL_S:
            return Detection("small_clock_offset", values)
        whole = round(abs(offset_s))
        leap = _LEAP_S.get(whole, "") if abs(abs(offset_s) - whole) < SMALL_S else ""
        return Detection("clock_offset", {**values, "known_as": f" ({leap})" if leap else ""})
