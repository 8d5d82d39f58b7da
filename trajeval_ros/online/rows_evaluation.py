"""Offline evaluation of pairs from a live run."""

from __future__ import annotations

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.upright import upright
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.evaluation import Evaluation, evaluate_pairs
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.state_rows import Pairs, trajectory


def evaluate_rows(
    pairs: Pairs, protocol: Protocol, ups: tuple[UpAxis, UpAxis]
) -> Evaluation | None:
    """Return the evaluation of pairs; its coverage is a placeholder.

    Args:
        pairs: Pairs between the frames' own axes.
        protocol: The settings.
        ups: The up axes of groundtruth and estimate.

    Returns:
        None if the pairs cannot be evaluated, for example too few.
    """
    if not len(pairs.stamps):
        return None
    truth = trajectory(pairs.stamps, pairs.groundtruth, ups[0])
    estimate = trajectory(pairs.stamps, pairs.estimate, ups[1])
    if protocol.is_upright:
        truth, estimate = upright(truth), upright(estimate)
    association = Association(
        rule=protocol.association,
        groundtruth=truth,
        estimate=estimate,
        estimate_coverage=1.0,
        coverage=Coverage(1.0, 1.0),
        dropped={},
    )
    try:
        return evaluate_pairs(association, truth, estimate, protocol)
    except TrajevalError:
        return None
