"""Tests of the clocks: large offsets and rates. They precede the tests of axes."""

from __future__ import annotations

import itertools

import numpy as np

from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.diagnosis.motion_track import MotionTrack
from trajeval_ros.diagnosis.rates import (
    LEAST_LIKELY,
    ClockMatch,
    offsets_of_parts,
    unlikeness_ratio,
)
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.statistics import median

SMALL_S = 0.25  # limit of the test on the finer grid
USABLE = 0.8  # least correlation of an offset that other tests apply
_GAIN = 0.1
_LEAP_S = {18: "GPS time without leap seconds", 19: "GPS against TAI", 37: "TAI against UTC"}
_PART_S, _FEWEST_PARTS, _MOST_PARTS = 12.0, 4, 12
_LEAST_GROWTH_S, _LEAST_RATE = 0.06, 5e-5
_TIMES_NOISE, _TIMES_NOISE_OF_POSITIONS = 5.0, 8.0
_STRAIGHTER = 2.5
_FEWEST_HZ = 3.0


def clock_offset(match: ClockMatch | None, applied_s: float) -> Examined:
    """Test for a large offset between the clocks.

    Args:
        match: Match of the rates of motion; None without a common time span.
        applied_s: Offset that is already added to the estimate's timestamps, seconds.
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
    far = abs(match.offset_s) > SMALL_S and match.peak - match.zero > _GAIN
    if not (match.is_alone and far):
        return Examined("clocks", scores)
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
    truth: MotionTrack,
    estimate: MotionTrack,
    match: ClockMatch | None,
    offset_s: float,
    applied_s: float,
) -> Examined:
    """Test for an offset that increases along the run.

    Args:
        truth: Groundtruth in order of time.
        estimate: Estimate in order of time.
        match: Match of the whole run.
        offset_s: Known offset between the clocks, seconds.
        applied_s: Offset that is already added to the estimate's timestamps, seconds.
    """
    name = "clock rates"
    if match is None or not match.is_alone:
        return Examined(name, why_not="the rates of motion do not match at a common offset")
    turns = not np.isnan(match.turning)
    if min(match.turning if turns else 1.0, match.speed) <= 0.6:
        return Examined(name, why_not="the correlation of the rates of motion is too low")
    if len(estimate) <= _FEWEST_HZ * estimate.span_s:
        return Examined(name, why_not="the rate of the estimate is too low")
    parts = int(np.clip(estimate.span_s / _PART_S, _FEWEST_PARTS, _MOST_PARTS))
    times, offsets = offsets_of_parts(match, offset_s, parts)
    if len(times) < _FEWEST_PARTS:
        return Examined(name, why_not="too few parts of the run determine an offset")
    rate = _slope(times, offsets)
    level = median(offsets - rate * times)
    noise_s = _spread(offsets - level - rate * times)
    constant_s = _spread(offsets - median(offsets))
    growth_s = rate * float(times[-1] - times[0])
    scores = {"ppm": 1e6 * rate, "growth_s": growth_s, "noise_s": noise_s, "offset_s": level}
    limit_s = (_TIMES_NOISE if turns else _TIMES_NOISE_OF_POSITIONS) * noise_s
    grows = abs(growth_s) > max(limit_s, _LEAST_GROWTH_S) and abs(rate) > _LEAST_RATE
    if not (grows and constant_s > _STRAIGHTER * noise_s):
        return Examined(name, scores)
    scores["unlikeness"] = unlikeness_ratio(truth, estimate, level, rate, known_s=offset_s)
    if not scores["unlikeness"] < LEAST_LIKELY:
        return Examined(name, scores)
    values: dict[str, Value] = {
        "ppm": 1e6 * rate,
        "growth_ms": 1e3 * growth_s,
        "offset_s": level,
        "total_s": applied_s + level,
    }
    explained = 1.0 - (noise_s / constant_s) ** 2
    return Examined(name, scores, (Seen("clock_drift", explained, values),))


def _slope(times: Floats, offsets: Floats) -> float:
    """Return the median slope of all pairs of points, robust against outliers (Theil, 1950)."""
    rows = np.array(list(itertools.combinations(range(len(times)), 2)))
    steps = offsets[rows[:, 1]] - offsets[rows[:, 0]]
    return median(steps / (times[rows[:, 1]] - times[rows[:, 0]]))


def _spread(offsets: Floats) -> float:
    """Return a standard deviation from the median, plus 4 ms, the resolution of an offset."""
    return 1.48 * median(np.abs(offsets)) + 0.004
