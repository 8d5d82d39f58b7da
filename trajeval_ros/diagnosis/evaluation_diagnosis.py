"""The diagnosis of an evaluation: tests of the input and of the errors."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.both_sides import Recording
from trajeval_ros.diagnosis.covariance_blocks import covariance_blocks
from trajeval_ros.diagnosis.few_pairs import number_of_pairs
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.diagnosis.frame_offsets import frame_offset
from trajeval_ros.diagnosis.mistakes import diagnose
from trajeval_ros.diagnosis.small_offsets import small_clock_offset
from trajeval_ros.exceptions import InputError
from trajeval_ros.metrics.association import associate

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.metrics.evaluation import Evaluation
    from trajeval_ros.metrics.protocol import Protocol

# With such a finding, the errors contain no information on small offsets and covariances.
_GRAVE = 5.2  # of ranks
# A smaller coarse offset, in seconds or cells, is not significant.
_NONE_S, _NONE_CELLS = 0.005, 0.05


def diagnose_evaluation(
    evaluation: Evaluation, groundtruth: Trajectory, estimate: Trajectory, *, paired: bool = False
) -> Diagnosis:
    """Search for mistakes that affect an evaluation.

    Args:
        evaluation: The evaluation of the two trajectories.
        groundtruth: Evaluated groundtruth in the order of its source.
        estimate: Evaluated estimate in the order of its source, without the time offset.
        paired: Whether the trajectories contain only the pairs, row by row.
    """
    protocol, pairs = evaluation.protocol, evaluation.association
    time_offset_s = None
    if paired or pairs.rule.method == "index":
        groundtruth, estimate, time_offset_s = pairs.groundtruth, pairs.estimate, 0.0
        protocol = dataclasses.replace(protocol, association=pairs.rule)
    elif protocol.lever_m is not None:
        groundtruth, estimate = evaluation.groundtruth, evaluation.estimate
    recording = Recording.of(groundtruth, estimate, protocol, time_offset_s=time_offset_s)
    found = diagnose(recording)
    number = number_of_pairs(protocol, pairs, evaluation.groundtruth, evaluation.estimate)
    examined = [number, *found.examined, frame_offset(evaluation)]
    if all(each.rank < _GRAVE for each in found.findings):
        if _may_be_apart(found):
            examined.append(small_clock_offset(evaluation, *recording.in_order))
        examined.append(covariance_blocks(evaluation))
    return Diagnosis.of(examined)


def diagnose_sides(groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol) -> Diagnosis:
    """Search for mistakes in two trajectories that can't be evaluated.

    Raises:
        InputError: A side has no usable pose.
    """
    groundtruth.require_usable()
    estimate.require_usable()
    found = diagnose(Recording.of(groundtruth, estimate, protocol))
    try:
        pairs = associate(groundtruth, estimate, protocol.association)
    except InputError:  # no pairs: their number is not the cause
        return found
    number = number_of_pairs(protocol, pairs, groundtruth, estimate)
    return Diagnosis.of([number, *found.examined])


def require_conventions(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol, pairs: Association | None
) -> None:
    """Refuse a hand-eye calibration of poses with a wrong convention.

    The calibration would confuse a mirrored axis with a body rotated by 180 deg.

    Raises:
        InputError: A convention is wrong.
    """
    if pairs is not None:
        groundtruth, estimate = pairs.groundtruth, pairs.estimate
    groundtruth.require_usable()
    estimate.require_usable()
    offset_s = None if pairs is None else 0.0
    recording = Recording.of(groundtruth, estimate, protocol, time_offset_s=offset_s)
    found = diagnose(recording).of_conventions()
    if found is not None:
        raise InputError(f"--hand-eye auto needs correct conventions, but {found.text}")


def _may_be_apart(found: Diagnosis) -> bool:
    """Return whether a search on a finer grid can find an offset."""
    clocks = next((each.scores for each in found.examined if each.test == "clocks"), {})
    if "offset_s" not in clocks or clocks["peak"] < clocks["usable_from"]:
        return True
    return abs(clocks["offset_s"]) > max(_NONE_S, _NONE_CELLS * clocks["cell_s"])
