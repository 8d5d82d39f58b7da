"""The fields of messages: of standard types, and of types that a bag defines.

The standard types are listed here, so that live messages are decoded without importing a library.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Union

import numpy as np

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

TEXT = "text"

# Definitions are untrusted. The largest type of ROS 2 Jazzy has 87 fields in 7 levels.
_MOST_TEXT = 1 << 18  # characters
_MOST_FIELDS, _MOST_LEVELS = 1000, 50
LARGEST_MESSAGE = 1 << 28  # bytes


@dataclass(frozen=True, eq=False)
class Connection:
    """A topic as one file of a bag records it."""

    id: int
    topic: str
    type: str  # with `/msg/`
    language: str  # of the type's definition: `MSG`, `IDL`, or "" without a definition
    definition: str
    count: int  # of messages, as declared; -1 if it is unknown
    encoding: str  # of messages, such as `cdr` or `ros1`
    owner: Any  # the open file
    qos: str = ""  # the offered quality of service, in YAML
    is_latching: bool = False


@dataclass(frozen=True)
class Repeated:
    """Several values of one kind: `count` values, or None for a count in the message."""

    kind: Kind
    count: int | None = None


# A numpy type such as "f8", `TEXT`, the fields of a message, or a repeated kind.
Kind = Union[str, "Fields", Repeated]  # evaluated at run time
Fields = tuple[tuple[str, Kind], ...]


class UnplannedError(Exception):
    """A type has fields that can't be decoded by column, or lacks a requested field."""


_XYZ: Fields = (("x", "f8"), ("y", "f8"), ("z", "f8"))
_XYZW: Fields = (*_XYZ, ("w", "f8"))
_STAMP: Fields = (("sec", "i4"), ("nanosec", "u4"))
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_HEADER: Fields = (("stamp", _STAMP), ("frame_id", TEXT))
_POSE: Fields = (("position", _XYZ), ("orientation", _XYZW))
_TWIST: Fields = (("linear", _XYZ), ("angular", _XYZ))
_COVARIANCE = ("covariance", Repeated("f8", 36))
_POSE_STAMPED: Fields = (("header", _HEADER), ("pose", _POSE))
_TRANSFORM_STAMPED: Fields = (
    ("header", _HEADER),
    ("child_frame_id", TEXT),
    ("transform", (("translation", _XYZ), ("rotation", _XYZW))),
)
STANDARD: dict[str, Fields] = {
    "geometry_msgs/msg/PointStamped": (("header", _HEADER), ("point", _XYZ)),
    "geometry_msgs/msg/PoseStamped": _POSE_STAMPED,
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        ("header", _HEADER),
        ("pose", (("pose", _POSE), _COVARIANCE)),
    ),
    "geometry_msgs/msg/TransformStamped": _TRANSFORM_STAMPED,
    "sensor_msgs/msg/NavSatFix": (
        ("header", _HEADER),
        ("status", (("status", "i1"), ("service", "u2"))),
        ("latitude", "f8"),
        ("longitude", "f8"),
        ("altitude", "f8"),
        ("position_covariance", Repeated("f8", 9)),
        ("position_covariance_type", "u1"),
    ),
    "nav_msgs/msg/Odometry": (
        ("header", _HEADER),
        ("child_frame_id", TEXT),
        ("pose", (("pose", _POSE), _COVARIANCE)),
        ("twist", (("twist", _TWIST), _COVARIANCE)),
    ),
    "sensor_msgs/msg/Imu": (
        ("header", _HEADER),
        ("orientation", _XYZW),
        ("orientation_covariance", Repeated("f8", 9)),
        ("angular_velocity", _XYZ),
        ("angular_velocity_covariance", Repeated("f8", 9)),
        ("linear_acceleration", _XYZ),
        ("linear_acceleration_covariance", Repeated("f8", 9)),
    ),
    "nav_msgs/msg/Path": (("header", _HEADER), ("poses", Repeated(_POSE_STAMPED))),
    "tf2_msgs/msg/TFMessage": (("transforms", Repeated(_TRANSFORM_STAMPED)),),
}

_NUMBERS = {
    "bool": "?",
    "byte": "u1",
    "octet": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}


def full_name(message_type: str) -> str:
    """Return the name of a type with `/msg/`, which ROS 1 does not write."""
    package, slash, name = message_type.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else message_type


def ros1_fields(fields: Fields) -> Fields:
    """Return standard fields as in ROS 1: headers have `seq`, and times are unsigned."""
    return tuple((name, _ros1_kind(kind)) for name, kind in fields)


def _ros1_kind(kind: Kind) -> Kind:
    if kind == _HEADER:
        return (("seq", "u4"), ("stamp", (("sec", "u4"), ("nanosec", "u4"))), ("frame_id", TEXT))
    if isinstance(kind, Repeated):
        return Repeated(_ros1_kind(kind.kind), kind.count)
    return ros1_fields(kind) if isinstance(kind, tuple) else kind


def fields_of(types: Typesdict, message_type: str) -> Fields:
    """Return the fields of a type that rosbags has parsed.

    Raises:
        UnplannedError: A field can't be decoded by column, its type is unknown, or the message is
            larger than any message.
    """
    return _Expansion(types).of(message_type).fields


def recorded_fields(connection: Connection) -> Fields | None:
    """Return the fields of a connection's type by its own definition; None if that is invalid."""
    return _recorded_fields(connection.language, connection.definition, connection.type)


@functools.lru_cache(maxsize=64)
def _recorded_fields(language: str, text: str, message_type: str) -> Fields | None:
    if language == "MSG" and is_standard(text, message_type):
        return STANDARD[message_type]
    if len(text) > _MOST_TEXT:
        return None
    try:
        return fields_of(types_in(language, text, message_type), message_type)
    except Exception:  # rosbags raises many types for an invalid definition
        return None


def is_standard(text: str, message_type: str) -> bool:
    """Return whether a definition in the language MSG has the standard fields of a type.

    Most have. The comparison takes a hundredth of the time of parsing. Definitions with other
    elements, such as constants, are not standard.
    """
    if message_type not in STANDARD:
        return False
    name, *others = re.split(r"^=+\s*\nMSG:\s*(\S+)[ \t]*\n", text, flags=re.MULTILINE)
    sections = {message_type: name}
    for other, section in zip(others[::2], others[1::2], strict=True):
        package, _, last = other.replace("/msg/", "/").rpartition("/")
        sections[f"{package}/msg/{last}"] = section
    return _has_fields(sections, message_type, STANDARD[message_type])


def _has_fields(sections: dict[str, str], name: str, fields: Fields) -> bool:
    """Return whether a message of several definitions has exactly the given fields."""
    if name not in sections:
        return name in _TIMES and fields == _STAMP
    lines = [line.partition("#")[0].split() for line in sections[name].splitlines()]
    lines = [line for line in lines if line]
    if len(lines) != len(fields):
        return False
    for line, (field, kind) in zip(lines, fields, strict=True):
        if len(line) < 2 or line[1] != field or any("=" in word for word in line):
            return False
        base, bracket, count = line[0].partition("[")
        if bracket != ("[" if isinstance(kind, Repeated) else ""):
            return False
        if isinstance(kind, Repeated):
            if count != f"{'' if kind.count is None else kind.count}]":
                return False
            kind = kind.kind
        if isinstance(kind, tuple):
            package, _, last = base.replace("/msg/", "/").rpartition("/")
            if not _has_fields(sections, f"{package or name.split('/')[0]}/msg/{last}", kind):
                return False
        elif (TEXT if base == "string" else _NUMBERS.get(base)) != kind:
            return False
    return True


def types_in(language: str, text: str, message_type: str) -> Any:
    """Return the types of a recorded definition, in the language `MSG` or `IDL`."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if language == "MSG":
        return get_types_from_msg(text, message_type)
    types: Any = {}
    for part in re.split("=" * 80 + r"\nIDL: .*\n", text):
        if part.strip():
            types.update(get_types_from_idl(part))
    return types


class _Expanded(NamedTuple):
    """A type with the fields of its nested types."""

    fields: Fields
    leaves: int  # number of fields, nested ones included
    size: int  # least bytes of a message
    depth: int  # levels of nested types


class _Expansion:
    """Expands every type of a definition once. n levels of 10 fields have 10^n fields."""

    def __init__(self, types: Typesdict) -> None:
        self._types = types
        self._known: dict[str, _Expanded | None] = {}  # None while a type is expanded

    def of(self, message_type: str) -> _Expanded:
        if message_type not in self._types:
            if message_type in _TIMES:
                return _Expanded(_STAMP, 2, 8, 1)
            raise UnplannedError(f"{message_type} is not defined")
        if message_type not in self._known:
            self._known[message_type] = None
            self._known[message_type] = self._expanded(message_type)
        expanded = self._known[message_type]
        if expanded is None:
            raise UnplannedError(f"{message_type} contains itself")
        return expanded

    def _expanded(self, message_type: str) -> _Expanded:
        fields: list[tuple[str, Kind]] = []
        count = size = depth = 0
        for name, description in self._types[message_type][1]:
            kind, own_count, own_size, own_depth = self._kind_of(description)
            fields.append((name, kind))
            count, size = count + own_count, size + own_size
            depth = max(depth, own_depth + 1)
            is_large = count > _MOST_FIELDS or size > LARGEST_MESSAGE or depth > _MOST_LEVELS
            if is_large or own_size < 0:
                raise UnplannedError(f"{message_type} is larger than any message")
        return _Expanded(tuple(fields), count, size, depth)

    def _kind_of(self, description: Any) -> tuple[Kind, int, int, int]:
        """Return a field's kind, its number of fields, its least bytes and its levels."""
        from rosbags.interfaces import Nodetype

        node, content = description
        if node == Nodetype.NAME:
            return self.of(content)
        if node == Nodetype.BASE:
            name = content[0]
            if name == "string":
                return TEXT, 1, 4, 0
            if name not in _NUMBERS:
                raise UnplannedError(f"{name} has an unsupported layout")
            return _NUMBERS[name], 1, np.dtype(_NUMBERS[name]).itemsize, 0
        inside, length = content
        kind, count, size, depth = self._kind_of(inside)
        if node == Nodetype.ARRAY:
            return Repeated(kind, length), count, length * size, depth
        return Repeated(kind), count, 4, depth
