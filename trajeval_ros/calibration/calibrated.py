"""The result of an evaluation with calibration."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.calibration.calibrate import Calibration
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.metrics.evaluation import Evaluation


@dataclass(frozen=True)
class Ate:
    """The rmse of an evaluation: position in metres, rotation in degrees if it is known."""

    position_m: float
    rotation_deg: float | None

    @classmethod
    def of(cls, evaluation: Evaluation) -> Ate:
        """Take it from an evaluation."""
        position, rotation = evaluation.ate["position_m"], evaluation.ate["rotation_deg"]
        assert position is not None
        return cls(position.rmse, None if rotation is None else rotation.rmse)


@dataclass(frozen=True, eq=False)
class Calibrated:
    """An evaluation and what was calibrated for it.

    Attributes:
        evaluation: With what was applied.
        wanted: What was asked for.
        calibration: What was estimated; None if nothing had to be.
        estimated_from: Name of the estimate that it was estimated from.
        offset_applied: Whether the estimated offset is in the numbers.
        rotation_applied: Whether a rotation of the body is.
        lever_applied: Whether a lever arm is.
        hand_eye: What was applied; None for nothing.
        of_marker: Whether the errors are of the marker's position, since its groundtruth has no
            orientation that could tell the body's.
        before: The errors without any of it; None if no poses matched, or too few to be aligned,
            or `was_live`.
        after: Those of `evaluation`.
        if_applied: Those with all that was asked for, significant or not; None if that is what
            was applied, or nothing was found.
        was_live: Whether it was applied to messages as they came, of which only pairs are left.
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
        """Degrees of freedom that were taken from the data and are in the numbers."""
        if self.calibration is None:
            return 0
        count = int(self.offset_applied)
        if self.wanted.known is None:
            count += self.calibration.turn.seen if self.rotation_applied else 0
            count += self.calibration.lever.seen if self.lever_applied else 0
        return count
