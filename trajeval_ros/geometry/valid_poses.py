"""Usable poses, contradictions between repeated timestamps, and counts of dropped poses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, lengths

# Largest position or velocity, m or m/s. No robot exceeds it, and its square is representable.
LARGEST = 1e12
_SHORTEST = 1e-6  # least length of a quaternion
# Largest error of the squared length of a normalised quaternion, from rounding.
_ROUNDING = 8.0 * float(np.finfo(np.float64).eps)


def valid_mask(positions: Floats, quaternions: Floats | None = None) -> tuple[Booleans, Booleans]:
    """Return which rows are finite, (N,), and which have a quaternion of non-zero length, (N,).

    A diverged estimate can have finite numbers whose squares overflow; they count as infinite.
    `positions`: (N, 3), metres. `quaternions`: (N, 4), or None.
    """

    def finite_at(rows: Floats) -> tuple[Booleans]:
        return (np.logical_and.reduce(np.abs(rows) <= LARGEST, axis=1),)

    finite: Booleans = lie.by_blocks(finite_at, positions)[0]
    if quaternions is None:
        return finite, np.ones(len(positions), dtype=bool)
    with np.errstate(over="ignore", invalid="ignore"):
        squared_length = np.einsum("ni,ni->n", quaternions, quaternions)
    finite &= np.isfinite(squared_length)
    return finite, squared_length > _SHORTEST**2


def at_length_one(quaternions: Floats) -> Floats:
    """Return quaternions (N, 4) scaled to length 1, unchanged if they have this length already.

    Written quaternions are therefore read back without a change of digits.
    """

    def at(rows: Floats) -> tuple[Floats]:
        excess = np.abs(np.einsum("ni,ni->n", rows, rows) - 1.0)
        return (np.where((excess <= _ROUNDING)[:, None], rows, lie.normalized(rows)),)

    return lie.by_blocks(at, quaternions)[0]


_STEPS = 3.0  # multiple of the median step that noise explains for a body nearly at rest


class Conflicts(NamedTuple):
    """States that share a timestamp with another state at a different position."""

    number: int  # number of such states
    largest_m: float  # their largest distance from the first state of the timestamp, metres


def conflicts_of(stamps: NDArray[np.int64], positions: Floats) -> Conflicts:
    """Compare states of equal timestamps with the first one of that timestamp.

    Rounded timestamps repeat, too, but their positions are between those of the neighbouring
    states. Positions conflict if they are farther apart than the neighbours are, and than three
    median steps, which allows for the noise of a body at rest. `stamps`: (N,) sorted, nanoseconds.
    `positions`: (N, 3), metres.
    """
    is_first = np.concatenate([[True], np.diff(stamps) > 0])
    repeats = np.flatnonzero(~is_first)
    firsts = np.flatnonzero(is_first)
    if not len(repeats):
        return Conflicts(0, 0.0)
    distinct = positions[firsts]
    group = np.cumsum(is_first)[repeats] - 1
    apart_m = _lengths(positions[repeats] - distinct[group])
    before, after = np.maximum(group - 1, 0), np.minimum(group + 1, len(firsts) - 1)
    steps_m = _lengths(np.diff(distinct, axis=0))
    usual_m = float(np.median(steps_m)) if len(steps_m) else 0.0
    passed_m = _lengths(distinct[after] - distinct[before])
    conflict = apart_m > np.maximum(passed_m, _STEPS * usual_m)
    return Conflicts(int(np.count_nonzero(conflict)), float(apart_m[conflict].max(initial=0.0)))


def _lengths(vectors: Floats) -> Floats:
    # Positions that are not finite are refused later, where the states are used.
    with np.errstate(over="ignore", invalid="ignore"):
        return lengths(vectors)


# Reasons for dropping what is no state of its own; coverage does not count it.
NO_STATE = (
    "duplicate_stamp",
    "lone_stamp",
    "not_finite",
    "undecodable",
    # of PX4's messages
    *("no_position", "no_orientation", "unknown_frame", "other_frame"),
    *("xy_valid_false", "z_valid_false", "no_attitude_within_0.1_s"),
    "zero_quaternion",
    "zero_stamp",
    # of graphs and JSON lines
    *("other_vertex_type", "no_position_or_not_tracking"),
)


# Share of unusable poses from which on users are warned, live and in results.
MOST_UNUSABLE = 0.05


def count_up(counts: dict[str, int], reason: str, count: int) -> None:
    """Add to the count of a reason; a count of zero adds no key."""
    if count:
        counts[reason] = counts.get(reason, 0) + count


def add_counts(*counts: Mapping[str, int]) -> dict[str, int]:
    """Return the sums of counts by reason, without zeros."""
    total: dict[str, int] = {}
    for part in counts:
        for reason, count in part.items():
            count_up(total, reason, count)
    return total


# Reasons that their names do not state.
_REASONS = {
    "no_groundtruth_within_max_time_difference": "beyond the largest time difference to "
    "groundtruth",
    "no_estimate_within_max_time_difference": "without an estimate within the largest time "
    "difference",
    "no_groundtruth_of_this_frame": "in frames without groundtruth",
    "before_groundtruth": "before the groundtruth",
    "after_groundtruth": "after the groundtruth",
    "in_groundtruth_gap": "in a groundtruth gap",
    "before_estimate": "before the estimate",
    "after_estimate": "after the estimate",
    "in_estimate_gap": "in an estimate gap",
    "duplicate_stamp": "with a duplicate timestamp",
    "lone_stamp": "with an isolated timestamp",
    "zero_stamp": "with timestamp zero",
    "zero_quaternion": "with a zero quaternion",
    "undecodable": "that can't be decoded",
}


# In every text of `dropped_in_words`, and in no other.
POSES_DROPPED = "poses dropped: "
GROUNDTRUTH_DROPPED = "groundtruth poses were dropped: "

# Reasons that are no damage of the source: repeated poses, and poses that it marks as invalid.
_MARKED = (
    *("duplicate_stamp", "no_position_or_not_tracking"),
    *("no_position", "no_orientation", "unknown_frame", "other_frame"),
    *("xy_valid_false", "z_valid_false", "no_attitude_within_0.1_s"),
)


def dropped_in_words(dropped: Mapping[str, int], kept: int, *, all_reasons: bool = True) -> str:
    """Return the number of poses that a reader dropped as text, or "" without any.

    Args:
        dropped: Counts by reason.
        kept: Number of poses that are left.
        all_reasons: Whether to count poses that the source repeats or marks as invalid.
    """
    counted = {
        reason: count
        for reason, count in dropped.items()
        if reason in NO_STATE and (all_reasons or reason not in _MARKED)
    }
    lost = sum(counted.values())
    return f"{lost} of {lost + kept} {POSES_DROPPED}{reasons(counted)}" if lost else ""


def reasons(dropped: Mapping[str, int]) -> str:
    """Return counts by reason as text: "3 not finite, 12 before the groundtruth"."""
    return ", ".join(f"{count} {in_words(reason)}" for reason, count in dropped.items())


def in_words(reason: str) -> str:
    """Return a reason for dropping a pose as text."""
    return _REASONS.get(reason, reason.replace("_", " "))
