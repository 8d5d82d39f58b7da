"""Comparison of the ATE by association with poor groundtruth against accurate groundtruth.

It applies the probabilistic paper's argument for continuous groundtruth to any pair of
trajectories.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.likelihood.assessment import assess
from trajeval_ros.metrics.association import AssociationRule
from trajeval_ros.metrics.evaluation import Evaluation, evaluate
from trajeval_ros.metrics.protocol import Protocol

_ANY_GAP_S = 1e6


@dataclass(frozen=True)
class ReportedAte:
    """The ATE by one association.

    Attributes:
        association: The association in words.
        ate_m: Position ATE, metres; None if there is none.
        share: Share of the estimate's poses in the ATE.
        interval_m: Interval of the ATE against exact groundtruth; None if not available.
        reason: Why there is no number; empty if there is one.
    """

    association: str
    ate_m: float | None
    share: float
    interval_m: tuple[float, float] | None = None
    reason: str = ""


@dataclass(frozen=True)
class AssociationComparison:
    """The comparison for one estimate.

    Attributes:
        name: Name of the estimate.
        true_ate_m: ATE against all of the accurate groundtruth, interpolated.
        reported: The ATE against the poor groundtruth by association.
    """

    name: str
    true_ate_m: float
    reported: tuple[ReportedAte, ...]


def compare_associations(
    groundtruth: Trajectory,
    poor: Trajectory,
    estimate: Trajectory,
    protocol: Protocol,
) -> AssociationComparison:
    """Compare associations of one estimate.

    Args:
        groundtruth: Accurate and dense groundtruth.
        poor: Poor groundtruth made from it, for example by `degradation.Degradation`.
        estimate: The estimate.
        protocol: Gauge and alignment; its association is `continuous`, with the model and the
            noise of the poor groundtruth.

    Raises:
        InputError: The accurate groundtruth cannot be used.
        DegenerateGeometryError: The states do not determine the alignment.
    """

    def ruled(rule: AssociationRule) -> Protocol:
        return dataclasses.replace(protocol, association=rule, lengths=())

    modelled = protocol.association
    base = dataclasses.replace(modelled, method="linear")
    true = _position_ate(evaluate(groundtruth, estimate, ruled(base)))
    nearest = dataclasses.replace(base, method="nearest")
    plain = {
        f"nearest, within {base.max_time_difference_s:g} s": nearest,
        "nearest, every pose": dataclasses.replace(modelled, model="nearest"),
        f"linear, gaps up to {base.max_gap_s:g} s": base,
        "linear, every pose": dataclasses.replace(base, max_gap_s=_ANY_GAP_S),
    }
    reported = [_plain(name, poor, estimate, ruled(rule)) for name, rule in plain.items()]
    reported += _continuous(poor, estimate, ruled(modelled))
    return AssociationComparison(estimate.name, true, tuple(reported))


def _plain(name: str, poor: Trajectory, estimate: Trajectory, protocol: Protocol) -> ReportedAte:
    """Return the ATE by an association without uncertainty."""
    try:
        found = evaluate(poor, estimate, protocol)
    except TrajevalError as error:
        return ReportedAte(name, None, 0.0, reason=str(error))
    return ReportedAte(name, _position_ate(found), _covered(found))


def _continuous(poor: Trajectory, estimate: Trajectory, protocol: Protocol) -> list[ReportedAte]:
    """Return the ATEs by the continuous association: plain, weighted, of supported poses."""
    model = protocol.association.model
    names = [f"{model}, {which}" for which in ("plain", "weighted", "supported")]
    try:
        found = evaluate(poor, estimate, protocol)
        ate = assess(found).ate
    except TrajevalError as error:
        return [ReportedAte(name, None, 0.0, reason=str(error)) for name in names]
    covered = _covered(found)
    nowhere = "" if ate.supported_m is not None else "the groundtruth is too uncertain everywhere"
    return [
        ReportedAte(names[0], _position_ate(found), covered),
        ReportedAte(names[1], ate.weighted_m, covered),
        ReportedAte(
            names[2], ate.supported_m, covered * ate.supported_share, ate.interval_m, nowhere
        ),
    ]


def _covered(evaluation: Evaluation) -> float:
    """Return the share of estimated poses in a pair."""
    covered = evaluation.association.estimate_coverage
    assert covered is not None  # pairs are at the estimate's stamps
    return covered


def _position_ate(evaluation: Evaluation) -> float:
    """Return the position ATE, metres."""
    statistics = evaluation.ate["position_m"]
    assert statistics is not None
    return statistics.rmse
