"""The published errors of estimates, under `~/NAME/`: topics and transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.frame_axes import between_own_axes
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.trajectory_edits import every_nth
from trajeval_ros.io.bags.encode_messages import (
    encode_alignment,
    encode_path,
    encode_paths,
    encode_stamped,
    encode_transforms,
)
from trajeval_ros.io.bags.pose_messages import TRANSFORM_TYPES
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.stream_health import StreamHealth
from trajeval_ros.online import error_topics as topics
from trajeval_ros.online.live_availability import LiveAvailability
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.online.whole_run import MOST_POSES
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.message_types import message_class
from trajeval_ros.ros.status_topics import advertise

if TYPE_CHECKING:
    from rclpy.node import Node


_QUEUE = 1000  # messages; all messages of a tick are published at once


class _Topics:
    """Publishers below one name, made when needed: `Float64` and `Vector3Stamped`."""

    def __init__(self, node: Node, prefix: str, *, latched: bool) -> None:
        self._node, self._prefix, self._is_latched = node, prefix, latched
        self._publishers: dict[str, Any] = {}

    def _latched(self, kind: Any, name: str) -> Any:
        """Return a publisher whose newest message late subscribers receive at once."""
        return advertise(self._node, kind, f"{self._prefix}/{name}", 1, latched=True)

    def advertise(self, name: str, kind: str = topics.NUMBER_TYPE) -> Any:
        """Return the publisher of numbers, or of vectors with timestamps."""
        if name not in self._publishers:
            depth = 1 if self._is_latched else 10 if kind == topics.NUMBER_TYPE else _QUEUE
            topic, made = f"{self._prefix}/{name}", message_class(kind)
            self._publishers[name] = advertise(
                self._node, made, topic, depth, latched=self._is_latched
            )
        return self._publishers[name]

    def advertise_parts(self, topic: str) -> None:
        """Create the publishers of a number for the position and of one for the rotation."""
        for part in topics.PARTS:
            self.advertise(f"{topic}/{part}", topics.VECTOR_TYPE)

    def _publish_parts(
        self, topic: str, stamps: Stamps, position_m: float | None, rotation_deg: float | None
    ) -> None:
        for name, vectors in topics.by_part(topic, position_m, rotation_deg).items():
            self._publish_vectors(name, stamps, vectors)

    def _publish(self, name: str, value: float | None) -> None:
        from std_msgs.msg import Float64

        if value is not None:
            self.advertise(name).publish(Float64(data=value))

    def _publish_vectors(
        self, name: str, stamps: Stamps, vectors: Floats, frame: str = ""
    ) -> None:
        publisher = self.advertise(name, topics.VECTOR_TYPE)
        if self._is_latched or publisher.get_subscription_count():
            for message in encode_stamped(stamps, vectors, frame):
                publisher.publish(message.tobytes())


class RevisedOutputs(_Topics):
    """Publishers of one estimate that is a path; all are latched, because paths may be rare."""

    def __init__(self, node: Node, name: str) -> None:
        from geometry_msgs.msg import TransformStamped
        from nav_msgs.msg import Path

        super().__init__(node, f"~/{name}/revised", latched=True)
        self._alignment = self._latched(TransformStamped, topics.ALIGNMENT)
        self._path = self._latched(Path, topics.ALIGNED_PATH)

    def publish(self, run: LiveRun, estimate: LiveEstimate, evaluation: Evaluation) -> None:
        """Publish the errors, the alignment and the aligned path of its newest version."""
        ups = run.groundtruth_up, estimate.up
        frame, child_frame = run.groundtruth_status.frame, estimate.status.frame
        stamps, positions = evaluation.aligned.stamps, evaluation.aligned.positions
        evaluated = [(topics.ATE, evaluation.ate)]
        evaluated += [
            (topics.relative_error_topic(str(item.length)), item.statistics)
            for item in evaluation.relative or ()
        ]
        for topic, statistics in evaluated:
            position, rotation = statistics["position_m"], statistics["rotation_deg"]
            if position is not None:
                rotation_deg = None if rotation is None else rotation.rmse
                self._publish_parts(topic, stamps[-1:], position.rmse, rotation_deg)
        similarity = evaluation.alignment.similarity
        rotations = evaluation.aligned.quaternions
        assert rotations is not None  # of a path
        if evaluation.protocol.is_upright:
            similarity, back = between_own_axes(similarity, *ups), ups[0].matrix.T
            positions = positions @ back.T
            rotations = lie.multiply(lie.from_matrices(back[None]), rotations)
        self._alignment.publish(encode_alignment(similarity, stamps[-1:], (frame, child_frame)))
        picked = every_nth(len(stamps), MOST_POSES)
        self._path.publish(
            encode_path(stamps[picked], positions[picked], rotations[picked], frame)
        )


class StreamOutputs(_Topics):
    """Publishers of the health of one source's messages."""

    def __init__(self, node: Node, name: str) -> None:
        super().__init__(node, f"~/stream/{name}", latched=False)
        for stream_number in topics.STREAM_NUMBERS:
            self.advertise(stream_number)

    def publish(self, health: StreamHealth) -> None:
        """Publish what is known of the newest messages."""
        for name, field in topics.STREAM_NUMBERS.items():
            self._publish(name, getattr(health, field))


class FrameBroadcaster:
    """Broadcasts one transform per frame of the estimates.

    A frame has one parent. If another node publishes a different parent of an estimate's frame,
    the TF tree is invalid.
    """

    def __init__(self, node: Node, gauge: Gauge, tolerance_s: float) -> None:
        if gauge.has_scale:
            raise SettingsError(
                f"broadcast_tf can't publish gauge {gauge.value}, since a transform has no "
                "scale; remove it, or use a gauge without scale"
            )
        kind = message_class(TRANSFORM_TYPES[0])
        if kind is None:
            raise SettingsError("broadcast_tf needs tf2_msgs; install ros-$ROS_DISTRO-tf2-msgs")
        self._publisher = advertise(node, kind, "/tf")
        self._tolerance_ns = round(tolerance_s * NANOSECONDS)
        self._owners: dict[str, str] = {}
        self._refused: dict[str, Remark] = {}

    def publish(
        self, name: str, alignment: Similarity, stamp: int, frame: str, child_frame: str
    ) -> None:
        """Publish an estimate's alignment."""
        owner = self._owners.setdefault(child_frame, name)
        why = ""
        if not frame or not child_frame or frame == child_frame:
            why = f"two frame names are required, found {frame!r} and {child_frame!r}"
        elif owner != name:
            why = f"{child_frame} is also the frame of {owner}, and a frame has only one parent"
        self._refused.pop(name, None)
        if why:
            text = f"broadcast_tf:=true has no effect for {name}: {why}"
            self._refused[name] = warning("hint", text, "broadcast_tf")
            return
        pose = np.concatenate([alignment.translation, alignment.rotation_xyzw])
        stamps = np.array([stamp + self._tolerance_ns])
        self._publisher.publish(
            bytes(encode_transforms(stamps, pose[None], (frame, child_frame))[0])
        )

    def remarks(self, name: str) -> list[Remark]:
        """Return why the alignment of an estimate is not broadcast; empty if it is."""
        return [self._refused[name]] if name in self._refused else []


class EstimateOutputs(_Topics):
    """All that is published of one estimate: numbers, vectors with timestamps, alignment, paths.

    PlotJuggler and rqt_plot can draw the numbers.
    """

    def __init__(
        self, node: Node, name: str, broadcaster: FrameBroadcaster | None, *, judges: bool
    ) -> None:
        from geometry_msgs.msg import TransformStamped
        from nav_msgs.msg import Path

        super().__init__(node, f"~/{name}", latched=False)
        self._name, self._broadcaster = name, broadcaster
        self._revised: RevisedOutputs | None = None
        by_covariances = (
            (*topics.NEES_NUMBERS, *topics.PROTECTION_LEVELS.values()) if judges else ()
        )
        for number in (*topics.NUMBERS, *by_covariances):
            self.advertise(number)
        for topic in topics.VECTORS:
            self.advertise(topic, topics.VECTOR_TYPE)
        self.advertise_parts(topics.ATE)
        self._alignment = self._latched(TransformStamped, topics.ALIGNMENT)
        self._paths = {
            item: self._latched(Path, item)
            for item in (topics.ALIGNED_PATH, topics.GROUNDTRUTH_PATH)
        }

    def publish_update(self, run: LiveRun, estimate: LiveEstimate, update: Update) -> None:
        """Publish the errors of new pairs and of ended sub-trajectories, and the transform.

        The update has a pair.
        """
        assert update.stamp is not None
        frame, offset_ns = run.groundtruth_status.frame, estimate.offset_ns
        for topic in topics.VECTORS:
            if not self._publishers[topic].get_subscription_count():
                continue  # vectors without a subscriber are not computed
            for errors in update.errors:
                vectors = topics.vectors_of(errors, topic, offset_ns)
                self._publish_vectors(topic, *vectors, frame)
        for name, numbers_of in topics.NUMBERS.items() if update.errors else ():
            numbers = numbers_of(update.errors[-1])
            self._publish(name, None if numbers is None else float(numbers[-1]))
        for end in update.ends:
            topic, stamps = topics.relative_error_topic(end.length), [end.stamp - offset_ns]
            self._publish_parts(topic, np.array(stamps), end.position_m, end.rotation_deg)
        alignment = estimate.evaluator.alignment
        if self._broadcaster is not None and alignment is not None:
            frames = frame, estimate.status.frame
            stamp = update.stamp - offset_ns
            self._broadcaster.publish(self._name, alignment.similarity, stamp, *frames)

    def publish_report(
        self, run: LiveRun, estimate: LiveEstimate
    ) -> tuple[Snapshot, float | None]:
        """Publish the window, as-available errors, the newest path if it is new, and the paths.

        Returns:
            The errors of the window, and the position ATE of the newest path, metres.
        """
        snapshot = estimate.snapshot()
        estimate.peaks.see_snapshot(snapshot)
        self._publish_window(snapshot, estimate.offset_ns)
        if estimate.availability is not None:
            self._publish_available(run, estimate, estimate.availability)
        revised_m = self._publish_revised(run, estimate)
        if snapshot.alignment is not None and len(estimate.thinned):
            self._publish_geometry(run, estimate, snapshot.alignment.similarity)
        return snapshot, revised_m

    def _publish_window(self, snapshot: Snapshot, offset_ns: int) -> None:
        for topic, ate in topics.window_ate(snapshot).items():
            assert snapshot.stamp is not None  # since there are pairs
            self._publish_vectors(topic, np.array([snapshot.stamp - offset_ns]), ate)
        for numbers in (topics.nees_numbers, topics.integrity_numbers):
            for name, number in numbers(snapshot).items():
                self._publish(name, number)

    def _publish_available(
        self, run: LiveRun, estimate: LiveEstimate, errors: LiveAvailability
    ) -> None:
        """Publish the newest error that is final now, and all of them as vectors."""
        alignment = estimate.evaluator.alignment
        errors.update(None if alignment is None else alignment.similarity, estimate.offset_ns)
        for name, number in errors.numbers.items():
            self._publish(name, number)
        if errors.newest is not None:
            vectors, frame = errors.newest.position.sum(axis=0), run.groundtruth_status.frame
            self._publish_vectors(topics.AVAILABLE_ERROR, errors.newest.stamps, vectors, frame)

    def _publish_revised(self, run: LiveRun, estimate: LiveEstimate) -> float | None:
        """Publish the errors of the newest path if it is new; return its position ATE, metres."""
        is_new = estimate.renew_slow(run.groundtruth_status.child_frame)
        revised = estimate.slow.revised
        if revised is None:
            return None
        self._revised = self._revised or RevisedOutputs(self._node, self._name)
        if is_new:
            self._revised.publish(run, estimate, revised)
        position = revised.ate["position_m"]
        return None if position is None else position.rmse

    def _publish_geometry(
        self, run: LiveRun, estimate: LiveEstimate, alignment: Similarity
    ) -> None:
        """Publish the alignment, and paths in the groundtruth's frame."""
        pairs = estimate.thinned.pairs()
        frames = run.groundtruth_status.frame, estimate.status.frame
        self._alignment.publish(encode_alignment(alignment, pairs.stamps[-1:], frames))
        for name, path in encode_paths(pairs, alignment, frames[0]).items():
            self._paths[name].publish(path)

    @property
    def remarks(self) -> list[Remark]:
        """Why the transform is not broadcast, if it is requested; empty if it is."""
        return [] if self._broadcaster is None else self._broadcaster.remarks(self._name)
