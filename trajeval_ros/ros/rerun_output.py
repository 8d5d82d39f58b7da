"""Output in Rerun, drawn on threads that never delay the node."""

from __future__ import annotations

import functools
import uuid
from collections.abc import Callable, Mapping, Sequence

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.formatting.remarks import Remark
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.metrics.discontinuities.events import Event
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.viewer.live_scene import LiveScene
from trajeval_ros.viewer.sinks import ServerTarget, sinks_for
from trajeval_ros.viewer.stream import DrawingThread, lower_priority

FILE = "run.rrd"


class RerunOutput:
    """Draws a live run on every sink that the parameter `rerun` names."""

    def __init__(
        self,
        value: str,
        run: LiveRun,
        gauge: Gauge,
        before: RerunOutput | None = None,
        modality: str | None = None,
    ) -> None:
        self._run = run
        self._streams: list[tuple[DrawingThread, LiveScene]] = []
        self._told: set[str] = set()
        self.trouble = ""  # why there is no picture, if one was requested
        self.address = ""  # for viewers; empty if nothing is served
        folder, names = run.folder, [estimate.name for estimate in run.estimates]
        try:
            for place, sink in enumerate(sinks_for(value, folder / FILE, str(uuid.uuid4()))):
                if isinstance(sink, ServerTarget):
                    self.address = sink.url
                scene = LiveScene(folder.name, names, gauge, modality)
                after = None if before is None else before._stream(place)
                self._streams.append((DrawingThread(sink, scene, after), scene))
        except TrajevalError as error:
            self.trouble = str(error)
        if self._streams:
            lower_priority()
            run.on_groundtruth = self._groundtruth
            for estimate in run.estimates:
                estimate.on_pairs = self._pairs

    def update(self, estimate: LiveEstimate, update: Update) -> None:
        """Show the errors of the newest pair."""
        name = estimate.name
        self._put(lambda scene: scene.update(name, update))

    def points(self, stamp: int, points: Floats) -> None:
        """Show points (N, 3) that were measured in the body of the first estimate."""
        estimate = self._run.estimates[0]
        name, at = estimate.name, stamp + estimate.offset_ns
        self._put(lambda scene: scene.points(name, at, points))

    def event(self, event: Event, text: str) -> None:
        """Show a discontinuity."""
        self._put(lambda scene: scene.event(event.end_ns, text))

    def snapshot(
        self, estimate: LiveEstimate, snapshot: Snapshot, revised_m: float | None
    ) -> None:
        """Show the errors of the window, the alignment, and the estimate's covariance."""
        name, stamp = estimate.name, snapshot.stamp
        if stamp is None:
            return
        errors = None if estimate.availability is None else estimate.availability.newest
        self._put(lambda scene: scene.snapshot(name, stamp, snapshot, revised_m, errors))
        uncertain = estimate.uncertainty() if self._streams else None
        if uncertain is not None:
            self._put(lambda scene: scene.uncertainty(name, *uncertain))

    def statuses(self, remarks: Mapping[str, Sequence[Remark]]) -> None:
        """Show the current remarks about estimates, by name."""
        for estimate in self._run.estimates:
            stamps = self._run.groundtruth_status.last, estimate.status.last
            known = [item for item in stamps if item is not None]
            if known and estimate.name in remarks:
                name, stamp, now = estimate.name, max(known), remarks[estimate.name]
                self._put(functools.partial(_show_status, name, stamp, now))

    def news(self) -> list[str]:
        """Return the problems that are new since the last call."""
        present = [
            self.trouble,
            *(stream.trouble or stream.absence for stream, _ in self._streams),
        ]
        new = [trouble for trouble in present if trouble and trouble not in self._told]
        self._told = set(present)
        return new

    @property
    def dropped(self) -> int:
        """Number of updates that a sink did not receive."""
        return sum(stream.dropped for stream, _ in self._streams)

    def close(self) -> list[str]:
        """Draw the end and write everything; return the problems."""
        for estimate in self._run.estimates:
            self.snapshot(estimate, estimate.snapshot(), None)
        for stream, _ in self._streams:
            stream.end()
        late = [stream.name for stream, _ in self._streams if not stream.close()]
        return [*self.news(), *(f"Rerun's {item} does not stop in time" for item in late)]

    def end(self) -> None:
        """Stop drawing without waiting, because the run is complete."""
        for stream, _ in self._streams:
            stream.end()

    def _stream(self, place: int) -> DrawingThread | None:
        return self._streams[place][0] if place < len(self._streams) else None

    def _groundtruth(self, states: Trajectory) -> None:
        status, up = self._run.groundtruth_status, self._run.groundtruth_up
        poses, fixes = StampedPoses.of(states), states.reading.fixes
        frames = status.frame, status.child_frame
        self._put(lambda scene: scene.groundtruth(*poses, up, *frames))
        if fixes is not None and fixes.datum is not None:
            self._put(lambda scene: scene.fixes(poses.stamps, fixes))

    def _pairs(self, estimate: LiveEstimate, pairs: PairedStates) -> None:
        name, frames = estimate.name, (estimate.status.frame, estimate.status.child_frame)
        groundtruth = StampedPoses.of(pairs.groundtruth).poses
        stamps, poses = StampedPoses.of(pairs.estimate)
        self._put(lambda scene: scene.pairs(name, stamps, groundtruth, poses, *frames))

    def _put(self, draw: Callable[[LiveScene], object]) -> None:
        for stream, scene in self._streams:
            stream.put(functools.partial(draw, scene))


def _show_status(name: str, stamp: int, remarks: Sequence[Remark], scene: LiveScene) -> None:
    scene.status(name, stamp, remarks)
