"""Plain tests of the columns of both sides: timestamps, rows, names, units and velocities."""

from __future__ import annotations

import math
import re

import numpy as np

from trajeval_ros.diagnosis.findings import Detection, TestResult
from trajeval_ros.diagnosis.input_pair import (
    FEWEST,
    SAMPLE,
    InputPair,
    TimedPoses,
    other_side,
)
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, extents, lengths
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.so3 import best_rotations
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.trajectory_edits import evenly, every_nth
from trajeval_ros.metrics.statistics import median

_ROUNDED_TO_S = np.array([1.0, 0.5, 0.1])  # steps of timestamps with too few digits
_SAME_S = 2e-6  # tolerance of equal timestamps
_FEWEST_EQUAL, _SHARED, _NEARLY_ALL = 3, 0.5, 0.9  # poses with a partner, and equal ones of them
_DECIMALS = range(3, 10)  # of text files
_FITTED_SHARE = 1e-6  # of the extent: largest difference after a rigid fit
# Largest extent of a body at rest, as a fraction of the other side's, and least extent of motion,
# in units of the source.
_STILL_SHARE, _MOVED = 1e-5, 0.3
_LONGEST_S = 0.6  # between poses whose difference is a velocity
_SLOW_HZ = 4.0  # of keyframes; odometry is faster
_NUMBERS_S = 1e7  # the largest row number; timestamps since 1970 are larger
_METRES_PER_DEG, _FACTOR = 111_320.0, 4.0  # of latitude; of longitude it is less
_DEGREES, _LEAST_M = 0.1, 1.0  # largest extent in degrees, least motion
_FLAT = 0.05  # least rms height of the other side, as a fraction of its extent
_TILTS = 1e-3  # least change of a body's vertical axis
_ALIKE = 2.0  # largest ratio of durations or lengths of the same run
# Of increments: least correlation, largest extent relative to the groundtruth, and steps to add.
_STEPS_ALIKE, _SMALL, _TOGETHER = 0.8, 0.5, 10
# The rooms of EuRoC's sequences are called "Vicon room".
_GROUNDTRUTH = re.compile(
    r"(gt|(?<![a-z])((ground.?)?truth|vicon(?!.?room)|mocap|optitrack|qualisys|vrpn|leica|rtk"
    r"|reference))(?![a-z])",
    re.IGNORECASE,
)
_ESTIMATE = re.compile(
    r"(vio|vins|slam|odometry|odom|openvins|rovio|okvis|msckf|estimate|kimera|svo)(?![a-z])",
    re.IGNORECASE,
)


def tests_of_columns(inputs: InputPair) -> list[TestResult]:
    """Apply the tests that need no motion of both sides."""
    some = standing_still, rounded_stamps, same_positions, duplicated_rows, swapped_names
    more = (row_numbers, degrees, flat, increments) if inputs.has_enough else ()
    return [test(inputs) for test in (*some, *more)]


def rounded_stamps(inputs: InputPair) -> TestResult:
    """Test for rounded timestamps that several poses share."""
    seen = []
    for side, read in (("estimate", inputs.estimate), ("groundtruth", inputs.groundtruth)):
        seconds = read.stamps / NANOSECONDS
        some = seconds[:SAMPLE, None] / _ROUNDED_TO_S
        steps = _ROUNDED_TO_S[(np.abs(some - np.rint(some)) < 1e-4).all(axis=0)]
        if not len(steps) or len(read) < FEWEST:
            continue
        stamps, counts = np.unique(seconds, return_counts=True)
        moving = np.any(np.diff(read.positions, axis=0) != 0.0, axis=1)
        if (shared := median(counts)) >= 2.0 and moving.mean() > 0.5:
            step_s = max(float(steps[0]), float(min(np.diff(stamps), default=0.0)))
            seen.append(
                Detection.of("stamps_rounded", side=side, step_s=step_s, poses_per_stamp=shared)
            )
    return TestResult("rounded stamps", seen=tuple(seen))


def duplicated_rows(inputs: InputPair) -> TestResult:
    """Test for blocks of moving poses that occur twice, bit by bit, at one distance in rows."""
    seen: list[Detection] = []
    scores: dict[str, float] = {}
    for side, poses in inputs.poses.items():
        if len(poses) < FEWEST:
            continue
        repeats, apart, extent = _repeats(poses)
        scores[f"{side} share"] = share = min(1.0, repeats / min(SAMPLE, len(poses)))
        if repeats >= FEWEST and extent > 1e-3 * _travelled(poses.positions):
            percent = 100.0 * share
            seen.append(Detection.of("duplicated", side=side, percent=percent, rows_apart=apart))
    return TestResult("duplicated rows", scores, tuple(seen))


def _repeats(poses: TimedPoses) -> tuple[int, float, float]:
    """Return the number of repeated probes, their distance in rows, and their extent."""
    # Candidates by the first coordinate.
    along = np.ascontiguousarray(poses.positions[:, 0])
    probes = np.sort(along[evenly(len(along), SAMPLE)])
    some = np.flatnonzero(probes[np.searchsorted(probes[:-1], along)] == along)
    some = some[every_nth(max(len(some), 1), 20_000)]
    columns = [poses.positions] + ([] if poses.quaternions is None else [poses.quaternions])
    rows = np.concatenate([column[some] for column in columns], axis=1)
    order = np.lexsort((some, rows[:, 1], rows[:, 0]))
    same = (rows[order[1:]] == rows[order[:-1]]).all(axis=1)
    first, second = np.sort([some[order[:-1]][same], some[order[1:]][same]], axis=0)
    apart = second - first
    if np.count_nonzero(apart > 5) < FEWEST:
        return 0, 0.0, 0.0
    # A copied block repeats at one distance; a body at rest repeats at all distances.
    distances, numbers = np.unique(apart[apart > 5], return_counts=True)
    most = int(np.argmax(numbers))
    again = poses.positions[first[apart == distances[most]]]
    return int(numbers[most]), float(distances[most]), float(np.linalg.norm(extents(again)))


def same_positions(inputs: InputPair) -> TestResult:
    """Test whether the positions of both sides are equal at equal timestamps, or in equal rows.

    They are equal as written, or up to rounding after a rigid transformation.
    """
    test = "same positions"
    few, many = sorted(inputs.in_order if inputs.by_time else inputs.poses.values(), key=len)
    rows = same = evenly(len(few), SAMPLE)
    where = "in equal rows"
    if inputs.by_time:
        where = "at equal timestamps"
        place = np.searchsorted(many.seconds, few.seconds[rows] - _SAME_S).clip(0, len(many) - 1)
        known = np.abs(many.seconds[place] - few.seconds[rows]) < _SAME_S
        rows, same = rows[known], place[known]
    elif len(few) != len(many):
        return TestResult(test, why_not="the numbers of rows differ")
    if len(rows) < max(_FEWEST_EQUAL, _SHARED * min(len(few), SAMPLE)):
        return TestResult(test, why_not=f"too few poses {where}")
    one, other = few.positions[rows], many.positions[same]
    share = _equal(one, other)
    if share < _NEARLY_ALL and len(rows) >= FEWEST:
        share, where = _equal_when_fitted(one, other), f"{where}, after a rigid fit,"
    scores = {"percent": 100.0 * share}
    is_same = share >= _NEARLY_ALL and bool(extents(one).any())
    seen = Detection.of("identical", percent=100.0 * share, where=where)
    return TestResult(test, scores, (seen,) * is_same)


def _equal(one: Floats, other: Floats) -> float:
    """Return the share of equal rows (N, 3); one side may have fewer digits than the other."""
    # An interpolation at a groundtruth timestamp differs by rounding.
    rounding = 4.0 * np.finfo(np.float64).eps * max(np.abs(one).max(), np.abs(other).max())
    written = [(one, other)]
    for decimals in _DECIMALS:
        written += [(one.round(decimals), other), (one, other.round(decimals))]
    return max(float(np.mean((np.abs(a - b) <= rounding).all(axis=1))) for a, b in written)


def _equal_when_fitted(one: Floats, other: Floats) -> float:
    """Return the share of rows (N, 3) that are equal up to rounding after a rigid fit."""
    a, b = one - one.mean(axis=0), other - other.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum(b * b, axis=1))))
    return float(np.mean(lengths(b - a @ best_rotations(b.T @ a)[1].T) < _FITTED_SHARE * size))


def is_at_rest(inputs: InputPair) -> bool:
    """Return whether neither side moves."""
    return all(_travelled(poses.positions) < _MOVED for poses in inputs.poses.values())


def standing_still(inputs: InputPair) -> TestResult:
    """Test for a side that does not move while the other one moves."""
    sizes = {side: _travelled(poses.positions) for side, poses in inputs.poses.items()}
    scores = {f"{side} path": size for side, size in sizes.items()}
    still, path_m = min(sizes, key=sizes.__getitem__), max(sizes.values())
    if not inputs.has_enough or path_m < _MOVED:
        return TestResult("standing still", scores, why_not="neither side moves")
    # Next to an estimate that diverges by far, all groundtruth is small.
    is_still = sizes[still] <= min(_STILL_SHARE * path_m, _MOVED)
    seen = Detection.of("stands_still", side=still, other=other_side(still), path_m=path_m)
    return TestResult("standing still", scores, (seen,) * is_still)


def _travelled(positions: Floats) -> float:
    """Return the extent of a path without outliers."""
    some = positions[evenly(len(positions), SAMPLE)]
    outliers = len(some) // 50
    ranked = np.sort(some, axis=0)
    return float(np.linalg.norm(ranked[len(some) - 1 - outliers] - ranked[outliers]))


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
    is_swapped = bool(is_groundtruth and groundtruth) and not is_named_groundtruth(groundtruth)
    seen = Detection.of("swapped", groundtruth=groundtruth, estimate=estimate)
    return TestResult("source names", seen=(seen,) * is_swapped)


def is_named_groundtruth(name: str) -> bool:
    """Return whether a name has a word for groundtruth, or for a system that measures it."""
    return _GROUNDTRUTH.search(name) is not None


def row_numbers(inputs: InputPair) -> TestResult:
    """Test for numbers of rows in place of the estimate's timestamps."""
    stamps, others = inputs.estimate.stamps, inputs.groundtruth.stamps
    is_counted = bool((np.diff(stamps) == NANOSECONDS).all()) and stamps[0] < _NUMBERS_S * 1e9
    ratio = float(np.ptp(stamps)) / max(float(np.ptp(others)), 1.0)
    apart = not 1.0 / _ALIKE < ratio < _ALIKE or stamps[-1] < others[0]
    seen = (Detection("row_numbers"),) if inputs.by_time and is_counted and apart else ()
    return TestResult("row numbers", {"span_ratio": ratio}, seen)


def degrees(inputs: InputPair) -> TestResult:
    """Test for longitude and latitude: degrees of the extent that the other side moves."""
    sizes = {side: extents(poses.positions) for side, poses in inputs.poses.items()}
    for side, size in sizes.items():
        other, columns = other_side(side), np.argsort(size)[:2]
        extent, moved = (float(np.linalg.norm(one)) for one in (size[columns], sizes[other]))
        ratio = moved / max(extent * _METRES_PER_DEG, 1e-12)
        likely = 1.0 / _FACTOR < ratio < _FACTOR and extent < _DEGREES and moved > _LEAST_M
        if likely and (np.abs(inputs.poses[side].positions[:, columns]) <= 180.0).all():
            seen = Detection.of("degrees", side=side, other=other, path_m=moved, extent=extent)
            return TestResult("degrees", {"ratio": ratio}, (seen,))
    return TestResult("degrees")


def flat(inputs: InputPair) -> TestResult:
    """Test for a constant column of one side while the other side moves in space.

    A side with roll and pitch is three-dimensional, and has a height that is not constant.
    """
    constant = {side: extents(poses.positions) == 0.0 for side, poses in inputs.poses.items()}
    for side in ("groundtruth", "estimate"):
        poses, other = inputs.poses[side], other_side(side)
        if np.count_nonzero(constant[side]) != 1 or constant[other].any():
            continue
        axis, tilts = constant[side].astype(float), 0.0
        if poses.quaternions is not None:
            some = lie.conjugate(poses.quaternions[every_nth(len(poses), SAMPLE)])
            tilts = float(np.linalg.norm(extents(lie.rotate(some, axis))))
        height_m = float(inputs.poses[other].positions[:, 2].std())
        is_high = height_m > _FLAT * inputs.poses[other].extent
        if inputs.gauge is not Gauge.PLANAR and (tilts > _TILTS or is_high):
            name = "xyz"[axis.argmax()]
            seen = Detection.of("flat", side=side, other=other, axis=name, height_m=height_m)
            return TestResult("flat", {"height_m": height_m}, (seen,))
    return TestResult("flat")


def increments(inputs: InputPair) -> TestResult:
    """Compare the lengths of the estimate's positions with steps of the groundtruth."""
    test, (groundtruth, estimate) = "increments", inputs.in_order
    if not inputs.by_time or min(len(groundtruth), len(estimate)) < FEWEST:
        return TestResult(test, why_not="no timestamps")
    if estimate.extent > _SMALL * groundtruth.extent:
        return TestResult(test)
    at = groundtruth.at(estimate.seconds, inputs.protocol.association.longest_step_s)
    both = at.known[1:] & at.known[:-1]
    rows = [lengths(np.diff(at.positions, axis=0))[both], lengths(estimate.positions[1:])[both]]
    # Noise is large in comparison with short steps, so some are added.
    together = max(min(_TOGETHER, len(rows[0]) // FEWEST), 1)
    blocks = np.arange(0, len(rows[0]), together)
    steps, sizes = (np.add.reduceat(row, blocks) for row in rows)
    if len(steps) < FEWEST or not (steps.std() > 0.0 and sizes.std() > 0.0):
        return TestResult(test, why_not="too few common poses")
    peak = float(np.corrcoef(steps, sizes)[0, 1])
    ratio = median(sizes) / max(median(steps), 1e-12)
    is_alike = peak > _STEPS_ALIKE and 1.0 / _ALIKE < ratio < _ALIKE
    seen = Detection.of("increments", peak=peak)
    return TestResult(test, {"peak": peak, "ratio": ratio}, (seen,) * is_alike)


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
        if as_world > 0.25 and as_body < min(0.2 * as_world, 0.1):
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
    scores = {"rate_hz": (len(estimate) - 1) / max(estimate.span_s, 1e-9)}
    if scores["rate_hz"] >= _SLOW_HZ:
        return TestResult("keyframes", scores)
    steps_s = np.diff(estimate.seconds)
    low, high = np.quantile(steps_s, [0.1, 0.9])
    scores["spread"] = float(high - low) / median(steps_s)
    is_thin = scores["spread"] > 0.5 and median(steps_s) > 4.0 * groundtruth.usual_step_s
    cause = "frames_lost" if is_odometry else "keyframes"
    seen = Detection.of(cause, rate_hz=scores["rate_hz"], of_hz=1.0 / float(low))
    return TestResult("keyframes", scores, (seen,) * is_thin)
