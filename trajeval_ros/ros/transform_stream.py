"""The pose of one frame in another, from live transforms on `/tf`."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import note, warning
from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.reading import FORMAT, SourceInfo
from trajeval_ros.geometry.receptions import ReceiveTimes
from trajeval_ros.geometry.stamp_trust import LONE, NEAR_NS, OutlierStamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.bags.pose_messages import TransformColumns, decode_transforms
from trajeval_ros.io.bags.received_transforms import (
    NO_TRANSFORMS,
    ReceivedChain,
    Transforms,
    transforms_of,
)
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


class TransformStream(PoseStream):
    """Chains the edges between two frames at the timestamps of the leading edge, as for bags.

    The first pose is available when the leading edge is determined. A pose is available when all
    edges have reached its timestamp. A tree has only one chain between two frames. When it is
    found, all other edges are removed.
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
        # For `as_received`: the transforms since its last call, and what composes them.
        self._received: dict[EdgeKey, Transforms] = {}
        self._chain: ReceivedChain | None = None
        self._anew_row = 0  # the newest message at which time started again
        self._is_over = False  # whether no transforms will follow

    def poses(
        self, message_type: str, payloads: Sequence[bytes], arrived_ns: Stamps
    ) -> tuple[Trajectory, Indices]:
        """Return the states that new messages complete, with the row of the last message."""
        del message_type  # timestamps are tested per edge
        edges, undecodable = decode_transforms(payloads)
        self.status.drop("undecodable", undecodable)
        self._anew_row = 0
        for key, columns in edges.items():
            if self._wants(key):
                self._extend(key, columns)
        for key in edges.keys() & self._trusts.keys() if self.is_receiver else ():
            self._receive(key, edges[key], arrived_ns)
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
        reading = SourceInfo(receptions=ReceiveTimes(np.full(len(stamps), UNKNOWN), "node"))
        states = Trajectory.from_columns(stamps, *composed, reading=reading)
        for reason, number in states.reading.dropped.items():
            self.status.drop(reason, number)
        self._forget()
        self._count(states.stamps)
        return states, np.full(len(states), row)

    def as_received(self, poses: Trajectory) -> Trajectory:
        """Return the poses at every reception since the last call; see `ReceivedChain`.

        They begin when the leading edge is determined. Their times of arrival are never `UNKNOWN`.
        """
        if self._leading is None:
            return poses
        self._chain = self._chain or ReceivedChain(self._edges, self._way, self._leading)
        found = self._chain.poses(self._received, at_end=self._is_over)
        self._received = {}
        return found

    def last_poses(self) -> Trajectory:
        """Return the states whose timestamps are still under test, at the end of the run."""
        self._is_over = True
        for key in self._trusts:
            none = np.empty(0, np.int64)
            self._extend(key, TransformColumns(none, np.empty((0, 7)), none))
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

    def _extend(self, key: EdgeKey, columns: TransformColumns) -> None:
        timed = columns.stamps != 0  # a timestamp that was not set
        trust = self._trusts.setdefault(key, OutlierStamps())
        before = trust.lone
        stamps, numbers = trust.take(
            columns.stamps[timed], columns.numbers[timed], at_end=self._is_over
        )
        if trust.lone > before:
            self._tell_lone(trust)
            self.status.drop(LONE, trust.lone - before)
        known = self._edges.get(key)
        if self.starts_new_run and len(stamps):
            last = stamps[:1] if known is None or known.is_static else known.stamps[-1:]
            back = np.flatnonzero(np.diff(np.concatenate([last, stamps])) < -NEAR_NS)
            if len(back):
                self._drop_moving()
                self._anew_row = int(columns.rows[max(back[-1] - len(stamps), -len(columns.rows))])
                stamps, numbers = stamps[back[-1] :], numbers[back[-1] :]
        new = Edge.from_columns(stamps, numbers, False)
        if key == self._leading and len(new.stamps):
            self._tell_step_back((self._until - int(new.stamps[-1])) / NANOSECONDS)
        known = self._edges.get(key)
        self._keep(key, new if known is None or known.is_static else known.joined(new))

    def _receive(self, key: EdgeKey, columns: TransformColumns, arrived_ns: Stamps) -> None:
        new = columns.rows >= self._anew_row
        received = transforms_of(columns.stamps, columns.numbers, arrived_ns[columns.rows])[new]
        known = np.concatenate([self._received.get(key, NO_TRANSFORMS), received])
        if not self._way:
            recent = known["time"][-1:] - round(_MEMORY_S * NANOSECONDS)
            known = known[known["time"] >= recent]
        self._received[key] = known[-_MOST_TRANSFORMS:]

    def begin_anew(self) -> None:
        """Forget earlier messages."""
        self._trusts = {}
        self._drop_moving()

    def _drop_moving(self) -> None:
        """Drop moving transforms, because time started again."""
        self._edges = {key: edge for key, edge in self._edges.items() if edge.is_static}
        self._way, self._leading, self._until = [], None, NEVER
        self._received, self._chain, self._is_over = {}, None, False

    def _wants(self, key: EdgeKey) -> bool:
        return key in self._edges or (not self._way and len(self._edges) < _MOST_EDGES)

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
