"""Coverage: the share of the groundtruth's time in which the estimate was tracked.

An estimate at the camera's rate was lost during a step much longer than usual. Keyframes are
chosen by motion, so slow motion makes long steps. For keyframes, only a long step with more motion
than usual is a loss; the motion is the groundtruth's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.formatting.numbers import percent
from trajeval_ros.geometry.arrays import Booleans, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.log_histogram import LogHistogram
from trajeval_ros.metrics.pair_steps import PairSteps, StampedPoses, StepMeter, waypoints

# Steps are between keyframes if their 90 % quantile exceeds this time, and this multiple of the
# median. Fewer steps than this give no reliable quantile.
_KEYFRAMES_S = 0.2
_UNEVEN = 1.2
_FEWEST_STEPS = 10
# A step between keyframes is no loss if it is shorter than this time or this multiple of the
# median, or if the robot moved less than these limits or than this multiple of the usual motion.
_SHORT_S = 3.0
_USUAL_STEPS = 2.0
_STILL_M = 0.05
_STILL_RAD = math.radians(3.0)
_NO_GAP_NS = int(np.iinfo(np.int64).max)


@dataclass(frozen=True)
class Gap:
    """A period in which the estimate was lost.

    Attributes:
        duration_s: Its duration without gaps of the groundtruth.
        reach_m: Largest distance of the groundtruth from its position at the start.
        turn_deg: Largest rotation of the groundtruth since the start; None without orientations.
    """

    duration_s: float
    reach_m: float
    turn_deg: float | None

    def __str__(self) -> str:
        """Write it for a sentence: "12.3 s (4.51 m, 90 deg)"."""
        turned = "" if self.turn_deg is None else f", {self.turn_deg:.0f} deg"
        return f"{self.duration_s:.1f} s ({self.reach_m:.2f} m{turned})"


@dataclass(frozen=True)
class Coverage:
    """The share of the groundtruth's time that pairs cover, gaps of the groundtruth excluded.

    Attributes:
        covered: Share of the time in which the estimate was tracked.
        span: Share of the time from the first to the last pair.
        keyframes: Whether the pairs are keyframes, with uneven steps.
        longest_gap: The longest step between pairs that is not covered; None if all are.

    Example:
        >>> from trajeval_ros import evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> coverage = evaluate(flight.groundtruth, flight.estimate).association.coverage
        >>> 0.9 < coverage.covered < coverage.span <= 1.0
        True
    """

    covered: float
    span: float
    keyframes: bool = False
    longest_gap: Gap | None = None

    @property
    def of_what(self) -> str:
        """What covers the groundtruth, for a message: pairs, or keyframe pairs."""
        return "keyframe pairs" if self.keyframes else "pairs"

    @property
    def gap_in_words(self) -> str:
        """Span and longest gap, for a message; empty if all steps are covered."""
        if self.longest_gap is None:
            return ""
        return (
            f"{percent(self.span)} from the first to the last pair, longest gap {self.longest_gap}"
        )


class CoverageSums:
    """Running sums of the steps between pairs, from which coverage follows.

    Steps longer than the maximum gap are kept, at most one per maximum gap. All others are summed
    and counted in histograms. Live and offline evaluation share this code, so that their coverage
    is equal.
    """

    def __init__(self, max_gap_s: float) -> None:
        """Create sums without a step.

        Args:
            max_gap_s: Longest step that always counts as covered.
        """
        self._max_gap_s = max_gap_s
        self._steps = 0
        self._time_ns = self._short_ns = 0
        self._time_s, self._reach_m, self._turn_rad = (LogHistogram() for _ in range(3))
        self._long: list[PairSteps] = []

    def add(self, steps: PairSteps) -> None:
        """Add steps, in any order."""
        is_long = steps.time_ns > round(self._max_gap_s * NANOSECONDS)
        self._steps += len(steps.time_ns)
        self._time_ns += int(steps.time_ns.sum())
        self._short_ns += int(steps.time_ns[~is_long].sum())
        self._time_s.add(steps.time_ns / NANOSECONDS)
        self._reach_m.add(steps.reach_m)
        self._turn_rad.add(steps.turn_rad[~np.isnan(steps.turn_rad)])
        if is_long.any():
            self._long.append(steps.where(is_long))

    def coverage(self, time_ns: int, states: int) -> Coverage:
        """Return the coverage of the pairs.

        Args:
            time_ns: Groundtruth time without gaps, nanoseconds. If it is 0 (every step is a gap),
                the share of states is returned instead.
            states: Number of groundtruth states.
        """
        if time_ns == 0:
            share = min(1.0, (self._steps + 1) / states)
            return Coverage(share, share)
        usual_s, most_s = self._time_s.quantile(0.5), self._time_s.quantile(0.9)
        keyframes = (
            self._steps >= _FEWEST_STEPS and most_s > _KEYFRAMES_S and most_s > _UNEVEN * usual_s
        )
        covered_ns, gap = self._short_ns, None
        if self._long:
            steps = PairSteps(*map(np.concatenate, zip(*self._long, strict=True)))
            self._long = [steps]
            limit_s = max(self._max_gap_s, _USUAL_STEPS * usual_s)
            if keyframes:
                limit_s = max(limit_s, _SHORT_S)
            is_tracked = steps.time_ns / NANOSECONDS <= limit_s
            if keyframes:
                is_tracked |= self._hardly_moved(steps)
            covered_ns += int(steps.time_ns[is_tracked].sum())
            gap = _longest(steps.where(~is_tracked))
        covered, span = (min(1.0, part_ns / time_ns) for part_ns in (covered_ns, self._time_ns))
        return Coverage(covered, span, keyframes, gap)

    def _hardly_moved(self, steps: PairSteps) -> Booleans:
        """Return in which steps the robot moved at most twice as much as in a usual step."""
        most_m = max(_STILL_M, _USUAL_STEPS * self._reach_m.quantile(0.9))
        most_rad = max(_STILL_RAD, _USUAL_STEPS * self._turn_rad.quantile(0.9))
        # Unknown rotations are NaN; their comparison is false.
        still: Booleans = (steps.reach_m <= most_m) & ~(steps.turn_rad > most_rad)
        return still


def _longest(steps: PairSteps) -> Gap | None:
    if not len(steps.time_ns):
        return None
    longest = int(steps.time_ns.argmax())
    turn_deg = float(np.degrees(steps.turn_rad[longest]))
    return Gap(
        duration_s=float(steps.time_ns[longest] / NANOSECONDS),
        reach_m=float(steps.reach_m[longest]),
        turn_deg=None if math.isnan(turn_deg) else turn_deg,
    )


def coverage_of(
    groundtruth: Trajectory, pairs: Trajectory, max_gap_s: float, *, in_gaps: bool = False
) -> Coverage:
    """Return the share of the groundtruth's time that pairs cover.

    Args:
        groundtruth: All M states.
        pairs: The groundtruth states of the N pairs, N > 0, without repetition.
        max_gap_s: Longest step of either side that is no gap, seconds.
        in_gaps: Whether pairs exist in gaps of the groundtruth, so that gaps count as time.
    """
    max_gap_ns = _NO_GAP_NS if in_gaps else round(max_gap_s * NANOSECONDS)
    order = np.argsort(groundtruth.stamps, kind="stable")
    times = groundtruth.stamps[order]
    needed = order[waypoints(times, max_gap_ns)]
    found = StampedPoses.of(pairs, np.argsort(pairs.stamps, kind="stable"))
    # The nearest estimate can be beyond the groundtruth's ends; coverage ends there.
    within = found._replace(stamps=found.stamps.clip(times[0], times[-1]))
    sums = CoverageSums(max_gap_s)
    sums.add(StepMeter(max_gap_ns).measure(StampedPoses.of(groundtruth, needed), within))
    return sums.coverage(time_without_gaps(times, max_gap_ns), len(groundtruth))


def time_without_gaps(stamps: Indices, max_gap_ns: int) -> int:
    """Return the sum of the steps between sorted stamps (N,) that are no gaps, nanoseconds."""
    steps = stamps[1:] - stamps[:-1]
    return int(steps[steps <= max_gap_ns].sum())
