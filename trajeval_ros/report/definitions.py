"""Definitions in words, for the titles of figures: a number without them is not a result."""

from __future__ import annotations

from collections.abc import Sequence

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.evaluation import Evaluation


def alignment_of(evaluations: Sequence[Evaluation]) -> str:
    """Say what alignment may change, and which states decide it."""
    protocol = evaluations[0].protocol
    if protocol.gauge is Gauge.NONE:
        return protocol.gauge.description
    used = {evaluation.alignment.states_used for evaluation in evaluations}
    if protocol.align_states == 1:
        states = "the first matched state"
    elif protocol.align_states is not None:
        states = f"the first {protocol.align_states} matched states"
    elif len(used) == 1:
        states = f"all {used.pop()} matched states"
    else:
        states = "all matched states"
    weighted = ", weighted" if protocol.align_weights != "none" else ""
    if protocol.apply == "scale":
        states += ", its scale alone applied"
    poses = " with orientations" if protocol.align_with == "poses" else ""
    return f"aligned by {protocol.gauge.description}, {states}{poses}{weighted}"


def absolute_form_of(evaluations: Sequence[Evaluation]) -> str:
    """Say which form of the absolute error it is."""
    if evaluations[0].protocol.ate_form == "tutorial":
        return "Absolute error, tutorial's eq. (23)"
    return "Absolute error, plain difference"


def first_state_alignment_of(evaluations: Sequence[Evaluation]) -> str:
    """Say how sub-trajectories are aligned at their first states."""
    protocol = evaluations[0].protocol
    if protocol.re_form == "fitted":
        return "each aligned by yaw and position over all its states"
    by_gauge = protocol.re_form in ("gauge", "tutorial")
    what = "yaw and translation" if by_gauge and protocol.gauge is Gauge.YAW else "SE(3)"
    if by_gauge and protocol.gauge is Gauge.PLANAR:
        what = "SE(2), 2-D errors"
    if protocol.gauge is Gauge.SIM3:
        what += " with the global scale"
    equation = ", tutorial's eq. (26)" if protocol.re_form == "tutorial" else ""
    return f"each aligned at its first state by {what}{equation}"


def why_no_rotation(evaluation: Evaluation) -> str:
    """Say why rotation errors are withheld."""
    return evaluation.withheld or positions_only(evaluation)


def positions_only(evaluation: Evaluation) -> str:
    """Say which side has no rotations."""
    pairs = evaluation.association
    sides = [
        who
        for who, side in (("groundtruth", pairs.groundtruth), ("estimate", pairs.estimate))
        if side.quaternions is None
    ]
    have = "has" if len(sides) == 1 else "have"
    return f"the {' and the '.join(sides)} {have} positions only"
