"""The hand-eye transform that a live run has applied to messages before it paired them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.requests.hand_eye_file import hand_eye_of
from trajeval_ros.pipeline.outcome import RunOutcome
from trajeval_ros.pipeline.request import Request


@dataclass(frozen=True, eq=False)
class AppliedHandEye:
    """What a pair file says of it.

    Attributes:
        hand_eye: The transform.
        source: Where it was from.
        of_marker: Whether the estimate was moved to the marker, instead of the groundtruth to the
            body.
    """

    hand_eye: HandEye
    source: str
    of_marker: bool

    @classmethod
    def in_state(cls, state: Mapping[str, Any], path: str) -> AppliedHandEye | None:
        """Return what a state of a pair file holds; None for nothing.

        Raises:
            InputError: It is no transform.
        """
        found = state.get("hand_eye")
        if found is None:
            return None
        hand_eye = hand_eye_of(found["T_body_marker"], path)
        return cls(hand_eye, str(found["source"]), bool(found["of_marker"]))

    def require_no_other(self, request: Request, rotation_frame: str) -> None:
        """Refuse a request for another one, which would come on top of it.

        Args:
            request: What is asked for now.
            rotation_frame: Axes of rotation covariances that it was applied by.

        Raises:
            SettingsError: It asks for another one, or for covariances about other axes.
        """
        asked = request.covariances
        if self.of_marker and asked.source == "message" and asked.rotation_frame != rotation_frame:
            raise SettingsError(
                "the live run has moved covariances by a lever arm, taking their rotations to be "
                f"about the {rotation_frame}'s axes; set rotation_covariance_frame for the node, "
                "or evaluate a bag"
            )
        if request.calibration.hand_eye or request.calibration.known is not None:
            raise SettingsError(
                f"the live run has applied hand_eye {self.source} to its messages; remove "
                "--hand-eye, or evaluate a bag"
            )

    def renamed(
        self, truth: Mapping[str, Any], estimate: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return what is known of both sides, of the same body now."""
        names = self.hand_eye.names(
            truth["child_frame"], estimate["child_frame"], of_marker=self.of_marker
        )
        return {**truth, "child_frame": names[0]}, {**estimate, "child_frame": names[1]}

    def told(self, run: RunOutcome) -> RunOutcome:
        """Return a run that says what was applied."""
        from trajeval_ros.calibration.apply import moved_before

        calibrated = moved_before(
            run.evaluation, self.hand_eye, self.source, of_marker=self.of_marker
        )
        return dataclasses.replace(run, calibrated=calibrated)
