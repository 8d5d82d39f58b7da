"""Whether receive times and timestamps can be compared: three clocks are involved.

A constant offset of the receiver's clock cannot be separated from latency. It is never estimated
silently.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.statistics import median

_COPIED_S, _MOST_COPIED = 1e-6, 0.99
_DAY_S = 86400.0
_EARLY_S, _LATE_S = 1e-3, 1.0
# Clocks drift by less than the largest value; a larger slope is a growing queue.
_DRIFT_PPM, _LARGEST_PPM = 20.0, 1000.0
# A step of the clock is a step of the smallest latency in so many messages, above their scatter. A
# growing queue has no step.
_BLOCK, _LEAST_STEP_S, _FEWEST_BLOCKS = 10, 0.01, 3
_FASTEST = "fastest"
_WITHHELD = ("copied", "epochs", "impossible")
_SAMPLE = 20_000  # states of a sample
_JITTER = 0.15  # least spread of steps in time, relative to the steps; less has no effect
_FEWEST_SMOOTH = 100  # steps of smooth motion for a slope
# Slope of steps in space over steps in time: 1 for sensor timestamps, and 0 for arrival times.
_FOLLOWS = 0.2
_SPARSE_S = 0.12  # usual step from which on poses are keyframes, at a constant distance


def clock_correction(text: str) -> tuple[float | None, float]:
    """Return the seconds in a text: `OFFSET` of all receive times, or `fastest:LATENCY`.

    The offset is None if the latency of the fastest message is given, which comes second.

    Raises:
        SettingsError: The text is not valid.
    """
    name, _, number = text.rpartition(":")
    try:
        seconds = float(number)
        if name not in ("", _FASTEST) or not math.isfinite(seconds):
            raise ValueError(text)
    except ValueError:
        raise SettingsError(
            f"the clock of receive times {text!r} is not valid; give an offset in seconds, or "
            f"the latency of the fastest message, as in {_FASTEST}:0.005"
        ) from None
    return (None, seconds) if name else (seconds, 0.0)


@dataclass(frozen=True)
class ReceiveClock:
    """The comparison of receive times with timestamps."""

    verdict: str  # `ok`, `copied`, `epochs`, `impossible`, `suspicious`, `step` or `drift`
    smallest_s: float  # smallest latency, seconds, after the correction
    # Drift of the smallest latency, the slope of its lower convex hull at the middle.
    drift_ppm: float
    # Seconds that were added to all receive_times; None if the fastest message was set.
    offset_s: float | None
    step_s: float = 0.0  # of the smallest latency; 0 without a step
    step_at_s: float = 0.0  # time of the step since the first timestamp, seconds

    @property
    def is_usable(self) -> bool:
        """Whether latencies are meaningful."""
        return self.verdict not in _WITHHELD

    @property
    def sentence(self) -> str:
        """The sentence about the verdict; empty for `ok`."""
        return {
            "ok": "",
            "copied": "the receive times are copies of the timestamps; record the topic "
            "again, or use --columns with received",
            "epochs": "timestamps and receive times differ by over a day: the timestamps are "
            "simulated, or a clock was never set; set --receive-clock fastest:0.005",
            "impossible": f"messages were received {-self.smallest_s:.4g} s before their "
            f"timestamps; correct the clock with --receive-clock of at least "
            f"{(self.offset_s or 0.0) - self.smallest_s:.4g}",
            "suspicious": f"every message was received at least {self.smallest_s:.4g} s after its "
            "timestamp; check for a queue, or correct the clock with --receive-clock",
            "step": f"all latencies change by {self.step_s:+.4g} s at {self.step_at_s:.1f} s; the "
            "receiver's clock stepped, or the estimator fell behind, and latencies include it",
            "drift": "the clocks of timestamps and receive times drift by "
            f"{self.drift_ppm:.0f} ppm; latencies include this drift",
        }[self.verdict]


def judged_receive_times(
    stamps: Stamps, times: Stamps, correction: str = "0"
) -> tuple[Stamps, ReceiveClock]:
    """Return the corrected receive times (N,), N > 0, and what is known of their clock.

    `stamps`: (N,) int64, nanoseconds, of the messages. `times`: (N,) as they were received.
    `correction` is a text that `clock_correction` reads.
    """
    offset_s, fastest_s = clock_correction(correction)
    seconds = (stamps - stamps[0]) / NANOSECONDS
    # Differences to the fastest message are small; between epochs, float64 would lose digits.
    above_s = (times - stamps - (times - stamps).min()) / NANOSECONDS
    at_s, slope = _fastest(seconds, above_s)
    copied = np.mean(np.abs(times - stamps) < _COPIED_S * NANOSECONDS) > _MOST_COPIED
    if offset_s is None:
        above_ns = np.round((above_s - at_s - slope * seconds) * NANOSECONDS)
        times = stamps + above_ns.astype(np.int64) + round(fastest_s * NANOSECONDS)
    else:
        times = times + round(offset_s * NANOSECONDS)
    smallest_s = float((times - stamps).min()) / NANOSECONDS
    step_s, step_at_s = _step(seconds, above_s)
    rules = {
        "copied": copied,
        "epochs": abs(median(times - stamps)) > _DAY_S * NANOSECONDS,
        "impossible": smallest_s < -_EARLY_S,
        "suspicious": smallest_s > _LATE_S,
        "step": step_s != 0.0,
        "drift": offset_s is not None and _DRIFT_PPM < 1e6 * abs(slope) < _LARGEST_PPM,
    }
    verdict = next((name for name, holds in rules.items() if holds), "ok")
    return times, ReceiveClock(verdict, smallest_s, 1e6 * slope, offset_s, step_s, step_at_s)


def _step(seconds: Floats, latencies_s: Floats) -> tuple[float, float]:
    """Return the step of the smallest latency and its time; zeros without one.

    Before the step, the smallest latencies of all blocks of messages are on one side of those
    after it, and the step is larger than the scatter of both parts together.
    """
    count = len(seconds) // _BLOCK
    if count < 2 * _FEWEST_BLOCKS:
        return 0.0, 0.0
    floors = latencies_s[: count * _BLOCK].reshape(count, _BLOCK).min(axis=1)
    splits = np.arange(_FEWEST_BLOCKS, count - _FEWEST_BLOCKS + 1)
    most, least = np.maximum.accumulate(floors), np.minimum.accumulate(floors)
    most_after = np.maximum.accumulate(floors[::-1])[::-1]
    least_after = np.minimum.accumulate(floors[::-1])[::-1]
    up = least_after[splits] - most[splits - 1]
    down = least[splits - 1] - most_after[splits]
    sizes = np.maximum(up, down)
    best = int(np.argmax(sizes))
    split = int(splits[best])
    scatter = most[split - 1] - least[split - 1] + most_after[split] - least_after[split]
    if sizes[best] < max(_LEAST_STEP_S, scatter):
        return 0.0, 0.0
    # The block before the split can have messages from both sides.
    around = np.arange((split - 1) * _BLOCK, (split + 1) * _BLOCK)
    at = around[1 + int(np.argmax(np.abs(np.diff(latencies_s[around]))))]
    return float(median(floors[split:]) - median(floors[:split])), float(seconds[at])


def _fastest(seconds: Floats, latencies_s: Floats) -> tuple[float, float]:
    """Return value at zero and slope of the lower convex hull's edge at the middle of the time.

    A line through one point of either half is lowered until no point is below it; few steps are
    enough, since every step takes the point that is farthest below.
    """
    is_late = seconds > (seconds.min() + seconds.max()) / 2.0
    if not is_late.any():
        return float(latencies_s.min()), 0.0
    halves = (np.flatnonzero(item) for item in (~is_late, is_late))
    ends = [half[latencies_s[half].argmin()] for half in halves]
    while True:
        slope = float(np.diff(latencies_s[ends])[0] / np.diff(seconds[ends])[0])
        at_s = float(latencies_s[ends[0]] - slope * seconds[ends[0]])
        above = latencies_s - at_s - slope * seconds
        above[ends] = 0.0
        lowest = above.argmin()
        if above[lowest] >= -1e-12 * (1.0 + abs(at_s)):
            return at_s, slope
        ends[int(is_late[lowest])] = lowest


def stamped_at_arrival(side: Trajectory) -> bool:
    """Return whether steps in time vary, and steps in space do not depend on them.

    A body with smooth motion moves twice as far in twice the time. If the distance does not depend
    on the timestamps, they are not the times of the poses.
    """
    some = slice(_SAMPLE)
    step_s = np.diff(side.stamps[some]) / NANOSECONDS
    is_regular = np.ptp(step_s) <= _JITTER * step_s.min() if len(step_s) else True
    # The distance between sparse keyframes is constant.
    if is_regular or not side.reading.stamped or (usual_s := median(step_s)) > _SPARSE_S:
        return False
    moved = np.diff(side.positions[some], axis=0)
    distance = np.linalg.norm(moved, axis=1)
    # Steps with neighbours on both sides and without lost messages. A body at rest moves by noise.
    whole = (step_s > 0.1 * usual_s) & (step_s < 1.9 * usual_s)
    nearby_s, nearby = (step_s[:-2] + step_s[2:]) / 2.0, (distance[:-2] + distance[2:]) / 2.0
    smooth = np.einsum("ni,ni->n", moved[:-2], moved[2:]) > 0.9 * distance[:-2] * distance[2:]
    counts = smooth & (nearby > 0.0) & whole[:-2] & whole[1:-1] & whole[2:]
    if np.count_nonzero(counts) < _FEWEST_SMOOTH:
        return False
    longer = step_s[1:-1][counts] / nearby_s[counts] - 1.0
    farther = distance[1:-1][counts] / nearby[counts] - 1.0
    jitter = float(np.sqrt(np.mean(longer**2)))
    follows = float(longer @ farther) / max(float(longer @ longer), 1e-12)
    return jitter > _JITTER and follows < _FOLLOWS
