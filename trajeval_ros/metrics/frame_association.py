"""Pairs without timestamps: by frame number, as in KITTI's files, or row by row."""

from __future__ import annotations

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.geometry.trajectory import Trajectory


def match_rows(
    groundtruth: Trajectory, estimate: Trajectory
) -> tuple[Indices, Indices, dict[str, int]]:
    """Return the paired rows of both sides, (K,) each, and the number of estimates without a pair.

    Frames are paired by number if a file has numbers, or if both files have a row for every frame.
    Otherwise rows are paired in order.

    Raises:
        InputError: Frame numbers are not increasing, or the files have different numbers of rows.
    """
    truth, other = groundtruth.frames, estimate.frames
    numbered = groundtruth.numbered or estimate.numbered
    as_long = _rows_of(groundtruth) == _rows_of(estimate)
    if truth is None or other is None or not (numbered or as_long):
        if len(groundtruth) == len(estimate):
            rows = np.arange(len(estimate))
            return rows, rows, {}
        raise InputError(
            f"{groundtruth.name or 'the groundtruth'} has {counted(len(groundtruth), 'pose')}, "
            f"{estimate.name or 'the estimate'} has {len(estimate)}, without timestamps; give "
            "files of equal length, with timestamps, or KITTI files with the frame number as "
            "the first of 13 columns"
        )
    for side in (groundtruth, estimate):
        _require_order(side)
    _, truth_rows, rows = np.intersect1d(truth, other, assume_unique=True, return_indices=True)
    return truth_rows, rows, {"no_groundtruth_of_this_frame": len(estimate) - len(rows)}


def _rows_of(trajectory: Trajectory) -> int:
    """Return the number of rows in the file, including those without a pose."""
    return len(trajectory) + sum(trajectory.dropped.values())


def _require_order(side: Trajectory) -> None:
    assert side.frames is not None
    wrong = np.flatnonzero(np.diff(side.frames) <= 0)
    if len(wrong):
        before, after = side.frames[wrong[0] : wrong[0] + 2]
        raise InputError(
            f"{side.name or 'a trajectory'} has frame {after} after frame {before}; sort the "
            "rows by frame and remove duplicates"
        )
