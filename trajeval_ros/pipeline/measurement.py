"""The errors of one estimate: prepared, calibrated, associated and aligned, in this order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.diagnose import require_conventions
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.preparation import (
    Inputs,
    at_discontinuities,
    corrected_and_cut,
    in_world_axes,
)
from trajeval_ros.pipeline.request import Request

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Calibrated


def measured(
    given: Inputs,
    request: Request,
    same_as: Calibrated | None = None,
    *,
    compares: bool = True,
) -> tuple[Inputs, Calibrated | None, Evaluation]:
    """Correct, cut, calibrate, associate, align and compute the errors of one estimate.

    A calibration `compares` errors with those without it.
    """
    inputs, protocol = in_world_axes(corrected_and_cut(given, request), request)
    offset_s = protocol.association.time_offset_s
    inputs = at_discontinuities(inputs, request.discontinuities, offset_s)
    calibrated = _calibrated(inputs, protocol, request, same_as, compares=compares)
    if calibrated is None:
        return inputs, None, inputs.evaluated(protocol)
    evaluation = calibrated.evaluation
    if calibrated.hand_eye is not None:  # a side has another body now
        streams = inputs.streams
        if streams is not None:
            revised = streams[1]
            if calibrated.of_marker:
                revised = calibrated.hand_eye.of_marker(revised, 1.0)
            streams = evaluation.groundtruth, revised
        inputs = Inputs(evaluation.groundtruth, evaluation.estimate, inputs.pairs, streams)
    return inputs, calibrated, evaluation


def _calibrated(
    inputs: Inputs,
    protocol: Protocol,
    request: Request,
    same_as: Calibrated | None,
    *,
    compares: bool,
) -> Calibrated | None:
    """Estimate or apply the clock and the body, and evaluate; None if neither is requested."""
    groundtruth, estimate, pairs = inputs.groundtruth, inputs.estimate, inputs.pairs
    if not request.calibration.anything:
        return None
    if request.calibration.hand_eye:
        require_conventions(groundtruth, estimate, protocol, pairs)
    from trajeval_ros.calibration.apply import evaluate_calibrated

    return evaluate_calibrated(
        groundtruth,
        estimate,
        protocol,
        request.calibration,
        same_as=same_as,
        pairs=pairs,
        compares=compares,
    )
