"""What of clocks and bodies is to be calibrated."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.marker import HandEye


@dataclass(frozen=True, eq=False)
class CalibrationRequest:
    """What to estimate from the data, or to apply as known.

    Attributes:
        offset: Estimate the clocks' offset, and apply it if it is significant.
        hand_eye: Likewise the body's rotation and lever arm.
        known: A hand-eye transform to apply, instead of one to be estimated.
        source: Where the known transform was read from.

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
        """Refuse a transform that is known and to be estimated.

        Raises:
            SettingsError: It is both.
        """
        if self.hand_eye and self.known is not None:
            raise SettingsError("a hand-eye transform is either known or estimated; give only one")

    @property
    def anything(self) -> bool:
        """Whether there is anything to do."""
        return self.offset or self.hand_eye or self.known is not None
