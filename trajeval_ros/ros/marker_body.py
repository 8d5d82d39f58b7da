"""The evaluated body, if the groundtruth is measured at a marker on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.calibration.calibrate import Calibration
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.pose_messages import TRANSFORM_TYPES, decode_transforms
from trajeval_ros.io.bags.transform_tree import Edge, EdgeKey, fixed_transform
from trajeval_ros.io.hand_eye_file import hand_eye_json
from trajeval_ros.io.requests.setting import AUTO, NONE
from trajeval_ros.online.live_frames import at_marker
from trajeval_ros.ros.message_types import require_installed
from trajeval_ros.ros.subscriptions import TopicInput

if TYPE_CHECKING:
    from rclpy.node import Node


_MOST_EDGES = 10_000


class StaticTransform:
    """Looks up the transform between two frames, `/tf_static:BODY.MARKER`."""

    def __init__(self, node: Node, source: str) -> None:
        topic, _, frames = source.partition(":")
        self._body, dot, self._marker = (item.strip("/ ") for item in frames.partition("."))
        if not (self._body and dot and self._marker):
            raise SettingsError(
                f"hand_eye {source!r} has no pair of frames; write body and marker frame as in "
                "/tf_static:base_link.marker"
            )
        require_installed(TRANSFORM_TYPES[0], f"hand_eye {source}", "give a file")
        self.source = source  # the source in the notation of the user
        # Why the transform is not known yet; empty when it is.
        self.trouble = f"{source}: no static transform received so far"
        self._input = TopicInput(node, topic, TRANSFORM_TYPES[:1], is_static=True)
        self._edges: dict[EdgeKey, Edge] = {}

    def match(self) -> str:
        """Connect to the present publishers; return a sentence for the log."""
        return self._input.match()

    def leave(self) -> None:
        """Unsubscribe."""
        self._input.leave()

    def take(self) -> HandEye | None:
        """Process new transforms; return the marker's pose in the body, None if not known yet."""
        payloads = self._input.take().payloads
        if not payloads:
            return None
        for key, columns in decode_transforms(payloads)[0].items():
            if key in self._edges or len(self._edges) < _MOST_EDGES:
                edge = Edge.from_columns(columns.stamps, columns.numbers, True)
                if len(edge.stamps):
                    self._edges[key] = edge
        try:
            lever_m, quaternion = fixed_transform(
                self._edges, self._body, self._marker, self.source.partition(":")[0]
            )
        except InputError as error:
            self.trouble = str(error)
            return None
        self.trouble = ""
        return HandEye(quaternion, lever_m, self._body, self._marker)


class MarkerBody:
    """The marker's pose in the body, given or estimated; transforms states by it.

    Its source is a file, frames, or `auto`; `none` for no marker. If the groundtruth has no
    orientation, the evaluated body is the marker: the estimate is moved to the marker instead of
    the groundtruth to the body.
    """

    def __init__(
        self,
        source: str = NONE,
        known: HandEye | None = None,
        transform: StaticTransform | None = None,
        rotation_frame: str = "world",
    ) -> None:
        self.source, self.transform = source, transform
        self.hand_eye: HandEye | None = None  # None while unknown, or if it is not applied
        self.of_marker = False  # whether the evaluated body is the marker
        self.why_not = ""  # why the requested pose is not applied; else empty
        self._found, self._rotation_frame = known, rotation_frame
        self._without: list[str] = []  # rotation or lever arm that is not applied, with the reason

    @property
    def is_wanted(self) -> bool:
        """Whether there is a marker."""
        return self.source != NONE

    def look(self, calibration: Calibration | None, *, is_spent: bool) -> bool:
        """Look for the pose; return whether to stop waiting."""
        if self.transform is not None:
            self._found = self.transform.take() or self._found
            self.why_not = self.transform.trouble
        elif self.source == AUTO and calibration is not None:
            rotation, lever = calibration.rotation, calibration.lever
            known = [item.value if item.is_significant else None for item in (rotation, lever)]
            is_found = any(item is not None for item in known)
            self._found = HandEye.of(*known) if is_found else None
            self.why_not = f"rotation: {rotation.reason}; lever arm: {lever.reason}"
            self._without = [
                f"no {what} ({item.reason})"
                for what, item in (("rotation", rotation), ("lever arm", lever))
                if not item.is_significant
            ]
            return is_spent or not self._without
        return is_spent or self._found is not None

    def settle(self, *, is_oriented: bool, has_scale: bool) -> None:
        """Apply the pose from now on, if it is known."""
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

    def groundtruth(self, states: Trajectory) -> Trajectory:
        """Return groundtruth states of the evaluated body; none without orientations."""
        if self.hand_eye is None or self.of_marker:
            return states
        return states[:0] if states.quaternions is None else self.hand_eye.of_body(states)

    def estimated(self, states: Trajectory) -> Trajectory:
        """Return estimated states of the evaluated body; none without orientations."""
        if self.hand_eye is None or not self.of_marker:
            return states
        if states.quaternions is None:
            return states[:0]
        return at_marker(states, self.hand_eye, self._rotation_frame)

    def renamed(self, groundtruth: str, estimate: str) -> tuple[str, str]:
        """Return the names of the bodies of both sides in pairs."""
        if self.hand_eye is None:
            return groundtruth, estimate
        return self.hand_eye.names(groundtruth, estimate, of_marker=self.of_marker)

    @property
    def text(self) -> str:
        """A sentence for the warnings of the results; empty if there is nothing to report."""
        if self.why_not:
            return f"hand_eye {self.source} not applied: {self.why_not}"
        if self.hand_eye is None or self.source != AUTO:
            return ""
        angle_deg = float(np.degrees(lie.angle(self.hand_eye.rotation_xyzw)))
        x, y, z = self.hand_eye.lever_m.tolist()
        without = f", {' and '.join(self._without)}" if self._without else ""
        return (
            f"marker pose: rotation {angle_deg:.1f} deg, position ({x:.3f}, {y:.3f}, {z:.3f}) m "
            f"in the body frame{without}; estimated from the start of the run and applied"
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
