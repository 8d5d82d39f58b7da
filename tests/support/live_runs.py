"""Live runs that tests feed by hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from ros_bags import ODOM, PATH, POSE, TRANSFORMS, Message, messages_of, path_message
from strategies import make_pair

from trajeval_ros import CovarianceRequest
from trajeval_ros.cli.app import main
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.requests.request_from import protocol_from
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.reports import Update
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun, RunPlan
from trajeval_ros.ros.live_runs import LiveRuns
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.pose_source import PoseSource, TimeAt
from trajeval_ros.ros.poses import PoseStream
from trajeval_ros.ros.recorded_state import write_states
from trajeval_ros.ros.start_decision import StartDecision
from trajeval_ros.ros.subscriptions import ReceivedMessages
from trajeval_ros.ros.transform_stream import TransformStream

GROUNDTRUTH, ESTIMATE = "/groundtruth", "/vio"
COUNT = 160
WORDS = {"modality": None, "align_states": None, "association": None, "max_time_difference": None,
         "max_gap": None, "time_offset": None, "ate_form": None, "re_form": None}  # fmt: skip


class QueueSource:
    """A source whose messages a test hands over."""

    lost = 0
    loss_is_exact = True
    mixed = ""
    silent_s = 0.0
    waits_s = 0.0

    def __init__(self, topic: str, kind: str) -> None:
        self.source, self.name, self.kind = topic, topic.strip("/"), kind
        self.stream: PoseStream = PoseStream(topic, covariances=topic == ESTIMATE)
        if kind == TRANSFORMS:
            self.stream = TransformStream(topic, "map", "base")
        self.queue: list[bytes] = []

    def take(
        self, time_at: TimeAt | None
    ) -> list[tuple[str, ReceivedMessages, NDArray[np.int64]]]:
        assert time_at is not None
        taken, self.queue = self.queue, []
        stamps = time_at(np.zeros(len(taken), np.int64))
        return [(self.kind, ReceivedMessages(taken, stamps.tolist()), stamps)] if taken else []


class Live:
    """Live runs that are fed by hand; all but the first have folders with a number."""

    def __init__(
        self,
        folder: Path,
        kind: str,
        *,
        find_offset: bool = False,
        limits: BufferLimits | None = None,
        body: MarkerBody | None = None,
        groundtruth_kind: str = POSE,
        covariances: CovarianceRequest | None = None,
        available: AvailabilityRule | None = None,
        at_time_jumps: bool = True,
        at_restarts: bool = False,
        others: Sequence[str] = (),
        **words: Any,
    ) -> None:
        folder.mkdir(parents=True)
        self.folder = folder
        self.groundtruth, self.estimate = (
            QueueSource(GROUNDTRUTH, groundtruth_kind),
            QueueSource(ESTIMATE, kind),
        )
        others_ = {other: QueueSource(other, kind) for other in others}
        self._by_topic = {GROUNDTRUTH: self.groundtruth, ESTIMATE: self.estimate, **others_}
        words = {**WORDS, "gauge": "yaw", "lengths": "2,4", **words}
        self.folders = [folder]
        self.begun: list[str] = []  # why runs began
        self.closed: list[Path] = []
        self._settings = OnlineSettings(
            protocol_from("default", **words),
            limits=limits,
            covariances=covariances,
            available=available,
        )
        self._words, self._find_offset, self._body = words, find_offset, body
        self._worker = ThreadPoolExecutor(1)
        self.runs = LiveRuns(
            self._sources,
            self._new_run,
            self._new_folder,
            at_time_jumps=at_time_jumps,
            at_restarts=at_restarts,
        )
        self.runs.on_begun = lambda _, begun: self.begun.append(begun.began_by)
        self.runs.on_closed = self._close
        self.now_ns = 0
        self.on_update: Callable[[LiveEstimate, Update], object] = lambda *_: None

    @property
    def _sources(self) -> list[PoseSource]:
        return [cast("PoseSource", item) for item in self._by_topic.values()]

    def _new_run(self) -> LiveRun:
        start = StartDecision(self._body or MarkerBody(), find_offset=self._find_offset)
        is_default = self._words["gauge"] is None and self._words.get("modality") is None
        plan = RunPlan(self._sources, self._settings, start, self._worker, {}, is_default)
        return LiveRun(plan, self.folders[-1])

    def _new_folder(self) -> Path:
        folder = self.folder.with_name(f"{self.folder.name}_{len(self.folders) + 1}")
        folder.mkdir()
        self.folders.append(folder)
        return folder

    def _close(self, run: LiveRun, troubles: list[str]) -> None:
        assert troubles == []
        self.closed.append(run.folder)

    @property
    def run(self) -> LiveRun:
        """The newest run."""
        return self.runs.current

    def feed(self, messages: Sequence[Message]) -> list[Update]:
        """Let messages arrive together; returns what was published of them."""
        for topic, _, logged, payload in messages:
            self._by_topic[topic].queue.append(payload)
            self.now_ns = logged
        self.runs.take(self._time_at)
        updates = []
        for estimate, update in self.runs.update():
            estimate.digest()
            self.on_update(estimate, update)
            updates.append(update)
        return updates

    def _time_at(self, received: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.full(len(received), self.now_ns)

    def reset(self) -> None:
        folder = self._new_folder()
        assert folder == self.folders[-1]
        self.runs.reset(self._time_at)

    def end(self) -> None:
        self.runs.conclude(self._time_at)
        write_states(self.run)
        assert self.run.close() == []
        self._worker.shutdown()

    def finish(self, *options: str) -> int:
        return main(["finish", str(self.folder), "--quiet", *options])

    @property
    def results(self) -> list[Any]:
        """The results of all runs."""
        result = []
        for folder in self.folders:
            assert main(["finish", str(folder), "--quiet", "--json", str(folder / "r.json")]) == 0
            result.append(json.loads((folder / "r.json").read_text()))
        return result

    @property
    def result(self) -> Any:
        """The result of the first run."""
        file = self.folder / "result.json"
        assert self.finish("--json", str(file)) == 0
        return json.loads(file.read_text())


def messages(seed: int, kind: str = ODOM) -> list[Message]:
    """Return both topics' messages in order of their stamps."""
    pair = make_pair(seed, COUNT, smooth=True)
    both = [
        *messages_of(pair.groundtruth, GROUNDTRUTH, POSE),
        *messages_of(pair.estimate, ESTIMATE, kind),
    ]
    return sorted(both, key=lambda item: item[2])


def batches(feed: list[Message], cuts: Sequence[int]) -> list[list[Message]]:
    return [[feed[row] for row in part] for part in np.split(np.arange(len(feed)), sorted(cuts))]


def path_messages(final: Trajectory, step: int) -> list[Message]:
    """Return a path that grows by some poses each time, and is right in its last version only."""
    assert final.quaternions is not None
    result = []
    for number, end in enumerate(range(step, len(final) + step, step)):
        aside_m = 0.8 * (number % 2) if end < len(final) else 0.0
        places = final.positions[:end] + [aside_m, 0.0, 0.0]
        stamps, rotations = final.stamps[:end].tolist(), final.quaternions[:end]
        result.append(
            (ESTIMATE, PATH, stamps[-1], path_message(stamps, places.tolist(), rotations))
        )
    return result
