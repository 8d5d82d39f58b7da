"""Trajectories from the topics of a bag: poses, paths and transforms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags import Advance, Bag, Topic
from trajeval_ros.io.checks import check_stamps, judge_rotations
from trajeval_ros.io.messages import PoseColumns, Transforms, read_poses, read_transforms
from trajeval_ros.io.transforms import Edge, chain
from trajeval_ros.trajectory import Trajectory

Floats = NDArray[np.float64]


def read_bag(
    path: Path, topic: str, frames: tuple[str, str] | None, advance: Advance | None = None
) -> Trajectory:
    """Read a trajectory from a bag.

    Args:
        path: A bag.
        topic: Name of the topic, "" for the only one that holds poses.
        frames: (parent, child) if the topic holds transforms.
        advance: Called with the messages done and all messages, now and then.

    Raises:
        InputError: The bag, the topic or its poses can't be used.
    """
    with Bag(path, advance) as bag:
        if frames is not None:
            return _transform_trajectory(bag, topic, frames)
        chosen = _choose(bag, topic)
        if not topic:
            bag.notes.append(f"{chosen.name} is the only topic with poses")
        return read_topic(bag, chosen)


def read_topic(bag: Bag, topic: Topic) -> Trajectory:
    """Read the trajectory of a topic that holds poses.

    Raises:
        InputError: None of its messages can be used.
    """
    columns = read_poses(bag.payloads([topic]), bag.decoder(topic), topic.type)
    return _trajectory(bag, topic, columns)


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
        columns: dict[tuple[str, str], Transforms] = {}
        damaged += read_transforms(bag.payloads([found]), bag.decoder(found), columns)
        for key, transforms in columns.items():
            edge = Edge.from_columns(
                np.array(transforms.stamps, dtype=np.int64),
                np.array(transforms.numbers).reshape(-1, 7),
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
        raise InputError(f"{bag.path} is an empty bag: it has no topics")
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
        why = f": none of its {columns.undecodable} messages can be decoded"
        raise InputError(f"{where} holds no pose" + (why if columns.undecodable else ""))
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
