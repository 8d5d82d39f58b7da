"""Output in Rerun, drawn on threads that never delay the node."""

from __future__ import annotations

import functools
import uuid
from collections.abc import Callable
from dataclasses import replace

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.io.fix_rows import fixes_of_rows
from trajeval_ros.online.jump_detector import Jump
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.online.state_rows import Pairs
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.poses import StateColumns
from trajeval_ros.viewer.live_scene import LiveScene
from trajeval_ros.viewer.sinks import ServerTarget, sinks_for
from trajeval_ros.viewer.stream import DrawingThread, give_way

FILE = "run.rrd"


class RerunOutput:
    """Draws a live run on every sink that the parameter `rerun` names.

    Attributes:
        trouble: Why there is no picture; empty if there is one, or none was requested.
        address: Address for viewers; empty if nothing is served.
    """

    def __init__(
        self, value: str, run: LiveRun, gauge: Gauge, before: RerunOutput | None = None
    ) -> None:
        """Start to draw; `news` reports sinks that are not available, and the node continues.

        Args:
            value: Value of the parameter `rerun`.
            run: The run to draw.
            gauge: Gauge of its alignments.
            before: Picture of the previous run, which ends.
        """
        self._run = run
        self._streams: list[tuple[DrawingThread, LiveScene]] = []
        self._told: set[str] = set()
        self.trouble = self.address = ""
        folder = run.folders.finisher.folder
        names = [each.name for each in run.estimates]
        try:
            for place, sink in enumerate(sinks_for(value, folder / FILE, str(uuid.uuid4()))):
                if isinstance(sink, ServerTarget):
                    self.address = sink.url
                scene = LiveScene(folder.name, names, gauge)
                after = None if before is None else before._ending(place)
                self._streams.append((DrawingThread(sink, scene, after), scene))
        except TrajevalError as error:
            self.trouble = str(error)
        if self._streams:
            give_way()
            run.watch = self._groundtruth
            for each in run.estimates:
                each.watch = self._pairs

    def update(self, estimate: LiveEstimate, update: Update) -> None:
        """Show the errors of the newest pair."""
        name = estimate.name
        self._put(lambda scene: scene.update(name, update))

    def jump(self, estimate: LiveEstimate, jump: Jump) -> None:
        """Show a jump of an estimate."""
        name = estimate.name
        text = f"{name} jumps by {jump.position_m:.2f} m and {jump.rotation_deg:.0f} deg"
        self._put(lambda scene: scene.event(name, jump.stamp, text))

    def snapshot(
        self, estimate: LiveEstimate, snapshot: Snapshot, revised_m: float | None
    ) -> None:
        """Show the errors of the window, the alignment, and the estimate's covariance."""
        name, stamps = estimate.name, estimate.evaluator.store.stamps()
        if not len(stamps):
            return
        stamp = int(stamps[-1])
        self._put(lambda scene: scene.snapshot(name, stamp, snapshot, revised_m))
        uncertain = estimate.uncertainty() if self._streams else None
        if uncertain is not None:
            self._put(lambda scene: scene.uncertainty(name, *uncertain))

    def news(self) -> list[str]:
        """Return the problems since the last call."""
        troubles = [self.trouble, *(stream.trouble for stream, _ in self._streams)]
        new = [each for each in troubles if each and each not in self._told]
        self._told.update(new)
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
        return [*self.news(), *(f"Rerun's {each} does not stop in time" for each in late)]

    def _ending(self, place: int) -> DrawingThread | None:
        if place >= len(self._streams):
            return None
        stream, _ = self._streams[place]
        stream.end()
        return stream

    def _groundtruth(self, poses: StateColumns, epoch: int) -> None:
        up, datum = self._run.groundtruth_up, self._run.groundtruth.stream.fixes.datum
        self._put(lambda scene: scene.groundtruth(poses.stamps, poses.states, up, epoch))
        if poses.fixes is not None and datum is not None:
            as_sent = fixes_of_rows(poses.fixes[:, :3], poses.fixes[:, 3:])
            fixes = replace(as_sent, datum=datum)
            self._put(lambda scene: scene.fixes(poses.stamps, fixes))

    def _pairs(self, estimate: LiveEstimate, pairs: Pairs) -> None:
        name, segment = estimate.name, (estimate.epoch, estimate.segment)
        self._put(lambda scene: scene.pairs(name, *pairs, segment))

    def _put(self, draw: Callable[[LiveScene], object]) -> None:
        for stream, scene in self._streams:
            stream.put(functools.partial(draw, scene))
