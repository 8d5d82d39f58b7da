"""Arithmetic of other programs: evo's association and pose relations, KITTI's frames and matrices.

* evo 1.38 bisects sorted timestamps and scans unsorted ones. The results differ if several
  timestamps are equally near.
* KITTI's files have few digits. Its devkit inverts and multiplies matrices that are not quite
  rotations without correction, which changes small angles. With 6 digits on KITTI 00, the smallest
  changes by 9 %, the mean by 0.003 %.
* evo's pose relations: with a position error dp and a rotation error E of angle a, the error of a
  pose is the 4 x 4 matrix [E dp; 0 1]. `full` is its Frobenius distance from the identity.
  `rotation_part` is that of E alone, the chord 2 sqrt(2) sin(a / 2). Both have no unit: `full`
  adds squared metres and squared chords.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices, lengths
from trajeval_ros.geometry.source_info import FRAMES_FROM_1
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.statistics import Statistics, statistics_of


def match_as_evo(short_s: Floats, long_s: Floats, limit_s: float) -> tuple[Indices, Indices]:
    """Return pairs of rows: every timestamp of the shorter trajectory with the nearest other one.

    Seconds (N,) of the trajectory with fewer states and (M,) of the other, M > 0; `limit_s` is
    inclusive. Returned are rows of `short_s` (K,), increasing, and the paired rows of `long_s`, in
    which a row can occur several times.
    """
    if (np.diff(long_s) >= 0.0).all():
        return _bisect(short_s, long_s, limit_s)
    return _scan(short_s, long_s, limit_s)


def _bisect(short_s: Floats, long_s: Floats, limit_s: float) -> tuple[Indices, Indices]:
    """Bisect: the last of equal timestamps; the earlier of two equally near ones."""
    last = len(long_s) - 1
    # On or after the last timestamp, the two candidates are the last two rows. If the last
    # timestamp is repeated, evo therefore takes the last row but one.
    upper = np.minimum(np.searchsorted(long_s, short_s, side="right"), last)
    to_upper = long_s[upper] - short_s
    to_lower = np.where(upper > 0, short_s - long_s[upper - 1], np.inf)
    in_range = (short_s >= long_s[0] - limit_s) & (short_s <= long_s[last] + limit_s)
    take_upper = in_range & (to_upper <= limit_s) & (to_upper < to_lower)
    take_lower = in_range & (to_lower <= limit_s) & (to_lower <= to_upper)
    rows = np.flatnonzero(take_upper | take_lower)
    return rows, np.where(take_upper, upper, upper - 1)[rows]


def _scan(short_s: Floats, long_s: Floats, limit_s: float) -> tuple[Indices, Indices]:
    """Scan in file order: of equally near timestamps, the first row."""
    order = np.argsort(long_s, kind="stable")  # equal stamps stay in file order
    in_order = long_s[order]
    after = np.minimum(np.searchsorted(in_order, short_s), len(in_order) - 1)
    before = np.searchsorted(in_order, in_order[np.maximum(after - 1, 0)])
    to_after, to_before = (np.abs(in_order[rows] - short_s) for rows in (after, before))
    after, before = order[after], order[before]
    nearest = np.where(to_after < to_before, after, before)
    nearest = np.where(to_after == to_before, np.minimum(after, before), nearest)
    rows = np.flatnonzero(np.minimum(to_after, to_before) <= limit_s)
    return rows, nearest[rows]


def match_frames(
    groundtruth: Trajectory, estimate: Trajectory
) -> tuple[Indices, Indices, dict[str, int]]:
    """Return the paired rows of both sides, (K,) each, and the number of estimates without a pair.

    Frames are paired by number if a file has numbers, or if both files have a row for every frame.
    Otherwise rows are paired in order.
    """
    true_frames, frames = groundtruth.reading.frame_numbers, estimate.reading.frame_numbers
    numbered = groundtruth.reading.numbered or estimate.reading.numbered
    as_long = _rows_of(groundtruth) == _rows_of(estimate)
    if true_frames is None or frames is None or not (numbered or as_long):
        if len(groundtruth) == len(estimate):
            rows = np.arange(len(estimate))
            return rows, rows, {}
        advice = (
            "give times (--frame-rate, NAME_times.txt or, in Python, seconds=), or the frame "
            "number as the first of 13 columns"
        )
        if groundtruth.reading.stamped and estimate.reading.stamped:
            advice = "pair them by time with --association linear"
        raise InputError(
            f"{groundtruth.name or 'the groundtruth'} has {counted(len(groundtruth), 'pose')}, "
            f"{estimate.name or 'the estimate'} has {len(estimate)}, which cannot be paired by "
            f"row; {advice}"
        )
    for side, numbers in ((groundtruth, frames), (estimate, true_frames)):
        _require_order(side)
        doubts = [remark.text for remark in side.reading.remarks if remark.code == FRAMES_FROM_1]
        if doubts and numbers.min(initial=1) == 0:
            raise InputError(f"{side.name}, and the other side's at 0: {doubts[0]}")
    _, groundtruth_rows, rows = np.intersect1d(
        true_frames, frames, assume_unique=True, return_indices=True
    )
    return groundtruth_rows, rows, {"no_groundtruth_of_this_frame": len(estimate) - len(rows)}


def _rows_of(trajectory: Trajectory) -> int:
    """Return the number of rows in the file, including those without a pose."""
    return len(trajectory) + sum(trajectory.reading.dropped.values())


def _require_order(side: Trajectory) -> None:
    frames = side.reading.frame_numbers
    assert frames is not None
    wrong = np.flatnonzero(np.diff(frames) <= 0)
    if len(wrong):
        before, after = frames[wrong[0] : wrong[0] + 2]
        raise InputError(
            f"{side.name or 'a trajectory'} has frame {after} after frame {before}; sort the "
            "rows by frame and remove duplicates"
        )


def by_matrices(
    groundtruth: Trajectory, estimate: Trajectory, starts: Indices, ends: Indices, scale: float
) -> tuple[Floats, Floats]:
    """Return position errors, metres, and rotation errors, degrees, (K,) each.

    With poses T_i of the groundtruth and T'_i of the scaled estimate, the error from s to e is
    (T'_s^-1 T'_e)^-1 T_s^-1 T_e. The position error is the length of its translation, the rotation
    error the arc cosine of (trace - 1) / 2. Both sides have matrices or, without them,
    orientations.
    """
    true_turn, true_step = _steps(groundtruth, starts, ends)
    rotation, step = _steps(estimate, starts, ends)
    back = np.linalg.inv(rotation)
    error = back @ true_turn
    cosine = 0.5 * (np.trace(error, axis1=1, axis2=2) - 1.0)
    difference = np.einsum("nij,nj->ni", back, true_step - scale * step)
    return lengths(difference), np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _steps(trajectory: Trajectory, starts: Indices, ends: Indices) -> tuple[Floats, Floats]:
    """Return rotations (K, 3, 3) and translations (K, 3) from start to end, in start's frame."""
    inverse = np.linalg.inv(_matrices(trajectory, starts))
    moved = trajectory.positions[ends] - trajectory.positions[starts]
    return inverse @ _matrices(trajectory, ends), np.einsum("nij,nj->ni", inverse, moved)


def _matrices(trajectory: Trajectory, rows: Indices) -> Floats:
    if trajectory.reading.matrices is not None:
        return trajectory.reading.matrices[rows]
    assert trajectory.quaternions is not None
    return lie.to_matrix(trajectory.quaternions[rows])


def pose_errors(position_m: Floats, rotation_deg: Floats | None) -> dict[str, Statistics | None]:
    """Return statistics of `rotation_part` and `full` from errors (N,); None without angles."""
    if rotation_deg is None:
        return {"rotation_part": None, "full": None}
    chord = np.sqrt(8.0) * np.sin(np.radians(rotation_deg) / 2.0)
    return {
        "rotation_part": statistics_of(chord),
        "full": statistics_of(np.hypot(position_m, chord)),
    }


def distance_errors(
    groundtruth: Floats, estimate: Floats, starts: Indices, ends: Indices, scale: float
) -> dict[str, Statistics | None]:
    """Return statistics of the errors of distances between first and last states.

    `distance_m` is | |p_e - p_s| - |p'_e - p'_s| |, from positions (N, 3). `distance_percent` is
    relative to the groundtruth's distance, without sub-trajectories that end where they start.
    Neither needs an alignment (except its scale) or orientations.
    """
    true = np.linalg.norm(groundtruth[ends] - groundtruth[starts], axis=1)
    error = np.abs(true - scale * np.linalg.norm(estimate[ends] - estimate[starts], axis=1))
    moved = true > 0.0
    return {
        "distance_m": statistics_of(error),
        "distance_percent": statistics_of(100.0 * error[moved] / true[moved]),
    }
