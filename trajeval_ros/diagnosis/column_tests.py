"""Tests for columns with other contents: degrees, increments, row numbers, two dimensions."""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.findings import Detection, TestResult
from trajeval_ros.diagnosis.input_pair import FEWEST, SAMPLE, InputPair, TimedPoses, lengths
from trajeval_ros.diagnosis.input_tests import other_side, sides_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, extents
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.trajectory_edits import every_nth
from trajeval_ros.metrics.statistics import median

_NUMBERS_S = 1e7  # the largest row number; timestamps since 1970 are larger
_METRES_PER_DEG, _FACTOR = 111_320.0, 4.0  # of latitude; of longitude it is less
_DEGREES, _LEAST_M = 0.1, 1.0  # largest extent in degrees, least motion
_FLAT = 0.05  # least rms height of the other side, as a fraction of its extent
_TILTS = 1e-3  # least change of a body's vertical axis
_ALIKE = 2.0  # largest ratio of durations or lengths of the same run
# Of increments: least correlation, largest extent relative to the groundtruth, and steps to add.
_STEPS_ALIKE, _SMALL, _TOGETHER = 0.8, 0.5, 10


def columns_of_others(inputs: InputPair) -> list[TestResult]:
    """Apply the tests of this file."""
    sides = sides_of(inputs)
    if min(map(len, sides.values())) < FEWEST:
        return []
    sizes = {side: extents(poses.positions) for side, poses in sides.items()}
    return [
        _row_numbers(inputs),
        _degrees(sides, sizes),
        _flat(sides, sizes, inputs.gauge),
        _increments(inputs),
    ]


def _row_numbers(inputs: InputPair) -> TestResult:
    stamps, others = inputs.estimate.stamps, inputs.groundtruth.stamps
    is_counted = bool((np.diff(stamps) == NANOSECONDS).all()) and stamps[0] < _NUMBERS_S * 1e9
    ratio = float(np.ptp(stamps)) / max(float(np.ptp(others)), 1.0)
    apart = not 1.0 / _ALIKE < ratio < _ALIKE or stamps[-1] < others[0]
    seen = (Detection("row_numbers"),) if inputs.by_time and is_counted and apart else ()
    return TestResult("row numbers", {"span_ratio": ratio}, seen)


def _degrees(sides: dict[str, TimedPoses], sizes: dict[str, Floats]) -> TestResult:
    for side, size in sizes.items():
        other, columns = other_side(side), np.argsort(size)[:2]
        extent, moved = (float(np.linalg.norm(one)) for one in (size[columns], sizes[other]))
        ratio = moved / max(extent * _METRES_PER_DEG, 1e-12)
        likely = 1.0 / _FACTOR < ratio < _FACTOR and extent < _DEGREES and moved > _LEAST_M
        if likely and (np.abs(sides[side].positions[:, columns]) <= 180.0).all():
            seen = Detection.of("degrees", side=side, other=other, path_m=moved, extent=extent)
            return TestResult("degrees", {"ratio": ratio}, (seen,))
    return TestResult("degrees")


def _flat(sides: dict[str, TimedPoses], sizes: dict[str, Floats], gauge: Gauge) -> TestResult:
    """Test for a constant column of one side while the other side moves in space.

    A side with roll and pitch is three-dimensional, and has a height that is not constant.
    """
    constant = {side: size == 0.0 for side, size in sizes.items()}
    for side in ("groundtruth", "estimate"):
        other = other_side(side)
        if np.count_nonzero(constant[side]) != 1 or constant[other].any():
            continue
        height_m, axis = float(sides[other].positions[:, 2].std()), constant[side].astype(float)
        tilts, quaternions = 0.0, sides[side].quaternions
        if quaternions is not None:
            some = lie.conjugate(quaternions[every_nth(len(quaternions), SAMPLE)])
            tilts = float(np.linalg.norm(extents(lie.rotate(some, axis))))
        is_high = height_m > _FLAT * sides[other].extent
        if gauge is not Gauge.PLANAR and (tilts > _TILTS or is_high):
            name = "xyz"[axis.argmax()]
            seen = Detection.of("flat", side=side, other=other, axis=name, height_m=height_m)
            return TestResult("flat", {"height_m": height_m}, (seen,))
    return TestResult("flat")


def _increments(inputs: InputPair) -> TestResult:
    """Compare the lengths of the estimate's positions with steps of the groundtruth."""
    test, (groundtruth, estimate) = "increments", inputs.in_order
    if not inputs.by_time or min(len(groundtruth), len(estimate)) < FEWEST:
        return TestResult(test, why_not="no timestamps")
    if estimate.extent > _SMALL * groundtruth.extent:
        return TestResult(test)
    at = groundtruth.at(estimate.seconds, inputs.max_gap_s)
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
    seen = (Detection.of(test, peak=peak),) if is_alike else ()
    return TestResult(test, {"peak": peak, "ratio": ratio}, seen)
