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
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.continuous_time.models import DEFAULT_MODEL, MODELS
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.exceptions import NoMatchError, SettingsError, require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.geometry.dropped_counts import add_counts
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.bracket import between, bracket_stamps
from trajeval_ros.metrics.completeness import completeness
from trajeval_ros.metrics.coverage import Coverage, coverage_of
from trajeval_ros.metrics.frame_association import match_rows
from trajeval_ros.metrics.interpolation import Interpolation, InterpolationMeter
from trajeval_ros.metrics.nearest_association import nearest_pairs
from trajeval_ros.metrics.no_match import LATEST_CLOCK_S, explain_no_match

if TYPE_CHECKING:
    from trajeval_ros.continuous_time.continuous_trajectory import ContinuousTrajectory

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
        """Refuse unknown names and numbers out of range."""
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
    """N pairs of states, and the number of states without a pair.

    Attributes:
        rule: The settings of the association.
        groundtruth: N groundtruth states at the timestamps of the pairs.
        estimate: N estimated states, in the estimate's frame.
        estimate_coverage: Share of the estimate's usable states that are in a pair; None for
            `groundtruth-stamps`, where it is not defined.
        coverage: Share of the groundtruth's time that the pairs cover. Groundtruth gaps do not
            count, except for `continuous`, which pairs in gaps, too.
        dropped: Number of states without a pair by reason: of the estimate, or of the groundtruth
            for `groundtruth-stamps`.
        continuous: The groundtruth's model, for `continuous`; else None.
        groundtruth_rows: (N,) index of the groundtruth state of every pair; None if the
            groundtruth was interpolated.
        from_the_start: Whether the first pair has the first estimated state.
        interpolation: Of the estimate, for `groundtruth-stamps`; None if no pair is between two of
            its states.
    """

    rule: AssociationRule
    groundtruth: Trajectory
    estimate: Trajectory
    estimate_coverage: float | None
    coverage: Coverage
    dropped: dict[str, int]
    continuous: ContinuousTrajectory | None = None
    groundtruth_rows: Indices | None = None
    from_the_start: bool = True
    interpolation: Interpolation | None = None

    def __len__(self) -> int:
        """Return the number of pairs."""
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
    def is_at_groundtruth(self) -> bool:
        """Whether pairs are at the groundtruth's timestamps; coverage then counts its states."""
        return self.rule.method == AT_GROUNDTRUTH


def associate(groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule) -> Association:
    """Pair the states of two trajectories.

    Args:
        groundtruth: M states.
        estimate: States in their own frame.
        rule: The settings.

    Raises:
        NoMatchError: There is no pair; the message has both time ranges and the likely cause.
        InputError: A trajectory has no usable state, or rows cannot be paired (`match_rows`).
    """
    rule = rule.for_kind(groundtruth.kind)
    groundtruth.require_usable()
    estimate.require_usable()
    offset = round(rule.time_offset_s * NANOSECONDS)
    shifted = dataclasses.replace(estimate, stamps=estimate.stamps + offset)
    continuous = truth_rows = None
    by_row = rule.method == "index" or not (groundtruth.stamped and estimate.stamped)
    if by_row:
        rule = dataclasses.replace(rule, method="index")
        truth_rows, rows, dropped = match_rows(groundtruth, estimate)
        truth = groundtruth[truth_rows]
    elif rule.method == "linear":
        truth, rows, dropped = _interpolated(groundtruth.in_order(), shifted, rule)
    elif rule.method == AT_GROUNDTRUTH:
        return _at_groundtruth(groundtruth, estimate, shifted, rule)
    elif rule.method == "continuous":
        from trajeval_ros.continuous_time.continuous_trajectory import fit_trajectory

        continuous = fit_trajectory(groundtruth.in_order(), rule.model, rule.noise)
        truth, rows, dropped = _modelled(groundtruth, shifted, continuous)
    else:
        truth_rows, rows = nearest_pairs(groundtruth, shifted, rule)
        truth = groundtruth[truth_rows]
        unmatched = len(estimate) - _distinct(rows, len(estimate))
        dropped = {"no_groundtruth_within_max_time_difference": unmatched}
    if len(rows) == 0:
        raise NoMatchError(explain_no_match(groundtruth, shifted, rule, dropped))
    pairs = shifted[rows]
    # Without timestamps in the estimate, a pair has the groundtruth's.
    stamps = truth.stamps if by_row and groundtruth.stamped else pairs.stamps
    truth = dataclasses.replace(truth, stamps=stamps)
    # Coverage counts a groundtruth state once, also if several pairs share it.
    once = truth if truth_rows is None else truth[np.unique(truth_rows, return_index=True)[1]]
    return Association(
        rule=rule,
        groundtruth=truth,
        estimate=dataclasses.replace(pairs, stamps=stamps),
        estimate_coverage=_distinct(rows, len(estimate)) / len(estimate),
        coverage=coverage_of(
            groundtruth, once, rule.max_gap_s, in_gaps=rule.method == "continuous"
        ),
        dropped=add_counts(estimate.dropped, dropped),
        continuous=continuous,
        groundtruth_rows=truth_rows,
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
    truth = dataclasses.replace(
        groundtruth,
        stamps=stamps,
        positions=np.ascontiguousarray(poses[:, :3, 3]),
        quaternions=lie.from_matrices(poses[:, :3, :3]) if oriented else None,
        velocities=None,
        gyroscope_biases=None,
        accelerometer_biases=None,
        covariances=None,
        frames=None,
        matrices=None,
        fixes=None,
    )
    return truth, rows, _outside(groundtruth.stamps, estimate.stamps)


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
    bracket = bracket_stamps(groundtruth.stamps, estimate.stamps, rule.max_gap_s)
    rows = np.flatnonzero(bracket.usable)
    return between(groundtruth, estimate.stamps, bracket), rows, bracket.dropped("groundtruth")


def _at_groundtruth(
    groundtruth: Trajectory, estimate: Trajectory, shifted: Trajectory, rule: AssociationRule
) -> Association:
    """Interpolate the estimate at the groundtruth's timestamps.

    Coverage is completeness: the share of the groundtruth's states that are in a pair.
    """
    truth, states = groundtruth.in_order(), shifted.in_order()
    bracket = bracket_stamps(states.stamps, truth.stamps, rule.max_gap_s)
    rows = np.flatnonzero(bracket.usable)
    dropped = bracket.dropped("estimate")
    if not len(rows):
        raise NoMatchError(explain_no_match(truth, states, rule, dropped))
    meter = InterpolationMeter()
    meter.add(states.stamps, states.positions)
    return Association(
        rule=rule,
        groundtruth=truth[rows],
        estimate=between(states, truth.stamps, bracket),
        estimate_coverage=None,
        coverage=completeness(truth, rows),
        dropped=add_counts(estimate.dropped, dropped),
        groundtruth_rows=rows,
        interpolation=meter.found if bracket.is_between else None,
    )


def _distinct(rows: Indices, count: int) -> int:
    """Return the number of distinct indices in `rows`, which are below `count`."""
    named = np.zeros(count, dtype=bool)
    named[rows] = True
    return int(np.count_nonzero(named))
