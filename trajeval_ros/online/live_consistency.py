"""Live consistency test of covariances: a window is tested as a recorded run."""

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
    """Test the covariances of pairs, which are aligned on their own, as for recorded runs.

    Args:
        pairs: Pairs of a window, with the estimate's covariances.
        protocol: Protocol of the run.
        request: Settings of the test.

    Returns:
        The result, or None and the reason.
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
    """Return the integrity of a window: errors against protection levels; None if not available.

    Args:
        consistency: Consistency test of the window.
        request: Limits and risk; None if integrity is not configured.
        stamps: (N,) timestamps of its pairs, nanoseconds.
    """
    if consistency is None or request is None:
        return None
    from trajeval_ros.consistency.integrity import integrity_of  # imports scipy

    return integrity_of(consistency, request, stamps)
