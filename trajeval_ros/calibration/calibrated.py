"""The result of an evaluation with calibration."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.calibration.calibrate import Calibration
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.metrics.evaluation import Evaluation


@dataclass(frozen=True)
class Ate:
    """The RMSE of an evaluation: position in metres, rotation in degrees if available."""

    position_m: float
    rotation_deg: float | None

    @classmethod
    def of(cls, evaluation: Evaluation) -> Ate:
        """Return the RMSE of an evaluation."""
        position, rotation = evaluation.ate["position_m"], evaluation.ate["rotation_deg"]
        assert position is not None
        return cls(position.rmse, None if rotation is None else rotation.rmse)


@dataclass(frozen=True, eq=False)
class Calibrated:
    """An evaluation with the applied calibration.

    Attributes:
        evaluation: The evaluation with the applied parameters.
        wanted: The request.
        calibration: The estimated parameters; None if nothing was estimated.
        estimated_from: Name of the estimate that they were estimated from.
        offset_applied: Whether the estimated offset is applied.
        rotation_applied: Whether a rotation of the body is applied.
        lever_applied: Whether a lever arm is applied.
        hand_eye: The applied transform; None if there is none.
        of_marker: Whether the errors are those of the marker's position. This is so if the
            groundtruth has no orientations, which a conversion to the body needs.
        before: The errors without calibration; None if there were too few pairs, or if `was_live`.
        after: The errors of `evaluation`.
        if_applied: The errors with all requested parameters, significant or not; None if these are
            the applied ones, or nothing was estimated.
        was_live: Whether a live run applied the transform to its messages.
    """

    evaluation: Evaluation
    wanted: CalibrationRequest
    calibration: Calibration | None
    estimated_from: str
    offset_applied: bool
    rotation_applied: bool
    lever_applied: bool
    hand_eye: HandEye | None
    of_marker: bool
    before: Ate | None
    after: Ate
    if_applied: Ate | None
    was_live: bool = False

    @property
    def parameters_applied(self) -> int:
        """Degrees of freedom of the applied parameters that were estimated from the data."""
        if self.calibration is None:
            return 0
        count = int(self.offset_applied)
        if self.wanted.known is None:
            count += self.calibration.turn.seen if self.rotation_applied else 0
            count += self.calibration.lever.seen if self.lever_applied else 0
        return count
