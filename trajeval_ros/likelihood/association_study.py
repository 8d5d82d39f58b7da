"""What each association would have reported on poor groundtruth, beside what good one says.

The probabilistic paper's argument for continuous groundtruth, on any pair of trajectories.
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
    """What one association says.

    Attributes:
        association: In words.
        ate_m: Position ATE, metres; None where it gives none.
        share: Share of the estimate's poses that it is of.
        interval_m: Of the ATE that exact groundtruth would give; None where it says nothing.
        reason: Why there is no number; empty if there is.
    """

    association: str
    ate_m: float | None
    share: float
    interval_m: tuple[float, float] | None = None
    reason: str = ""


@dataclass(frozen=True)
class AssociationComparison:
    """Of one estimate.

    Attributes:
        name: The estimate's.
        true_ate_m: Against all of the good groundtruth, interpolated.
        reported: By each association, against the poor one.
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
        groundtruth: Good and dense.
        poor: Made of it, such as by `degradation.Degradation`.
        estimate: To be evaluated.
        protocol: Gauge and alignment; its association is `continuous`, with the model and the
            noise of the poor groundtruth's samples.

    Raises:
        InputError: The good groundtruth can't be used either.
        DegenerateGeometryError: Likewise.
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
    try:
        found = evaluate(poor, estimate, protocol)
    except TrajevalError as error:
        return ReportedAte(name, None, 0.0, reason=str(error))
    return ReportedAte(name, _position_ate(found), _covered(found))


def _continuous(poor: Trajectory, estimate: Trajectory, protocol: Protocol) -> list[ReportedAte]:
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
    covered = evaluation.association.estimate_coverage
    assert covered is not None  # pairs are at the estimate's stamps
    return covered


def _position_ate(evaluation: Evaluation) -> float:
    statistics = evaluation.ate["position_m"]
    assert statistics is not None
    return statistics.rmse
