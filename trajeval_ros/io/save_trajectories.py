"""Writing of trajectories to text files of other programs (TUM, KITTI, EuRoC) or to one bag."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError, require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.source_info import ReceiveTimes
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.text.names import RECEIVED
from trajeval_ros.io.writing import refused_by_disk, write_whole

_BLOCK = 1 << 11  # rows that are converted at once; their objects fit into the cache
_TUM_HEADER = "# timestamp [s] tx ty tz qx qy qz qw\n"
_EUROC_GROUPS = {
    "positions": [f"p_RS_R_{axis} [m]" for axis in "xyz"],
    "quaternions": [f"q_RS_{element} []" for element in "wxyz"],
    "velocities": [f"v_RS_R_{axis} [m s^-1]" for axis in "xyz"],
    "gyroscope_biases": [f"b_w_RS_S_{axis} [rad s^-1]" for axis in "xyz"],
    "accelerometer_biases": [f"b_a_RS_S_{axis} [m s^-2]" for axis in "xyz"],
}


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write `t x y z qx qy qz qw` in seconds and metres.

    If the trajectory has no orientations, identity quaternions are written.
    """
    values = np.hstack([trajectory.positions, trajectory.known_quaternions])
    _write(path, _TUM_HEADER, trajectory, values, _seconds, " ")


def write_euroc(path: Path, trajectory: Trajectory) -> None:
    """Write CSV with the columns of EuRoC that the trajectory has.

    The columns are the timestamp in nanoseconds, position, quaternion (w first), velocity and
    biases; then the receive time in nanoseconds, a column of this package.
    """
    groups = {
        name: column for name in _EUROC_GROUPS if (column := getattr(trajectory, name)) is not None
    }
    header = ",".join(
        ["timestamp [ns]", *(title for name in groups for title in _EUROC_GROUPS[name])]
    )
    if "quaternions" in groups:
        groups["quaternions"] = groups["quaternions"][:, [3, 0, 1, 2]]
    values, receive_times = np.hstack(list(groups.values())), trajectory.reading.receive_times
    header += "" if receive_times is None else f",{RECEIVED} [ns]"
    _write(path, f"#{header}\n", trajectory, values, _integers, ",", receive_times)


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Write 3 x 4 matrices row by row, and the timestamps in seconds to STEM_times.txt.

    The axes of the trajectory are kept. They are not converted to the camera axes of KITTI.
    """
    matrices = trajectory.reading.matrices
    if matrices is None:
        matrices = lie.to_matrix(trajectory.known_quaternions)
    poses = np.concatenate([matrices, trajectory.positions[:, :, None]], axis=2)
    if trajectory.reading.stamped:
        no_values = np.empty((len(trajectory), 0))
        times = path.with_name(f"{path.stem}_times.txt")
        _write(times, "", trajectory, no_values, _seconds, " ")
    _write(path, "", trajectory, poses.reshape(-1, 12), None, " ")


def _write(
    path: Path,
    header: str,
    trajectory: Trajectory,
    values: Floats,
    stamp_texts: Callable[[Sequence[int]], list[str]] | None,
    separator: str,
    receive_times: ReceiveTimes | None = None,
) -> None:
    def lines() -> Iterator[str]:
        yield header
        for start in range(0, len(values), _BLOCK):
            rows = slice(start, start + _BLOCK)
            parts = []
            if stamp_texts is not None:
                parts.append(stamp_texts(trajectory.stamps[rows].tolist()))
            if values.shape[1]:
                parts.append(_rows_of_floats(values[rows], separator))
            if receive_times is not None:
                parts.append(_integers(receive_times.times[rows].tolist()))
            yield "\n".join(map(separator.join, zip(*parts, strict=True))) + "\n"

    def write(temporary: Path) -> None:
        with temporary.open("w", encoding="ascii", newline="\n") as file:
            file.writelines(lines())

    write_whole(path, write)


def _rows_of_floats(values: Floats, separator: str) -> list[str]:
    """Return the finite floats (N, M) of every row as text, as `repr` writes them."""
    # The text of a list has the same digits, and takes half the time of `repr` per float.
    return repr(values.tolist())[2:-2].replace(", ", separator).split(f"]{separator}[")


def _integers(stamps: Sequence[int]) -> list[str]:
    return list(map(str, stamps))


def _seconds(stamps: Sequence[int]) -> list[str]:
    """Return nanoseconds as seconds with nine decimals, exact."""
    return [
        f"{'-' * (stamp < 0)}{abs(stamp) // NANOSECONDS}.{abs(stamp) % NANOSECONDS:09d}"
        for stamp in stamps
    ]


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
