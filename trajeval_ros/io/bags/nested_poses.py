"""Poses inside messages of any type: `BAG:/vendor/status.odom`, `BAG:/mocap/poses[0]`.

A pose is recognised by its fields: position and orientation, or translation and rotation. Its
timestamp is that of the nearest header or stamp around it. The order of a quaternion in an array
of four numbers is not in the message, so the field path states it: `BAG:/vendor/state.q[wxyz]`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.cdr_columns import Columns, Numbers, StringColumn
from trajeval_ros.io.bags.message_definitions import TEXT, Fields, Kind, Repeated
from trajeval_ros.io.bags.pose_columns import PoseColumns
from trajeval_ros.io.bags.pose_messages import changes_of, floats_of

_ELEMENT = re.compile(r"\[(\d{1,6})\]")
_STEPS = re.compile(r"(\.\w+|\[\d{1,6}\])*")
_TIME = ("sec", "nanosec")
_MATRIX = Repeated("f8", 36)
_ORDER = re.compile(r"\[(wxyz|xyzw)\]$")
_POSITION = re.compile(r"p|pos|position|translation|xyz", re.IGNORECASE)
_ROTATION = re.compile(r"q|quat|quaternion|orientation|rotation|attitude", re.IGNORECASE)


@dataclass(frozen=True)
class NestedPose:
    """Where the messages of a type have a pose; paths from the message, "" for none."""

    path: str  # of the message with the position and the orientation
    position: str
    quaternion: str
    sequence: str = ""  # the sequence that the pose is in
    index: int = 0  # number of its element
    stamp: str = ""
    frame: str = ""
    child_frame: str = ""
    velocity: str = ""  # in the body
    covariance: str = ""
    order: str = ""  # of the quaternion in an array: "wxyz" or "xyzw"

    @property
    def field(self) -> str:
        """The field as it is written after a topic: ".odom.pose.pose", ".poses[0]", ".q[wxyz]"."""
        rest = self.path[len(self.sequence) :]
        element = f".{self.sequence}[{self.index}]" if self.sequence else ""
        order = f"[{self.order}]" if self.order else ""
        return element + (rest if self.sequence else f".{rest}" if rest else "") + order

    def requested(self, *, covariances: bool) -> list[str]:
        """Return the fields to decode."""
        stamps = [f"{self.stamp}.{part}" for part in _TIME] if self.stamp else []
        others = [self.frame, self.child_frame, self.velocity]
        others += [self.covariance] if covariances else []
        return [self.position, self.quaternion, *stamps, *filter(None, others)]

    def poses(
        self, columns: Columns, log_times: Stamps, undecodable: int, *, covariances: bool
    ) -> PoseColumns:
        """Return the poses in decoded columns; without a stamp they have the log times (N,)."""
        fields = _Decoded(columns, self)
        rows = fields.rows
        if self.stamp:
            seconds = fields.numbers(f"{self.stamp}.sec").astype(np.int64)
            stamps = seconds * NANOSECONDS + fields.numbers(f"{self.stamp}.nanosec")
        else:
            stamps = log_times[rows]
        matrices = self.covariance if covariances else ""
        none = StringColumn(("",), np.zeros(len(rows), dtype=np.int64))
        quaternions = floats_of(fields.numbers(self.quaternion))
        return PoseColumns(
            stamps=stamps,
            positions=floats_of(fields.numbers(self.position)),
            quaternions=np.roll(quaternions, -1, axis=1) if self.order == "wxyz" else quaternions,
            body_velocities=floats_of(fields.numbers(self.velocity)) if self.velocity else None,
            covariances=(
                floats_of(fields.numbers(matrices)).reshape(-1, 6, 6) if matrices else None
            ),
            fix_quality=None,
            frames=changes_of(
                fields.texts(self.frame) if self.frame else none,
                fields.texts(self.child_frame) if self.child_frame else None,
            ),
            rows=rows,
            undecodable=undecodable,
            dropped={"without_this_element": len(columns.rows) - len(rows)},
        )


class _Decoded:
    """The decoded fields of messages, for those that have the element."""

    def __init__(self, columns: Columns, place: NestedPose) -> None:
        self._message, self._sequence = columns, place.sequence
        if not place.sequence:
            self.rows = columns.rows
            return
        self._elements = columns.sequences[place.sequence]
        owners = self._elements.rows
        begins = np.searchsorted(owners, np.arange(len(columns.rows)))
        numbers = np.arange(len(owners)) - begins[owners]
        self._chosen: Indices = np.flatnonzero(numbers == place.index)
        self._owners: Indices = owners[self._chosen]
        self.rows = columns.rows[self._owners]

    def numbers(self, path: str) -> Numbers:
        columns, name, chosen = self._place(path)
        column = columns.numbers[name]
        return column if chosen is None else column[chosen]

    def texts(self, path: str) -> StringColumn:
        columns, name, chosen = self._place(path)
        column = columns.texts[name]
        return column if chosen is None else replace(column, codes=column.codes[chosen])

    def _place(self, path: str) -> tuple[Columns, str, Indices | None]:
        if not self._sequence:
            return self._message, path, None
        inside = f"{self._sequence}."
        if path.startswith(inside):
            return self._elements, path[len(inside) :], self._chosen
        return self._message, path, self._owners


def nested_poses(fields: Fields) -> list[NestedPose]:
    """Return the poses in the messages of a type, of sequences those of the first element."""
    return list(_inside(fields, "", NestedPose("", "", "")))


def _inside(fields: Fields, prefix: str, around: NestedPose) -> Iterator[NestedPose]:
    """Yield the poses in a message; `around` has what the messages around it contribute."""
    kinds = dict(fields)
    header = kinds.get("header")
    if _has_names(kinds.get("stamp"), _TIME):
        around = replace(around, stamp=f"{prefix}stamp")
    elif isinstance(header, tuple) and _has_names(dict(header).get("stamp"), _TIME):
        around = replace(around, stamp=f"{prefix}header.stamp")
        if dict(header).get("frame_id") == TEXT:
            around = replace(around, frame=f"{prefix}header.frame_id")
    if kinds.get("child_frame_id") == TEXT:
        around = replace(around, child_frame=f"{prefix}child_frame_id")
    for position, orientation in (("position", "orientation"), ("translation", "rotation")):
        if _is_vector(kinds.get(position), "xyz") and _is_vector(kinds.get(orientation), "xyzw"):
            paths = prefix.rstrip("."), prefix + position, prefix + orientation
            yield replace(around, path=paths[0], position=paths[1], quaternion=paths[2])
            return
    positions = [
        name
        for name, kind in fields
        if _POSITION.fullmatch(name) and (_is_array(kind, 3) or _is_vector(kind, "xyz"))
    ]
    arrays = [name for name, kind in fields if _ROTATION.fullmatch(name) and _is_array(kind, 4)]
    if len(positions) == len(arrays) == 1:
        path = prefix + arrays[0]
        place = replace(around, path=path, position=prefix + positions[0], quaternion=path)
        yield from (replace(place, order=order) for order in ("wxyz", "xyzw"))
    for name, kind in fields:
        if isinstance(kind, tuple):
            inner = replace(around, covariance="")
            if name == "pose" and kinds.get("covariance") == _MATRIX:
                inner = replace(inner, covariance=f"{prefix}covariance")
            if name == "pose" and _has_twist(kinds.get("twist")):
                inner = replace(inner, velocity=f"{prefix}twist.twist.linear")
            yield from _inside(kind, f"{prefix}{name}.", inner)
        elif isinstance(kind, Repeated) and isinstance(kind.kind, tuple) and not around.sequence:
            inner = replace(around, sequence=prefix + name, covariance="", velocity="")
            yield from _inside(kind.kind, f"{prefix}{name}.", inner)


def _is_array(kind: Kind, count: int) -> bool:
    return kind in (Repeated("f4", count), Repeated("f8", count))


def _has_names(kind: Kind | None, names: Sequence[str]) -> bool:
    return isinstance(kind, tuple) and tuple(name for name, _ in kind) == tuple(names)


def _is_vector(kind: Kind | None, names: str) -> bool:
    return isinstance(kind, tuple) and kind in [
        tuple((name, number) for name in names) for number in ("f4", "f8")
    ]


def _has_twist(kind: Kind | None) -> bool:
    twist = dict(kind).get("twist") if isinstance(kind, tuple) else None
    return isinstance(twist, tuple) and _is_vector(dict(twist).get("linear"), "xyz")


def chosen_pose(fields: Fields, text: str, topic: str) -> NestedPose:
    """Return the pose that a field path names.

    Args:
        fields: Of the topic's type.
        text: What follows the topic, such as `.status.odom`, `[2]`, `.poses[0].pose`, `.q[wxyz]`;
            "" for the only pose in the messages. A path to a message with one pose is enough.
        topic: The topic in messages, with the bag.

    Raises:
        InputError: There is no such pose, or there are several.
    """
    places = nested_poses(fields)
    order = _ORDER.search(text)
    steps = _ORDER.sub("", text)
    element = _ELEMENT.search(steps)
    path = _ELEMENT.sub("", steps, count=1).strip(".")
    if _STEPS.fullmatch(steps) and not _ELEMENT.search(path):
        fitting = [
            place
            for place in places
            if bool(place.sequence) == bool(element)
            and (not order or place.order == order[1])
            and (not path or f"{place.path}.".startswith(f"{path}."))
        ]
        if len(fitting) == 1:
            return replace(fitting[0], index=int(element[1]) if element else 0)
    listed = ", ".join(f"{topic}{place.field}" for place in places)
    choice = f"choose one of {listed}" if len(places) > 1 else f"give {listed}"
    if any(place.order for place in places):
        choice += "; the message does not state the order of the quaternion in an array"
    raise InputError(
        f"{topic}{text} is not one pose; {choice}"
        if places
        else f"{topic} has no position and orientation in its messages"
    )
