"""Association: pairs of estimated states and groundtruth states.

`linear` interpolates the groundtruth at the estimate's timestamps. `groundtruth-stamps`
interpolates the estimate at the groundtruth's timestamps. Neither interpolates across a gap or
extrapolates. `auto` is `linear` for poses and `groundtruth-stamps` for points and GNSS fixes,
which are sparse. `continuous` evaluates a model of the groundtruth's motion, also in gaps.
`nearest` pairs one to one, closest first. The other methods reproduce a tool or a benchmark:
`rpg`, `evo`, and `index`, which pairs by frame number or row by row.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import NoMatchError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.valid_poses import add_counts
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH, AssociationRule
from trajeval_ros.metrics.completeness import Interpolation, InterpolationMeter, completeness
from trajeval_ros.metrics.coverage import Coverage, coverage_of
from trajeval_ros.metrics.discontinuities.lost_tracking import frozen_in
from trajeval_ros.metrics.other_programs import match_as_evo, match_frames

if TYPE_CHECKING:
    from trajeval_ros.continuous_time.continuous_trajectory import ContinuousTrajectory
    from trajeval_ros.metrics.discontinuities.events import Loss

_ROUNDS = 8  # of closest pairs of `nearest`, before pairs go one by one


class Tracking(NamedTuple):
    """How much of the groundtruth's time the estimate was tracked."""

    # Share of the groundtruth's time that the pairs cover. Groundtruth gaps do not count, except
    # for `continuous`, which pairs in gaps, too.
    coverage: Coverage
    frozen: tuple[Loss, ...] = ()  # times in which the estimate repeats its pose


@dataclass(frozen=True, eq=False)
class Association:
    """N pairs of states, and the number of states without a pair."""

    rule: AssociationRule
    groundtruth: Trajectory  # N groundtruth states at the timestamps of the pairs
    estimate: Trajectory  # N estimated states, in the estimate's frame
    # Share of the estimate's usable states that are in a pair; None for `groundtruth-stamps` and
    # for points, where it is not defined.
    estimate_coverage: float | None
    # Computes `tracking` at its first access: the verification of a mistake does not need it.
    compute_tracking: Callable[[], Tracking]
    # Number of states without a pair by reason: of the estimate, or of the groundtruth for
    # `groundtruth-stamps`.
    dropped: dict[str, int]
    # The groundtruth's model, for `continuous`; else None.
    continuous: ContinuousTrajectory | None = None
    # (N,) index of the groundtruth state of every pair; None if the groundtruth was interpolated.
    groundtruth_rows: Indices | None = None
    from_the_start: bool = True  # whether the first pair has the first estimated state
    # Of the estimate, for `groundtruth-stamps`; None if no pair is between two of its states.
    interpolation: Interpolation | None = None

    def __len__(self) -> int:
        return len(self.estimate)

    @cached_property
    def tracking(self) -> Tracking:
        """Coverage, and the times in which the estimate repeats its pose."""
        return self.compute_tracking()

    @property
    def coverage(self) -> Coverage:
        """The share of the groundtruth's time that the pairs cover, and the longest gap."""
        return self.tracking.coverage

    @property
    def groundtruth_coverage(self) -> float:
        """Share of the groundtruth's time that the pairs cover."""
        return self.coverage.covered

    @property
    def have_rotations(self) -> bool:
        """Whether both sides have orientations."""
        return self.groundtruth.quaternions is not None and self.estimate.quaternions is not None

    @property
    def without_orientations(self) -> str:
        """Which sides have no orientations, as text; empty if both have them."""
        sides = (("groundtruth", self.groundtruth), ("estimate", self.estimate))
        absent = [name for name, side in sides if side.quaternions is None]
        return f"no orientations in the {' and the '.join(absent)}" if absent else ""

    @cached_property
    def has_headings_only(self) -> bool:
        """Whether the estimate has 2-D headings, and the groundtruth has tilt."""
        true, other = self.groundtruth.quaternions, self.estimate.quaternions
        if true is None or other is None or other[:, :2].any():
            return False
        return bool(true[:, :2].any())

    @property
    def is_at_groundtruth(self) -> bool:
        """Whether pairs are at the groundtruth's timestamps; coverage then counts its states."""
        return self.rule.method == AT_GROUNDTRUTH


def associate(groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule) -> Association:
    """Pair the states of two trajectories.

    `estimate`: states in their own frame.
    """
    rule = rule.for_kind(groundtruth.kind)
    groundtruth.require_usable()
    estimate.require_usable()
    offset = round(rule.time_offset_s * NANOSECONDS)
    shifted = dataclasses.replace(estimate, stamps=estimate.stamps + offset)
    continuous = groundtruth_rows = None
    by_row = rule.method == "index" or not (
        groundtruth.reading.stamped and estimate.reading.stamped
    )
    if by_row:
        rule = dataclasses.replace(rule, method="index")
        groundtruth_rows, rows, dropped = match_frames(groundtruth, estimate)
        paired = groundtruth[groundtruth_rows]
    elif rule.method == "linear":
        paired, rows, dropped = _interpolated(groundtruth.in_order(), shifted, rule)
    elif rule.method == AT_GROUNDTRUTH:
        return _at_groundtruth(groundtruth, estimate, shifted, rule)
    elif rule.method == "continuous":
        from trajeval_ros.continuous_time.continuous_trajectory import fit_trajectory

        continuous = fit_trajectory(groundtruth.in_order(), rule.model, rule.noise)
        paired, rows, dropped = _modelled(groundtruth, shifted, continuous)
    else:
        groundtruth_rows, rows = _nearest_pairs(groundtruth, shifted, rule)
        paired = groundtruth[groundtruth_rows]
        unmatched = len(estimate) - _distinct(rows, len(estimate))
        dropped = {"no_groundtruth_within_max_time_difference": unmatched}
    if len(rows) == 0:
        raise _no_match(groundtruth, shifted, dropped, rule)
    share: float | None = _distinct(rows, len(estimate)) / len(estimate)
    completed = None
    if groundtruth.kind == "points" and groundtruth_rows is not None and not by_row:
        known = np.unique(groundtruth_rows)
        share, completed = None, completeness(groundtruth, known)
        dropped = {"no_estimate_within_max_time_difference": len(groundtruth) - len(known)}
    pairs = shifted[rows]
    # Without timestamps in the estimate, a pair has the groundtruth's.
    stamps = paired.stamps if by_row and groundtruth.reading.stamped else pairs.stamps
    paired = dataclasses.replace(paired, stamps=stamps)

    def tracking() -> Tracking:
        frozen, frozen_ns = ((), 0) if by_row else frozen_in(paired, pairs, rule)
        if completed is not None:
            return Tracking(completed, frozen)
        once = paired  # a groundtruth state counts once, also if several pairs share it
        if groundtruth_rows is not None:
            once = paired[np.unique(groundtruth_rows, return_index=True)[1]]
        return Tracking(coverage_of(groundtruth, once, rule, frozen_ns), frozen)

    return Association(
        rule=rule,
        groundtruth=paired,
        estimate=dataclasses.replace(pairs, stamps=stamps),
        estimate_coverage=share,
        compute_tracking=tracking,
        dropped=add_counts(estimate.reading.dropped, dropped),
        continuous=continuous,
        groundtruth_rows=groundtruth_rows,
        from_the_start=bool(pairs.stamps[0] == shifted.stamps[0]),
    )


def _modelled(
    groundtruth: Trajectory, estimate: Trajectory, continuous: ContinuousTrajectory
) -> tuple[Trajectory, Indices, dict[str, int]]:
    """Evaluate the groundtruth's model at the estimate's timestamps, gaps included."""
    rows = np.flatnonzero(continuous.covers(estimate.stamps))
    stamps = estimate.stamps[rows]
    poses = continuous.at(stamps).poses
    oriented = groundtruth.quaternions is not None
    paired = groundtruth.moved_to(
        stamps,
        positions=np.ascontiguousarray(poses[:, :3, 3]),
        quaternions=lie.from_matrices(poses[:, :3, :3]) if oriented else None,
    )
    return paired, rows, _outside(groundtruth.stamps, estimate.stamps)


def _outside(times: Indices, stamps: Indices) -> dict[str, int]:
    """Return how many stamps (N,) are before and after all times (M,), by reason."""
    return {
        "before_groundtruth": int(np.count_nonzero(stamps < times.min())),
        "after_groundtruth": int(np.count_nonzero(stamps > times.max())),
    }


def _interpolated(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule
) -> tuple[Trajectory, Indices, dict[str, int]]:
    """Interpolate the groundtruth at the estimate's timestamps."""
    paired, bracket = rule.interpolated(groundtruth, estimate.stamps)
    return paired, np.flatnonzero(bracket.usable), bracket.dropped("groundtruth")


def _at_groundtruth(
    groundtruth: Trajectory, estimate: Trajectory, shifted: Trajectory, rule: AssociationRule
) -> Association:
    """Interpolate the estimate at the groundtruth's timestamps.

    Coverage is completeness: the share of the groundtruth's states that are in a pair.
    """
    groundtruth, states = groundtruth.in_order(), shifted.in_order()
    between, bracket = rule.interpolated(states, groundtruth.stamps)
    rows = np.flatnonzero(bracket.usable)
    dropped = bracket.dropped("estimate")
    if not len(rows):
        raise _no_match(groundtruth, states, dropped, rule)
    meter = InterpolationMeter()
    meter.add(states.stamps, states.positions)
    paired = groundtruth[rows]

    def tracking() -> Tracking:
        return Tracking(completeness(groundtruth, rows), frozen_in(paired, between, rule)[0])

    return Association(
        rule=rule,
        groundtruth=paired,
        estimate=between,
        estimate_coverage=None,
        compute_tracking=tracking,
        dropped=add_counts(estimate.reading.dropped, dropped),
        groundtruth_rows=rows,
        interpolation=meter.interpolation if bracket.is_between else None,
    )


def _no_match(
    groundtruth: Trajectory, estimate: Trajectory, dropped: dict[str, int], rule: AssociationRule
) -> NoMatchError:
    from trajeval_ros.metrics.no_match import explain_no_match

    return NoMatchError(explain_no_match(groundtruth, estimate, dropped, rule))


def _distinct(rows: Indices, count: int) -> int:
    """Return the number of distinct indices in `rows`, which are below `count`."""
    named = np.zeros(count, dtype=bool)
    named[rows] = True
    return int(np.count_nonzero(named))


def _one_to_one(
    groundtruth: Trajectory, estimate: Trajectory, limit_s: float, *, is_rpg: bool
) -> tuple[Indices, Indices]:
    """Pair greedily, closest first, every state at most once (rule of TUM and of rpg's toolbox).

    The toolbox excludes the limit itself and compares timestamps in float64 seconds.
    """
    groundtruth_times: NDArray[Any] = groundtruth.stamps
    times: NDArray[Any] = estimate.stamps
    reach: float = round(limit_s * NANOSECONDS)
    if is_rpg:
        groundtruth_times, times, reach = (
            _float_seconds(groundtruth_times),
            _float_seconds(times),
            limit_s,
        )
    groundtruth_order = np.argsort(groundtruth_times, kind="stable")
    in_order = groundtruth_times[groundtruth_order]
    low = np.searchsorted(in_order, times - reach, side="left")
    count = np.searchsorted(in_order, times + reach, side="right") - low
    row = np.repeat(np.arange(len(count)), count)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    groundtruth_row = groundtruth_order[low[row] + place]
    difference = np.abs(groundtruth_times[groundtruth_row] - times[row])
    if is_rpg:
        close = difference < limit_s
        row, groundtruth_row, difference = row[close], groundtruth_row[close], difference[close]
    order = np.lexsort((groundtruth_row, row, difference))
    row, groundtruth_row = row[order], groundtruth_row[order]
    taken_row: Indices = np.full(len(estimate), -1, dtype=np.int64)
    taken_groundtruth = np.zeros(len(groundtruth), dtype=bool)
    # A pair that is the closest one of both of its states is accepted, and all other pairs of
    # these states are removed. Then other pairs are the closest. A few rounds are usually enough.
    for _ in range(_ROUNDS):
        if not len(row):
            break
        rank = np.arange(len(row))
        first_of_row = np.full(len(estimate), len(row))
        first_of_groundtruth = np.full(len(groundtruth), len(row))
        np.minimum.at(first_of_row, row, rank)
        np.minimum.at(first_of_groundtruth, groundtruth_row, rank)
        both = (first_of_row[row] == rank) & (first_of_groundtruth[groundtruth_row] == rank)
        taken_row[row[both]] = groundtruth_row[both]
        taken_groundtruth[groundtruth_row[both]] = True
        free = (taken_row[row] < 0) & ~taken_groundtruth[groundtruth_row]
        row, groundtruth_row = row[free], groundtruth_row[free]
    # Long chains of competing pairs, such as equal rates half a period apart, go one by one.
    for one, other in zip(row.tolist(), groundtruth_row.tolist(), strict=True):
        if taken_row[one] < 0 and not taken_groundtruth[other]:
            taken_row[one] = other
            taken_groundtruth[other] = True
    rows = np.flatnonzero(taken_row >= 0)
    return taken_row[rows], rows


def _evo(groundtruth: Trajectory, estimate: Trajectory, limit_s: float) -> tuple[Indices, Indices]:
    """Pair as evo does: every state of the shorter trajectory with the nearest of the other.

    Timestamps are compared as evo reads them.
    """
    driven_by_groundtruth = len(groundtruth) < len(estimate)
    short, long = (groundtruth, estimate) if driven_by_groundtruth else (estimate, groundtruth)
    short_rows, long_rows = match_as_evo(
        _float_seconds(short.stamps), _float_seconds(long.stamps), limit_s
    )
    return (short_rows, long_rows) if driven_by_groundtruth else (long_rows, short_rows)


def _nearest_pairs(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule
) -> tuple[Indices, Indices]:
    """Return the paired rows (K,) of both sides in any order, by `nearest`, `rpg` or `evo`."""
    limit_s = rule.max_time_difference_s
    if rule.method == "evo":
        return _evo(groundtruth, estimate, limit_s)
    return _one_to_one(groundtruth, estimate, limit_s, is_rpg=rule.method == "rpg")


def _float_seconds(stamps: Indices) -> Floats:
    """Return timestamps in float64 seconds, as rpg and evo read them; resolution 2.4e-7 s.

    A difference equal to the limit is then rounded as in these tools.
    """
    seconds: Floats = stamps // NANOSECONDS + (stamps % NANOSECONDS) / NANOSECONDS
    return seconds
