"""Messages of ROS 1, converted to the serialisation of ROS 2."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from trajeval_ros.io.bags.message_definitions import types_in
from trajeval_ros.io.bags.recorded_topic import Topic, encoding_of

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

Convert = Callable[[bytes], bytes]

_RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
_HEADER = "std_msgs/msg/Header"  # without `seq` in ROS 2
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


def ros2_type(message_type: str) -> str:
    """Return the name in ROS 2 of a type of ROS 1."""
    return _RENAMED.get(message_type, message_type)


def is_ros1(topic: Topic) -> bool:
    """Return whether a topic was recorded by ROS 1."""
    return encoding_of(topic.connections[0]) == "ros1"


def converter(topic: Topic) -> Convert | None:
    """Return a function that converts serialised messages of ROS 1 to CDR.

    Returns:
        None if the type has other fields in ROS 2.
    """
    from rosbags.typesys import Stores, get_typestore

    ros2 = get_typestore(Stores.ROS2_JAZZY)
    store = get_typestore(Stores.EMPTY)
    name = topic.type
    try:
        text = topic.connections[0].msgdef.data
        recorded = types_in("MSG", text, topic.type)
        kept = (_HEADER, *_TIMES)
        store.register({key: value for key, value in recorded.items() if key not in kept})
        store.register({key: ros2.fielddefs[key] for key in kept if key not in store.fielddefs})
        store.get_msgdef(name)
    except Exception:  # rosbags raises many types; the standard definition is used instead
        store, name = ros2, ros2_type(name)
        if name not in ros2.fielddefs:
            return None
    if ros2_type(name) in ros2.fielddefs:
        here, there = _layout(store, name), _layout(ros2, ros2_type(name))
        if here != there:
            return None
    return lambda payload: bytes(store.ros1_to_cdr(payload, name))


def _layout(store: Typestore, message_type: str) -> list[Any]:
    """Return the types of all fields without names, with the types in nested messages."""
    return [_spelled_out(store, kind) for _, kind in store.fielddefs[message_type][1]]


def _spelled_out(store: Typestore, kind: Any) -> Any:
    """Return a field's type with the layout in place of a message's name."""
    from rosbags.interfaces import Nodetype

    node, content = kind
    if node == Nodetype.NAME:
        return _layout(store, content)
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        inner, length = content
        return node, _spelled_out(store, inner), length
    return node, content
