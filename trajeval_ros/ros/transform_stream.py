"""The pose of one frame in another, from live transforms on `/tf`."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import note, warning
from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.outlier_stamps import LONE, NEAR_NS, OutlierStamps
from trajeval_ros.geometry.source_info import FORMAT, ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.bags.pose_messages import TransformColumns, decode_transforms
from trajeval_ros.io.bags.received_transforms import TRANSFORM, ReceivedChain, transforms_of
from trajeval_ros.io.bags.transform_tree import (
    LEADS_BY_S,
    Edge,
    EdgeKey,
    Way,
    common_span,
    compose,
    find_way,
    leading_edge,
)
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.state_buffer import NEVER
from trajeval_ros.ros.poses import PoseStream

_MEMORY_S = 10.0  # time span that is kept while the two frames are not connected
_MOST_TRANSFORMS = 50_000  # transforms per edge
_MOST_EDGES = 1000  # edges, which may belong to other trees
_WARN_AFTER_S = 5.0

# A transform and the number of its message, in order of arrival.
_NUMBERED = np.dtype([("transform", TRANSFORM), ("message", "<i8")])
_NumberedTransforms = NDArray[np.void]
_NONE: _NumberedTransforms = np.empty(0, _NUMBERED)


class TransformStream(PoseStream):
    """Chains the edges between two frames at the timestamps of the leading edge, as for bags.

    The first pose is available when the leading edge is determined. A pose is available when all
    edges have reached its timestamp. A tree has only one chain between two frames. When it is
    complete, all other edges are removed.

    When the time of one edge steps back, all edges start again with the first message after the
    step. It was received before the step was certain, so the newest messages are kept.
    """

    def __init__(self, source: str, parent: str, child: str) -> None:
        super().__init__(source)
        self.status.frame, self.status.child_frame = parent, child
        self.status.note(note(FORMAT, "format: TF"))
        self._parent, self._child = parent, child
        self._edges: dict[EdgeKey, Edge] = {}
        self._trusts: dict[EdgeKey, OutlierStamps] = {}
        self._way: Way = []
        self._leading: EdgeKey | None = None
        self._until = NEVER
        self._warn_at: float | None = None
        self._messages = 0  # number of messages so far
        # Transforms from the first message on that may be after a step back of time, and those
        # that `as_received` has not composed.
        self._recent: dict[EdgeKey, _NumberedTransforms] = {}
        self._chain: ReceivedChain | None = None
        self._is_over = False  # whether no transforms will follow

    def poses(
        self, message_type: str, payloads: Sequence[bytes], arrived_ns: Stamps
    ) -> tuple[Trajectory, Indices]:
        """Return the states that new messages complete, with the row of the last message."""
        del message_type  # timestamps are tested per edge
        edges, undecodable = decode_transforms(payloads)
        self.status.drop("undecodable", undecodable)
        self._extend({key: self._numbered(item, arrived_ns) for key, item in edges.items()})
        self._messages += len(payloads)
        if not self.is_receiver:
            self._take_certain()
        return self._completed(len(payloads) - 1, arrived_ns)

    def _completed(self, row: int, arrived_ns: Stamps) -> tuple[Trajectory, Indices]:
        """Return the states that are possible now, with the row and the arrival of a message."""
        stamps = self._new_stamps()
        arrived = np.full(len(stamps), UNKNOWN)  # only of the newest
        if len(stamps):
            self._until = int(stamps[-1])
            self.heard_at = time.monotonic()
            self.arrivals.see(stamps[-1:], arrived_ns[-1:])
            arrived[-1] = arrived_ns[-1]
            self.status.stream.add(stamps, arrived)
        composed = compose(self._edges, self._way, stamps)
        reading = SourceInfo(receive_times=ReceiveTimes(np.full(len(stamps), UNKNOWN), "node"))
        states = Trajectory.from_columns(stamps, *composed, reading=reading)
        for reason, number in states.reading.dropped.items():
            self.status.drop(reason, number)
        self._forget()
        self._count(states.stamps)
        return states, np.full(len(states), row)

    def as_received(self, poses: Trajectory) -> Trajectory:
        """Return the poses at every receive time since the last call; see `ReceivedChain`.

        They begin when the leading edge is determined. Their times of arrival are never `UNKNOWN`.
        """
        if self._leading is None:
            return poses
        self._chain = self._chain or ReceivedChain(self._edges, self._way, self._leading)
        certain = {key: item["transform"] for key, item in self._take_certain().items()}
        return self._chain.poses(certain, at_end=self._is_over)

    def last_poses(self) -> Trajectory:
        """Return the states whose timestamps are still under test, at the end of the run."""
        self._is_over = True
        self._extend(dict.fromkeys(self._trusts, _NONE))
        return self._completed(0, np.array([UNKNOWN]))[0]

    def hold(self, payloads: Sequence[bytes]) -> None:
        """Add static transforms."""
        edges, undecodable = decode_transforms(payloads)
        self.status.drop("undecodable", undecodable)
        for key, columns in edges.items():
            known = self._edges.get(key)
            # A frame with moving transforms stays a moving frame.
            if self._wants(key) and (known is None or known.is_static):
                self._keep(key, Edge.from_columns(columns.stamps, columns.numbers, True))

    @property
    def _all_trusts(self) -> Iterable[OutlierStamps]:
        return self._trusts.values()

    def tell_trouble(self) -> None:
        """Warn once if `trouble` lasts for `_WARN_AFTER_S`, even if no more transforms arrive."""
        if self.trouble and self._warn_at is not None and time.monotonic() > self._warn_at:
            self._warn_at = np.inf
            self.news.append(self.trouble)

    def _numbered(self, columns: TransformColumns, arrived_ns: Stamps) -> _NumberedTransforms:
        """Return the transforms of an edge in new messages that arrived at times (N,)."""
        numbered = np.empty(len(columns.rows), _NUMBERED)
        arrived = arrived_ns[columns.rows]
        numbered["transform"] = transforms_of(columns.stamps, columns.numbers, arrived)
        numbered["message"] = self._messages + columns.rows
        return numbered

    def _extend(self, new: Mapping[EdgeKey, _NumberedTransforms]) -> None:
        """Take new transforms by edge."""
        while new:
            begins = [
                self._extend_edge(key, transforms)
                for key, transforms in new.items()
                if self._wants(key)
            ]
            after_steps = [begin for begin in begins if begin is not None]
            if not after_steps:
                return
            first = min(after_steps)
            new = {key: item[item["message"] >= first] for key, item in self._recent.items()}
            self._trusts = {}
            self._drop_moving()

    def _extend_edge(self, key: EdgeKey, transforms: _NumberedTransforms) -> int | None:
        """Extend an edge; or return the first message after a step back of time, by number."""
        self._recent[key] = np.concatenate([self._recent.get(key, _NONE), transforms])
        # A timestamp of 0 was not set.
        timed = transforms[transforms["transform"]["stamp"] != 0]
        trust = self._trusts.setdefault(key, OutlierStamps())
        before = trust.isolated
        stamps, trusted = trust.take(timed["transform"]["stamp"], timed, at_end=self._is_over)
        if trust.isolated > before:
            self._tell_lone(trust)
            self.status.drop(LONE, trust.isolated - before)
        known = self._edges.get(key)
        if known is not None and known.is_static:
            known = None
        if self.starts_new_run and len(stamps):
            last = stamps[:1] if known is None else known.stamps[-1:]
            back = np.flatnonzero(np.diff(np.concatenate([last, stamps])) < -NEAR_NS)
            if len(back):
                return int(trusted["message"][back[-1]])
        new = Edge.from_columns(stamps, trusted["transform"]["numbers"], is_static=False)
        if key == self._leading and len(new.stamps):
            self._tell_step_back((self._until - int(new.stamps[-1])) / NANOSECONDS)
        self._keep(key, new if known is None else known.joined(new))
        return None

    def _take_certain(self) -> dict[EdgeKey, _NumberedTransforms]:
        """Return, and forget, transforms that are not after a possible step back of time."""
        begin = self._messages
        for key, trust in self._trusts.items() if self.starts_new_run else ():
            edge = self._edges.get(key)
            if trust.waiting and edge is not None and trust.waiting[0][0] < edge.stamps[-1]:
                begin = min(begin, int(trust.waiting[1]["message"][0]))
        recent = self._recent
        self._recent = {key: item[item["message"] >= begin] for key, item in recent.items()}
        return {key: item[item["message"] < begin] for key, item in recent.items()}

    def reset(self) -> None:
        """Forget earlier messages."""
        self._trusts, self._is_over = {}, False
        self._drop_moving()

    def _drop_moving(self) -> None:
        """Drop moving transforms, because time started again."""
        self._edges = {key: edge for key, edge in self._edges.items() if edge.is_static}
        self._way, self._leading, self._until = [], None, NEVER
        self._recent, self._chain = {}, None

    def _wants(self, key: EdgeKey) -> bool:
        known = self._edges.keys() | self._trusts.keys()
        return key in self._edges or (not self._way and (key in known or len(known) < _MOST_EDGES))

    def _keep(self, key: EdgeKey, edge: Edge) -> None:
        if len(edge.stamps):
            self._edges[key] = edge

    def _new_stamps(self) -> Stamps:
        try:
            leading, span = self._lead()
        except InputError as error:
            self.trouble = warning("data", str(error))
            if self._warn_at is None:
                self._warn_at = time.monotonic() + _WARN_AFTER_S
            return np.empty(0, dtype=np.int64)
        self.trouble = None
        stamps = self._edges[leading].within(*span)
        return stamps[stamps > self._until]

    def _lead(self) -> tuple[EdgeKey, tuple[int, int]]:
        """Return the leading edge, and first and last timestamp that all edges cover."""
        if not self._way:
            self._way = find_way(self._edges, self._parent, self._child, self._topic)
            self._edges = {key: self._edges[key] for key, _ in self._way}
        span = common_span(self._edges, self._way)
        if span is None:
            raise InputError(
                f"{self._topic}: all transforms between {self._parent} and {self._child} are "
                "static so far; choose a moving frame"
            )
        if self._leading is None:
            if span[1] - span[0] < round(LEADS_BY_S * NANOSECONDS):
                raise InputError(
                    f"{self._topic}: incomplete chain from {self._parent} to {self._child}; "
                    f"output starts {LEADS_BY_S:g} s after all its transforms are received"
                )
            self._leading = leading_edge(self._edges, self._way, span)
        return self._leading, span

    def _forget(self) -> None:
        for key, edge in self._edges.items():
            if edge.is_static:
                continue
            recent = int(edge.stamps[-1]) - round(_MEMORY_S * NANOSECONDS)
            self._edges[key] = edge.since(self._until if self._way else recent)[-_MOST_TRANSFORMS:]
        for key, transforms in self._recent.items():
            times = transforms["transform"]["time"]
            begin = times.max(initial=0) - round(_MEMORY_S * NANOSECONDS)
            kept = (times >= begin) | (times == UNKNOWN) | bool(self._way)
            self._recent[key] = transforms[kept][-_MOST_TRANSFORMS:]
