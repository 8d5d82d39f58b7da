"""The published errors of all estimates, under `~/NAME/`: topics and transforms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
from trajeval_ros.geometry.up_axis import UpAxis
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
from trajeval_ros.online.whole_run import MOST_POSES, ThinnedRun
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

    def publish(
        self, evaluation: Evaluation, ups: tuple[UpAxis, UpAxis], frame: str, child_frame: str
    ) -> None:
        """Publish the errors, the alignment and the aligned path of its newest version."""
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


class Outputs(_Topics):
    """Publishers of one estimate: numbers, vectors with timestamps, the alignment, and paths.

    PlotJuggler and rqt_plot can draw the numbers.
    """

    def __init__(self, node: Node, name: str, *, judges: bool) -> None:
        from geometry_msgs.msg import TransformStamped
        from nav_msgs.msg import Path

        super().__init__(node, f"~/{name}", latched=False)
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

    def publish_update(self, update: Update, frame: str, offset_ns: int) -> None:
        """Publish the errors of new pairs, and of sub-trajectories that have ended."""
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

    def publish_snapshot(self, snapshot: Snapshot, offset_ns: int) -> None:
        """Publish the errors of the window."""
        for topic, ate in topics.window_ate(snapshot).items():
            assert snapshot.stamp is not None  # since there are pairs
            self._publish_vectors(topic, np.array([snapshot.stamp - offset_ns]), ate)
        for numbers in (topics.nees_numbers, topics.integrity_numbers):
            for name, number in numbers(snapshot).items():
                self._publish(name, number)

    def publish_available(self, errors: LiveAvailability, frame: str) -> None:
        """Publish the newest as-available errors, and all of them as vectors."""
        for name, number in errors.numbers.items():
            self._publish(name, number)
        if errors.newest is not None:
            vectors = errors.newest.position.sum(axis=0)
            topic = topics.AVAILABLE_ERROR
            self._publish_vectors(topic, errors.newest.stamps, vectors, frame)

    def publish_geometry(
        self, thinned: ThinnedRun, alignment: Similarity, frame: str, child_frame: str
    ) -> None:
        """Publish the alignment, and paths in the groundtruth's frame."""
        if not len(thinned):
            return
        pairs, frames = thinned.pairs(), (frame, child_frame)
        self._alignment.publish(encode_alignment(alignment, pairs.stamps[-1:], frames))
        for name, path in encode_paths(pairs, alignment, frame).items():
            self._paths[name].publish(path)


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


class LiveOutputs:
    """Publishes the errors of a run."""

    def __init__(
        self,
        node: Node,
        names: Iterable[str],
        broadcaster: FrameBroadcaster | None,
        *,
        judges: bool,
    ) -> None:
        self._node, self._broadcaster = node, broadcaster
        self._outputs = {name: Outputs(node, name, judges=judges) for name in names}
        self._revised: dict[str, RevisedOutputs] = {}
        self._streams: dict[str, StreamOutputs] = {}  # by name of the source

    def advertise_lengths(self, lengths: Sequence[str]) -> None:
        """Create the publishers of relative errors for lengths of sub-trajectories."""
        for output in self._outputs.values():
            for length in lengths:
                output.advertise_parts(topics.relative_error_topic(length))

    def publish_update(self, run: LiveRun, estimate: LiveEstimate, update: Update) -> None:
        """Publish the errors of new pairs, and the alignment; needs a pair."""
        assert update.stamp is not None
        frame = run.groundtruth_status.frame
        self._outputs[estimate.name].publish_update(update, frame, estimate.offset_ns)
        if self._broadcaster is not None and estimate.evaluator.alignment is not None:
            self._broadcaster.publish(
                estimate.name,
                estimate.evaluator.alignment.similarity,
                update.stamp - estimate.offset_ns,
                frame,
                estimate.status.frame,
            )

    def publish_streams(self, run: LiveRun) -> None:
        """Publish the health of the messages of all sources."""
        for place, source in enumerate(run.plan.sources):
            if source.name not in self._streams:
                self._streams[source.name] = StreamOutputs(self._node, source.name)
            self._streams[source.name].publish(run.status_of(place).stream.recent())

    def publish_snapshot(self, estimate: LiveEstimate) -> Snapshot:
        """Publish the errors of the window, and return them."""
        snapshot = estimate.snapshot()
        estimate.peaks.see_snapshot(snapshot)
        self._outputs[estimate.name].publish_snapshot(snapshot, estimate.offset_ns)
        return snapshot

    def publish_available(self, run: LiveRun, estimate: LiveEstimate) -> None:
        """Publish the as-available errors that are final now."""
        assert estimate.availability is not None
        errors, alignment = estimate.availability, estimate.evaluator.alignment
        errors.update(None if alignment is None else alignment.similarity, estimate.offset_ns)
        frame = run.groundtruth_status.frame
        self._outputs[estimate.name].publish_available(errors, frame)

    def publish_revised(self, run: LiveRun, estimate: LiveEstimate) -> float | None:
        """Publish the errors of the newest path if it is new; return its position ATE, metres."""
        groundtruth = run.groundtruth_status
        is_new = estimate.renew_slow(groundtruth.child_frame)
        revised = estimate.slow.revised
        if revised is None:
            return None
        name = estimate.name
        if name not in self._revised:
            self._revised[name] = RevisedOutputs(self._node, name)
        if is_new:
            frames = groundtruth.frame, estimate.status.frame
            self._revised[name].publish(revised, (run.groundtruth_up, estimate.up), *frames)
        position = revised.ate["position_m"]
        return None if position is None else position.rmse

    def publish_geometry(self, run: LiveRun, estimate: LiveEstimate, snapshot: Snapshot) -> None:
        """Publish the paths, if there is an alignment."""
        if snapshot.alignment is not None:
            self._outputs[estimate.name].publish_geometry(
                estimate.thinned,
                snapshot.alignment.similarity,
                run.groundtruth_status.frame,
                estimate.status.frame,
            )

    def remarks(self, estimate: LiveEstimate) -> list[Remark]:
        """Return the conditions of an estimate's transform."""
        return [] if self._broadcaster is None else self._broadcaster.remarks(estimate.name)
