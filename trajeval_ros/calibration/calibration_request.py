"""Request for a calibration."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.marker import HandEye


@dataclass(frozen=True, eq=False)
class CalibrationRequest:
    """Parameters to estimate from the data, or to apply as known.

    Attributes:
        offset: Estimate the clock offset, and apply it if it is significant.
        hand_eye: Estimate the body's rotation and lever arm, and apply them likewise.
        known: A hand-eye transform to apply instead of estimating one.
        source: Source of the known transform.

    Raises:
        SettingsError: A transform is both known and to be estimated.

    Example:
        >>> from trajeval_ros import CalibrationRequest
        >>> CalibrationRequest(offset=True, hand_eye=True).anything
        True
    """

    offset: bool = False
    hand_eye: bool = False
    known: HandEye | None = None
    source: str = ""

    def __post_init__(self) -> None:
        if self.hand_eye and self.known is not None:
            raise SettingsError("a hand-eye transform is either known or estimated; give only one")

    @property
    def anything(self) -> bool:
        """Whether a calibration is requested."""
        return self.offset or self.hand_eye or self.known is not None
