"""Trajectories from logs of PX4 (.ulg), read with pyulog: `LOG.ulg:TOPIC` or `LOG.ulg:TOPIC.1`."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Level, Remark, damaged, note
from trajeval_ros.geometry.source_info import FORMAT
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.px4_messages import (
    ATTITUDE,
    GPS,
    LOCAL_POSITION,
    ODOMETRY,
    attitude_name,
    poses_of_px4,
    with_attitudes,
)
from trajeval_ros.io.bags.topics import trajectory_of_columns
from trajeval_ros.io.checks import nearest

_HEADER = 16  # bytes before the first message
# Message types of px4_msgs by the topics of uORB.
_TYPES = {
    "vehicle_odometry": ODOMETRY,
    "vehicle_visual_odometry": ODOMETRY,
    "vehicle_mocap_odometry": ODOMETRY,
    "estimator_odometry": ODOMETRY,
    "vehicle_local_position": LOCAL_POSITION,
    "vehicle_local_position_groundtruth": LOCAL_POSITION,  # of the simulator
    "estimator_local_position": LOCAL_POSITION,
    "vehicle_gps_position": GPS,
    "sensor_gps": GPS,
}
_kept: dict[tuple[Path, int], PoseLog] = {}  # the newest log of `topics_of`
_ATTITUDES = tuple(attitude_name(name) for name, kind in _TYPES.items() if kind == LOCAL_POSITION)


class PoseLog:
    """The poses in a log."""

    def __init__(self, path: Path, limit: int = -1) -> None:
        """Read the topics with poses of a log, in its first `limit` bytes.

        Raises:
            InputError: The log can't be read.
        """
        try:
            from pyulog import ULog
        except ImportError as error:
            raise InputError(
                f"{path} is a log of PX4, which needs an extra; install it: {extra_command('px4')}"
            ) from error
        self.path = path
        with path.open("rb") as file:
            raw = file.read(limit)
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # where pyulog prints its warnings
                log = ULog(io.BytesIO(raw), [*_TYPES, *_ATTITUDES], disable_str_exceptions=True)
        except Exception as error:  # of many types, for damaged files
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise InputError(f"{path} can't be read as a log of PX4: {reason}") from error
        self.remarks: list[Remark] = []
        cut = 0 if log.file_corruption else _cut_off(raw)
        if log.file_corruption or cut:
            what = f"its last {cut} bytes are truncated" if cut else "unreadable parts are dropped"
            self.remarks.append(damaged(f"{path} is damaged: {what}"))
        if log.dropouts:
            lost_s = sum(dropout.duration for dropout in log.dropouts) / 1000.0
            text = f"{counted(len(log.dropouts), 'dropout')} of the logger, {lost_s:.1f} s"
            self.remarks.append(note("dropouts", text))
        self._data = {_name(item): _columns_of(item.data) for item in log.data_list}
        self.topics = [name for name in self._data if name.partition(".")[0] in _TYPES]

    def count(self, name: str) -> int:
        """Return the number of messages of a topic."""
        return len(self._data[name].rows)

    def trajectory(self, name: str) -> Trajectory:
        """Return the trajectory of a topic, such as `vehicle_odometry`, or `NAME.1`.

        Raises:
            InputError: The log lacks the topic, or it has no usable pose.
        """
        if name not in self.topics:
            raise InputError(
                f"{self.path} has no topic {name}; topics with poses: {nearest(name, self.topics)}"
            )
        base, dot, instance = name.partition(".")
        kind, attitude = _TYPES[base], attitude_name(base) + dot + instance
        poses = poses_of_px4(self._data[name], kind, 0)
        if kind == LOCAL_POSITION and attitude in self._data:
            poses = with_attitudes(poses, poses_of_px4(self._data[attitude], ATTITUDE, 0))
        remarks = (note(FORMAT, f"format: ULog, {kind}"), *self.remarks)
        return trajectory_of_columns(f"{self.path}:{name}", name, kind, poses, remarks)


def read_log(path: Path, topics: Sequence[str], *, strict: bool = False) -> list[Trajectory]:
    """Return the trajectories of topics of a log; "" is the only topic with poses.

    Raises:
        InputError: The log can't be read, lacks a topic, or is damaged and `strict` is set.
    """
    log = _kept.pop(_version(path), None) or PoseLog(path)
    if strict and (
        wrong := [remark.text for remark in log.remarks if remark.level is Level.ERROR]
    ):
        raise InputError(wrong[0])
    if "" in topics and len(log.topics) != 1:
        listed = ", ".join(log.topics)
        several = f"several topics with poses; choose one as in {path}:TOPIC, of {listed}"
        raise InputError(f"{path} has {several if listed else 'no topic with poses'}")
    return [log.trajectory(topic.lstrip("/") or log.topics[0]) for topic in topics]


def topics_of(path: Path) -> list[str]:
    """Return the topics with poses of a log, which is kept for the next `read_log`."""
    _kept.clear()
    log = _kept[_version(path)] = PoseLog(path)
    return log.topics


def _version(path: Path) -> tuple[Path, int]:
    return path, path.stat().st_mtime_ns


def _cut_off(raw: bytes) -> int:
    """Return the number of bytes of an incomplete message at the end, which pyulog ignores."""
    at = _HEADER
    while at + 3 <= len(raw) and (after := at + 3 + raw[at] + (raw[at + 1] << 8)) <= len(raw):
        at = after
    return len(raw) - at


def _name(data: Any) -> str:
    """Return the name of a topic, with its instance unless that is the first."""
    return f"{data.name}.{data.multi_id}" if data.multi_id else str(data.name)


def _columns_of(fields: Mapping[str, Any]) -> Columns:
    """Return the fields of a log as columns; `q[0]` to `q[3]` become one, (N, 4)."""
    parts: dict[str, list[Any]] = {}
    for name, column in fields.items():
        parts.setdefault(name.partition("[")[0], []).append(column)
    numbers = {name: np.column_stack(columns) for name, columns in parts.items()}
    count = max(map(len, numbers.values()), default=0)  # a damaged log may lack the timestamp
    return Columns(np.arange(count), numbers, {}, {})
