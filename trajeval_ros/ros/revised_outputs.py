"""The topics of the newest version of a path, under `~/NAME/revised/`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.thinning import every_nth
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.upright import between_own_axes
from trajeval_ros.io.bags.alignment_messages import encode_alignment
from trajeval_ros.io.bags.pose_messages import encode_path
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.online.error_topics import relative_error_topic
from trajeval_ros.online.trail import MOST_POSES
from trajeval_ros.ros.advertise import advertise

if TYPE_CHECKING:
    from rclpy.node import Node


class RevisedOutputs:
    """Publishers of one estimate that is a path; all are latched, because paths may be rare."""

    def __init__(self, node: Node, name: str) -> None:
        """Create the publishers that do not depend on settings."""
        from geometry_msgs.msg import TransformStamped
        from nav_msgs.msg import Path

        self._node, self._name = node, name
        self._numbers: dict[str, Any] = {}
        self._alignment = self._latched(TransformStamped, "alignment")
        self._path = self._latched(Path, "aligned_path")

    def publish(
        self, evaluation: Evaluation, ups: tuple[UpAxis, UpAxis], frame: str, child_frame: str
    ) -> None:
        """Publish the errors, the alignment and the aligned path of its newest version.

        Args:
            evaluation: Evaluation of that version.
            ups: The up axes of groundtruth and estimate.
            frame: Frame of the groundtruth.
            child_frame: Frame of the estimate.
        """
        for name in ("position_m", "rotation_deg"):
            statistics = evaluation.ate[name]
            if statistics is not None:
                self._publish(f"ate_{name.partition('_')[0]}", statistics.rmse)
        for segment in evaluation.segments or ():
            errors = segment.errors.position_m
            if len(errors):
                rmse_m = float(np.sqrt(np.mean(np.square(errors))))
                self._publish(relative_error_topic(str(segment.length)), rmse_m)
        similarity = evaluation.alignment.similarity
        stamps, positions = evaluation.aligned.stamps, evaluation.aligned.positions
        turns = evaluation.aligned.quaternions
        assert turns is not None  # of a path
        if evaluation.protocol.is_upright:
            similarity, back = between_own_axes(similarity, *ups), ups[0].matrix.T
            positions = positions @ back.T
            turns = lie.multiply(lie.from_matrices(back[None]), turns)
        self._alignment.publish(encode_alignment(similarity, stamps[-1:], (frame, child_frame)))
        picked = every_nth(len(stamps), MOST_POSES)
        self._path.publish(encode_path(stamps[picked], positions[picked], turns[picked], frame))

    def _publish(self, name: str, value: float) -> None:
        from std_msgs.msg import Float64

        if name not in self._numbers:
            self._numbers[name] = self._latched(Float64, name)
        self._numbers[name].publish(Float64(data=value))

    def _latched(self, kind: Any, name: str) -> Any:
        topic = f"~/{self._name}/revised/{name}"
        return advertise(self._node, kind, topic, 1, latched=True)
