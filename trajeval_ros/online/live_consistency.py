"""Whether covariances fit errors while a run goes on: of a window, as of a recorded run."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.evaluation import evaluate_pairs
from trajeval_ros.metrics.protocol import Protocol

if TYPE_CHECKING:
    from trajeval_ros.consistency.integrity import Integrity, IntegrityRequest
    from trajeval_ros.consistency.result import Consistency


def judge_window(
    pairs: Association, protocol: Protocol, request: CovarianceRequest
) -> tuple[Consistency | None, str]:
    """Judge the covariances of pairs, aligned by themselves, by the rules of recorded runs.

    Args:
        pairs: Those of a window, with the estimate's covariances.
        protocol: Of the run.
        request: Whether to judge at all, and how.

    Returns:
        What was found, or why it can't be told.
    """
    if request.source == "none":
        return None, ""
    from trajeval_ros.consistency.judge import judge  # imports scipy

    protocol = dataclasses.replace(protocol, lengths=())
    try:
        evaluation = evaluate_pairs(pairs, pairs.groundtruth, pairs.estimate, protocol)
        return judge(evaluation, request), ""
    except TrajevalError as error:
        return None, str(error)


def window_integrity(
    consistency: Consistency | None, request: IntegrityRequest | None, stamps: Stamps
) -> Integrity | None:
    """Return how errors of a window keep to their protection levels; None if it can't be told.

    Args:
        consistency: Of the window.
        request: Limits and risk; None if nobody asked.
        stamps: (N,) of its pairs, ns.
    """
    if consistency is None or request is None:
        return None
    from trajeval_ros.consistency.integrity import integrity_of  # imports scipy

    return integrity_of(consistency, request, stamps)
