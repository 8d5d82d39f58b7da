"""Coverage: the share of the groundtruth's time in which the estimate was tracked.

An estimate at the camera's rate was lost during a step much longer than usual. Keyframes are
chosen by motion, so slow motion makes long steps. For keyframes, only a long step with more motion
than usual is a loss; the motion is the groundtruth's. While the estimate repeats its position and
the groundtruth moves, it was lost, too (`TrackingLosses`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.formatting.numbers import whole_percent
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.statistics import LogHistogram

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
LOW_COVERAGE = 0.9  # below, errors of different runs are not compared


@dataclass(frozen=True)
class Gap:
    """A period in which the estimate was lost."""

    duration_s: float  # its duration without gaps of the groundtruth
    reach_m: float  # largest distance of the groundtruth from its position at the start
    # Largest rotation of the groundtruth since the start; None without orientations.
    turn_deg: float | None

    def __str__(self) -> str:
        """Write it for a sentence: "12.3 s (4.51 m, 90 deg)"."""
        rotation_text = "" if self.turn_deg is None else f", {self.turn_deg:.0f} deg"
        return f"{self.duration_s:.1f} s ({self.reach_m:.2f} m{rotation_text})"


@dataclass(frozen=True)
class Coverage:
    """The share of the groundtruth's time that pairs cover, gaps of the groundtruth excluded."""

    covered: float  # share of the time in which the estimate was tracked
    span: float  # share of the time from the first to the last pair
    keyframes: bool = False  # whether the pairs are keyframes, with uneven steps
    # The longest step between pairs that is not covered; None if all are.
    longest_gap: Gap | None = None

    @property
    def gap_in_words(self) -> str:
        """Span and longest gap, for a message; empty if all steps are covered."""
        if self.longest_gap is None:
            return ""
        return (
            f"{whole_percent(self.span)} from the first to the last pair, longest gap "
            f"{self.longest_gap}"
        )


class CoverageSums:
    """Running sums of the steps between pairs, from which coverage follows.

    Steps longer than the maximum gap are kept, at most one per maximum gap. All others are summed
    and counted in histograms. Live and offline evaluation share this code, so that their coverage
    is equal.
    """

    def __init__(self, rule: AssociationRule) -> None:
        """Create sums without a step; steps that are no gaps of the rule count as covered."""
        self._rule = rule
        self._steps = 0
        self._time_ns = self._short_ns = 0
        self._time_s, self._reach_m, self._turn_rad = (LogHistogram() for _ in range(3))
        self._long: list[PairSteps] = []

    def add(self, steps: PairSteps) -> None:
        """Add steps, in any order."""
        is_long = self._rule.is_gap(steps.time_ns)
        self._steps += len(steps.time_ns)
        self._time_ns += int(steps.time_ns.sum())
        self._short_ns += int(steps.time_ns[~is_long].sum())
        self._time_s.add(steps.time_ns / NANOSECONDS)
        self._reach_m.add(steps.reach_m)
        self._turn_rad.add(steps.turn_rad[~np.isnan(steps.turn_rad)])
        if is_long.any():
            self._long.append(steps.where(is_long))

    def coverage(self, time_ns: int, states: int, frozen_ns: int) -> Coverage:
        """Return the coverage of the pairs.

        `time_ns` is the groundtruth's time without gaps. If it is 0 (every step is a gap), the
        share of the groundtruth's states is returned instead. `frozen_ns` is the time of frozen
        estimates.
        """
        if time_ns == 0:
            share = min(1.0, (self._steps + 1) / states)
            return Coverage(share, share)
        usual_s, most_s = self._time_s.quantile(0.5), self._time_s.quantile(0.9)
        keyframes = (
            self._steps >= _FEWEST_STEPS and most_s > _KEYFRAMES_S and most_s > _UNEVEN * usual_s
        )
        covered_ns, gap = max(0, self._short_ns - frozen_ns), None
        if self._long:
            steps = PairSteps(*map(np.concatenate, zip(*self._long, strict=True)))
            self._long = [steps]
            limit_s = _USUAL_STEPS * usual_s
            if keyframes:
                limit_s = max(limit_s, _SHORT_S)
            is_tracked = ~self._rule.bridging(limit_s).is_gap(steps.time_ns)
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
    groundtruth: Trajectory,
    pairs: Trajectory,
    rule: AssociationRule,
    frozen_ns: int = 0,
) -> Coverage:
    """Return the share of the groundtruth's time that pairs cover.

    `pairs` are the groundtruth states of the pairs, at least one, without repetition. `frozen_ns`
    is the time of frozen estimates.
    """
    order = np.argsort(groundtruth.stamps, kind="stable")
    times = groundtruth.stamps[order]
    needed = order[waypoints(times, rule)]
    poses = StampedPoses.of(pairs, np.argsort(pairs.stamps, kind="stable"))
    # The nearest estimate can be beyond the groundtruth's ends; coverage ends there.
    within = poses._replace(stamps=poses.stamps.clip(times[0], times[-1]))
    sums = CoverageSums(rule)
    sums.add(StepMeter(rule).measure(StampedPoses.of(groundtruth, needed), within))
    return sums.coverage(time_without_gaps(times, rule), len(groundtruth), frozen_ns)


def time_without_gaps(stamps: Indices, rule: AssociationRule) -> int:
    """Return the sum of the steps between sorted stamps (N,) that are no gaps, nanoseconds."""
    steps = stamps[1:] - stamps[:-1]
    return int(steps[~rule.is_groundtruth_gap(steps)].sum())


# 20 Hz resolves the motion of a robot and needs little memory.
_CELL_NS = 50_000_000
POSE = slice(0, 7)  # columns of the pose in a state
ALL_ROWS = slice(None)


class StampedPoses(NamedTuple):
    """Poses and their timestamps, usually in order of time."""

    stamps: Stamps  # (N,) int64, nanoseconds
    poses: Floats  # (N, 7), position and quaternion xyzw; the latter NaN if unknown

    @classmethod
    def of(cls, trajectory: Trajectory, rows: slice | Indices = ALL_ROWS) -> StampedPoses:
        """Return rows of a trajectory, in their order."""
        stamps, quaternions = trajectory.stamps[rows], trajectory.quaternions
        poses = np.empty((len(stamps), POSE.stop))
        poses[:, :3] = trajectory.positions[rows]
        poses[:, 3:] = np.nan if quaternions is None else quaternions[rows]
        return cls(stamps, poses)

    @classmethod
    def joined(cls, parts: Sequence[StampedPoses]) -> StampedPoses:
        """Return consecutive parts as one; empty for no parts."""
        if not parts:
            return cls(np.empty(0, dtype=np.int64), np.empty((0, POSE.stop)))
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


class PairSteps(NamedTuple):
    """N steps between N + 1 consecutive pairs."""

    time_ns: Indices  # (N,) duration without gaps of the groundtruth, nanoseconds
    # (N,) largest distance of the groundtruth from its position at the start of the step; 0 for
    # steps of up to 50 ms.
    reach_m: Floats
    turn_rad: Floats  # (N,) largest rotation since the start of the step; NaN without orientations

    def where(self, chosen: Booleans) -> PairSteps:
        """Return the steps of a mask (N,)."""
        return PairSteps(self.time_ns[chosen], self.reach_m[chosen], self.turn_rad[chosen])


def waypoints(stamps: Stamps, rule: AssociationRule) -> Booleans:
    """Return which groundtruth states (N,) are needed to measure steps, by their sorted stamps.

    These are the first state of every 50 ms and both ends of longer steps, so that gaps keep their
    length. The choice depends only on a state's timestamp and its neighbours'.
    """
    cell = rule.cell_ns(_CELL_NS)
    needed = np.ones(len(stamps), dtype=bool)
    step = stamps[1:] - stamps[:-1]
    cells = stamps // cell
    needed[1:-1] = (cells[1:-1] != cells[:-2]) | (step[1:] > cell)
    return needed


class StepMeter:
    """Measures steps from batches of pairs and groundtruth, of any size, in order."""

    def __init__(self, rule: AssociationRule) -> None:
        """Create it before the first pair."""
        self._rule = rule
        self._last: tuple[int, int] | None = None  # last waypoint: stamp, time without gaps
        self._begin: Floats | None = None  # pose of the newest pair
        self._stamp = self._begin_ns = 0  # newest pair: stamp, time without gaps
        self._reach_m = self._turn_rad = 0.0  # since the newest pair

    def measure(self, groundtruth: StampedPoses, pairs: StampedPoses) -> PairSteps:
        """Return the steps that end at N new pairs, from the groundtruth's poses of these pairs.

        `groundtruth` has the waypoints since the last call: all up to the newest pair, possibly
        some after it.
        """
        times = self._time_without_gaps(groundtruth.stamps, pairs.stamps)
        if not len(pairs.stamps) and self._begin is None:
            return PairSteps(times, np.empty(0), np.empty(0))
        # Step k ends at pair k. Waypoints after the last pair belong to the open step.
        count = len(pairs.stamps)
        begin = pairs.poses[:1] if self._begin is None else self._begin
        known = pairs.poses if count else begin
        ends_at = pairs.stamps.searchsorted(groundtruth.stamps)
        reach, rotation = np.zeros(count + 1), np.zeros(count + 1)
        reach[0], rotation[0] = self._reach_m, self._turn_rad
        is_long = np.append(np.diff(pairs.stamps, prepend=self._stamp) > _CELL_NS, True)
        for poses, ends in ((pairs.poses, np.arange(count)), (groundtruth.poses, ends_at)):
            rows = np.flatnonzero(is_long[ends])
            before = ends[rows] - 1
            begins = np.where(before[:, None] < 0, begin, known[before])
            distance, angle = _apart(begins, poses[rows])
            np.maximum.at(reach, ends[rows], distance)
            with np.errstate(invalid="ignore"):  # unknown angles
                np.maximum.at(rotation, ends[rows], angle)
        reach[~is_long] = rotation[~is_long] = 0.0
        # The first pair ends no step.
        first = int(self._begin is None)
        time_ns = np.diff(times, prepend=self._begin_ns)[first:]
        if count:
            self._begin_ns, self._stamp = int(times[-1]), int(pairs.stamps[-1])
        self._begin = known[-1:].copy()
        self._reach_m, self._turn_rad = float(reach[-1]), float(rotation[-1])
        return PairSteps(time_ns, reach[first:-1], rotation[first:-1])

    def _time_without_gaps(self, groundtruth: Stamps, stamps: Stamps) -> Indices:
        """Return the time without gaps up to stamps (N,); advance to the last waypoint (M,)."""
        since_ns = 0
        if self._last is not None:
            groundtruth = np.concatenate([[self._last[0]], groundtruth])
            since_ns = self._last[1]
        if not len(groundtruth):
            return np.zeros(len(stamps), dtype=np.int64)
        step = groundtruth[1:] - groundtruth[:-1]
        is_gap = self._rule.is_groundtruth_gap(step)
        until = since_ns + np.concatenate([[0], np.cumsum(np.where(is_gap, 0, step))])
        place = (groundtruth.searchsorted(stamps, side="right") - 1).clip(0)
        beyond = (stamps - groundtruth[place]).clip(0)
        # A longer time after the last waypoint can only be an open gap.
        in_gap = np.append(is_gap, False)[place] | self._rule.is_groundtruth_gap(beyond)
        self._last = int(groundtruth[-1]), int(until[-1])
        times: Indices = until[place] + np.where(in_gap, 0, beyond)
        return times


def _apart(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """Return distances and angles between poses (N, 7), metres and radians."""
    # By components, so that the digits do not depend on the size of the batch.
    x, y, z = (one[:, i] - other[:, i] for i in range(3))
    same, opposite = (
        sum((one[:, i] - sign * other[:, i]) ** 2 for i in range(3, 7)) for sign in (1.0, -1.0)
    )
    half_chord = np.sqrt(np.minimum(same, opposite)) / 2.0
    return np.sqrt(x * x + y * y + z * z), 4.0 * np.arcsin(np.minimum(half_chord, 1.0))
