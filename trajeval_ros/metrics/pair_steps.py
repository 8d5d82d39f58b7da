"""Steps between consecutive pairs: their duration and the groundtruth's motion in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import Trajectory

# 20 Hz resolves the motion of a robot and needs little memory.
_CELL_NS = 50_000_000
POSE = slice(0, 7)  # columns of the pose in a state


class StampedPoses(NamedTuple):
    """Poses in order of their timestamps.

    Attributes:
        stamps: (N,) int64, nanoseconds.
        poses: (N, 7), position and quaternion xyzw; the latter NaN if unknown.
    """

    stamps: Stamps
    poses: Floats

    @classmethod
    def of(cls, trajectory: Trajectory, rows: Indices) -> StampedPoses:
        """Return rows of a trajectory; the rows are in order of time."""
        turned = trajectory.quaternions
        poses = np.empty((len(rows), POSE.stop))
        poses[:, :3] = trajectory.positions[rows]
        poses[:, 3:] = np.nan if turned is None else turned[rows]
        return cls(trajectory.stamps[rows], poses)

    @classmethod
    def joined(cls, parts: Sequence[StampedPoses]) -> StampedPoses:
        """Return consecutive parts as one; empty for no parts."""
        if not parts:
            return cls(np.empty(0, dtype=np.int64), np.empty((0, POSE.stop)))
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


class PairSteps(NamedTuple):
    """N steps between N + 1 consecutive pairs.

    Attributes:
        time_ns: (N,) duration without gaps of the groundtruth, nanoseconds.
        reach_m: (N,) largest distance of the groundtruth from its position at the start of the
            step; 0 for steps of up to 50 ms.
        turn_rad: (N,) largest rotation since the start of the step; NaN without orientations.
    """

    time_ns: Indices
    reach_m: Floats
    turn_rad: Floats

    def where(self, chosen: Booleans) -> PairSteps:
        """Return the steps of a mask (N,)."""
        return PairSteps(self.time_ns[chosen], self.reach_m[chosen], self.turn_rad[chosen])


def waypoints(stamps: Stamps, max_gap_ns: int) -> Booleans:
    """Return which groundtruth states (N,) are needed to measure steps, by their sorted stamps.

    These are the first state of every 50 ms and both ends of longer steps, so that gaps keep their
    length. The choice depends only on a state's timestamp and its neighbours'.
    """
    cell = min(_CELL_NS, max(max_gap_ns // 2, 1))
    needed = np.ones(len(stamps), dtype=bool)
    step = stamps[1:] - stamps[:-1]
    cells = stamps // cell
    needed[1:-1] = (cells[1:-1] != cells[:-2]) | (step[1:] > cell)
    return needed


class StepMeter:
    """Measures steps from batches of pairs and groundtruth, of any size, in order."""

    def __init__(self, max_gap_ns: int) -> None:
        """Create it before the first pair.

        Args:
            max_gap_ns: A longer step of the groundtruth is a gap, nanoseconds.
        """
        self._max_gap_ns = max_gap_ns
        self._last: tuple[int, int] | None = None  # last waypoint: stamp, time without gaps
        self._begin: Floats | None = None  # pose of the newest pair
        self._stamp = self._begin_ns = 0  # newest pair: stamp, time without gaps
        self._reach_m = self._turn_rad = 0.0  # since the newest pair

    def measure(self, truth: StampedPoses, pairs: StampedPoses) -> PairSteps:
        """Return the steps that end at new pairs.

        Args:
            truth: (M,) waypoints of the groundtruth since the last call: all up to the newest
                pair, possibly some after it.
            pairs: (N,) groundtruth poses of the new pairs.
        """
        times = self._time_without_gaps(truth.stamps, pairs.stamps)
        if not len(pairs.stamps) and self._begin is None:
            return PairSteps(times, np.empty(0), np.empty(0))
        # Step k ends at pair k. Waypoints after the last pair belong to the open step.
        count = len(pairs.stamps)
        begin = pairs.poses[:1] if self._begin is None else self._begin
        known = pairs.poses if count else begin
        ends_at = pairs.stamps.searchsorted(truth.stamps)
        reach, turn = np.zeros(count + 1), np.zeros(count + 1)
        reach[0], turn[0] = self._reach_m, self._turn_rad
        is_long = np.append(np.diff(pairs.stamps, prepend=self._stamp) > _CELL_NS, True)
        for poses, ends in ((pairs.poses, np.arange(count)), (truth.poses, ends_at)):
            rows = np.flatnonzero(is_long[ends])
            before = ends[rows] - 1
            begins = np.where(before[:, None] < 0, begin, known[before])
            distance, angle = _apart(begins, poses[rows])
            np.maximum.at(reach, ends[rows], distance)
            with np.errstate(invalid="ignore"):  # unknown angles
                np.maximum.at(turn, ends[rows], angle)
        reach[~is_long] = turn[~is_long] = 0.0
        # The first pair ends no step.
        first = int(self._begin is None)
        time_ns = np.diff(times, prepend=self._begin_ns)[first:]
        if count:
            self._begin_ns, self._stamp = int(times[-1]), int(pairs.stamps[-1])
        self._begin = known[-1:].copy()
        self._reach_m, self._turn_rad = float(reach[-1]), float(turn[-1])
        return PairSteps(time_ns, reach[first:-1], turn[first:-1])

    def _time_without_gaps(self, truth: Stamps, stamps: Stamps) -> Indices:
        """Return the time without gaps up to stamps (N,); advance to the last waypoint (M,)."""
        since_ns = 0
        if self._last is not None:
            truth = np.concatenate([[self._last[0]], truth])
            since_ns = self._last[1]
        if not len(truth):
            return np.zeros(len(stamps), dtype=np.int64)
        step = truth[1:] - truth[:-1]
        is_gap = step > self._max_gap_ns
        until = since_ns + np.concatenate([[0], np.cumsum(np.where(is_gap, 0, step))])
        place = (truth.searchsorted(stamps, side="right") - 1).clip(0)
        beyond = (stamps - truth[place]).clip(0)
        # A longer time after the last waypoint can only be an open gap.
        in_gap = np.append(is_gap, False)[place] | (beyond > self._max_gap_ns)
        self._last = int(truth[-1]), int(until[-1])
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
