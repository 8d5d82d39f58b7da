"""Writing of several trajectories to text files or to one bag."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from trajeval_ros.exceptions import InputError, require_one_of
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.text.text_writer import write_euroc, write_kitti, write_tum
from trajeval_ros.io.writing import refused_by_disk

_TEXT: dict[str, tuple[str, Callable[[Path, Trajectory], None]]] = {
    "tum": (".txt", write_tum),
    "kitti": (".txt", write_kitti),
    "euroc": (".csv", write_euroc),
}
_BAGS = {"mcap": ".mcap", "rosbag2": ""}
FORMATS = (*_TEXT, *_BAGS)
_TF = "tf"
MESSAGES = {
    "PoseStamped": "geometry_msgs/msg/PoseStamped",
    "Odometry": "nav_msgs/msg/Odometry",
    "Path": "nav_msgs/msg/Path",
    _TF: "tf2_msgs/msg/TFMessage",
}
_NO_FILE = re.compile(r"[^\w.+-]+")
_NO_TOPIC = re.compile(r"[^A-Za-z0-9_/]")
_DIGIT_FIRST = re.compile("/(?=[0-9])")  # a part of a topic's name must not start with a digit
_WORLD = "map"  # parent frame of a transform if the trajectory names none


def files_of(folder: Path, names: Sequence[str], kind: str) -> list[Path]:
    """Return the paths that `save_trajectories` writes: one text file per name, or one bag."""
    require_one_of(kind, FORMATS, "format")
    stems = [_NO_FILE.sub("_", name).strip("_") or "trajectory" for name in names]
    if kind in _BAGS:
        return [folder / f"{stems[0] if len(stems) == 1 else 'trajectories'}{_BAGS[kind]}"]
    return [folder / f"{stem}{_TEXT[kind][0]}" for stem in _distinct(stems)]


def save_trajectories(
    folder: Path, trajectories: Sequence[Trajectory], kind: str, message: str = "PoseStamped"
) -> list[Path]:
    """Write trajectories, every file completely or not at all, and return the paths.

    `kind`: one of `FORMATS`. `mcap` is a file, `rosbag2` a folder with an sqlite3 file. `message`:
    message type in a bag, one of `MESSAGES`. The topic is the topic of the source, or the name of
    the trajectory. `tf` writes all transforms to /tf.
    """
    paths = files_of(folder, [item.name for item in trajectories], kind)
    require_one_of(message, MESSAGES, "message")
    for item in trajectories if message == _TF else ():
        if item.quaternions is None:
            raise InputError(
                f"{item.name} has no orientations, which transforms need; use another --message"
            )
    for path in paths:
        if path.exists():
            raise InputError(f"{path} exists; remove it, or choose another --output")
    with refused_by_disk(f"the folder {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    if kind in _TEXT:
        for path, trajectory in zip(paths, trajectories, strict=True):
            _TEXT[kind][1](path, trajectory)
        return paths
    from trajeval_ros.io.bags.write_bag import write_bag, write_mcap

    transforms = _as_transforms(trajectories) if message == _TF else []
    topics = {}
    if message != _TF:
        named = zip(_topics(trajectories), trajectories, strict=True)
        topics = {topic: (item, MESSAGES[message]) for topic, item in named}
    if kind == "mcap":
        write_mcap(paths[0], topics, transforms)
    else:
        write_bag(paths[0], topics, "sqlite3", transforms)
    return paths


def _topics(trajectories: Sequence[Trajectory]) -> list[str]:
    """Return one topic per trajectory, all different.

    If all trajectories were read from different topics, these topics are kept. Otherwise the
    topics are made from the names.
    """
    sources = [trajectory.reading.source.rpartition(":")[2] for trajectory in trajectories]
    are_topics = all(source.startswith("/") and "." not in source for source in sources)
    names = (
        sources
        if are_topics and len(set(sources)) == len(sources)
        else [trajectory.name for trajectory in trajectories]
    )
    words = [_NO_TOPIC.sub("_", name).strip("/") or "trajectory" for name in names]
    return [_DIGIT_FIRST.sub("/_", f"/{word}") for word in _distinct(words)]


def _as_transforms(trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """Return the trajectories with frames; child frames differ, since a child has one parent."""
    children = [trajectory.child_frame for trajectory in trajectories]
    if "" in children or len(set(children)) < len(children):
        children = _distinct(
            [_NO_TOPIC.sub("_", trajectory.name).strip("/") for trajectory in trajectories]
        )
    return [
        dataclasses.replace(trajectory, frame=trajectory.frame or _WORLD, child_frame=child)
        for trajectory, child in zip(trajectories, children, strict=True)
    ]


def _distinct(names: Sequence[str]) -> list[str]:
    """Return the names; a repeated name gets its place in the list as a suffix."""
    return [
        name if name not in names[:place] else f"{name}_{place + 1}"
        for place, name in enumerate(names)
    ]
