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
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.continuous_time.models import DEFAULT_MODEL, MODELS
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.exceptions import NoMatchError, SettingsError, require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.valid_poses import add_counts
from trajeval_ros.metrics.completeness import Interpolation, InterpolationMeter, completeness
from trajeval_ros.metrics.coverage import Coverage, coverage_of
from trajeval_ros.metrics.discontinuities.lost_tracking import frozen_in
from trajeval_ros.metrics.nearest_association import nearest_pairs
from trajeval_ros.metrics.no_match import LATEST_CLOCK_S, explain_no_match
from trajeval_ros.metrics.other_programs import match_frames

if TYPE_CHECKING:
    from trajeval_ros.continuous_time.continuous_trajectory import ContinuousTrajectory
    from trajeval_ros.metrics.discontinuities.events import Loss

_LONGEST_S = 1e9  # limit of time differences and gaps; int64 nanoseconds hold more
AUTO, AT_GROUNDTRUTH = "auto", "groundtruth-stamps"
# Methods that interpolate one side at the timestamps of the other.
INTERPOLATING = (AUTO, "linear", AT_GROUNDTRUTH, "continuous")
METHODS = (AUTO, "linear", AT_GROUNDTRUTH, "continuous", "nearest", "rpg", "evo", "index")


@dataclass(frozen=True)
class AssociationRule:
    """The settings of an association.

    Attributes:
        method: One of `METHODS`.
        max_time_difference_s: Largest time difference in a pair, for `nearest`, `rpg` and `evo`.
        max_gap_s: Longest step between two states that is interpolated: of the groundtruth, or of
            the estimate for `groundtruth-stamps`.
        time_offset_s: Added to the estimate's timestamps before pairing, seconds.
        model: Motion model of the groundtruth, for `continuous`.
        noise: Noise of the groundtruth's samples, for `continuous`.

    Raises:
        SettingsError: An unknown method or model, or a number out of range.

    Example:
        >>> from trajeval_ros import AssociationRule, Protocol
        >>> rule = AssociationRule("nearest", max_time_difference_s=0.01)
        >>> Protocol(association=rule).association.method
        'nearest'
    """

    method: str = AUTO
    max_time_difference_s: float = 0.02
    max_gap_s: float = 0.5
    time_offset_s: float = 0.0
    model: str = DEFAULT_MODEL
    noise: Noise = field(default_factory=Noise)

    def __post_init__(self) -> None:
        require_one_of(self.method, METHODS, "association")
        for name in ("max_time_difference_s", "max_gap_s"):
            if not 0.0 < getattr(self, name) <= _LONGEST_S:
                raise SettingsError(
                    f"{name.removesuffix('_s')} must be greater than 0 and at most "
                    f"{_LONGEST_S:.0f} s, not {getattr(self, name):g}"
                )
        require_one_of(self.model, MODELS, "continuous model")
        if not abs(self.time_offset_s) <= LATEST_CLOCK_S:
            raise SettingsError(
                f"the time offset must be within {LATEST_CLOCK_S:g} s, not {self.time_offset_s}"
            )

    def for_kind(self, kind: str) -> AssociationRule:
        """Return the rule for a kind of groundtruth (`Trajectory.kind`), with `auto` resolved.

        Rates are not used for the choice, because a live run does not have them at its start.
        """
        if self.method != AUTO:
            return self
        return dataclasses.replace(self, method="linear" if kind == "poses" else AT_GROUNDTRUTH)


@dataclass(frozen=True, eq=False)
class Association:
    """N pairs of states, and the number of states without a pair."""

    rule: AssociationRule
    groundtruth: Trajectory  # N groundtruth states at the timestamps of the pairs
    estimate: Trajectory  # N estimated states, in the estimate's frame
    # Share of the estimate's usable states that are in a pair; None for `groundtruth-stamps` and
    # for points, where it is not defined.
    estimate_coverage: float | None
    # Share of the groundtruth's time that the pairs cover. Groundtruth gaps do not count, except
    # for `continuous`, which pairs in gaps, too.
    coverage: Coverage
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
    frozen: tuple[Loss, ...] = ()  # times in which the estimate repeats its pose

    def __len__(self) -> int:
        return len(self.estimate)

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
        groundtruth_rows, rows = nearest_pairs(
            groundtruth, shifted, rule.method, rule.max_time_difference_s
        )
        paired = groundtruth[groundtruth_rows]
        unmatched = len(estimate) - _distinct(rows, len(estimate))
        dropped = {"no_groundtruth_within_max_time_difference": unmatched}
    if len(rows) == 0:
        raise NoMatchError(_why_no_match(groundtruth, shifted, rule, dropped))
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
    frozen, frozen_ns = ((), 0) if by_row else frozen_in(paired, pairs, max_gap_s=rule.max_gap_s)
    # Coverage counts a groundtruth state once, also if several pairs share it.
    once = (
        paired
        if groundtruth_rows is None
        else paired[np.unique(groundtruth_rows, return_index=True)[1]]
    )
    return Association(
        rule=rule,
        groundtruth=paired,
        estimate=dataclasses.replace(pairs, stamps=stamps),
        estimate_coverage=share,
        coverage=completed
        or coverage_of(
            groundtruth,
            once,
            rule.max_gap_s,
            in_gaps=rule.method == "continuous",
            frozen_ns=frozen_ns,
        ),
        dropped=add_counts(estimate.reading.dropped, dropped),
        continuous=continuous,
        groundtruth_rows=groundtruth_rows,
        from_the_start=bool(pairs.stamps[0] == shifted.stamps[0]),
        frozen=frozen,
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
    paired, bracket = groundtruth.at(estimate.stamps, rule.max_gap_s)
    return paired, np.flatnonzero(bracket.usable), bracket.dropped("groundtruth")


def _at_groundtruth(
    groundtruth: Trajectory, estimate: Trajectory, shifted: Trajectory, rule: AssociationRule
) -> Association:
    """Interpolate the estimate at the groundtruth's timestamps.

    Coverage is completeness: the share of the groundtruth's states that are in a pair.
    """
    groundtruth, states = groundtruth.in_order(), shifted.in_order()
    between, bracket = states.at(groundtruth.stamps, rule.max_gap_s)
    rows = np.flatnonzero(bracket.usable)
    dropped = bracket.dropped("estimate")
    if not len(rows):
        raise NoMatchError(_why_no_match(groundtruth, states, rule, dropped))
    meter = InterpolationMeter()
    meter.add(states.stamps, states.positions)
    frozen, _ = frozen_in(groundtruth[rows], between, of_fixes=True)
    return Association(
        rule=rule,
        groundtruth=groundtruth[rows],
        estimate=between,
        estimate_coverage=None,
        coverage=completeness(groundtruth, rows),
        dropped=add_counts(estimate.reading.dropped, dropped),
        groundtruth_rows=rows,
        interpolation=meter.interpolation if bracket.is_between else None,
        frozen=frozen,
    )


def _why_no_match(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule, dropped: dict[str, int]
) -> str:
    return explain_no_match(
        groundtruth, estimate, dropped, rule.max_gap_s, rule.max_time_difference_s
    )


def _distinct(rows: Indices, count: int) -> int:
    """Return the number of distinct indices in `rows`, which are below `count`."""
    named = np.zeros(count, dtype=bool)
    named[rows] = True
    return int(np.count_nonzero(named))
