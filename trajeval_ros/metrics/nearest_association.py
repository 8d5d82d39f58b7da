"""Associations by nearest timestamps: one to one, and the rules of rpg and evo."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.other_programs import match_as_evo

_ROUNDS = 8


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


def nearest_pairs(
    groundtruth: Trajectory, estimate: Trajectory, method: str, limit_s: float
) -> tuple[Indices, Indices]:
    """Return the paired rows (K,) of groundtruth and estimate, which can be in any order.

    `method` is `nearest`, `rpg` or `evo`; `limit_s` is the largest time difference in a pair.
    """
    if method == "evo":
        return _evo(groundtruth, estimate, limit_s)
    return _one_to_one(groundtruth, estimate, limit_s, is_rpg=method == "rpg")


def _float_seconds(stamps: Indices) -> Floats:
    """Return timestamps in float64 seconds, as rpg and evo read them; resolution 2.4e-7 s.

    A difference equal to the limit is then rounded as in these tools.
    """
    seconds: Floats = stamps // NANOSECONDS + (stamps % NANOSECONDS) / NANOSECONDS
    return seconds
