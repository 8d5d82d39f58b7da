"""Test of the number of pairs: the alignment removes most of the error of a few pairs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.covariance_request import constant_covariances
from trajeval_ros.diagnosis.findings import Detection, TestResult
from trajeval_ros.diagnosis.input_pair import FEWEST
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.statistics import median

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation
    from trajeval_ros.metrics.protocol import Protocol


_LEAST_OFFSET_M = 0.5  # smaller offsets are errors of the estimate
_OFFSET_SHARE = 0.98  # of the squared error
# Of a difference of heights: largest level part, and the geoid's distance from the ellipsoid.
_LEVEL, _GEOID_M = 0.1, (5.0, 110.0)
_FEWEST_COVARIANCES = 50
# Of decimal logarithms: least difference between the blocks, largest of equal ones, and largest
# value of covariances that fit the errors.
_APART, _SAME, _NEAR = 1.0, 0.25, 0.5


def few_pairs(protocol: Protocol, pairs: Association) -> str:
    """Return the note of the ATE line if there are too few pairs; else ""."""
    if len(pairs) >= protocol.gauge.enough_pairs(protocol.align_states):
        return ""
    return f"{counted(len(pairs), 'pair')}, too few for an ATE"


def number_of_pairs(
    protocol: Protocol, pairs: Association, groundtruth: Trajectory, estimate: Trajectory
) -> TestResult:
    """Test the number of pairs of two trajectories, with advice on how to get more."""
    test, scores, rule = "number of pairs", {"pairs": float(len(pairs))}, pairs.rule
    text, more = (
        few_pairs(protocol, pairs),
        "evaluate a longer recording, or pair more poses with ",
    )
    if not text:
        return TestResult(test, scores)
    if protocol.gauge.has_translation:
        enough = protocol.gauge.enough_pairs(protocol.align_states)
        text += (
            f": the alignment by {protocol.gauge.value} removes most of the error of fewer than "
            f"{enough} pairs"
        )
    more += "--max-time-difference and --max-gap"
    step_s = median(np.diff(groundtruth.stamps)) / NANOSECONDS if len(groundtruth) > 1 else 0.0
    if groundtruth.kind == "points" and pairs.groundtruth_coverage == 1.0:
        more = "survey more points"
    elif step_s > rule.max_gap_s and rule.method == "linear":
        text += (
            f"; the groundtruth has {counted(len(groundtruth), 'state')}, {step_s:.1f} s apart "
            f"(median), and the limit for interpolation is {rule.max_gap_s:g} s: for "
            "surveyed points, use --association groundtruth-stamps"
        )
    elif rule.method in ("nearest", "rpg", "evo"):
        text += (
            f"; {len(groundtruth)} groundtruth states and {len(estimate)} estimated states are "
            f"paired within {rule.max_time_difference_s:g} s: change the limit with "
            "--max-time-difference SECONDS"
        )
    return TestResult(test, scores, (Detection.of("few_pairs", text=text, more=more, **scores),))


def frame_offset(evaluation: Evaluation) -> TestResult:
    """Compare the errors with their mean, if the gauge assumes equal frames."""
    test = "frame offset"
    if evaluation.protocol.gauge is not Gauge.NONE:
        return TestResult(test, why_not="the alignment removes an offset")
    apart = evaluation.association.groundtruth.positions - evaluation.aligned.positions
    mean, total = apart.mean(axis=0), float(np.mean(np.sum(apart**2, axis=1)))
    share = float(mean @ mean) / total if total > 0.0 else 0.0
    length_m = float(np.linalg.norm(mean))
    scores = {"offset_m": length_m, "share": share}
    if len(apart) < FEWEST or length_m < _LEAST_OFFSET_M or share < _OFFSET_SHARE:
        return TestResult(test, scores)
    height = abs(float(mean @ evaluation.groundtruth.up.matrix[2]))
    level = math.sqrt(max(length_m**2 - height**2, 0.0))
    is_geoid = level < _LEVEL * height and _GEOID_M[0] < height < _GEOID_M[1]
    kind = ": probably heights above the ellipsoid and above the geoid" if is_geoid else ""
    offset = ", ".join(f"{component:.2f}" for component in mean)
    seen = Detection.of(
        "frames_apart", offset=offset, offset_m=length_m, percent=100.0 * share, kind=kind
    )
    return TestResult(test, scores, (seen,))


def covariance_blocks(evaluation: Evaluation) -> TestResult:
    """Compare errors with standard deviations, of positions and of rotations."""
    test, pairs, errors = "covariance blocks", evaluation.association, evaluation.absolute
    covariances = pairs.estimate.covariances
    if covariances is None or errors.rotation_deg is None or len(pairs) < _FEWEST_COVARIANCES:
        return TestResult(test, why_not="no covariances in use, or too few pairs")
    if constant_covariances(covariances):
        return TestResult(test, why_not="the covariances are constant")
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    usable = np.isfinite(variances).all(axis=1) & (variances > 0.0).all(axis=1)
    if np.count_nonzero(usable) < _FEWEST_COVARIANCES:
        return TestResult(test, why_not="the covariances are not positive")
    blocks = variances[usable].reshape(-1, 2, 3).sum(axis=2).T
    squares = np.square([errors.position_m[usable], np.radians(errors.rotation_deg[usable])])
    # Ratios of errors and standard deviations, median over states, as read and exchanged.
    names = "position", "rotation", "position_if_exchanged", "rotation_if_exchanged"
    ratios = [math.sqrt(median(row)) for some in (blocks, blocks[::-1]) for row in squares / some]
    scores = dict(zip(names, ratios, strict=True))
    if not min(ratios) > 0.0:
        return TestResult(test, scores, why_not="the errors are zero")
    logs, others = np.log10(ratios).reshape(2, 2)
    seen: tuple[Detection, ...] = ()
    if np.ptp(logs) > _APART and np.ptp(others) < _SAME and np.abs(others).max() < _NEAR:
        names = "as_read", "as_read_rotation", "exchanged", "exchanged_rotation"
        seen = (Detection("covariance_order", dict(zip(names, ratios, strict=True))),)
    elif abs(logs[0]) < _SAME and abs(logs[1] + math.log10(math.degrees(1.0))) < _SAME:
        seen = (Detection.of("covariance_degrees", times=1.0 / ratios[1]),)
    return TestResult(test, scores, seen)
