"""Results of the pairs in the window, as for a recorded run of these pairs."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors, absolute_errors
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.evaluation import evaluate_pairs, meaningful
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.statistics import Statistics, statistics_of

if TYPE_CHECKING:
    from trajeval_ros.consistency.integrity import Integrity, IntegrityRequest
    from trajeval_ros.consistency.result import Consistency


def window_statistics(
    pairs: Association, alignment: Alignment, protocol: Protocol
) -> dict[str, Statistics | None]:
    """Return statistics of the absolute errors by metric, under the alignment of the run."""
    errors = absolute_errors(
        pairs.groundtruth,
        alignment.similarity.trajectory(pairs.estimate),
        rotation=not alignment.why_withheld(protocol),
    )
    errors = meaningful(errors, alignment, protocol.gauge)
    return {name: statistics_of(getattr(errors, name)) for name in AbsoluteErrors.__annotations__}


def judge_window(
    pairs: Association | None, protocol: Protocol, request: CovarianceRequest
) -> tuple[Consistency | None, str]:
    """Test the covariances of pairs, which are aligned on their own.

    Args:
        pairs: The pairs, with the estimate's covariances; None if there are none.
        protocol: Protocol of the run.
        request: Settings of the test.

    Returns:
        The result, or None and the reason.
    """
    if request.source == "none":
        return None, ""
    if pairs is None:
        return None, "no pairs yet"
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
