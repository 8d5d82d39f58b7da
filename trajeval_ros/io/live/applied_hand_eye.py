"""The hand-eye transform that a live run applied to its messages before the association."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.hand_eye_file import hand_eye_of
from trajeval_ros.pipeline.outcome import RunOutcome
from trajeval_ros.pipeline.request import Request


@dataclass(frozen=True, eq=False)
class AppliedHandEye:
    """The hand-eye transform recorded in a pair file."""

    hand_eye: HandEye  # the transform
    source: str  # its source
    # Whether the estimate was converted to the marker, not the groundtruth to the body.
    of_marker: bool

    @classmethod
    def in_state(cls, state: Mapping[str, Any], path: str) -> AppliedHandEye | None:
        """Return the transform in a pair file's state; None if it has none."""
        recorded = state.get("hand_eye")
        if recorded is None:
            return None
        hand_eye = hand_eye_of(recorded["T_body_marker"], path)
        return cls(hand_eye, str(recorded["source"]), bool(recorded["of_marker"]))

    def require_no_other(self, request: Request, rotation_frame: str) -> None:
        """Refuse a request for another transform, which would be applied in addition."""
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
        self, groundtruth: Mapping[str, Any], estimate: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the descriptions of both sides with the names of the common body."""
        names = self.hand_eye.names(
            groundtruth["child_frame"], estimate["child_frame"], of_marker=self.of_marker
        )
        return {**groundtruth, "child_frame": names[0]}, {**estimate, "child_frame": names[1]}

    def judging(self, covariances: CovarianceRequest) -> CovarianceRequest:
        """Return a request for covariances that takes the groundtruth's noise at the marker."""
        if self.of_marker:
            return covariances
        return covariances.of_moved_groundtruth(self.hand_eye)

    def told(self, run: RunOutcome) -> RunOutcome:
        """Return a run whose outcome describes the applied transform."""
        from trajeval_ros.calibration.apply import moved_before

        calibrated = moved_before(
            run.evaluation, self.hand_eye, self.source, of_marker=self.of_marker
        )
        return dataclasses.replace(run, calibrated=calibrated)
