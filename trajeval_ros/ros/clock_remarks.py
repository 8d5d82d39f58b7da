"""Remarks about the clocks of groundtruth and estimate in a live run."""

from __future__ import annotations

import math
from collections.abc import Iterator

from trajeval_ros.diagnosis.discontinuities import sentence_about
from trajeval_ros.formatting.numbers import with_unit
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.events import Event
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun

# Largest delay of an estimator, unless `max_delay` allows more; a larger difference is one of
# clocks.
_MOST_LATE_S = 10.0
_SAME_CLOCK_S = 60.0
# Differences of time scales, seconds: GPS, TAI and UTC since 2017, and the epoch of GPS.
_TIME_SCALES = {
    18.0: "GPS time is 18 s ahead of UTC",
    19.0: "TAI is 19 s ahead of GPS time",
    37.0: "TAI is 37 s ahead of UTC",
    315964800.0: "GPS time counts from 1980, Unix time from 1970",
}
_NEAR_SCALE_S = 0.6  # delays of messages
_QUARTER_S, _NEAR_ZONE_S = 900.0, 30.0  # time zones differ by quarters of an hour
_UNSET_BEFORE_S = 315964800.0  # earlier timestamps are no dates, but count from a start
_ONE_DAY_S = 86400.0


def about_clock_offset(run: LiveRun, estimate: LiveEstimate) -> Iterator[Remark]:
    """Yield the warning of a clock offset that is not applied."""
    clock, applied_s = estimate.clock.report, estimate.evaluator.settings.offset_s
    if run.holds or clock.offset_s is None or clock.half_width_95_s is None:
        return
    apart_s = clock.offset_s - applied_s
    if clock.is_significant and abs(apart_s) > clock.half_width_95_s:
        yield warning(
            "clock",
            f"the clocks differ by {1e3 * apart_s:+.0f} ms +- {1e3 * clock.half_width_95_s:.2g} "
            "ms, not applied; to apply it, set time_offset:=auto",
            values={"offset_s": apart_s, "half_width_95_s": clock.half_width_95_s},
        )


def about_clock_faults(run: LiveRun, estimate: LiveEstimate) -> Iterator[Remark]:
    """Yield the warnings of a clock that stepped, and of clocks that have nothing in common."""
    step = estimate.clock_step
    if step is None:
        yield from about_different_clocks(run, estimate)
    else:
        yield about_clock_step(step)


def about_clock_step(step: Event) -> Remark:
    """Return the warning of a step of one clock."""
    text = (
        f"{sentence_about(step)}: later poses are paired with those of another time; synchronise "
        "the clocks, then call ~/reset"
    )
    return warning(step.kind, text, step.side, {"step_s": step.s, "stamp_ns": step.end_ns})


def about_different_clocks(run: LiveRun, estimate: LiveEstimate) -> Iterator[Remark]:
    """Yield the warning of clocks that have nothing in common."""
    apart_s = estimate.source.stream.clocks.apart_s
    has_clock = estimate.evaluator.pairs and estimate.clock.report.offset_s is not None
    if apart_s is None or has_clock:
        return
    apart_s += estimate.evaluator.settings.offset_s
    past_s = estimate.evaluator.settings.limits.past_s
    if abs(apart_s) <= max(_MOST_LATE_S, past_s if math.isfinite(past_s) else 0.0):
        return
    groundtruth, estimated = run.groundtruth.stream.arrivals, estimate.source.stream.arrivals
    offsets = [item.offset_s or 0.0 for item in (estimated, groundtruth)]
    first, second = (with_unit(round(offset, 3), "s") for offset in offsets)
    side = "ahead of" if apart_s > 0.0 else "behind"
    yield warning(
        "clock",
        f"the timestamps of {estimate.source.source} are {with_unit(abs(apart_s), 's')} {side} "
        "those of the groundtruth that arrive at the same time (arrival minus timestamp: "
        f"{first} and {second}): {_cause(apart_s, run, estimate)}",
        "apart",
        {
            "apart_s": apart_s,
            "arrival_offset_s": offsets[0],
            "groundtruth_arrival_offset_s": offsets[1],
        },
    )


def _cause(apart_s: float, run: LiveRun, estimate: LiveEstimate) -> str:
    """Return the likely cause of different clocks, and what to do."""
    for off_s, text in _TIME_SCALES.items():
        if abs(abs(apart_s) - off_s) <= _NEAR_SCALE_S:
            return f"{text}; convert the timestamps, or set time_offset:={-apart_s:.0f}"
    for source in (run.groundtruth, estimate.source):
        _, stamps = source.stream.arrivals.columns
        if (
            len(stamps)
            and stamps[-1] < _UNSET_BEFORE_S * NANOSECONDS
            and abs(apart_s) > _ONE_DAY_S
        ):
            return (
                f"those of {source.source} count from the start of a computer or of a "
                "simulation; use one clock, as with use_sim_time:=true in all nodes"
            )
    quarters_s = _QUARTER_S * round(apart_s / _QUARTER_S)
    if quarters_s and abs(apart_s - quarters_s) <= _NEAR_ZONE_S and abs(apart_s) <= _ONE_DAY_S:
        return f"time zones differ by such times; use UTC, or set time_offset:={-quarters_s:.0f}"
    return "the clocks are not synchronised; synchronise them, as with chrony or PTP"


def sync_risk_m(run: LiveRun, estimate: LiveEstimate) -> float | None:
    """Return the position error that unsynchronised clocks may cause, metres.

    This is the groundtruth's mean speed times the difference of the offsets between timestamp and
    arrival. It is an upper bound: the estimator's own delay is part of the difference. None if
    timestamps and arrivals are of different clocks, as in a replay without simulated time, and
    when the clock offset itself has been estimated.
    """
    one, other = (item.stream.arrivals.offset_s for item in (run.groundtruth, estimate.source))
    buffer = estimate.evaluator.buffer
    if one is None or other is None or not buffer.groundtruth_time:
        return None
    if estimate.clock.report.offset_s is not None or max(abs(one), abs(other)) > _SAME_CLOCK_S:
        return None
    speed: float = buffer.groundtruth_path_m / (buffer.groundtruth_time / NANOSECONDS)
    return speed * abs(one - other)
