"""The evaluated body, if the groundtruth is measured at a marker on it."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajeval_ros.calibration.calibrate import Calibration
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.requests.hand_eye_file import hand_eye_json
from trajeval_ros.io.requests.request_words import AUTO, NONE
from trajeval_ros.online.marker_rows import body_rows, marker_rows
from trajeval_ros.online.state_rows import VELOCITY
from trajeval_ros.ros.static_transform import StaticTransform


class MarkerBody:
    """The marker's pose in the body, given or estimated; transforms states by it.

    Attributes:
        source: Source of the pose: a file, frames, or `auto`; `none` for no marker.
        transform: Looks up the frames; None for other sources.
        hand_eye: The pose; None while it is unknown, or if it is not applied.
        of_marker: Whether the evaluated body is the marker: the groundtruth has no orientation, so
            the estimate is moved to the marker instead of the groundtruth to the body.
        why_not: Why the requested pose is not applied; else empty.
    """

    def __init__(
        self,
        source: str = NONE,
        known: HandEye | None = None,
        transform: StaticTransform | None = None,
        rotation_frame: str = "world",
    ) -> None:
        """Create it.

        Args:
            source: Source of the pose, as in the attribute.
            known: The pose, if a file contains it.
            transform: Looks up the frames.
            rotation_frame: Frame of the rotation errors in the estimates' covariances.
        """
        self.source, self.transform = source, transform
        self.hand_eye: HandEye | None = None
        self.of_marker = False
        self.why_not = ""
        self._found, self._rotation_frame = known, rotation_frame
        self._without: list[str] = []  # rotation or lever arm that is not applied, with the reason

    @property
    def is_wanted(self) -> bool:
        """Whether there is a marker."""
        return self.source != NONE

    def look(self, calibration: Calibration | None, *, is_spent: bool) -> bool:
        """Look for the pose; return whether to stop waiting.

        Args:
            calibration: Calibration of the first estimate so far.
            is_spent: Whether the time limit is reached.
        """
        if self.transform is not None:
            self._found = self.transform.take() or self._found
            self.why_not = self.transform.trouble
        elif self.source == AUTO and calibration is not None:
            turn, lever = calibration.turn, calibration.lever
            known = [each.value if each.is_significant else None for each in (turn, lever)]
            is_found = any(each is not None for each in known)
            self._found = HandEye.of(*known) if is_found else None
            self.why_not = f"rotation: {turn.reason}; lever arm: {lever.reason}"
            self._without = [
                f"no {what} ({each.reason})"
                for what, each in (("rotation", turn), ("lever arm", lever))
                if not each.is_significant
            ]
            return is_spent or not self._without
        return is_spent or self._found is not None

    def settle(self, *, is_oriented: bool, has_scale: bool) -> None:
        """Apply the pose from now on, if it is known.

        Args:
            is_oriented: Whether the groundtruth has orientations.
            has_scale: Whether the alignment has a scale.
        """
        if self._found is None:
            self.why_not = self.why_not or "not observable in the recording so far"
        elif not is_oriented and has_scale:
            self.why_not = (
                "a lever arm needs the scale of the whole run if the groundtruth has no "
                "orientations; apply it with trajeval finish FOLDER --hand-eye FILE"
            )
        else:
            self.hand_eye, self.of_marker = self._found, not is_oriented
            self.why_not = ""

    def truth(self, rows: Floats) -> Floats:
        """Return groundtruth states (N, 10) of the evaluated body."""
        if self.hand_eye is None or self.of_marker:
            return rows
        return body_rows(rows, self.hand_eye)

    def estimated(self, rows: Floats) -> Floats:
        """Return estimated states (N, 10) or (N, 46) of the evaluated body."""
        if self.hand_eye is None or not self.of_marker:
            return rows
        return marker_rows(rows, self.hand_eye, self._rotation_frame)

    def renamed(self, groundtruth: str, estimate: str) -> tuple[str, str]:
        """Return the names of the bodies of both sides in pairs."""
        if self.hand_eye is None:
            return groundtruth, estimate
        return self.hand_eye.names(groundtruth, estimate, of_marker=self.of_marker)

    def leaves_out_velocities_of(self, rows: Floats, *, is_truth: bool) -> bool:
        """Return whether states (N, 10) of a side have velocities that a lever arm invalidates."""
        if self.hand_eye is None or self.of_marker is is_truth:
            return False
        velocities = rows[:, VELOCITY]
        return bool(self.hand_eye.lever_m.any() and np.nan_to_num(velocities).any())

    @property
    def said(self) -> str:
        """A sentence for the warnings of the results; empty if there is nothing to report."""
        if self.why_not:
            return f"hand_eye {self.source} not applied: {self.why_not}"
        if self.hand_eye is None or self.source != AUTO:
            return ""
        turned_deg = float(np.degrees(lie.angle(self.hand_eye.rotation_xyzw)))
        x, y, z = self.hand_eye.lever_m.tolist()
        applied = (
            f"marker pose: rotation {turned_deg:.1f} deg, position ({x:.3f}, {y:.3f}, {z:.3f}) m"
        )
        without = f", {' and '.join(self._without)}" if self._without else ""
        return (
            f"{applied} in the body frame{without}; estimated from the start of the run and "
            "applied"
        )

    @property
    def state(self) -> dict[str, Any] | None:
        """The state for `trajeval finish`; None if nothing is applied."""
        if self.hand_eye is None:
            return None
        return {
            "source": self.source,
            "of_marker": self.of_marker,
            "T_body_marker": hand_eye_json(self.hand_eye),
        }
