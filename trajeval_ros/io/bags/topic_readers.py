"""Readers of one topic. One pass over a bag gives blocks of messages to many readers."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.stamp_trust import trusted_states
from trajeval_ros.io.bags.bag import Bag, Key
from trajeval_ros.io.bags.blocks import Block
from trajeval_ros.io.bags.cdr import CdrPlan
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.foxglove import TYPES as FOXGLOVE_TYPES
from trajeval_ros.io.bags.foxglove import FoxglovePlan
from trajeval_ros.io.bags.growing_columns import GrowingPoses
from trajeval_ros.io.bags.message_definitions import recorded_fields
from trajeval_ros.io.bags.pose_2d import POSE_2D, pose_2d_plan, poses_2d_of
from trajeval_ros.io.bags.pose_messages import (
    PATH_TYPE,
    PoseColumns,
    TransformColumns,
    edges_of,
    plan_of,
    poses_of,
)
from trajeval_ros.io.bags.recorded_topic import Reading, Topic, encoding_of
from trajeval_ros.io.bags.transform_tree import Edge, EdgeKey
from trajeval_ros.io.checks import times

if TYPE_CHECKING:
    from rosbags.interfaces import Connection


class PoseReader:
    """Reads the poses of a topic; of one with paths, those of the last path.

    Attributes:
        reading: The topic, and the damage found while it is read.
    """

    def __init__(self, topic: Topic, *, covariances: bool) -> None:
        """Prepare to read.

        Args:
            topic: One that holds poses.
            covariances: Whether to decode them, too.
        """
        self.reading = Reading(topic)
        kind = _LastPath if topic.type == PATH_TYPE else _Poses
        self._poses = kind(_Decoders(topic, covariances=covariances))

    def add(self, key: Key, block: Block) -> None:
        """Add messages of one connection."""
        self._poses.add(key, block)

    def poses(self) -> PoseColumns:
        """Return all poses, in order of the log times of their messages."""
        return self._poses.done()


class TransformReader:
    """Reads the edges of the TF tree that a topic has.

    Attributes:
        reading: The topic, and the damage found while it is read.
        undecodable: Number of messages that can't be decoded.
        lone: Number of transforms of all edges with an isolated timestamp.
    """

    def __init__(self, topic: Topic) -> None:
        """Prepare to read a topic that holds transforms."""
        self.reading = Reading(topic)
        self.undecodable = self.lone = 0
        self._decoders = _Decoders(topic, covariances=False)
        self._parts: dict[EdgeKey, list[tuple[TransformColumns, NDArray[np.int64]]]] = {}

    def add(self, key: Key, block: Block) -> None:
        """Add messages of one connection."""
        columns = self._decoders.decode(key, block)
        self.undecodable += len(block) - len(columns.rows)
        for edge, transforms in edges_of(columns).items():
            part = transforms, block.log_times[transforms.rows]
            self._parts.setdefault(edge, []).append(part)

    @cached_property
    def edges(self) -> dict[EdgeKey, Edge]:
        """The edges by (parent, child), once all messages were added."""
        is_static = self.reading.topic.name.endswith("_static")
        edges = {}
        while self._parts:
            key, parts = self._parts.popitem()
            order = np.argsort(np.concatenate([logged for _, logged in parts]), kind="stable")
            stamps = np.concatenate([own.stamps for own, _ in parts])[order]
            numbers = np.concatenate([own.numbers for own, _ in parts])[order]
            if not is_static:
                timed = times(stamps)
                stamps, numbers = stamps[timed], numbers[timed]
                rows, trust = trusted_states(stamps)
                stamps, numbers = stamps[rows], numbers[rows]
                self.lone += trust.lone
            edges[key] = Edge.from_columns(stamps, numbers, is_static=is_static)
        return edges


def read_topics(bag: Bag, readers: Collection[PoseReader | TransformReader]) -> None:
    """Give all messages to their readers in one pass over a bag."""
    fed = {each.reading: each for each in readers}
    for reading, key, block in bag.blocks(list(fed)):
        fed[reading].add(key, block)


def tree_topics(bag: Bag, name: str) -> list[Topic]:
    """Return the topics of the TF tree that a topic belongs to.

    Args:
        bag: An open bag.
        name: `/tf`, or one with its name in a namespace; its `_static` sibling belongs to it.
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

    def __init__(self, topic: Topic, *, covariances: bool) -> None:
        self.topic = topic
        self._plans = {
            (id(each.owner), each.id): self._plan(each, covariances=covariances)
            for each in topic.connections
        }

    def _plan(self, connection: Connection, *, covariances: bool) -> CdrPlan | FoxglovePlan:
        encoding = encoding_of(connection)
        if self.topic.type in FOXGLOVE_TYPES:
            return FoxglovePlan(self.topic.type, encoding)
        if self.topic.type == POSE_2D:
            return pose_2d_plan(is_ros1=encoding == "ros1")
        return plan_of(
            recorded_fields(connection),
            self.topic.type,
            covariance=covariances,
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

    def __init__(self, decoders: _Decoders) -> None:
        self._decoders = decoders
        self._poses = GrowingPoses(decoders.topic.expected)

    def add(self, key: Key, block: Block) -> None:
        """Add the messages of a connection."""
        self._add(self._decoders.decode(key, block), block.log_times)

    def _add(self, columns: Columns, log_times: NDArray[np.int64]) -> None:
        undecodable, kind = len(log_times) - len(columns.rows), self._decoders.topic.type
        if kind == POSE_2D:
            poses = poses_2d_of(columns, log_times, undecodable)
        else:
            poses = poses_of(columns, kind, undecodable)
        self._poses.add(poses, log_times)

    def done(self) -> PoseColumns:
        """Return them in order of their log times."""
        self._add(self._decoders.nothing(), np.zeros(0, dtype=np.int64))
        return self._poses.done()


class _LastPath:
    """The last path of a topic, which is the revised trajectory."""

    def __init__(self, decoders: _Decoders) -> None:
        self._decoders = decoders
        self._last: tuple[int, Key, Block] | None = None

    def add(self, key: Key, block: Block) -> None:
        """Store the latest message."""
        row = len(block) - 1 - int(block.log_times[::-1].argmax())
        log_time = int(block.log_times[row])
        if self._last is None or log_time >= self._last[0]:
            self._last = log_time, key, block[row : row + 1].compact()

    def done(self) -> PoseColumns:
        """Return its poses."""
        poses = _Poses(self._decoders)
        if self._last is not None:
            poses.add(*self._last[1:])
        return poses.done()
