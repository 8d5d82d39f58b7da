"""Trajectories from the topics of a bag: poses, paths and transforms."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags import Advance, Bag, Topic, encoding_of
from trajeval_ros.io.blocks import Block, block_of
from trajeval_ros.io.cdr import Columns, in_order_of, joined
from trajeval_ros.io.checks import check_stamps, judge_rotations
from trajeval_ros.io.containers import Container
from trajeval_ros.io.definitions import recorded_fields
from trajeval_ros.io.messages import (
    PATH_TYPE,
    PoseColumns,
    TransformColumns,
    edges_of,
    plan_of,
    poses_of,
)
from trajeval_ros.io.transforms import Edge, chain
from trajeval_ros.trajectory import Trajectory

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]


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
        return read_topic(bag, chosen, covariances=covariances)


def read_topic(bag: Bag, topic: Topic, *, covariances: bool = True) -> Trajectory:
    """Read the trajectory of a topic that holds poses; of paths, the last one.

    Raises:
        InputError: None of its messages can be used.
    """
    if topic.type == PATH_TYPE:
        return _trajectory(bag, topic, _last_path(bag, topic))
    decoders = _Decoders(topic, covariances=covariances)
    parts, log_times = [decoders.nothing()], [np.zeros(0, dtype=np.int64)]
    undecodable = 0
    for block, columns in decoders.decoded(bag):
        parts.append(columns)
        log_times.append(block.log_times[columns.rows])
        undecodable += len(block) - len(columns.rows)
    everything = in_order_of(joined(parts), np.concatenate(log_times))
    return _trajectory(bag, topic, poses_of(everything, topic.type, undecodable))


def _last_path(bag: Bag, topic: Topic) -> PoseColumns:
    """Return the poses of the last path, the revised trajectory."""
    decoders = _Decoders(topic, covariances=False)
    last: tuple[int, Container, Block] | None = None
    for container, block in bag.blocks([topic]):
        row = len(block) - 1 - int(block.log_times[::-1].argmax())
        if last is None or block.log_times[row] >= last[0]:
            payload = [bytes(next(block[row : row + 1].payloads()))]
            only = block_of(block.connections[[row]], block.log_times[[row]], payload)
            last = int(block.log_times[row]), container, only
    if last is None:
        return poses_of(decoders.nothing(), topic.type, 0)
    ((_, columns),) = decoders.of_block(last[1], last[2])
    return poses_of(columns, topic.type, 1 - len(columns.rows))


class _Decoders:
    """How the messages of a topic are decoded, by connection: definitions may differ."""

    def __init__(self, topic: Topic, *, covariances: bool) -> None:
        self._topic = topic
        self._plans = {
            (id(each.owner), each.id): plan_of(
                recorded_fields(each),
                topic.type,
                covariance=covariances,
                is_ros1=encoding_of(each) == "ros1",
            )
            for each in topic.connections
        }

    def nothing(self) -> Columns:
        """Return the columns of no message."""
        return next(iter(self._plans.values())).decode([])

    def decoded(self, bag: Bag) -> Iterator[tuple[Block, Columns]]:
        """Yield the messages of the topic, and their columns."""
        for container, block in bag.blocks([self._topic]):
            yield from self.of_block(container, block)

    def of_block(self, container: Container, block: Block) -> Iterator[tuple[Block, Columns]]:
        """Yield the messages of a block by connection, and their columns."""
        ids = np.unique(block.connections).tolist()
        for each in ids:
            own = block if len(ids) == 1 else block[block.connections == each]
            plan = self._plans[id(container), each]
            yield own, plan.decode_at(own.buffer, own.begins, own.sizes)


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
        for block, columns in _Decoders(found, covariances=False).decoded(bag):
            damaged += len(block) - len(columns.rows)
            for key, own in edges_of(columns).items():
                parts.setdefault(key, []).append((own, block.log_times[own.rows]))
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
        types = ", ".join(sorted({topic.type for topic in bag.topics}))
        raise InputError(f"{bag.path} has no topic with poses, only {types}")
    raise InputError(
        f"{bag.path} is a bag with several topics; name one as in {bag.path}:TOPIC, of {listed}"
    )


def _trajectory(bag: Bag, topic: Topic, columns: PoseColumns) -> Trajectory:
    """Return the trajectory of a topic's columns."""
    where = f"{bag.path}:{topic.name}"
    if not len(columns.stamps):
        why = "; ".join(bag.damage)
        if columns.undecodable:
            why = f"none of its {columns.undecodable} messages can be decoded"
        raise InputError(f"{where} holds no pose" + (f": {why}" if why else ""))
    timed = check_stamps(columns.stamps, f"{where}, header.stamp")
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
            "zero_stamp": int(np.count_nonzero(~timed)),
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
    stamps, positions, quaternions = chain(edges, parent, child, where)
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
        velocities[usable] = Rotation.from_quat(quaternions[usable]).apply(body[usable])
    return velocities
