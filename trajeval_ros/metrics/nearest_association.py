"""Associations by nearest timestamps: one to one, and the rules of rpg and evo."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.evo_association import match

if TYPE_CHECKING:
    from trajeval_ros.metrics.association import AssociationRule


_ROUNDS = 8


def _one_to_one(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule
) -> tuple[Indices, Indices]:
    """Pair greedily, closest first, every state at most once (rule of TUM and of rpg's toolbox).

    `rpg` excludes the limit itself and compares timestamps as the toolbox reads them.
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
    # A pair that is the closest one of both of its states is accepted, and all other pairs of
    # these states are removed. Then other pairs are the closest. A few rounds are usually enough.
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
    # Long chains of competing pairs, such as equal rates half a period apart, go one by one.
    for one, other in zip(row.tolist(), truth.tolist(), strict=True):
        if taken_row[one] < 0 and not taken_truth[other]:
            taken_row[one] = other
            taken_truth[other] = True
    rows = np.flatnonzero(taken_row >= 0)
    return taken_row[rows], rows


def _evo(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule
) -> tuple[Indices, Indices]:
    """Pair as evo does: every state of the shorter trajectory with the nearest of the other.

    Timestamps are compared as evo reads them.
    """
    driven_by_truth = len(groundtruth) < len(estimate)
    short, long = (groundtruth, estimate) if driven_by_truth else (estimate, groundtruth)
    short_rows, long_rows = match(
        _float_seconds(short.stamps), _float_seconds(long.stamps), rule.max_time_difference_s
    )
    return (short_rows, long_rows) if driven_by_truth else (long_rows, short_rows)


def nearest_pairs(
    groundtruth: Trajectory, estimate: Trajectory, rule: AssociationRule
) -> tuple[Indices, Indices]:
    """Return the paired rows (K,) of groundtruth and estimate for `nearest`, `rpg` or `evo`."""
    pair = _evo if rule.method == "evo" else _one_to_one
    return pair(groundtruth, estimate, rule)


def _float_seconds(stamps: Indices) -> Floats:
    """Return timestamps in float64 seconds, as rpg and evo read them; resolution 2.4e-7 s.

    A difference equal to the limit is then rounded as in these tools.
    """
    seconds: Floats = stamps // NANOSECONDS + (stamps % NANOSECONDS) / NANOSECONDS
    return seconds
