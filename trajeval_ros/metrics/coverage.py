"""Coverage: in how much of the groundtruth's time an estimate was tracked; beside every ATE.

A tracker that publishes frame by frame was lost in a step much longer than usual. Keyframes are
chosen by motion, so that slow motion makes long steps: there the groundtruth says whether the
robot moved on, and only a long step with motion that no keyframe shows is a loss.
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

# Steps are those of keyframes if nine in ten are below a time that is longer than this, and than
# so many times the median; quantiles of fewer steps say nothing.
_KEYFRAMES_S = 0.2
_UNEVEN = 1.2
_FEWEST_STEPS = 10
# A keyframe's step is never a loss if it is no longer than this, or than so many times the usual
# one, or if the robot moved less than this in it, or than so many times what is usual.
_SHORT_S = 3.0
_USUAL_STEPS = 2.0
_STILL_M = 0.05
_STILL_RAD = math.radians(3.0)
_NO_GAP_NS = int(np.iinfo(np.int64).max)


@dataclass(frozen=True)
class Gap:
    """A stretch of time in which the estimate was lost.

    Attributes:
        duration_s: How long, gaps of the groundtruth left out.
        reach_m: The farthest that the groundtruth got from where it began.
        turn_deg: The farthest that the groundtruth turned; None without its orientations.
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
    """How much of the groundtruth's time pairs cover; its gaps don't count.

    Attributes:
        covered: Share of it in which the estimate was tracked.
        span: Share of it from the first pair to the last one.
        keyframes: Whether the pairs are keyframes, whose steps are uneven.
        longest_gap: The longest step between pairs that isn't covered; None if all are.

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
        """What covers, for a sentence: pairs, or keyframe pairs."""
        return "keyframe pairs" if self.keyframes else "pairs"

    @property
    def gap_in_words(self) -> str:
        """What a sentence adds about span and longest gap; empty where all steps are covered."""
        if self.longest_gap is None:
            return ""
        return (
            f"{percent(self.span)} from the first to the last pair, longest gap {self.longest_gap}"
        )


class CoverageSums:
    """What coverage needs of the steps between pairs, added up as they come.

    Steps that are longer than the maximum gap are kept, at most one per such time; of all others
    sums and histograms. Live and offline it is the same sums, so the same coverage.
    """

    def __init__(self, max_gap_s: float) -> None:
        """Create it without a step.

        Args:
            max_gap_s: Longest step that is never a loss.
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
        """Return what the pairs cover.

        Args:
            time_ns: The groundtruth's time that pairs can cover, nanoseconds; 0 of groundtruth
                that is all gaps, whose share of states counts then.
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
        covered, span = (min(1.0, each / time_ns) for each in (covered_ns, self._time_ns))
        return Coverage(covered, span, keyframes, gap)

    def _hardly_moved(self, steps: PairSteps) -> Booleans:
        """Return in which steps the robot did no more than in two usual ones of a keyframe run."""
        most_m = max(_STILL_M, _USUAL_STEPS * self._reach_m.quantile(0.9))
        most_rad = max(_STILL_RAD, _USUAL_STEPS * self._turn_rad.quantile(0.9))
        # Unknown turns are NaN, and larger than nothing.
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
    """Return what pairs cover of the groundtruth's time.

    Args:
        groundtruth: (M,) all its states.
        pairs: (N,) the groundtruth's states in pairs, N > 0, each once.
        max_gap_s: Longest step of either that is no gap.
        in_gaps: Whether pairs are made in the groundtruth's gaps, too, so that these count.
    """
    max_gap_ns = _NO_GAP_NS if in_gaps else round(max_gap_s * NANOSECONDS)
    order = np.argsort(groundtruth.stamps, kind="stable")
    times = groundtruth.stamps[order]
    needed = order[waypoints(times, max_gap_ns)]
    found = StampedPoses.of(pairs, np.argsort(pairs.stamps, kind="stable"))
    # The nearest state may be a little beyond the groundtruth's ends, whose time ends there.
    within = found._replace(stamps=found.stamps.clip(times[0], times[-1]))
    sums = CoverageSums(max_gap_s)
    sums.add(StepMeter(max_gap_ns).measure(StampedPoses.of(groundtruth, needed), within))
    return sums.coverage(time_without_gaps(times, max_gap_ns), len(groundtruth))


def time_without_gaps(stamps: Indices, max_gap_ns: int) -> int:
    """Return the sum of the steps between sorted stamps that are no gaps, nanoseconds."""
    steps = stamps[1:] - stamps[:-1]
    return int(steps[steps <= max_gap_ns].sum())
