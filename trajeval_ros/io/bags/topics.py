"""Trajectories from the topics of a bag: poses, paths and transforms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Level, Remark, note, warning
from trajeval_ros.geometry.fix_selection import trajectory_of_rows
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.outlier_stamps import LONE, trusted_states
from trajeval_ros.geometry.source_info import FORMAT, SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.bags.bag import Advance, Bag
from trajeval_ros.io.bags.containers import Topic
from trajeval_ros.io.bags.declared_resets import about_resets, declared_resets
from trajeval_ros.io.bags.nested_poses import NestedPose, chosen_pose, nested_poses
from trajeval_ros.io.bags.pose_columns import PoseColumns
from trajeval_ros.io.bags.pose_messages import POSE_2D, POSE_2D_TIMES
from trajeval_ros.io.bags.px4_messages import (
    PX4_POSE_TYPES,
    about_px4,
    expected_sizes,
    majority_frame,
    why_none,
)
from trajeval_ros.io.bags.received_transforms import ReceivedChain, compose_received
from trajeval_ros.io.bags.topic_readers import (
    PoseReader,
    TransformReader,
    read_topics,
    tree_of,
    tree_topics,
)
from trajeval_ros.io.bags.transform_tree import compose, find_chain, fixed_transform
from trajeval_ros.io.bags.usable_poses import WORLD_TWIST, has_world_twist, usable_poses
from trajeval_ros.io.checks import check_rotations, check_stamps


@dataclass(frozen=True)
class BagSource:
    """A trajectory in a bag."""

    topic: str  # name of the topic, "" for the only one that holds poses
    frames: tuple[str, str] | None  # (parent, child) if the topic holds transforms, else None
    covariances: bool = True  # whether to read them, too
    # Whether to read poses as they were received, and by which clock: `log`, `publish`, `auto`
    # (publish times where they differ); empty for no.
    received: str = ""


def read_bag(
    path: Path,
    sources: Sequence[BagSource],
    advance: Advance | None = None,
    *,
    strict: bool = False,
) -> list[Trajectory]:
    """Read trajectories from a bag, all of them in one pass.

    `advance`: called repeatedly with the number of messages read and the number of all.

    Returns:
        One trajectory per source; the same object for equal sources.
    """
    with Bag(path, advance, strict=strict) as bag:
        plan = _Plan(bag)
        unique = {source: plan.add(source) for source in sources}
        read_topics(bag, plan.readers)
        made = {source: make() for source, make in unique.items()}
        return [made[source] for source in sources]


class _Plan:
    """The readers for several sources. A topic of several sources is read once."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._poses: dict[tuple[Topic, NestedPose | None, bool, str], PoseReader] = {}
        self._transforms: dict[Topic, TransformReader] = {}

    @property
    def readers(self) -> list[PoseReader | TransformReader]:
        return [*self._poses.values(), *self._transforms.values()]

    def add(self, source: BagSource) -> Callable[[], Trajectory]:
        """Return a function that makes the trajectory of a source after the reading."""
        bag, frames = self._bag, source.frames
        if frames is not None:
            matches = bag.find(source.topic)
            if not any(item.holds_transforms for item in matches):
                raise InputError(
                    f"{bag.path}: {source.topic} has type {matches[0].type}, not transforms"
                )
            tree = [
                self._transforms.setdefault(tree_topic, TransformReader(tree_topic))
                for tree_topic in tree_topics(bag, source.topic)
            ]
            return lambda: _transform_trajectory(bag, source, frames, tree)
        topic, nested = _choose(bag, source.topic)
        key = topic, nested, source.covariances, source.received
        if key not in self._poses:
            self._poses[key] = PoseReader(
                bag,
                topic,
                covariances=source.covariances,
                received=source.received,
                nested=nested,
            )
        reader = self._poses[key]
        if source.topic:
            return lambda: trajectory_of(bag, reader)
        only = note("only_topic", f"{topic.name} is the only topic with poses")
        return lambda: trajectory_of(bag, reader, (only,))


def read_hand_eye_of_bag(path: Path, topic: str, frames: tuple[str, str]) -> HandEye:
    """Return T_B_M from the static transforms of a bag."""
    body, marker = frames
    with Bag(path) as bag:
        tree = [TransformReader(tree_topic) for tree_topic in tree_topics(bag, topic)]
        read_topics(bag, tree)
        where = f"{bag.path}:{topic}:{body}.{marker}"
        lever_m, quaternion = fixed_transform(tree_of(tree), body, marker, where)
    return HandEye(quaternion, lever_m, body, marker)


def _choose(bag: Bag, name: str) -> tuple[Topic, NestedPose | None]:
    """Return the topic to read, and where its messages have the pose if their type is no pose.

    Raises:
        InputError: There is none, or there are several; with the readable topics.
    """
    posed = [topic for topic in bag.topics if topic.holds_poses]
    # A topic of fixes is chosen only by its name, or if it is the only one.
    candidates = [topic for topic in posed if not topic.holds_fixes] or posed
    transforms = [topic for topic in bag.topics if topic.holds_transforms]
    listed = ", ".join([topic.name for topic in posed])
    if transforms:
        listed += (", " if listed else "") + f"{transforms[0].name}:PARENT.CHILD"
    if name:
        of_field = _topic_of_field(bag, name)
        if of_field is not None:
            return of_field
        matches = bag.find(name)
        poses = [topic for topic in matches if topic.holds_poses]
        if len(poses) == 1:
            return poses[0], None
        if len(matches) == 1 and not poses and nested_poses(matches[0].fields):
            return matches[0], chosen_pose(matches[0].fields, "", f"{bag.path}:{name}")
        types = " and ".join(topic.type for topic in matches)
        if len(poses) > 1:
            raise InputError(f"{bag.path}: {name} has several types of poses ({types})")
        raise InputError(
            f"{bag.path}: {name} has type {types}, not poses"
            + (f"; poses are on {listed}" if listed else ", and no other topic has poses")
        )
    if len(candidates) == 1:
        return candidates[0], None
    if not bag.topics:
        why = "; ".join(bag.damage) or "it has no topics"
        raise InputError(f"{bag.path} is an empty bag: {why}")
    if not listed:
        for topic in bag.topics:
            if topic.lacks_protobuf:
                bag.find(topic.name)  # raises with the package to install
        types = ", ".join(sorted({topic.type for topic in bag.topics}))
        raise InputError(f"{bag.path} has no topic with poses, only {types}")
    raise InputError(
        f"{bag.path} has several topics with poses; choose one as in {bag.path}:TOPIC, of {listed}"
    )


def _topic_of_field(bag: Bag, name: str) -> tuple[Topic, NestedPose] | None:
    """Return the topic and the pose of a name with a field path; None for other names."""
    if any(topic.name == name for topic in bag.topics):
        return None
    begun = [
        topic
        for topic in bag.topics
        if name.startswith(topic.name) and name[len(topic.name)] in ".["
    ]
    if not begun:
        return None
    topic = max(begun, key=lambda candidate: len(candidate.name))
    field = name[len(topic.name) :]
    return topic, chosen_pose(topic.fields, field, f"{bag.path}:{topic.name}")


def trajectory_of(bag: Bag, reader: PoseReader, remarks: tuple[Remark, ...] = ()) -> Trajectory:
    """Return the trajectory of a topic that was read."""
    topic = reader.reading.topic
    damage = bag.remarks([reader.reading])
    nested = reader.nested
    name = topic.name if nested is None else topic.name + nested.field
    where = f"{bag.path}:{name}"
    why = "; ".join(item.text for item in damage if item.level is Level.ERROR)
    if topic.type == POSE_2D:
        remarks = (*remarks, POSE_2D_TIMES)
    if reader.slides:
        text = "the paths slide: poses of all messages in their newest versions"
        remarks = (*remarks, note("sliding_path", text))
    if nested is not None and not nested.stamp:
        remarks = (*remarks, note("log_times", "no timestamps in messages: log times used"))
    kind = f"{topic.type}, field {nested.field}" if nested and nested.field else topic.type
    columns, remarks = _with_times(reader.poses(), remarks)
    everything = (note(FORMAT, f"format: {kind}"), *remarks, *damage)
    return trajectory_of_columns(where, name, topic.type, columns, everything, why)


def _with_times(
    columns: PoseColumns, remarks: tuple[Remark, ...]
) -> tuple[PoseColumns, tuple[Remark, ...]]:
    """Return poses with log times if all timestamps are zero; not those of one message."""
    rows, receive_times = columns.rows, columns.receive_times
    if columns.stamps.any() or receive_times is None or not len(rows) or rows[0] == rows[-1]:
        return columns, remarks
    text = (
        "all timestamps of the headers are zero: log times used, which include delays; "
        "--time-offset auto estimates the delay"
    )
    remark = warning("log_times", text)
    return columns.replaced(stamps=receive_times.times), (*remarks, remark)


def trajectory_of_columns(
    where: str,
    name: str,
    message_type: str,
    columns: PoseColumns,
    remarks: tuple[Remark, ...],
    why: str = "",
) -> Trajectory:
    """Return the trajectory in the poses of a topic.

    `where`: source in messages. `why`: reason for missing poses, if the source is damaged.
    """
    if not len(columns.stamps):
        if columns.undecodable:
            why = f"none of its {columns.undecodable} messages can be decoded"
            if message_type in PX4_POSE_TYPES:
                why += f": {expected_sizes(message_type)}"
        elif columns.dropped:
            why = why_none(columns.dropped)
        raise InputError(f"{where} has no poses" + (f": {why}" if why else ""))
    if message_type in PX4_POSE_TYPES:
        columns = majority_frame(columns)
        remarks = (*remarks, *about_px4(columns))
    count = len(columns.stamps)
    are_times = check_stamps(columns.stamps, f"{where}, header.stamp")
    columns, velocities, dropped, frame_changes = usable_poses(columns, are_times)
    quaternions, judgement = check_rotations(columns.quaternions)
    if velocities is not None and (
        quaternions is None or not velocities.any() or not np.isfinite(velocities).any()
    ):
        velocities = None
    if velocities is not None and has_world_twist(columns):
        remarks = (*remarks, WORLD_TWIST)
    covariances = columns.covariances
    if covariances is not None and not np.nan_to_num(covariances).any():
        covariances = None
    changes = [
        f"{where}: frame_id changes from {before[1:]} to {after[1:]} at pose {after[0]}"
        for before, after in frame_changes
    ]
    if len(changes) > 1:
        changes = [f"{changes[0]}, and {counted(len(changes) - 1, 'more time')}"]
    if columns.fix_quality is not None:
        receivers = _receivers(where, columns.frames)
        return trajectory_of_rows(
            where,
            columns.stamps,
            columns.positions,
            columns.fix_quality,
            SourceInfo(
                dropped=dropped,
                remarks=(*remarks, *receivers),
                receive_times=columns.receive_times,
            ),
            child_frame=columns.frames[0][1],
            name=name.strip("/"),
        )
    resets = declared_resets(columns)
    reset_remarks = about_resets(resets, int(columns.stamps.min()))
    frames = (note("frame_changed", change) for change in changes)
    everything = Trajectory.from_columns(
        columns.stamps,
        columns.positions,
        quaternions,
        velocities=velocities,
        covariances=covariances,
        frame=columns.frames[0][1],
        up=UpAxis.of_frame(columns.frames[0][1]),
        child_frame=columns.frames[0][2],
        name=name.strip("/"),
        reading=SourceInfo(
            has_identity_rotations=columns.quaternions is not None and quaternions is None,
            dropped=dropped,
            remarks=(*remarks, *reset_remarks, *frames, *judgement),
            resets=resets,
            receive_times=columns.receive_times,
            as_received=None if columns.as_received is None else _as_received(columns.as_received),
        ),
    )
    return _usable(_without_lone_stamps(everything), where, count)


def _as_received(columns: PoseColumns) -> Trajectory:
    rows = columns.rows_of(trusted_states(columns.stamps)[0])
    reading = SourceInfo(receive_times=rows.receive_times)
    return Trajectory.from_columns(rows.stamps, rows.positions, rows.quaternions, reading)


def _without_lone_stamps(trajectory: Trajectory) -> Trajectory:
    """Return the states without isolated timestamps, in order of arrival."""
    rows, trust = trusted_states(trajectory.stamps)
    if not trust.isolated:
        return trajectory
    trusted = trajectory[rows]
    reading = trusted.reading.with_dropped({LONE: trust.isolated})
    return replace(trusted, reading=reading.remarked(note(LONE, trust.message)))


def _receivers(where: str, frames: list[tuple[int, str, str]]) -> tuple[Remark, ...]:
    """Refuse fixes of several receivers, which have different antennas; remark on one renaming."""
    names = list(dict.fromkeys(frame for _, frame, _ in frames))
    if len(frames) > 2:
        raise InputError(
            f"{where} has fixes of several receivers (frame_id {', '.join(map(repr, names))}); "
            "record one topic per receiver"
        )
    if len(names) < 2:
        return ()
    return (note("frame_changed", f"frame_id changes from {names[0]} to {names[1]}"),)


def _transform_trajectory(
    bag: Bag, source: BagSource, frames: tuple[str, str], tree: Sequence[TransformReader]
) -> Trajectory:
    """Return the trajectory of a child frame in a parent frame."""
    parent, child = frames
    where = f"{bag.path}:{source.topic}:{parent}.{child}"
    remarks = bag.remarks([item.reading for item in tree])
    edges, clock, received = tree_of(tree), source.received, None
    way, leading, stamps = find_chain(edges, parent, child, where)
    positions, quaternions = compose(edges, way, stamps)
    check_stamps(stamps, where)
    if clock:
        arrived = {key: item for reader in tree for key, item in reader.received(clock).items()}
        received = compose_received(ReceivedChain(edges, way, leading), arrived)
    trajectory = Trajectory.from_columns(
        stamps,
        positions,
        quaternions,
        frame=parent,
        up=UpAxis.of_frame(parent),
        child_frame=child,
        name=f"{parent}.{child}",
        reading=SourceInfo(
            dropped={
                "undecodable": sum(item.undecodable for item in tree),
                LONE: sum(item.isolated for item in tree),
            },
            remarks=(note(FORMAT, "format: TF"), *remarks),
            as_received=received,
        ),
    )
    return _usable(trajectory, where, len(stamps))


def _usable(trajectory: Trajectory, where: str, count: int) -> Trajectory:
    """Return the trajectory, or raise InputError if it has no poses."""
    if not len(trajectory):
        dropped = trajectory.reading.dropped
        why = ", ".join(f"{number} {reason}" for reason, number in dropped.items())
        raise InputError(f"{where}: no valid pose in {counted(count, 'message')} ({why})")
    return trajectory
