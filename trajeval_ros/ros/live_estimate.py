"""One estimate while it is evaluated: messages in, errors and a pair file out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.consistency.marginal_covariances import unknown_covariances
from trajeval_ros.diagnosis.vertical import doubt_of
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, add_counts, judge_poses
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.bags.pose_messages import COVARIANCE_TYPES, PATH_TYPE, decode_poses
from trajeval_ros.io.live.live_folder import REVISED_SUFFIX, write_revised
from trajeval_ros.io.live.pair_file import SUFFIX, PairWriter
from trajeval_ros.io.writing import write_whole
from trajeval_ros.online.alarms import Peaks
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.jump_detector import Jump, JumpDetector
from trajeval_ros.online.live_clock import ClockReport, OnlineClock
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.notices import Standing
from trajeval_ros.online.reports import Snapshot, Update, united
from trajeval_ros.online.revised import RevisedPath
from trajeval_ros.online.state_rows import POSITION, QUATERNION, Pairs, trajectory
from trajeval_ros.online.trail import Trail
from trajeval_ros.ros.held_messages import HeldMessages
from trajeval_ros.ros.poses import StateColumns
from trajeval_ros.ros.sides import Side
from trajeval_ros.ros.subscriptions import ReceivedMessages
from trajeval_ros.ros.timing import Latency


class LiveEstimate:
    """Evaluates one estimate topic.

    Attributes:
        side: Where its messages come from.
        name: Of its files and topics.
        stream: What its messages have told.
        evaluator: Its evaluation.
        latency: How long its errors take to be published.
        jumps: Restarts and corrections so far.
        clock: What is known of its clock; nothing if the topic carries paths.
        trail: The run in few poses.
        revised: The newest path, if the topic carries paths.
        watch: Is given all new pairs, to draw them.
        peaks: The largest errors since the last status.
        standing: What has been said of it and still is so.
        offset_ns: What is added to its stamps, nanoseconds.
        doubt: Why the axis that is taken for up in the groundtruth can't be, as of the newest
            snapshot; empty if it can.
    """

    def __init__(
        self,
        side: Side,
        settings: OnlineSettings,
        folder: Path,
        groundtruth: str,
        place: int,
        *,
        hold: bool,
    ) -> None:
        """Begin, with an empty pair file.

        Args:
            side: Where its messages come from.
            settings: What to do.
            folder: For its files.
            groundtruth: The groundtruth's source.
            place: Its place among the estimates, from 0.
            hold: Evaluate nothing until `release` says by which clock.

        Raises:
            InputError: The file can't be made.
        """
        self.side, self.name, self.stream = side, side.name, side.stream
        self.evaluator = OnlineEvaluator(
            settings,
            record=self._record,
            record_waypoints=lambda waypoints: self.writer.append_waypoints(waypoints),
        )
        self.latency = Latency()
        self.jumps, self.trail = JumpDetector(), Trail()
        self.revised: RevisedPath | None = None
        self.watch: Callable[[Pairs], object] | None = None
        self.clock = OnlineClock(settings.protocol.gauge)
        self.peaks, self.standing = Peaks(), Standing()
        self.doubt = ""
        self._given_up = None if settings.up is None else settings.up[1]
        self._held = HeldMessages() if hold else None
        self._released: list[Update] = []
        self.offset_ns = round(settings.protocol.association.time_offset_s * NANOSECONDS)
        self._newest: tuple[str, bytes] | None = None
        self._folder = folder
        self._undigested: list[Pairs] = []
        self._state: Mapping[str, Any] = {}
        description = {"groundtruth": groundtruth, "estimate": side.source, "place": place}
        self.writer = PairWriter(folder / f"{self.name}{SUFFIX}", description)

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states: stamps (N,) and rows (N, 10)."""
        self.clock.add_groundtruth(stamps, rows)
        if self._held is not None and not self._held.calls:
            # No estimate waits so far; the evaluator itself forgets what nobody needs.
            self.evaluator.add_groundtruth(stamps, rows)
        else:
            self._now_or_later(
                "groundtruth", stamps, lambda: self.evaluator.add_groundtruth(stamps, rows)
            )

    @property
    def up(self) -> UpAxis:
        """Which axis points up in its frame."""
        return self.stream.up(self._given_up)

    @property
    def held_s(self) -> float:
        """How long messages have been held, by their stamps, seconds."""
        return 0.0 if self._held is None else self._held.span_s

    def release(self, offset_s: float) -> None:
        """Evaluate what was held, by a clock that is known now, and go on with it."""
        assert self._held is not None
        self.evaluator.set_offset(offset_s)
        self.offset_ns = round(offset_s * NANOSECONDS)
        held, self._held = self._held, None
        for each in held.calls:
            each()
            # At once, as if it came only now: no more waits than ever does.
            self._released.append(self.evaluator.update())

    def take(self, now_ns: int | None) -> None:
        """Take the messages that have arrived; `now_ns` is the simulated time."""
        for message_type, taken, arrived in self.side.take(now_ns):
            self._take(message_type, taken, arrived)

    def update(self, *, at_end: bool = False) -> Update:
        """Evaluate what has arrived and write its pairs; returns what is new."""
        released, self._released = self._released, []
        return united([*released, self.evaluator.update(at_end=at_end)])

    def snapshot(self) -> Snapshot:
        """Return the state of the evaluation, without yaw and tilt where up is doubtful."""
        snapshot = self.evaluator.snapshot()
        stamps, truth, _ = self.trail.columns()
        if len(stamps):
            self.doubt = doubt_of(trajectory(stamps, truth, self.evaluator.groundtruth_up))
        if not self.doubt:
            return snapshot
        return replace(snapshot, ate={**snapshot.ate, "yaw_deg": None, "tilt_deg": None})

    def digest(self) -> list[Jump]:
        """Take the pairs since the last call into trail and revision; returns their jumps.

        Apart from `update`, so that what can wait costs a few calls a second.
        """
        alignment = self.evaluator.alignment
        scale = 1.0 if alignment is None else alignment.similarity.scale
        found: list[Jump] = []
        for pairs in joined(self._undigested):
            found += self.jumps.update(pairs, scale)
            self.trail.add(pairs)
            if self.revised is not None:  # by the estimate's own clock
                self.revised.record(pairs._replace(stamps=pairs.stamps - self.offset_ns))
        self._undigested = []
        return found

    def uncertainty(self) -> tuple[int, Floats, Floats] | None:
        """Return stamp, position (3,) and its covariance (3, 3) of the newest message.

        Returns:
            None if there is none, or it says nothing of its covariance.
        """
        if self._newest is None or self._newest[0] not in COVARIANCE_TYPES:
            return None
        message_type, payload = self._newest
        pose = decode_poses([payload], message_type, covariance=True)
        if not len(pose.stamps) or pose.covariances is None or pose.stamps[0] == 0:
            return None
        position, covariance = pose.positions[0], pose.covariances[0]
        # The first of a run may be zero, hence this one twice.
        if not judge_poses(pose.positions)[0][0] or unknown_covariances(
            pose.covariances.repeat(2, 0)
        ):
            return None
        return int(pose.stamps[0]) + self.offset_ns, position, covariance[:3, :3]

    def write_state(self, state: Mapping[str, Any]) -> None:
        """Write what `trajeval finish` can't tell from pairs, if it has changed.

        Args:
            state: What is known beside the estimate: settings, groundtruth, live, warnings.
        """
        status, evaluator = self.stream.status, self.evaluator
        decided = status.poses - evaluator.buffer.waiting
        state = {
            **state,
            "estimate": {
                "poses": status.poses,
                "states": decided - evaluator.buffer.dropped.get("duplicate_stamp", 0),
                "duration_s": status.duration_s,
                "frame": status.frame,
                "child_frame": status.child_frame,
                "up": asdict(self.up),
                "notes": list(status.notes),
            },
            "dropped": add_counts(status.dropped, evaluator.buffer.dropped),
            "aligned_by": evaluator.frozen_at,
        }
        if state == self._state:
            self.writer.write()
            return
        self._state = state
        none = np.empty((0, 10))
        self.writer.append(np.empty(0, dtype=np.int64), none, none, state)

    def write_revised(self) -> None:
        """Write the newest path, if there is one.

        Raises:
            InputError: It can't be written.
        """
        path = self.revised
        if path is None or not len(path.stamps):
            return
        stamps, positions = path.stamps + self.offset_ns, path.states[:, POSITION]
        write_whole(
            self._folder / f"{self.name}{REVISED_SUFFIX}",
            lambda file: write_revised(file, stamps, positions, path.states[:, QUATERNION]),
        )

    def _record(self, pairs: Pairs) -> None:
        """Have new pairs on disk before anything else."""
        self.writer.append(*pairs)
        self._undigested.append(pairs)
        if self.watch is not None:
            self.watch(pairs)

    def _take(self, message_type: str, taken: ReceivedMessages, arrived: Stamps) -> None:
        if message_type == PATH_TYPE:
            for payload, each in zip(taken.payloads, arrived.tolist(), strict=True):
                self._take_path(payload, each)
            return
        self._newest = message_type, taken.payloads[-1]
        poses = self.stream.poses(message_type, taken.payloads, arrived)
        self.evaluator.estimate_up = self.up
        received = np.array(taken.received, dtype=np.int64)[poses.rows]
        self.clock.add_estimate(poses.stamps, poses.states)
        self._now_or_later("estimate", poses.stamps, lambda: self._evaluate(poses, received))

    def _take_path(self, payload: bytes, arrived_ns: int) -> None:
        """Take a path: evaluate the poses that are new, and remember how it sees the others."""
        path = self.stream.path(payload)
        self.evaluator.estimate_up = self.up
        if self.revised is None:
            self.revised = RevisedPath(self.evaluator.settings.protocol.gauge, self.up)
            reason = "a path is revised as it goes, which hides its clock"
            self.clock.report = ClockReport(status="unobservable", reason=reason)
        rows = self.revised.renew(path.stamps, path.states)
        new = StateColumns(path.stamps[rows], path.states[rows], path.rows[rows])
        self.stream.count_new(new, arrived_ns)
        self._now_or_later(
            "estimate", new.stamps, lambda: self.evaluator.add_estimate(new.stamps, new.states)
        )

    def _evaluate(self, poses: StateColumns, received: Stamps) -> None:
        self.latency.arrive(poses.stamps + self.offset_ns, received)
        self.evaluator.add_estimate(poses.stamps, poses.states)

    def _now_or_later(self, side: str, stamps: Stamps, evaluate: Callable[[], None]) -> None:
        if self._held is None:
            evaluate()
        elif len(stamps):
            self._held.add(side, stamps, evaluate)


def joined(several: list[Pairs]) -> list[Pairs]:
    """Return one block of pairs, in order of their stamps, instead of several; none for none."""
    if len(several) < 2:
        return several
    stamps = np.concatenate([each.stamps for each in several])
    order = np.argsort(stamps, kind="stable")  # late ones go where they belong
    return [
        Pairs(
            stamps[order],
            np.concatenate([each.groundtruth for each in several])[order],
            np.concatenate([each.estimate for each in several])[order],
        )
    ]
