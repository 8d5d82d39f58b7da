"""Readers of one topic. One pass over a bag gives blocks of messages to many readers."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from functools import cached_property

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.outlier_stamps import trusted_states
from trajeval_ros.geometry.source_info import LOG, ReceiveTimes
from trajeval_ros.geometry.valid_poses import add_counts
from trajeval_ros.io.bags.bag import Bag, Key
from trajeval_ros.io.bags.blocks import Block
from trajeval_ros.io.bags.cdr import CdrPlan
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.containers import Topic, TopicReading
from trajeval_ros.io.bags.foxglove import TYPES as FOXGLOVE_TYPES
from trajeval_ros.io.bags.foxglove import FoxglovePlan
from trajeval_ros.io.bags.message_definitions import Connection, recorded_fields
from trajeval_ros.io.bags.nested_poses import NestedPose
from trajeval_ros.io.bags.pose_columns import COLUMNS, Frames, PoseColumns, frames_changes
from trajeval_ros.io.bags.pose_messages import (
    PATH_TYPE,
    POSE_2D,
    TransformColumns,
    edges_of,
    plan_of,
    pose_2d_plan,
    poses_2d_of,
    poses_of,
)
from trajeval_ros.io.bags.px4_messages import (
    ATTITUDE,
    LOCAL_POSITION,
    PX4_POSE_TYPES,
    Px4Plan,
    attitude_name,
    with_attitudes,
)
from trajeval_ros.io.bags.received_transforms import Transforms, transforms_of
from trajeval_ros.io.bags.transform_tree import Edge, EdgeKey
from trajeval_ros.io.checks import times
from trajeval_ros.io.growing_rows import GrowingRows


class PoseReader:
    """Reads the poses of a topic; of one with paths, those of the last path or of sliding ones.

    PX4's local positions get the orientations of the attitude's topic, if the bag has it.
    """

    def __init__(
        self,
        bag: Bag,
        topic: Topic,
        *,
        covariances: bool,
        received: str = "",
        nested: NestedPose | None = None,
    ) -> None:
        """Prepare to read.

        `nested`: where the messages have the pose, if their type is not one of poses.
        """
        self.nested = nested
        self.reading = TopicReading(topic)  # the topic, and the damage found while it is read
        named = [item for item in bag.topics if item.name == attitude_name(topic.name)]
        attitudes = [item for item in named if item.type == ATTITUDE]
        self.attitudes: PoseReader | None = None
        if topic.type == LOCAL_POSITION and attitudes:
            self.attitudes = PoseReader(bag, attitudes[0], covariances=False)
        kind = _LastPath if topic.type == PATH_TYPE and nested is None else _Poses
        decoders = _Decoders(topic, covariances=covariances, rates=bool(received), nested=nested)
        self._poses: _Poses | _LastPath = kind(decoders, received)

    def add(self, key: Key, block: Block) -> None:
        """Add messages of one connection."""
        self._poses.add(key, block)

    @property
    def slides(self) -> bool:
        """Whether the topic has paths that slide; then `merge` needs all messages again."""
        return isinstance(self._poses, _LastPath) and self._poses.slides

    def merge(self, key: Key, block: Block) -> None:
        """Add messages of paths that slide."""
        assert isinstance(self._poses, _LastPath)
        self._poses.merge(key, block)

    def poses(self) -> PoseColumns:
        """Return all poses, in order of the log times of their messages."""
        columns = self._poses.done()
        if self.attitudes is None:
            return columns
        return with_attitudes(columns, self.attitudes.poses())


class TransformReader:
    """Reads the edges of the TF tree that a topic has."""

    def __init__(self, topic: Topic) -> None:
        self.reading = TopicReading(topic)  # the topic, and the damage found while it is read
        self.undecodable = 0  # number of messages that can't be decoded
        self.isolated = 0  # number of transforms of all edges with an isolated timestamp
        self._decoders = _Decoders(topic, covariances=False)
        self._parts: dict[EdgeKey, list[tuple[TransformColumns, Stamps, Stamps]]] = {}

    def add(self, key: Key, block: Block) -> None:
        """Add messages of one connection."""
        columns = self._decoders.decode(key, block)
        self.undecodable += len(block) - len(columns.rows)
        for edge, transforms in edges_of(columns).items():
            rows = transforms.rows
            part = transforms, block.log_times[rows], block.publish_times[rows]
            self._parts.setdefault(edge, []).append(part)

    def received(self, clock: str) -> dict[EdgeKey, tuple[Transforms, ReceiveTimes]]:
        """Return the transforms of moving edges, and what their receive times are.

        `clock`: the clock of the receive times, as in `ReceiveTimes.of_bag`.
        """
        edges = {}
        for key in () if self._is_static else self._parts:
            stamps, numbers, logged, published = self._in_order(key)
            receive_times = ReceiveTimes.of_bag(logged, published, clock)
            order = np.argsort(receive_times.times, kind="stable")
            edges[key] = transforms_of(stamps, numbers, receive_times.times)[order], receive_times
        return edges

    @property
    def _is_static(self) -> bool:
        return self.reading.topic.name.endswith("_static")

    def _in_order(self, key: EdgeKey) -> tuple[Stamps, Floats, Stamps, Stamps]:
        """Return stamps, numbers, log and publish times of an edge, in order of its log times."""
        parts = [(item.stamps, item.numbers, *at) for item, *at in self._parts[key]]
        stamps, numbers, logged, published = map(np.concatenate, zip(*parts, strict=True))
        order = np.argsort(logged, kind="stable")
        return stamps[order], numbers[order], logged[order], published[order]

    @cached_property
    def edges(self) -> dict[EdgeKey, Edge]:
        """The edges by (parent, child), once all messages were added."""
        edges = {}
        for key in self._parts:
            stamps, numbers, *_ = self._in_order(key)
            if not self._is_static:
                timed = times(stamps)
                stamps, numbers = stamps[timed], numbers[timed]
                rows, trust = trusted_states(stamps)
                stamps, numbers = stamps[rows], numbers[rows]
                self.isolated += trust.isolated
            edges[key] = Edge.from_columns(stamps, numbers, is_static=self._is_static)
        return edges


def read_topics(bag: Bag, readers: Collection[PoseReader | TransformReader]) -> None:
    """Give all messages to their readers in one pass over a bag."""
    fed = {reader.reading: reader for reader in readers}
    for reader in readers:
        if isinstance(reader, PoseReader) and reader.attitudes is not None:
            fed[reader.attitudes.reading] = reader.attitudes
    for reading, key, block in bag.blocks(list(fed)):
        fed[reading].add(key, block)
    sliding = {
        TopicReading(reader.reading.topic): reader
        for reader in readers
        if isinstance(reader, PoseReader) and reader.slides
    }
    if sliding:
        for reading, key, block in bag.blocks(list(sliding)):
            sliding[reading].merge(key, block)


def tree_topics(bag: Bag, name: str) -> list[Topic]:
    """Return the topics of the TF tree that a topic belongs to.

    `name`: `/tf`, or one with its name in a namespace; its `_static` sibling belongs to it.
    """
    base = name.removesuffix("_static")
    names = (base, f"{base}_static", "/tf_static")
    return [topic for topic in bag.topics if topic.name in names and topic.holds_transforms]


def tree_of(readers: Iterable[TransformReader]) -> dict[EdgeKey, Edge]:
    """Return the edges of several topics. A moving edge replaces a static one."""
    edges: dict[EdgeKey, Edge] = {}
    for reader in readers:
        for key, edge in reader.edges.items():
            if key not in edges or edges[key].is_static:
                edges[key] = edge
    return edges


class _Decoders:
    """The decoders of a topic by connection, because definitions can differ."""

    def __init__(
        self,
        topic: Topic,
        *,
        covariances: bool,
        rates: bool = False,
        nested: NestedPose | None = None,
    ) -> None:
        self.topic, self.covariances, self.nested = topic, covariances, nested
        self._plans = {
            (id(connection.owner), connection.id): self._plan(connection, covariances, rates)
            for connection in topic.connections
        }

    def _plan(
        self, connection: Connection, covariances: bool, rates: bool
    ) -> CdrPlan | FoxglovePlan:
        encoding = connection.encoding
        if self.nested is not None:
            requested = self.nested.requested(covariances=covariances)
            return CdrPlan(
                recorded_fields(connection) or (), requested, is_ros1=encoding == "ros1"
            )
        if self.topic.type in (*PX4_POSE_TYPES, ATTITUDE):
            fields = recorded_fields(connection)
            return Px4Plan(self.topic.type) if fields is None else CdrPlan(fields)
        if self.topic.type in FOXGLOVE_TYPES:
            return FoxglovePlan(self.topic.type, encoding)
        if self.topic.type == POSE_2D:
            return pose_2d_plan(is_ros1=encoding == "ros1")
        return plan_of(
            recorded_fields(connection),
            self.topic.type,
            covariance=covariances,
            rates=rates,
            is_ros1=encoding == "ros1",
        )

    def nothing(self) -> Columns:
        """Return the columns of no message."""
        return next(iter(self._plans.values())).decode([])

    def decode(self, key: Key, block: Block) -> Columns:
        """Return the columns of messages of one connection."""
        return self._plans[key].decode_at(block.buffer, block.begins, block.sizes)


class _Poses:
    """The poses of a topic, gathered block by block."""

    def __init__(self, decoders: _Decoders, received: str) -> None:
        self._decoders, self._received = decoders, received
        self._columns: dict[str, GrowingRows] = {}
        self._frames: list[Frames] = []
        self._dropped: dict[str, int] = {}
        self._undecodable = self._count = self._messages = 0

    def add(self, key: Key, block: Block) -> None:
        """Add the messages of a connection."""
        columns = self._decoders.decode(key, block)
        self._add(columns, block.log_times, block.publish_times)

    def _add(self, decoded: Columns, log_times: Stamps, publish_times: Stamps) -> None:
        undecodable, kind = len(log_times) - len(decoded.rows), self._decoders.topic.type
        nested, covariances = self._decoders.nested, self._decoders.covariances
        if nested is not None:
            part = nested.poses(decoded, log_times, undecodable, covariances=covariances)
        elif kind == POSE_2D:
            part = poses_2d_of(decoded, log_times, undecodable)
        else:
            part = poses_of(decoded, kind, undecodable, covariance=covariances)
        columns = {name: getattr(part, name) for name in COLUMNS} | {
            "rows": part.rows + self._messages,
            "log": log_times[part.rows],
            "published": publish_times[part.rows],
        }
        for name, rows in columns.items():
            if rows is not None:
                self._columns.setdefault(name, GrowingRows()).extend(rows)
        self._frames += [(self._count + row, frame, child) for row, frame, child in part.frames]
        self._undecodable += part.undecodable
        self._dropped = add_counts(self._dropped, part.dropped)
        self._count += len(part.stamps)
        self._messages += len(log_times)

    def done(self) -> PoseColumns:
        """Return all poses in order of their log times, with their receive times."""
        none = np.zeros(0, dtype=np.int64)
        self._add(self._decoders.nothing(), none, none)
        columns = {name: column.done() for name, column in self._columns.items()}
        frames, log_times = self._frames, columns["log"]
        if (np.diff(log_times) < 0).any():
            order = np.argsort(log_times, kind="stable")
            columns = {name: column[order] for name, column in columns.items()}
            firsts = np.array([row for row, *_ in frames])
            which = (np.searchsorted(firsts, order, side="right") - 1).tolist()
            frames = [(row, *frames[change][1:]) for row, change in enumerate(which)]
        return PoseColumns(
            **{name: columns.get(name) for name in COLUMNS},  # type: ignore[arg-type]
            frames=frames_changes(frames),
            undecodable=self._undecodable,
            dropped=self._dropped,
            receive_times=replace(
                ReceiveTimes.of_bag(columns["log"], columns["published"], self._received),
                body_rates=columns.get("body_rates"),
            ),
        )


class _LastPath:
    """The last path of a topic, which is the revised trajectory.

    Paths that slide, so that the last one begins after the end of the first one, are merged: the
    newest version of every pose.
    """

    def __init__(self, decoders: _Decoders, received: str) -> None:
        self._decoders, self._received = decoders, received
        self._first: tuple[int, Key, Block] | None = None
        self._last: tuple[int, Key, Block] | None = None
        self._newest = _Poses(decoders, received)  # the last pose of every path
        self._merged: PoseColumns | None = None  # of paths that slide

    def add(self, key: Key, block: Block) -> None:
        """Store the first and the last message."""
        first, last = int(block.log_times.argmin()), len(block) - 1
        last -= int(block.log_times[::-1].argmax())
        begin, end = int(block.log_times[first]), int(block.log_times[last])
        if self._first is None or begin < self._first[0]:
            self._first = begin, key, block[first : first + 1].compact()
        if self._last is None or end >= self._last[0]:
            self._last = end, key, block[last : last + 1].compact()
        if self._received:
            self._newest.add(key, block)

    @property
    def slides(self) -> bool:
        """Whether the last path begins after the end of the first one."""
        if self._first is None or self._last is None:
            return False
        first, last = self._poses_of(self._first).stamps, self._poses_of(self._last).stamps
        return bool(len(first) and len(last) and last.min() > first.max())

    def merge(self, key: Key, block: Block) -> None:
        """Merge all paths of a block."""
        poses = _Poses(self._decoders, LOG)
        poses.add(key, block)
        parts = [poses.done()] if self._merged is None else [self._merged, poses.done()]
        logged = np.concatenate([part.receive_times.times for part in parts if part.receive_times])
        every = parts[0] if len(parts) == 1 else parts[0].joined(parts[1])
        every = every.replaced(
            receive_times=ReceiveTimes(logged, LOG),
            undecodable=sum(part.undecodable for part in parts),
        )
        order = np.lexsort((logged, every.stamps))
        is_newest = np.diff(every.stamps[order], append=np.iinfo(np.int64).max) > 0
        self._merged = every.rows_of(order[is_newest])

    def _poses_of(self, message: tuple[int, Key, Block]) -> PoseColumns:
        poses = _Poses(self._decoders, self._received)
        poses.add(*message[1:])
        return poses.done()

    def done(self) -> PoseColumns:
        """Return its poses."""
        if self._last is None:
            return _Poses(self._decoders, self._received).done()
        poses = self._poses_of(self._last) if self._merged is None else self._merged
        if not self._received:
            return poses
        newest = self._newest.done()
        last = np.flatnonzero(np.diff(newest.rows, append=-1))
        return replace(poses, as_received=newest.rows_of(last))
