"""The text that defines a message type, as MCAP schemas have it: `ros2msg`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict


def definition_text(message_type: str) -> str | None:
    """Return the definition of a type and of all types in it; None if one is unknown.

    Installed packages have the definitions of their types. rosbags has those of other ROS types.

    Args:
        message_type: Such as `nav_msgs/msg/Odometry`.
    """
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types: Typesdict = {}
    wanted = [message_type]
    while wanted:
        name = wanted.pop()
        if name in types or name in store.types:
            continue
        found = _installed(name)
        if name not in found:
            return None
        types |= found
        wanted += _types_in(found[name][1])
    store.register(types)
    text: str = store.generate_msgdef(message_type, ros_version=2)[0]
    return text


@cache
def _installed(message_type: str) -> Typesdict:
    """Return the type as an installed package defines it; nothing if there is none."""
    from rosbags.typesys import get_types_from_msg

    package, _, name = message_type.partition("/msg/")
    for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix):
        path = Path(prefix, "share", package, "msg", f"{name}.msg")
        if prefix and name and path.is_file():
            return get_types_from_msg(path.read_text(encoding="utf-8"), message_type)
    return {}


def _types_in(fields: Any) -> Iterator[str]:
    """Yield the types of fields that are messages themselves."""
    from rosbags.interfaces import Nodetype

    for _, (kind, detail) in fields:
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, detail = detail[0]
        if kind == Nodetype.NAME:
            yield detail
