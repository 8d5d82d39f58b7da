"""The ROS graph: publishers of a topic, and existing names similar to a wrong one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from trajeval_ros.io.checks import nearest
from trajeval_ros.online.notices import WARN, Notice
from trajeval_ros.ros.message_types import is_installed

if TYPE_CHECKING:
    from rclpy.node import Node


def publishers_of(node: Node, name: str, types: tuple[str, ...] | None) -> list[Any]:
    """Return the endpoints that publish a topic with one of the types, all of one type.

    Args:
        node: A node, which has the ROS graph.
        name: Name of the topic, before remapping.
        types: Readable types; None for all installed types.
    """
    found = [
        each
        for each in node.get_publishers_info_by_topic(name)
        if (types is None or each.topic_type in types) and is_installed(each.topic_type)
    ]
    return [each for each in found if each.topic_type == found[0].topic_type]


def why_unmatched(node: Node, name: str, types: tuple[str, ...] | None) -> str:
    """Return why no message is received on a topic, and similar names or other types.

    Args:
        node: A node, which has the ROS graph.
        name: Name of the topic, before remapping.
        types: Readable types; None for all installed types.
    """
    topic = node.resolve_topic_name(name)
    there = node.get_publishers_info_by_topic(name)
    for each in there:
        kind = each.topic_type
        if types is None or kind in types:
            return (
                f"{topic} has type {kind}, which is not installed; install "
                f"ros-$ROS_DISTRO-{kind.partition('/')[0].replace('_', '-')}"
            )
    if types is None:
        return f"nobody publishes {topic}"
    if there:
        kinds = ", ".join(sorted({each.topic_type for each in there}))
        return f"{topic} has type {kinds}, not a supported type of poses ({', '.join(types)})"
    poses = [
        other
        for other, kinds in node.get_topic_names_and_types()
        if any(kind in types for kind in kinds)
        and node.count_publishers(other)
        and not other.startswith(f"{node.get_fully_qualified_name()}/")
    ]
    if poses:
        return f"no publisher on {topic}; poses are on {nearest(topic, poses)}"
    return f"no publisher on {topic}, and no poses on any other topic"


def about_twins(node: Node) -> list[Notice]:
    """Report other nodes with the same name, because their topics have equal names."""
    name = node.get_fully_qualified_name()
    everybody = node.get_node_names_and_namespaces()
    names = [f"{namespace.rstrip('/')}/{each}" for each, namespace in everybody]
    if names.count(name) < 2:
        return []
    said = (
        f"{names.count(name)} nodes have the name {name} and publish on the same topics; start "
        "them with different names, as in --ros-args -r __node:=evaluator_2"
    )
    return [Notice("hint", WARN, said, "name")]
