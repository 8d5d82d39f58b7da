"""Mistakes that users make: each takes a right pair and returns a wrong one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.diagnosis_runs import Array, Pair
from trajeval_ros.formatting.remarks import note
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.source_info import FORMAT, SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory

Make = Callable[[Pair], Pair]
CAMERA = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Mistake:
    """How a pair is spoilt, and what it should be called.

    Attributes:
        make: Spoils a pair.
        causes: Names that are right.
        only: Kinds of runs that can show it: "" for all, "yaw" where that is the gauge.
    """

    make: Make
    causes: tuple[str, ...]
    only: str = ""

    def applies(self, pair: Pair) -> bool:
        """Return whether the mistake can be made with a pair, and be seen."""
        if self.only == "yaw":
            return pair.gauge is Gauge.YAW
        if self.only == "vehicle":
            return pair.name.startswith(("car", "robot"))  # KITTI files have an up axis
        return True


def change(pair: Pair, side: str, **columns: object) -> Pair:
    """Return a pair with other columns on a side."""
    changed = dataclasses.replace(getattr(pair, side), **columns)
    return dataclasses.replace(pair, **{side: changed})


def quaternions_of(trajectory: Trajectory) -> Array:
    """Return the orientations (N, 4), which all recordings here have."""
    assert trajectory.quaternions is not None
    return trajectory.quaternions


def scaled(side: str, factor: float) -> Make:
    """Return what multiplies positions."""
    return lambda pair: change(pair, side, positions=factor * getattr(pair, side).positions)


def w_first(*sides: str) -> Make:
    """Return what takes w, x, y, z for x, y, z, w."""

    def make(pair: Pair) -> Pair:
        for side in sides:
            q = np.ascontiguousarray(quaternions_of(getattr(pair, side))[:, [3, 0, 1, 2]])
            pair = change(pair, side, quaternions=q)
        return pair

    return make


def w_last(*sides: str) -> Make:
    """Return what takes x, y, z, w for w, x, y, z."""

    def make(pair: Pair) -> Pair:
        for side in sides:
            q = np.ascontiguousarray(quaternions_of(getattr(pair, side))[:, [1, 2, 3, 0]])
            pair = change(pair, side, quaternions=q)
        return pair

    return make


def mirrored(pair: Pair) -> Pair:
    """Flip y of positions and rotations, as a left-handed engine does."""
    one = pair.estimate
    return change(
        pair,
        "estimate",
        positions=one.positions * [1.0, -1.0, 1.0],
        quaternions=quaternions_of(one) * [-1.0, 1.0, -1.0, 1.0],
    )


def inverse(side: str) -> Make:
    """Return what writes poses of the world in the body."""

    def make(pair: Pair) -> Pair:
        one = getattr(pair, side)
        q = lie.conjugate(quaternions_of(one))
        return change(pair, side, positions=-lie.rotate(q, one.positions), quaternions=q)

    return make


def transposed(pair: Pair) -> Pair:
    """Invert rotations alone."""
    return change(pair, "estimate", quaternions=lie.conjugate(quaternions_of(pair.estimate)))


def shifted(seconds: float) -> Make:
    """Return what sets a clock."""
    return lambda pair: change(
        pair, "estimate", stamps=pair.estimate.stamps + round(1e9 * seconds)
    )


def fast_clock(pair: Pair) -> Pair:
    """Let the estimate's clock gain 1000 ppm."""
    stamps = pair.estimate.stamps
    return change(pair, "estimate", stamps=stamps + (stamps - stamps[0]) // 1000)


def whole_seconds(pair: Pair) -> Pair:
    """Cut stamps to seconds."""
    return change(pair, "estimate", stamps=pair.estimate.stamps // 10**9 * 10**9)


def duplicated(pair: Pair) -> Pair:
    """Append an eighth of the log a second time, stamped anew."""
    one, count = pair.estimate, len(pair.estimate)
    start, length = count // 3, count // 8
    rows = np.concatenate([np.arange(start + length), np.arange(start, count)])
    stamps = one.stamps[rows].copy()
    stamps[start + length :] += one.stamps[start + length] - one.stamps[start]
    return dataclasses.replace(pair, estimate=dataclasses.replace(one[rows], stamps=stamps))


def held(pair: Pair) -> Pair:
    """Repeat each pose of a groundtruth of 2 Hz at the rate of the file."""
    stamps = pair.truth.stamps
    slow = (stamps - stamps[0]) // 500_000_000 * 500_000_000 + stamps[0]
    rows = np.minimum(np.searchsorted(stamps, slow), len(stamps) - 1)
    return dataclasses.replace(pair, truth=dataclasses.replace(pair.truth[rows], stamps=stamps))


def _bend(pair: Pair, seconds: float) -> slice:
    """Return the groundtruth's rows of a stretch, in the middle, over which it bends the most."""
    truth, estimate = pair.truth, pair.estimate
    begin = max(int(truth.stamps[0]), int(estimate.stamps[0]))
    end = min(int(truth.stamps[-1]), int(estimate.stamps[-1]))
    long = min(round(1e9 * seconds), round(0.3 * (end - begin)))
    result = []
    for start in np.linspace(begin + 0.1 * (end - begin), end - long - 0.1 * (end - begin), 15):
        first, last = np.searchsorted(truth.stamps, [start, start + long])
        p = truth.positions
        middle = p[(first + last) // 2] - (p[first] + p[last - 1]) / 2.0
        result.append((float(np.linalg.norm(middle)), int(first), int(last)))
    _, first, last = max(result)
    return slice(first, last)


def frozen(pair: Pair) -> Pair:
    """Let the groundtruth stand still for 20 s."""
    rows = np.arange(len(pair.truth))
    stretch = _bend(pair, 20.0)
    rows[stretch] = stretch.start
    return dataclasses.replace(
        pair, truth=dataclasses.replace(pair.truth[rows], stamps=pair.truth.stamps)
    )


def bridged(pair: Pair) -> Pair:
    """Fill 8 s of the groundtruth with a straight line."""
    truth, stretch = pair.truth, _bend(pair, 8.0)
    share = (truth.stamps[stretch] - truth.stamps[stretch.start]) / (
        truth.stamps[stretch.stop] - truth.stamps[stretch.start]
    )
    p, q = truth.positions.copy(), quaternions_of(truth).copy()
    ends = p[[stretch.start, stretch.stop]]
    p[stretch] = ends[0] + share[:, None] * (ends[1] - ends[0])
    start, end = (np.repeat(q[[row]], len(share), axis=0) for row in (stretch.start, stretch.stop))
    q[stretch] = lie.slerp(start, end, share)
    return change(pair, "truth", positions=p, quaternions=q)


def wide_gap(pair: Pair) -> Pair:
    """Lose 10 s of groundtruth, and interpolate across up to 30 s."""
    keep = np.ones(len(pair.truth), dtype=bool)
    keep[_bend(pair, 10.0)] = False
    return dataclasses.replace(pair, truth=pair.truth[keep], max_gap_s=30.0)


def in_axes(axes: Array, *sides: str) -> Make:
    """Return what tells poses in a world with other axes."""
    rotation = lie.from_matrix(axes)

    def make(pair: Pair) -> Pair:
        for side in sides:
            one = getattr(pair, side)
            pair = change(
                pair,
                side,
                positions=one.positions @ axes.T,
                quaternions=lie.multiply(rotation, quaternions_of(one)),
            )
        return pair

    return make


def camera_by_yaw(pair: Pair) -> Pair:
    """Align by yaw what is in a camera's axes, as KITTI's files are."""
    if not pair.name.startswith("KITTI"):
        pair = in_axes(CAMERA, "truth", "estimate")(pair)
    return dataclasses.replace(pair, gauge=Gauge.YAW)


def two_pairs(pair: Pair) -> Pair:
    """Keep two poses."""
    stamps, truth = pair.estimate.stamps, pair.truth.stamps
    inside = np.flatnonzero((stamps > truth[10]) & (stamps < truth[-10]))
    rows = inside[[len(inside) // 3, 2 * len(inside) // 3]]
    return dataclasses.replace(pair, estimate=pair.estimate[rows])


def restarted(pair: Pair) -> Pair:
    """Begin anew at the origin, with another yaw."""
    one, row = pair.estimate, int(0.55 * len(pair.estimate))
    p, q = one.positions.copy(), quaternions_of(one).copy()
    about_z = lie.rotation_vector(lie.conjugate(q[row])) * [0.0, 0.0, 1.0]
    rotation = lie.from_rotation_vector(about_z)
    p[row:] = lie.rotate(rotation, p[row:] - p[row])
    q[row:] = lie.multiply(rotation, q[row:])
    return change(pair, "estimate", positions=p, quaternions=q)


def marker(pair: Pair) -> Pair:
    """Turn the body's axes."""
    rotation = lie.from_rotation_vector(np.radians([35.0, -50.0, 80.0]))
    return change(
        pair, "estimate", quaternions=lie.multiply(quaternions_of(pair.estimate), rotation)
    )


def lever(pair: Pair) -> Pair:
    """Take another point of the body."""
    one = pair.estimate
    arm = lie.rotate(quaternions_of(one), np.array([0.3, -0.25, 0.4]))
    return change(pair, "estimate", positions=one.positions + arm)


def lost_frames(pair: Pair) -> Pair:
    """Keep some poses of odometry, which has no keyframes."""
    reading = SourceInfo(remarks=(note(FORMAT, "format: nav_msgs/msg/Odometry"),))
    return change(keyframes(pair), "estimate", reading=reading)


def keyframes(pair: Pair) -> Pair:
    """Keep poses that are far from the one before, now farther and now less so."""
    random, one = np.random.default_rng(1), pair.estimate
    usual = 0.6 * one.path_length_m / one.duration_s
    rows, need = [0], usual
    p, seconds = one.positions, one.seconds
    for row in range(1, len(one)):
        moved = float(np.linalg.norm(p[row] - p[rows[-1]]))
        if moved > need or seconds[row] - seconds[rows[-1]] > 4.0:
            rows.append(row)
            need = usual * random.uniform(0.4, 2.0)
    return dataclasses.replace(pair, estimate=one[_rows(rows)])


def body_twist(pair: Pair) -> Pair:
    """Give velocities in the body's axes."""
    one = pair.estimate
    velocity = np.gradient(one.positions, one.seconds, axis=0)
    return change(
        pair, "estimate", velocities=lie.rotate(lie.conjugate(quaternions_of(one)), velocity)
    )


def _rows(rows: list[int]) -> Indices:
    return np.array(rows, dtype=np.int64)


MISTAKES: dict[str, Mistake] = {
    "estimate in mm": Mistake(scaled("estimate", 1000.0), ("unit",)),
    "groundtruth in mm": Mistake(scaled("truth", 1000.0), ("unit",)),
    "scale lost": Mistake(scaled("estimate", 1.0 / 3.4), ("scale",)),
    "wxyz, estimate": Mistake(w_first("estimate"), ("wxyz",)),
    "xyzw, estimate": Mistake(w_last("estimate"), ("xyzw",)),
    "xyzw, groundtruth": Mistake(w_last("truth"), ("xyzw",)),
    "wxyz, both": Mistake(w_first("truth", "estimate"), ("wxyz",)),
    "mirrored": Mistake(mirrored, ("mirrored", "up_axis_or_mirrored")),
    "inverse, estimate": Mistake(inverse("estimate"), ("inverse",)),
    "inverse, groundtruth": Mistake(inverse("truth"), ("inverse",)),
    "transposed rotations": Mistake(transposed, ("transposed",)),
    "clock +18 s": Mistake(shifted(18.0), ("clock_offset",)),
    "clock -37 s": Mistake(shifted(-37.0), ("clock_offset",)),
    "clock 1000 ppm": Mistake(fast_clock, ("clock_drift",)),
    "whole seconds": Mistake(whole_seconds, ("stamps_rounded",)),
    "duplicated": Mistake(duplicated, ("duplicated",)),
    "groundtruth held": Mistake(held, ("groundtruth_held",)),
    "groundtruth frozen": Mistake(frozen, ("groundtruth_frozen",)),
    "groundtruth bridged": Mistake(bridged, ("groundtruth_bridged",)),
    "gap limit of 30 s": Mistake(wide_gap, ("gap_bridged",)),
    "the same file": Mistake(
        lambda pair: dataclasses.replace(pair, estimate=pair.truth[::5]), ("identical",)
    ),
    "camera axes": Mistake(in_axes(CAMERA, "estimate"), ("up_axis",), "yaw"),
    "NED": Mistake(in_axes(NED, "estimate"), ("up_axis", "up_axis_or_mirrored"), "yaw"),
    "KITTI by yaw": Mistake(camera_by_yaw, ("groundtruth_up_axis",), "vehicle"),
    "two pairs": Mistake(two_pairs, ("few_pairs",)),
    "restart": Mistake(restarted, ("restart",)),
    "marker": Mistake(marker, ("body",)),
    "lever arm": Mistake(lever, ("lever_arm",)),
    "keyframes": Mistake(keyframes, ("keyframes",)),
    "lost frames": Mistake(lost_frames, ("frames_lost",)),
    "body twist": Mistake(body_twist, ("twist_body",)),
}
