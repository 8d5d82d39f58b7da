"""Tests of the columns of one side: timestamps, rows, names and velocities."""

from __future__ import annotations

import re

import numpy as np

from trajeval_ros.diagnosis.findings import Examined, Seen
from trajeval_ros.diagnosis.input_pair import SAMPLE, InputPair, TimedPoses, lengths
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, extents
from trajeval_ros.geometry.rotation_fit import best_rotations
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.trajectory_edits import evenly
from trajeval_ros.metrics.statistics import median

_PROBES = 400
_FEWEST_POSES = 30
# Equal positions: tolerance of timestamps, least number and share of poses with a partner, share
# of them that is equal, decimals of text files, and relative error of an interpolation.
_SAME_S = 2e-6
_FEWEST_EQUAL, _SHARED, _NEARLY_ALL_PERCENT = 3, 0.5, 90.0
_DECIMALS = range(3, 10)
_ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
# After a rigid fit: least number of poses, and largest difference as a fraction of the extent.
_FEWEST_FITTED, _FITTED_SHARE = 10, 1e-6
# Largest extent of a body at rest, as a fraction of the other side's, and least extent of motion,
# in units of the source.
_STILL_SHARE, _MOVED = 1e-5, 0.3


# The rooms of EuRoC's sequences are called "Vicon room".
_GROUNDTRUTH = re.compile(
    r"(?<![a-z])(gt|(ground.?)?truth|vicon(?!.?room)|mocap|optitrack|qualisys|vrpn|leica|rtk"
    r"|reference)(?![a-z])",
    re.IGNORECASE,
)
_ESTIMATE = re.compile(
    r"(vio|vins|slam|odometry|odom|openvins|rovio|okvis|msckf|estimate|kimera|svo)(?![a-z])",
    re.IGNORECASE,
)


def rounded_stamps(inputs: InputPair) -> Examined:
    """Test for rounded timestamps that several poses share."""
    seen = []
    for side, poses, read in (
        ("estimate", inputs.estimate_poses, inputs.estimate),
        ("groundtruth", inputs.groundtruth_poses, inputs.groundtruth),
    ):
        first = read.stamps[:SAMPLE] / NANOSECONDS
        step_s = next(
            (
                step
                for step in (1.0, 0.5, 0.1)
                if (np.abs(first / step - np.rint(first / step)) < 1e-4).all()
            ),
            0.0,
        )
        if not step_s or len(poses) < 10:
            continue
        seconds = read.stamps / NANOSECONDS
        stamps, counts = np.unique(seconds, return_counts=True)
        shared = median(counts)
        moving = float(np.mean(np.any(np.diff(poses.positions, axis=0) != 0.0, axis=1)))
        if shared >= 2.0 and moving > 0.5:
            if len(stamps) > 1:
                step_s = max(step_s, float(np.diff(stamps).min()))
            seen.append(
                Seen.of("stamps_rounded", side=side, step_s=step_s, poses_per_stamp=shared)
            )
    return Examined("rounded stamps", seen=tuple(seen))


def duplicated_rows(inputs: InputPair) -> Examined:
    """Test for blocks of moving poses that occur twice, bit by bit, at one distance in rows."""
    seen: list[Seen] = []
    scores: dict[str, float] = {}
    for side, poses in _sides(inputs):
        if len(poses) < _FEWEST_POSES:
            continue
        repeats, rows_apart, extent = _repeats(poses)
        share = min(1.0, repeats / min(_PROBES, len(poses)))
        scores[f"{side} share"] = share
        if repeats >= max(10, 0.02 * _PROBES) and extent > 1e-3 * _travelled(poses.positions):
            apart = float(rows_apart)
            seen.append(Seen.of("duplicated", side=side, percent=100.0 * share, rows_apart=apart))
    return Examined("duplicated rows", scores, tuple(seen))


def _repeats(poses: TimedPoses) -> tuple[int, int, float]:
    """Return the number of repeated probes of 400, their distance in rows, and their extent."""
    count = len(poses)
    probes = evenly(count, _PROBES)
    # Candidates by a hash table of the first coordinate, which is faster than a sort.
    bits = np.ascontiguousarray(poses.positions[:, 0]).view(np.int64)
    bits = (bits ^ (bits >> 23)) & 0x3FFFF
    table = np.zeros(0x40000, dtype=bool)
    table[bits[probes]] = True
    some = np.flatnonzero(table[bits])
    if len(some) > 20_000:
        some = some[:: len(some) // 20_000 + 1]
    rows = poses.positions[some]
    if poses.quaternions is not None:
        rows = np.concatenate([rows, poses.quaternions[some]], axis=1)
    order = np.lexsort((some, rows[:, 1], rows[:, 0]))
    same = (rows[order[1:]] == rows[order[:-1]]).all(axis=1)
    first, second = np.sort([some[order[:-1]][same], some[order[1:]][same]], axis=0)
    far = second - first > 5
    first, second = first[far], second[far]
    if len(first) < 10:
        return 0, 0, 0.0
    # A copied block repeats at one distance; a body at rest repeats at all distances.
    distances, numbers = np.unique(second - first, return_counts=True)
    most = int(np.argmax(numbers))
    again = first[second - first == distances[most]]
    extent = float(np.linalg.norm(extents(poses.positions[again])))
    return int(numbers[most]), int(distances[most]), extent


def same_positions(inputs: InputPair) -> Examined:
    """Test whether the positions of both sides are equal at equal timestamps, or in equal rows.

    They are equal as written, or up to rounding after a rigid transformation.
    """
    test = "same positions"
    groundtruth, poses = (
        inputs.in_order if inputs.by_time else (inputs.groundtruth_poses, inputs.estimate_poses)
    )
    few, many = sorted((groundtruth, poses), key=len)
    rows = same = evenly(len(few), _PROBES)
    where = "in equal rows"
    if inputs.by_time:
        where = "at equal timestamps"
        place = np.searchsorted(many.seconds, few.seconds[rows] - _SAME_S).clip(0, len(many) - 1)
        known = np.abs(many.seconds[place] - few.seconds[rows]) < _SAME_S
        rows, same = rows[known], place[known]
    elif len(few) != len(many):
        return Examined(test, why_not="the numbers of rows differ")
    if len(rows) < max(_FEWEST_EQUAL, _SHARED * min(len(few), _PROBES)):
        return Examined(test, why_not=f"too few poses {where}")
    one, other = few.positions[rows], many.positions[same]
    percent = 100.0 * _equal(one, other)
    if percent < _NEARLY_ALL_PERCENT and len(rows) >= _FEWEST_FITTED:
        percent, where = 100.0 * _equal_when_fitted(one, other), f"{where}, after a rigid fit,"
    moves = bool(extents(one).any())
    if not moves or percent < _NEARLY_ALL_PERCENT:
        return Examined(test, {"percent": percent})
    seen = Seen.of("identical", percent=percent, where=where)
    return Examined(test, {"percent": percent}, (seen,))


def _equal(one: Floats, other: Floats) -> float:
    """Return the share of equal rows (N, 3); one side may have fewer digits than the other."""
    size = max(float(np.abs(one).max()), float(np.abs(other).max()))
    written = [(one, other)]
    for decimals in _DECIMALS:
        written += [(one.round(decimals), other), (one, other.round(decimals))]
    # An interpolation at a groundtruth timestamp differs by rounding.
    return max(float(np.mean((np.abs(a - b) <= _ROUNDING * size).all(axis=1))) for a, b in written)


def _equal_when_fitted(one: Floats, other: Floats) -> float:
    """Return the share of rows (N, 3) that are equal up to rounding after a rigid fit."""
    a, b = one - one.mean(axis=0), other - other.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum(b * b, axis=1))))
    turned = best_rotations(b.T @ a)[1]
    return float(np.mean(lengths(b - a @ turned.T) < _FITTED_SHARE * size))


def is_at_rest(inputs: InputPair) -> bool:
    """Return whether neither side moves."""
    return max(_travelled(poses.positions) for _, poses in _sides(inputs)) < _MOVED


def standing_still(inputs: InputPair) -> Examined:
    """Test for a side that does not move while the other one moves."""
    sizes = {side: _travelled(poses.positions) for side, poses in _sides(inputs)}
    still = min(sizes, key=lambda side: sizes[side])
    moving = max(sizes.values())
    scores = {f"{side} path": size for side, size in sizes.items()}
    few = min(map(len, (inputs.groundtruth_poses, inputs.estimate_poses))) < 10
    if few or is_at_rest(inputs):
        return Examined("standing still", scores, why_not="neither side moves")
    # Next to an estimate that diverges by far, all groundtruth is small.
    if sizes[still] > min(_STILL_SHARE * moving, _MOVED):
        return Examined("standing still", scores)
    seen = Seen.of("stands_still", side=still, other=_other(still), path_m=moving)
    return Examined("standing still", scores, (seen,))


def swapped_names(inputs: InputPair) -> Examined:
    """Test whether only the estimate has a name of groundtruth."""
    groundtruth, estimate = (
        side.reading.source or side.name for side in (inputs.groundtruth, inputs.estimate)
    )
    name = own_name(estimate)
    # A folder can name the groundtruth, as in `state_groundtruth_estimate0/data.csv`.
    is_groundtruth = is_named_groundtruth(name) and not is_named_estimate(name)
    if not is_groundtruth or not groundtruth or is_named_groundtruth(groundtruth):
        return Examined("source names")
    seen = Seen.of("swapped", groundtruth=groundtruth, estimate=estimate)
    return Examined("source names", seen=(seen,))


def _sides(inputs: InputPair) -> list[tuple[str, TimedPoses]]:
    return [("estimate", inputs.estimate_poses), ("groundtruth", inputs.groundtruth_poses)]


def _other(side: str) -> str:
    return "groundtruth" if side == "estimate" else "estimate"


def _travelled(positions: Floats) -> float:
    """Return the extent of a path without outliers."""
    some = positions[evenly(len(positions), _PROBES)]
    outliers = len(some) // 50
    ranked = np.sort(some, axis=0)
    return float(np.linalg.norm(ranked[len(some) - 1 - outliers] - ranked[outliers]))


_LONGEST_S = 0.6
_SLOW_HZ = 4.0


def velocities(groundtruth: TimedPoses, estimate: TimedPoses) -> Examined:
    """Compare velocities, as read and rotated to the world, with the rate of the positions."""
    seen: list[Seen] = []
    scores: dict[str, float] = {}
    for side, poses in (("estimate", estimate), ("groundtruth", groundtruth)):
        if poses.velocities is None or poses.quaternions is None or len(poses) < _FEWEST_POSES:
            continue
        rows = evenly(len(poses) - 2, SAMPLE) + 1
        time = poses.seconds[rows + 1] - poses.seconds[rows - 1]
        rows, time = rows[time < _LONGEST_S], time[time < _LONGEST_S]
        if len(rows) < _FEWEST_POSES:
            continue
        moving = (poses.positions[rows + 1] - poses.positions[rows - 1]) / time[:, None]
        total = float(np.sum(moving**2))
        given = poses.velocities[rows]
        turned = lie.rotate(poses.quaternions[rows], given)
        if not total > 0.0:
            continue
        as_world = float(np.sum((given - moving) ** 2)) / total
        as_body = float(np.sum((turned - moving) ** 2)) / total
        scores |= {f"{side} as world": as_world, f"{side} as body": as_body}
        if as_world > 0.25 and as_body < 0.2 * as_world and as_body < 0.1:
            world, body = (100.0 * float(np.sqrt(share)) for share in (as_world, as_body))
            seen.append(Seen.of("twist_body", side=side, off_percent=world, turned_percent=body))
    why_not = "" if scores else "no side has both velocities and orientations"
    return Examined("velocities", scores, tuple(seen), why_not)


def rhythm(groundtruth: TimedPoses, estimate: TimedPoses, *, is_odometry: bool) -> Examined:
    """Test whether the estimate has only keyframes, or lost frames: few, at irregular times.

    Odometry is published once per frame and not optimised later.
    """
    if len(estimate) < 6:
        return Examined("keyframes", why_not="too few poses")
    rate_hz = (len(estimate) - 1) / max(estimate.span_s, 1e-9)
    if rate_hz >= _SLOW_HZ:
        return Examined("keyframes", {"rate_hz": rate_hz})
    steps_s = np.diff(estimate.seconds)
    usual_s = median(steps_s)
    low, high = np.quantile(steps_s, [0.1, 0.9])
    spread = float(high - low) / usual_s
    scores = {"rate_hz": rate_hz, "spread": spread}
    if spread > 0.5 and usual_s > 4.0 * groundtruth.usual_step_s:
        cause = "frames_lost" if is_odometry else "keyframes"
        seen = Seen.of(cause, rate_hz=rate_hz, of_hz=1.0 / float(low))
        return Examined("keyframes", scores, (seen,))
    return Examined("keyframes", scores)


def is_named_groundtruth(name: str) -> bool:
    """Return whether a name has a word for groundtruth, or for a system that measures it."""
    return _GROUNDTRUTH.search(name) is not None


def is_named_estimate(name: str) -> bool:
    """Return whether a name has a word for an estimate, or for an estimator."""
    return _ESTIMATE.search(name) is not None


def own_name(source: str) -> str:
    """Return the topic of a source `BAG:/topic`, or the name of its file without folders."""
    _, colon, topic = source.rpartition(":/")
    return topic if colon and not topic.startswith("/") else source.rpartition("/")[2]
