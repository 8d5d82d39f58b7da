"""Association: which groundtruth belongs to which estimated state.

`linear` interpolates the groundtruth at the estimate's stamps, never across a gap and never
beyond its ends. `continuous` asks a model of the groundtruth's motion, also in gaps. `nearest`
pairs one to one, closest first. The other methods reproduce a tool or a benchmark: `rpg` and
`evo` by name, and `index` pairs by the number of the frame, or row by row.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.continuous_time.models import DEFAULT_MODEL, MODELS
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.exceptions import NoMatchError, SettingsError, require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory, add_counts
from trajeval_ros.metrics.coverage import Coverage, coverage_of
from trajeval_ros.metrics.evo_association import match
from trajeval_ros.metrics.frame_association import match_rows
from trajeval_ros.metrics.no_match import LATEST_CLOCK_S, explain_no_match

if TYPE_CHECKING:
    from trajeval_ros.continuous_time.continuous_trajectory import ContinuousTrajectory

_ROUNDS = 8
_LONGEST_S = 1e9  # of time differences and gaps; far below what nanoseconds in int64 can hold
METHODS = ("linear", "continuous", "nearest", "rpg", "evo", "index")


@dataclass(frozen=True)
class AssociationRule:
    """How pairs are made; a pair needs a groundtruth close in time.

    Attributes:
        method: One of `METHODS`.
        max_time_difference_s: Largest difference of stamps in a pair, for the nearest kinds.
        max_gap_s: Longest step between two groundtruth states to interpolate across.
        time_offset_s: Added to the estimate's stamps before pairing.
        model: For `continuous`: how the groundtruth moves between its samples.
        noise: For `continuous`: of the groundtruth's samples.

    Example:
        >>> from trajeval_ros import AssociationRule, Protocol
        >>> rule = AssociationRule("nearest", max_time_difference_s=0.01)
        >>> Protocol(association=rule).association.method
        'nearest'
    """

    method: str = "linear"
    max_time_difference_s: float = 0.02
    max_gap_s: float = 0.5
    time_offset_s: float = 0.0
    model: str = DEFAULT_MODEL
    noise: Noise = field(default_factory=Noise)

    def __post_init__(self) -> None:
        """Refuse what no rule can mean."""
        require_one_of(self.method, METHODS, "association")
        for name in ("max_time_difference_s", "max_gap_s"):
            if not 0.0 < getattr(self, name) <= _LONGEST_S:
                raise SettingsError(
                    f"{name} must be above 0 and at most {_LONGEST_S:g}, not {getattr(self, name)}"
                )
        require_one_of(self.model, MODELS, "continuous model")
        if not abs(self.time_offset_s) <= LATEST_CLOCK_S:
            raise SettingsError(
                f"the time offset must be within {LATEST_CLOCK_S:g} s, not {self.time_offset_s}"
            )


@dataclass(frozen=True, eq=False)
class Association:
    """Pairs of states, row by row, and what is left over.

    Attributes:
        rule: How they were made.
        groundtruth: N groundtruth states at the pairs' stamps.
        estimate: N estimated states, in their own frame.
        estimate_coverage: Share of the estimate's usable states that are in a pair.
        coverage: How much of the groundtruth's time pairs cover; its gaps are left out, except
            of method `continuous`, which pairs in them too.
        dropped: Number of estimated states that are in no pair, by reason.
        continuous: The groundtruth's model, of method `continuous`.
        groundtruth_rows: (N,) which groundtruth state is in each pair; None where it is none of
            the recorded ones, but one between them.
    """

    rule: AssociationRule
    groundtruth: Trajectory
    estimate: Trajectory
    estimate_coverage: float
    coverage: Coverage
    dropped: dict[str, int]
    continuous: ContinuousTrajectory | None = None
    groundtruth_rows: Indices | None = None

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.estimate)

    @property
    def groundtruth_coverage(self) -> float:
        """Share of the groundtruth's time in which the estimate was tracked."""
        return self.coverage.covered

    @property
    def have_rotations(self) -> bool:
        """Whether both sides have orientations."""
        return self.groundtruth.quaternions is not None and self.estimate.quaternions is not None


def associate(groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule) -> Association:
    """Pair the states of two trajectories by their stamps.

    Raises:
        NoMatchError: Nothing pairs; says both time ranges and the likely cause.
        InputError: Pairing by frame or row, but see `match_rows`.
    """
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
    elif rule.method == "continuous":
        from trajeval_ros.continuous_time.continuous_trajectory import fit_trajectory

        continuous = fit_trajectory(groundtruth.in_order(), rule.model, rule.noise)
        truth, rows, dropped = _modelled(groundtruth, shifted, continuous)
    else:
        truth_rows, rows = _NEAREST[rule.method](groundtruth, shifted, rule)
        truth = groundtruth[truth_rows]
        unmatched = len(estimate) - _distinct(rows, len(estimate))
        dropped = {"no_groundtruth_within_max_time_difference": unmatched}
    if len(rows) == 0:
        raise NoMatchError(explain_no_match(groundtruth, shifted, rule, dropped))
    pairs = shifted[rows]
    # A row of a file without stamps happened when its groundtruth did.
    stamps = truth.stamps if by_row and groundtruth.stamped else pairs.stamps
    truth = dataclasses.replace(truth, stamps=stamps)
    # A state that several pairs share is covered once.
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
    )


def _modelled(
    groundtruth: Trajectory, estimate: Trajectory, continuous: ContinuousTrajectory
) -> tuple[Trajectory, Indices, dict[str, int]]:
    """Take the most likely groundtruth poses at the estimate's stamps, gaps or not."""
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
    )
    return truth, rows, _outside(groundtruth.stamps, estimate.stamps)


def _outside(times: Indices, stamps: Indices) -> dict[str, int]:
    return {
        "before_groundtruth": int(np.count_nonzero(stamps < times.min())),
        "after_groundtruth": int(np.count_nonzero(stamps > times.max())),
    }


def _interpolated(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule
) -> tuple[Trajectory, Indices, dict[str, int]]:
    """Interpolate the groundtruth at the estimate's stamps, linearly and by slerp."""
    bracket = bracket_stamps(groundtruth.stamps, estimate.stamps, rule.max_gap_s)
    rows = np.flatnonzero(bracket.usable)
    start, end, fraction = bracket.start[rows], bracket.end[rows], bracket.fraction[rows]
    quaternions = groundtruth.quaternions
    positions = mix(groundtruth.positions, start, end, fraction)
    assert positions is not None
    truth = dataclasses.replace(
        groundtruth,
        stamps=estimate.stamps[rows],
        positions=positions,
        quaternions=None
        if quaternions is None
        else lie.normalized(lie.slerp(quaternions[start], quaternions[end], fraction)),
        velocities=mix(groundtruth.velocities, start, end, fraction),
        gyroscope_biases=mix(groundtruth.gyroscope_biases, start, end, fraction),
        accelerometer_biases=mix(groundtruth.accelerometer_biases, start, end, fraction),
        covariances=None,
        frames=None,
        matrices=None,
    )
    return truth, rows, bracket.dropped()


@dataclass(frozen=True, eq=False)
class Bracket:
    """Where each of N stamps lies between the stamps of a sorted trajectory.

    Attributes:
        start: (N,) index of the state at or before it.
        end: (N,) index of the state after it; equal to `start` on a state's very stamp.
        fraction: (N,) of the way from one to the other, in [0, 1].
        early: (N,) whether it lies before all states.
        late: (N,) whether it lies after all states.
        gap: (N,) whether it lies in a gap.
    """

    start: Indices
    end: Indices
    fraction: Floats
    early: Booleans
    late: Booleans
    gap: Booleans

    @property
    def usable(self) -> Booleans:
        """Whether there is a state on, or are states on both sides of, each stamp."""
        usable: Booleans = ~(self.early | self.late | self.gap)
        return usable

    def dropped(self) -> dict[str, int]:
        """Return how many stamps are not usable, by reason."""
        return {
            "before_groundtruth": int(np.count_nonzero(self.early)),
            "after_groundtruth": int(np.count_nonzero(self.late)),
            "in_groundtruth_gap": int(np.count_nonzero(self.gap)),
        }


def bracket_stamps(times: Indices, stamps: Indices, max_gap_s: float) -> Bracket:
    """Find each of the stamps (N,) between the sorted, distinct times of states (M,), M > 0."""
    end = np.minimum(times.searchsorted(stamps), len(times) - 1)
    at_end = times[end]
    # A stamp on a state's own takes that state alone, also at the first one.
    start = np.where(at_end == stamps, end, np.maximum(end - 1, 0))
    at_start = times[start]
    step = at_end - at_start
    early, late = stamps < times[0], stamps > times[-1]
    gap = (step > round(max_gap_s * NANOSECONDS)) & ~late
    fraction = np.where(early | late, 0.0, (stamps - at_start) / np.maximum(step, 1))
    return Bracket(start, end, fraction, early, late, gap)


def mix(
    column: Floats | None,
    start: Indices,
    end: Indices,
    fraction: Floats,
) -> Floats | None:
    """Return a column (M, k) interpolated linearly between its rows, (N, k)."""
    if column is None:
        return None
    mixed: Floats = column[start] + fraction[:, None] * (column[end] - column[start])
    return mixed


def _one_to_one(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule
) -> tuple[Indices, Indices]:
    """Pair greedily, closest first, each state once (TUM's and the authors' toolbox's rule).

    `rpg` leaves out the limit itself and compares stamps as the toolbox reads them.
    """
    limit = rule.max_time_difference_s
    truth_times: NDArray[Any] = groundtruth.stamps
    times: NDArray[Any] = estimate.stamps
    reach: float = round(limit * NANOSECONDS)
    if rule.method == "rpg":
        truth_times, times, reach = _float_seconds(truth_times), _float_seconds(times), limit
    truth_order = np.argsort(truth_times, kind="stable")
    in_order = truth_times[truth_order]
    low = np.searchsorted(in_order, times - reach, side="left")
    count = np.searchsorted(in_order, times + reach, side="right") - low
    row = np.repeat(np.arange(len(count)), count)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    truth = truth_order[low[row] + place]
    difference = np.abs(truth_times[truth] - times[row])
    if rule.method == "rpg":
        close = difference < limit
        row, truth, difference = row[close], truth[close], difference[close]
    order = np.lexsort((truth, row, difference))
    row, truth = row[order], truth[order]
    taken_row: Indices = np.full(len(estimate), -1, dtype=np.int64)
    taken_truth = np.zeros(len(groundtruth), dtype=bool)
    # A pair that comes first for both of its states is accepted, which rules out all others of
    # these states; what is left has new first pairs. A few rounds settle usual recordings ...
    for _ in range(_ROUNDS):
        if not len(row):
            break
        rank = np.arange(len(row))
        first_of_row = np.full(len(estimate), len(row))
        first_of_truth = np.full(len(groundtruth), len(row))
        np.minimum.at(first_of_row, row, rank)
        np.minimum.at(first_of_truth, truth, rank)
        both = (first_of_row[row] == rank) & (first_of_truth[truth] == rank)
        taken_row[row[both]] = truth[both]
        taken_truth[truth[both]] = True
        free = (taken_row[row] < 0) & ~taken_truth[truth]
        row, truth = row[free], truth[free]
    # ... and chains of rivals, such as equal rates half a period apart, go one by one.
    for one, other in zip(row.tolist(), truth.tolist(), strict=True):
        if taken_row[one] < 0 and not taken_truth[other]:
            taken_row[one] = other
            taken_truth[other] = True
    rows = np.flatnonzero(taken_row >= 0)
    return taken_row[rows], rows


def _evo(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule
) -> tuple[Indices, Indices]:
    """Pair as evo does: each state of the shorter trajectory with the other's nearest one.

    Stamps are compared as evo reads them.
    """
    driven_by_truth = len(groundtruth) < len(estimate)
    short, long = (groundtruth, estimate) if driven_by_truth else (estimate, groundtruth)
    short_rows, long_rows = match(
        _float_seconds(short.stamps), _float_seconds(long.stamps), rule.max_time_difference_s
    )
    return (short_rows, long_rows) if driven_by_truth else (long_rows, short_rows)


_NEAREST = {"nearest": _one_to_one, "rpg": _one_to_one, "evo": _evo}


def _float_seconds(stamps: Indices) -> Floats:
    """Return stamps as the tools to be reproduced read them, seconds to 2.4e-7.

    A difference at the very limit then falls to the same side as theirs.
    """
    seconds: Floats = stamps // NANOSECONDS + (stamps % NANOSECONDS) / NANOSECONDS
    return seconds


def _distinct(rows: Indices, count: int) -> int:
    """Return how many different ones of `count` rows are named."""
    named = np.zeros(count, dtype=bool)
    named[rows] = True
    return int(np.count_nonzero(named))
