"""Tests of the columns of one side: timestamps, rows, names and velocities."""

from __future__ import annotations

import math
import re

import numpy as np

from trajeval_ros.diagnosis.findings import Detection, TestResult, Value
from trajeval_ros.diagnosis.input_pair import FEWEST, SAMPLE, InputPair, TimedPoses, lengths
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, extents
from trajeval_ros.geometry.rotation_fit import best_rotations
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.trajectory_edits import evenly
from trajeval_ros.metrics.statistics import median

_PROBES = 400  # rows of a side that are compared, which bounds the cost
# Equal positions: tolerance of timestamps, least number and share of poses with a partner, share
# of them that is equal, decimals of text files, and relative error of an interpolation.
_SAME_S = 2e-6
_FEWEST_EQUAL, _SHARED, _NEARLY_ALL_PERCENT = 3, 0.5, 90.0
_DECIMALS = range(3, 10)
_ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
_FITTED_SHARE = 1e-6  # largest difference after a rigid fit, as a fraction of the extent
# Largest extent of a body at rest, as a fraction of the other side's, and least extent of motion,
# in units of the source.
_STILL_SHARE, _MOVED = 1e-5, 0.3
_LONGEST_S = 0.6  # between poses whose difference is a velocity
_SLOW_HZ = 4.0  # of keyframes; odometry is faster
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


def sides_of(inputs: InputPair) -> dict[str, TimedPoses]:
    """Return the poses by side."""
    return {"estimate": inputs.estimate_poses, "groundtruth": inputs.groundtruth_poses}


def other_side(side: str) -> str:
    """Return the side that is not the given one."""
    return "groundtruth" if side == "estimate" else "estimate"


def rounded_stamps(inputs: InputPair) -> TestResult:
    """Test for rounded timestamps that several poses share."""
    seen = []
    for side, read in (("estimate", inputs.estimate), ("groundtruth", inputs.groundtruth)):
        seconds, steps = read.stamps / NANOSECONDS, np.array([1.0, 0.5, 0.1])
        some = seconds[:SAMPLE, None] / steps
        steps = steps[(np.abs(some - np.rint(some)) < 1e-4).all(axis=0)]
        if not len(steps) or len(read) < FEWEST:
            continue
        stamps, counts = np.unique(seconds, return_counts=True)
        shared = median(counts)
        moving = np.any(np.diff(read.positions, axis=0) != 0.0, axis=1)
        if shared >= 2.0 and moving.mean() > 0.5:
            apart_s = np.diff(stamps).min() if len(stamps) > 1 else 0.0
            step_s = max(float(steps[0]), float(apart_s))
            values: dict[str, Value] = {"side": side, "step_s": step_s, "poses_per_stamp": shared}
            seen.append(Detection("stamps_rounded", values))
    return TestResult("rounded stamps", seen=tuple(seen))


def duplicated_rows(inputs: InputPair) -> TestResult:
    """Test for blocks of moving poses that occur twice, bit by bit, at one distance in rows."""
    seen: list[Detection] = []
    scores: dict[str, float] = {}
    for side, poses in sides_of(inputs).items():
        if len(poses) < FEWEST:
            continue
        repeats, apart, extent = _repeats(poses)
        scores[f"{side} share"] = share = min(1.0, repeats / min(_PROBES, len(poses)))
        if repeats >= FEWEST and extent > 1e-3 * _travelled(poses.positions):
            percent = 100.0 * share
            seen.append(Detection.of("duplicated", side=side, percent=percent, rows_apart=apart))
    return TestResult("duplicated rows", scores, tuple(seen))


def _repeats(poses: TimedPoses) -> tuple[int, float, float]:
    """Return the number of repeated probes, their distance in rows, and their extent."""
    # Candidates by a hash table of the first coordinate, which is faster than a sort.
    bits = np.ascontiguousarray(poses.positions[:, 0]).view(np.int64)
    bits = (bits ^ (bits >> 23)) & 0x3FFFF
    table = np.zeros(0x40000, dtype=bool)
    table[bits[evenly(len(poses), _PROBES)]] = True
    some = np.flatnonzero(table[bits])
    some = some[:: len(some) // 20_000 + 1]
    columns = [poses.positions] + ([] if poses.quaternions is None else [poses.quaternions])
    rows = np.concatenate([column[some] for column in columns], axis=1)
    order = np.lexsort((some, rows[:, 1], rows[:, 0]))
    same = (rows[order[1:]] == rows[order[:-1]]).all(axis=1)
    first, second = np.sort([some[order[:-1]][same], some[order[1:]][same]], axis=0)
    far = second - first > 5
    first, second = first[far], second[far]
    if len(first) < FEWEST:
        return 0, 0.0, 0.0
    # A copied block repeats at one distance; a body at rest repeats at all distances.
    distances, numbers = np.unique(second - first, return_counts=True)
    most = int(np.argmax(numbers))
    again = first[second - first == distances[most]]
    size = float(np.linalg.norm(extents(poses.positions[again])))
    return int(numbers[most]), float(distances[most]), size


def same_positions(inputs: InputPair) -> TestResult:
    """Test whether the positions of both sides are equal at equal timestamps, or in equal rows.

    They are equal as written, or up to rounding after a rigid transformation.
    """
    test = "same positions"
    sides = inputs.in_order if inputs.by_time else sides_of(inputs).values()
    few, many = sorted(sides, key=len)
    rows = same = evenly(len(few), _PROBES)
    where = "in equal rows"
    if inputs.by_time:
        where = "at equal timestamps"
        place = np.searchsorted(many.seconds, few.seconds[rows] - _SAME_S).clip(0, len(many) - 1)
        known = np.abs(many.seconds[place] - few.seconds[rows]) < _SAME_S
        rows, same = rows[known], place[known]
    elif len(few) != len(many):
        return TestResult(test, why_not="the numbers of rows differ")
    if len(rows) < max(_FEWEST_EQUAL, _SHARED * min(len(few), _PROBES)):
        return TestResult(test, why_not=f"too few poses {where}")
    one, other = few.positions[rows], many.positions[same]
    percent = 100.0 * _equal(one, other)
    if percent < _NEARLY_ALL_PERCENT and len(rows) >= FEWEST:
        percent, where = 100.0 * _equal_when_fitted(one, other), f"{where}, after a rigid fit,"
    scores = {"percent": percent}
    if not extents(one).any() or percent < _NEARLY_ALL_PERCENT:
        return TestResult(test, scores)
    return TestResult(test, scores, (Detection.of("identical", percent=percent, where=where),))


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
    rotated = a @ best_rotations(b.T @ a)[1].T
    return float(np.mean(lengths(b - rotated) < _FITTED_SHARE * size))


def is_at_rest(inputs: InputPair) -> bool:
    """Return whether neither side moves."""
    return max(_travelled(poses.positions) for poses in sides_of(inputs).values()) < _MOVED


def standing_still(inputs: InputPair) -> TestResult:
    """Test for a side that does not move while the other one moves."""
    test, sides = "standing still", sides_of(inputs)
    sizes = {side: _travelled(poses.positions) for side, poses in sides.items()}
    scores = {f"{side} path": size for side, size in sizes.items()}
    if min(map(len, sides.values())) < FEWEST or is_at_rest(inputs):
        return TestResult(test, scores, why_not="neither side moves")
    still, path_m = min(sizes, key=sizes.__getitem__), max(sizes.values())
    # Next to an estimate that diverges by far, all groundtruth is small.
    if sizes[still] > min(_STILL_SHARE * path_m, _MOVED):
        return TestResult(test, scores)
    seen = Detection.of("stands_still", side=still, other=other_side(still), path_m=path_m)
    return TestResult(test, scores, (seen,))


def _travelled(positions: Floats) -> float:
    """Return the extent of a path without outliers."""
    some = positions[evenly(len(positions), _PROBES)]
    outliers = len(some) // 50
    ranked = np.sort(some, axis=0)
    return float(np.linalg.norm(ranked[len(some) - 1 - outliers] - ranked[outliers]))


def velocities(groundtruth: TimedPoses, estimate: TimedPoses) -> TestResult:
    """Compare velocities, as read and rotated to the world, with the rate of the positions."""
    seen: list[Detection] = []
    scores: dict[str, float] = {}
    for side, poses in (("estimate", estimate), ("groundtruth", groundtruth)):
        if poses.velocities is None or poses.quaternions is None or len(poses) < FEWEST:
            continue
        rows = evenly(len(poses) - 2, SAMPLE) + 1
        time = poses.seconds[rows + 1] - poses.seconds[rows - 1]
        rows, time = rows[time < _LONGEST_S], time[time < _LONGEST_S]
        moving = (poses.positions[rows + 1] - poses.positions[rows - 1]) / time[:, None]
        total = float(np.sum(moving**2))
        if len(rows) < FEWEST or not total > 0.0:
            continue
        given = poses.velocities[rows]
        as_world, as_body = (
            float(np.sum((velocity - moving) ** 2)) / total
            for velocity in (given, lie.rotate(poses.quaternions[rows], given))
        )
        scores |= {f"{side} as world": as_world, f"{side} as body": as_body}
        if as_world > 0.25 and as_body < 0.2 * as_world and as_body < 0.1:
            world, body = (100.0 * math.sqrt(share) for share in (as_world, as_body))
            seen.append(
                Detection.of("twist_body", side=side, off_percent=world, turned_percent=body)
            )
    why_not = "" if scores else "no side has both velocities and orientations"
    return TestResult("velocities", scores, tuple(seen), why_not)


def rhythm(groundtruth: TimedPoses, estimate: TimedPoses, *, is_odometry: bool) -> TestResult:
    """Test whether the estimate has only keyframes, or lost frames: few, at irregular times.

    Odometry is published once per frame and not optimised later.
    """
    test, rate_hz = "keyframes", (len(estimate) - 1) / max(estimate.span_s, 1e-9)
    if rate_hz >= _SLOW_HZ:
        return TestResult(test, {"rate_hz": rate_hz})
    steps_s = np.diff(estimate.seconds)
    low, high = np.quantile(steps_s, [0.1, 0.9])
    spread = float(high - low) / median(steps_s)
    scores = {"rate_hz": rate_hz, "spread": spread}
    if spread > 0.5 and median(steps_s) > 4.0 * groundtruth.usual_step_s:
        cause = "frames_lost" if is_odometry else "keyframes"
        seen = Detection.of(cause, rate_hz=rate_hz, of_hz=1.0 / float(low))
        return TestResult(test, scores, (seen,))
    return TestResult(test, scores)


def swapped_names(inputs: InputPair) -> TestResult:
    """Test whether only the estimate has a name of groundtruth."""
    groundtruth, estimate = (
        side.reading.source or side.name for side in (inputs.groundtruth, inputs.estimate)
    )
    # A topic, or a file: a folder can name the groundtruth, as in
    # `state_groundtruth_estimate0/data.csv`.
    _, colon, topic = estimate.rpartition(":/")
    is_topic = colon and not topic.startswith("/")
    name = topic if is_topic else estimate.rpartition("/")[2]
    is_groundtruth = is_named_groundtruth(name) and _ESTIMATE.search(name) is None
    if not is_groundtruth or not groundtruth or is_named_groundtruth(groundtruth):
        return TestResult("source names")
    seen = Detection.of("swapped", groundtruth=groundtruth, estimate=estimate)
    return TestResult("source names", seen=(seen,))


def is_named_groundtruth(name: str) -> bool:
    """Return whether a name has a word for groundtruth, or for a system that measures it."""
    return _GROUNDTRUTH.search(name) is not None
