"""Trajectories from the topics of a bag: poses, paths and transforms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.bag import Advance, Bag, Topic, encoding_of
from trajeval_ros.io.bags.blocks import Block
from trajeval_ros.io.bags.cdr import CdrPlan, Columns
from trajeval_ros.io.bags.foxglove import TYPES as FOXGLOVE_TYPES
from trajeval_ros.io.bags.foxglove import FoxglovePlan
from trajeval_ros.io.bags.growing_columns import GrowingPoses
from trajeval_ros.io.bags.message_definitions import recorded_fields
from trajeval_ros.io.bags.pose_messages import (
    PATH_TYPE,
    PoseColumns,
    TransformColumns,
    edges_of,
    plan_of,
    poses_of,
)
from trajeval_ros.io.bags.transform_tree import Edge, compose_transforms
from trajeval_ros.io.checks import check_stamps, judge_rotations

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Key = tuple[int, int]  # which file, and which of its connections


def read_bag(
    path: Path,
    topic: str,
    frames: tuple[str, str] | None,
    advance: Advance | None = None,
    *,
    covariances: bool = True,
    strict: bool = False,
) -> Trajectory:
    """Read a trajectory from a bag.

    Args:
        path: A bag.
        topic: Name of the topic, "" for the only one that holds poses.
        frames: (parent, child) if the topic holds transforms.
        advance: Called with the messages done and all messages, now and then.
        covariances: Whether to read them, too.
        strict: Whether to verify all that is read, and to refuse what is damaged.

    Raises:
        InputError: The bag, the topic or its poses can't be used.
    """
    with Bag(path, advance, strict=strict) as bag:
        if frames is not None:
            return _transform_trajectory(bag, topic, frames)
        chosen = _choose(bag, topic)
        if not topic:
            bag.notes.append(f"{chosen.name} is the only topic with poses")
        (columns,) = read_columns(bag, [chosen], covariances=covariances)
        return trajectory_of(bag, chosen, columns)


def read_columns(
    bag: Bag, topics: Sequence[Topic], *, covariances: bool = True
) -> list[PoseColumns]:
    """Return the poses of topics, of all in one go; of paths, those of the last one."""
    readers = [
        (_LastPath if topic.type == PATH_TYPE else _Poses)(topic, covariances=covariances)
        for topic in topics
    ]
    owners = {
        (id(connection.owner), connection.id): reader
        for topic, reader in zip(topics, readers, strict=True)
        for connection in topic.connections
    }
    for container, block in bag.blocks(topics):
        for connection, own in block.by_connection():
            owners[id(container), connection].add((id(container), connection), own)
    return [reader.done() for reader in readers]


class _Decoders:
    """How the messages of a topic are decoded, by connection: definitions may differ."""

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

    def __init__(self, topic: Topic, *, covariances: bool) -> None:
        self._decoders = _Decoders(topic, covariances=covariances)
        self._poses = GrowingPoses()

    def add(self, key: Key, block: Block) -> None:
        """Add the messages of a connection."""
        columns = self._decoders.decode(key, block)
        undecodable = len(block) - len(columns.rows)
        poses = poses_of(columns, self._decoders.topic.type, undecodable)
        self._poses.add(poses, block.log_times)

    def done(self) -> PoseColumns:
        """Return them in order of their log times."""
        nothing = poses_of(self._decoders.nothing(), self._decoders.topic.type, 0)
        self._poses.add(nothing, np.zeros(0, dtype=np.int64))
        return self._poses.done()


class _LastPath:
    """The last path of a topic, which is the revised trajectory."""

    def __init__(self, topic: Topic, *, covariances: bool) -> None:
        self._decoders = _Decoders(topic, covariances=covariances)
        self._last: tuple[int, Key, Block] | None = None

    def add(self, key: Key, block: Block) -> None:
        """Look whether one of the messages is later than those before."""
        row = len(block) - 1 - int(block.log_times[::-1].argmax())
        log_time = int(block.log_times[row])
        if self._last is None or log_time >= self._last[0]:
            self._last = log_time, key, block[row : row + 1].compact()

    def done(self) -> PoseColumns:
        """Return its poses."""
        if self._last is None:
            return poses_of(self._decoders.nothing(), PATH_TYPE, 0)
        columns = self._decoders.decode(*self._last[1:])
        return poses_of(columns, PATH_TYPE, 1 - len(columns.rows))


def read_edges(bag: Bag, topic: str) -> tuple[dict[tuple[str, str], Edge], int]:
    """Return the edges of the TF tree by (parent, child), and the number of damaged messages.

    Args:
        bag: An open bag.
        topic: `/tf`, or one with its name in a namespace; its `_static` sibling is read as well.
    """
    base = topic.removesuffix("_static")
    names = (base, f"{base}_static", "/tf_static")
    edges: dict[tuple[str, str], Edge] = {}
    damaged = 0
    for found in bag.topics:
        if found.name not in names or not found.holds_transforms:
            continue
        parts: dict[tuple[str, str], list[tuple[TransformColumns, Stamps]]] = {}
        decoders = _Decoders(found, covariances=False)
        for container, block in bag.blocks([found]):
            for connection, own in block.by_connection():
                columns = decoders.decode((id(container), connection), own)
                damaged += len(own) - len(columns.rows)
                for key, edge_columns in edges_of(columns).items():
                    log_times = own.log_times[edge_columns.rows]
                    parts.setdefault(key, []).append((edge_columns, log_times))
        for key, transforms in parts.items():
            order = np.argsort(np.concatenate([times for _, times in transforms]), kind="stable")
            edge = Edge.from_columns(
                np.concatenate([own.stamps for own, _ in transforms])[order],
                np.concatenate([own.numbers for own, _ in transforms])[order],
                is_static=found.name.endswith("_static"),
            )
            if key not in edges or edges[key].is_static:  # what moves is no static frame
                edges[key] = edge
    return edges, damaged


def _choose(bag: Bag, name: str) -> Topic:
    """Return the topic to read, or raise InputError with those that could be read."""
    candidates = [topic for topic in bag.topics if topic.holds_poses]
    transforms = [topic for topic in bag.topics if topic.holds_transforms]
    listed = ", ".join([topic.name for topic in candidates])
    if transforms:
        listed += (", " if listed else "") + f"{transforms[0].name}:PARENT.CHILD"
    if name:
        found = bag.find(name)
        poses = [topic for topic in found if topic.holds_poses]
        if len(poses) == 1:
            return poses[0]
        types = " and ".join(topic.type for topic in found)
        if len(poses) > 1:
            raise InputError(f"{bag.path}: {name} carries several types of poses ({types})")
        raise InputError(
            f"{bag.path}: {name} holds {types}, no poses"
            + (f"; poses are on {listed}" if listed else ", and no other topic does")
        )
    if len(candidates) == 1:
        return candidates[0]
    if not bag.topics:
        why = "; ".join(bag.damage) or "it has no topics"
        raise InputError(f"{bag.path} is an empty bag: {why}")
    if not listed:
        for topic in bag.topics:
            if topic.lacks_protobuf:
                bag.find(topic.name)  # says what to install
        types = ", ".join(sorted({topic.type for topic in bag.topics}))
        raise InputError(f"{bag.path} has no topic with poses, only {types}")
    raise InputError(
        f"{bag.path} is a bag with several topics; name one as in {bag.path}:TOPIC, of {listed}"
    )


def trajectory_of(bag: Bag, topic: Topic, columns: PoseColumns) -> Trajectory:
    """Return the trajectory of a topic's columns.

    Raises:
        InputError: None of its messages can be used.
    """
    where = f"{bag.path}:{topic.name}"
    if not len(columns.stamps):
        why = "; ".join(bag.damage)
        if columns.undecodable:
            why = f"none of its {columns.undecodable} messages can be decoded"
        raise InputError(f"{where} holds no pose" + (f": {why}" if why else ""))
    are_times = check_stamps(columns.stamps, f"{where}, header.stamp")
    timed = slice(None) if are_times.all() else are_times  # a mask would copy everything
    quaternions, notes = judge_rotations(columns.quaternions)
    velocities = None
    if columns.body_velocities is not None and quaternions is not None:
        velocities = _world_velocities(columns.body_velocities, quaternions)
    covariances = columns.covariances
    if covariances is not None and not covariances.any():
        covariances = None
    changes = [
        f"{where}: frame_id changes from {before[1:]} to {after[1:]} at pose {after[0]}"
        for before, after in zip(columns.frames, columns.frames[1:], strict=False)
    ]
    if len(changes) > 1:
        changes = [f"{changes[0]}, and {len(changes) - 1} times more"]
    everything = Trajectory.from_columns(
        columns.stamps[timed],
        columns.positions[timed],
        None if quaternions is None else quaternions[timed],
        velocities=None if velocities is None else velocities[timed],
        covariances=None if covariances is None else covariances[timed],
        frame=columns.frames[0][1],
        child_frame=columns.frames[0][2],
        name=topic.name.strip("/"),
        dropped={
            "undecodable": columns.undecodable,
            "zero_stamp": int(np.count_nonzero(~are_times)),
        },
        notes=(f"format: {topic.type}", *bag.notes, *changes, *notes),
        damage=tuple(bag.damage),
    )
    return _usable(everything, where, len(columns.stamps))


def _transform_trajectory(bag: Bag, topic: str, frames: tuple[str, str]) -> Trajectory:
    """Return the trajectory of a child frame in a parent frame."""
    found = bag.find(topic)
    if not any(each.holds_transforms for each in found):
        raise InputError(f"{bag.path}: {topic} holds {found[0].type}, no transforms")
    parent, child = frames
    where = f"{bag.path}:{topic}:{parent}.{child}"
    edges, damaged = read_edges(bag, topic)
    stamps, positions, quaternions = compose_transforms(edges, parent, child, where)
    check_stamps(stamps, where)
    trajectory = Trajectory.from_columns(
        stamps,
        positions,
        quaternions,
        frame=parent,
        child_frame=child,
        name=f"{parent}.{child}",
        dropped={"undecodable": damaged},
        notes=("format: TF", *bag.notes),
        damage=tuple(bag.damage),
    )
    return _usable(trajectory, where, len(stamps))


def _usable(trajectory: Trajectory, where: str, count: int) -> Trajectory:
    """Return the trajectory, or raise InputError if none of its poses was left."""
    if not len(trajectory):
        why = ", ".join(f"{number} {reason}" for reason, number in trajectory.dropped.items())
        raise InputError(f"{where}: none of {count} messages is a pose ({why})")
    return trajectory


def _world_velocities(body: Floats, quaternions: Floats) -> Floats | None:
    """Return the velocities (N, 3) in the frame, or None if they were never filled in."""
    if not body.any() or not np.isfinite(body).any():
        return None
    lengths = np.linalg.norm(quaternions, axis=1)
    usable = np.isfinite(lengths) & (lengths > 1e-6)
    velocities = np.zeros_like(body)
    if usable.any():
        (velocities[usable],) = lie.by_blocks(_turned, quaternions[usable], body[usable])
    return velocities


def _turned(quaternions: Floats, vectors: Floats) -> tuple[Floats]:
    """Return the vectors (N, 3) turned by quaternions (N, 4) of any length."""
    matrices = lie.to_matrix(lie.normalized(quaternions))
    return (np.einsum("nij,nj->ni", matrices, vectors),)
