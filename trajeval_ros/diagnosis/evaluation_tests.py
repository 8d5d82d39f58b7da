"""Test of the number of pairs: the alignment removes most of the error of a few pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.constant_covariances import constant_covariances
from trajeval_ros.diagnosis.findings import Examined, Seen
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.statistics import median

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation
    from trajeval_ros.metrics.protocol import Protocol


def few_pairs(protocol: Protocol, pairs: Association) -> str:
    """Return the note of the ATE line if there are too few pairs; else ""."""
    count = len(pairs)
    if count >= protocol.gauge.enough_pairs(protocol.align_states):
        return ""
    return f"{counted(count, 'pair')}, too few for an ATE"


def number_of_pairs(
    protocol: Protocol, pairs: Association, groundtruth: Trajectory, estimate: Trajectory
) -> Examined:
    """Test the number of pairs of two trajectories, with advice on how to get more."""
    name, scores = "number of pairs", {"pairs": float(len(pairs))}
    warning = few_pairs(protocol, pairs)
    if not warning:
        return Examined(name, scores)
    if protocol.gauge.has_translation:
        enough = protocol.gauge.enough_pairs(protocol.align_states)
        warning += (
            f": the alignment by {protocol.gauge.value} removes most of the error of fewer than "
            f"{enough} pairs"
        )
    more = (
        "evaluate a longer recording, or pair more poses with --max-time-difference and --max-gap"
    )
    step_s = median(np.diff(groundtruth.stamps)) / NANOSECONDS if len(groundtruth) > 1 else 0.0
    if groundtruth.kind == "points" and pairs.groundtruth_coverage == 1.0:
        more = "survey more points"
    elif step_s > pairs.rule.max_gap_s and pairs.rule.method == "linear":
        warning += (
            f"; the groundtruth has {counted(len(groundtruth), 'state')}, {step_s:.1f} s apart "
            f"(median), and the limit for interpolation is {pairs.rule.max_gap_s:g} s: for "
            "surveyed points, use --association groundtruth-stamps"
        )
    elif pairs.rule.method in ("nearest", "rpg", "evo"):
        warning += (
            f"; {len(groundtruth)} groundtruth states and {len(estimate)} estimated states are "
            f"paired within {pairs.rule.max_time_difference_s:g} s: change the limit with "
            "--max-time-difference SECONDS"
        )
    seen = Seen("few_pairs", {"text": warning, "more": more, **scores})
    return Examined(name, scores, (seen,))


_OFFSET = "frame offset"
_FEWEST_PAIRS = 10
_LEAST_OFFSET_M = 0.5
_OFFSET_SHARE = 0.98  # of the squared error
# The geoid is up to 107 m from the ellipsoid.
_VERTICAL, _GEOID_M = 0.1, (5.0, 110.0)


def frame_offset(evaluation: Evaluation) -> Examined:
    """Compare the errors with their mean, if the gauge assumes equal frames."""
    if evaluation.protocol.gauge is not Gauge.NONE:
        return Examined(_OFFSET, why_not="the alignment removes an offset")
    groundtruth = evaluation.association.groundtruth.positions
    apart = groundtruth - evaluation.aligned.positions
    mean = apart.mean(axis=0)
    total = float(np.mean(np.sum(apart**2, axis=1)))
    share = float(mean @ mean) / total if total > 0.0 else 0.0
    length = float(np.linalg.norm(mean))
    scores = {"offset_m": length, "share": share}
    # Smaller offsets are errors of the estimate.
    if len(apart) < _FEWEST_PAIRS or length < _LEAST_OFFSET_M or share < _OFFSET_SHARE:
        return Examined(_OFFSET, scores)
    up = evaluation.groundtruth.up.matrix[2]
    height = abs(float(mean @ up))
    level = float(np.sqrt(max(length**2 - height**2, 0.0)))
    is_geoid = level < _VERTICAL * height and _GEOID_M[0] < height < _GEOID_M[1]
    kind = ": probably heights above the ellipsoid and above the geoid" if is_geoid else ""
    offset = ", ".join(f"{component:.2f}" for component in mean)
    seen = Seen.of(
        "frames_apart", offset=offset, offset_m=length, percent=100.0 * share, kind=kind
    )
    return Examined(_OFFSET, scores, (seen,))


_COVARIANCES = "covariance blocks"
_FEWEST_COVARIANCES = 50
# Of decimal logarithms: least difference between the blocks, and largest of equal ones.
_APART, _SAME = 1.0, 0.25
_NEAR = 0.5
_DEGREES = float(np.log10(180.0 / np.pi))


def covariance_blocks(evaluation: Evaluation) -> Examined:
    """Compare errors with standard deviations, of positions and of rotations."""
    pairs, errors = evaluation.association, evaluation.absolute
    covariances = pairs.estimate.covariances
    if covariances is None or errors.rotation_deg is None or len(pairs) < _FEWEST_COVARIANCES:
        return Examined(_COVARIANCES, why_not="no covariances in use, or too few pairs")
    if constant_covariances(covariances):
        return Examined(_COVARIANCES, why_not="the covariances are constant")
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    usable = np.isfinite(variances).all(axis=1) & (variances > 0.0).all(axis=1)
    if np.count_nonzero(usable) < _FEWEST_COVARIANCES:
        return Examined(_COVARIANCES, why_not="the covariances are not positive")
    first, second = variances[usable, :3].sum(axis=1), variances[usable, 3:].sum(axis=1)
    position, rotation = errors.position_m[usable], np.radians(errors.rotation_deg[usable])
    as_read = _too_small(position, first), _too_small(rotation, second)
    exchanged = _too_small(position, second), _too_small(rotation, first)
    scores = {
        "position": as_read[0],
        "rotation": as_read[1],
        "position_if_exchanged": exchanged[0],
        "rotation_if_exchanged": exchanged[1],
    }
    if not min(*as_read, *exchanged) > 0.0:
        return Examined(_COVARIANCES, scores, why_not="the errors are zero")
    logs, others = np.log10(as_read), np.log10(exchanged)
    if np.ptp(logs) > _APART and np.ptp(others) < _SAME and np.abs(others).max() < _NEAR:
        seen = Seen.of(
            "covariance_order",
            as_read=as_read[0],
            as_read_rotation=as_read[1],
            exchanged=exchanged[0],
            exchanged_rotation=exchanged[1],
        )
        return Examined(_COVARIANCES, scores, (seen,))
    if abs(logs[0]) < _SAME and abs(logs[1] + _DEGREES) < _SAME:
        seen = Seen.of("covariance_degrees", times=1.0 / as_read[1])
        return Examined(_COVARIANCES, scores, (seen,))
    return Examined(_COVARIANCES, scores)


def _too_small(errors: Floats, variances: Floats) -> float:
    """Return the ratio of errors and standard deviations, median over N states of three axes."""
    return float(np.sqrt(median(errors**2 / variances)))
