"""The published errors of all estimates: topics and transforms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rclpy.node import Node

from trajeval_ros.online.notices import Notice
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.ros.frame_broadcaster import FrameBroadcaster
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.publishers import Outputs
from trajeval_ros.ros.revised_outputs import RevisedOutputs


class LiveOutputs:
    """Publishes the errors of a run.

    Attributes:
        newest: The newest published errors by estimate.
        snapshots: The newest published state by estimate.
    """

    def __init__(
        self,
        node: Node,
        names: Iterable[str],
        broadcaster: FrameBroadcaster | None,
        *,
        judges: bool,
    ) -> None:
        """Create the publishers.

        Args:
            node: The ROS node.
            names: Names of the estimates.
            broadcaster: Publishes the alignments as transforms; None if it is not requested.
            judges: Whether covariances are tested.
        """
        self._node, self._broadcaster = node, broadcaster
        self._outputs = {each: Outputs(node, each, judges=judges) for each in names}
        self._revised: dict[str, RevisedOutputs] = {}
        self.newest: dict[str, Update] = {}
        self.snapshots: dict[str, Snapshot] = {}

    def advertise_lengths(self, lengths: Sequence[str]) -> None:
        """Create the publishers of relative errors for lengths of sub-trajectories."""
        for each in self._outputs.values():
            each.advertise_lengths(lengths)

    def begin_run(self) -> None:
        """Forget the errors of the previous run."""
        self.newest, self.snapshots = {}, {}

    def publish_update(self, run: LiveRun, estimate: LiveEstimate, update: Update) -> None:
        """Publish the errors of new pairs, and the alignment; needs a pair."""
        assert update.stamp is not None
        self.newest[estimate.name] = update
        frame = run.groundtruth.stream.status.frame
        self._outputs[estimate.name].publish_update(
            update, frame, estimate.offset_ns, knows_up=not estimate.doubt
        )
        if self._broadcaster is not None and estimate.evaluator.alignment is not None:
            self._broadcaster.publish(
                estimate.name,
                estimate.evaluator.alignment.similarity,
                update.stamp - estimate.offset_ns,
                frame,
                estimate.stream.status.frame,
            )

    def publish_snapshot(self, estimate: LiveEstimate) -> Snapshot:
        """Publish the errors of the window, and return them."""
        snapshot = estimate.snapshot()
        self.snapshots[estimate.name] = snapshot
        estimate.peaks.see_snapshot(snapshot)
        self._outputs[estimate.name].publish_snapshot(snapshot)
        return snapshot

    def publish_revised(self, run: LiveRun, estimate: LiveEstimate) -> float | None:
        """Publish the errors of the newest path if it is new; return its position ATE, metres."""
        truth = run.groundtruth.stream.status
        is_new = estimate.renew_slow(truth.child_frame)
        revised = estimate.slow.revised
        if revised is None:
            return None
        name = estimate.name
        if name not in self._revised:
            self._revised[name] = RevisedOutputs(self._node, name)
        if is_new:
            frames = truth.frame, estimate.stream.status.frame
            self._revised[name].publish(revised, (run.groundtruth_up, estimate.up), *frames)
        position = revised.ate["position_m"]
        return None if position is None else position.rmse

    def publish_geometry(self, run: LiveRun, estimate: LiveEstimate, snapshot: Snapshot) -> None:
        """Publish the paths, if there is an alignment."""
        if snapshot.alignment is not None:
            self._outputs[estimate.name].publish_geometry(
                estimate.trail,
                snapshot.alignment.similarity,
                run.groundtruth.stream.status.frame,
                estimate.stream.status.frame,
            )

    def notices(self, estimate: LiveEstimate) -> list[Notice]:
        """Return the conditions of an estimate's transform."""
        return [] if self._broadcaster is None else self._broadcaster.notices(estimate.name)
