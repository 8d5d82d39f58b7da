"""What is on the network: who publishes a topic, and what could have been meant by a name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from trajeval_ros.io.checks import nearest
from trajeval_ros.ros.message_types import is_installed

if TYPE_CHECKING:
    from rclpy.node import Node


def publishers_of(node: Node, name: str, types: tuple[str, ...]) -> list[Any]:
    """Return the endpoints that publish a topic with one of the types, all of one type.

    Args:
        node: Knows the network.
        name: The topic's, before remapping.
        types: Those that can be read.
    """
    found = [
        each
        for each in node.get_publishers_info_by_topic(name)
        if each.topic_type in types and is_installed(each.topic_type)
    ]
    return [each for each in found if each.topic_type == found[0].topic_type]


def why_unmatched(node: Node, name: str, types: tuple[str, ...]) -> str:
    """Return why nothing is received on a topic, and what there is instead.

    Args:
        node: Knows the network.
        name: The topic's, before remapping.
        types: Those that can be read.
    """
    topic = node.resolve_topic_name(name)
    there = node.get_publishers_info_by_topic(name)
    for each in there:
        kind = each.topic_type
        if kind in types:
            return (
                f"{topic} carries {kind}, which is not installed here; install its package, "
                f"ros-$ROS_DISTRO-{kind.partition('/')[0].replace('_', '-')}"
            )
    if there:
        kinds = ", ".join(sorted({each.topic_type for each in there}))
        return f"{topic} carries {kinds}, no poses that can be read ({', '.join(types)})"
    poses = [
        other
        for other, kinds in node.get_topic_names_and_types()
        if any(kind in types for kind in kinds)
        and node.count_publishers(other)
        and not other.startswith(f"{node.get_fully_qualified_name()}/")
    ]
    if poses:
        return f"nobody publishes {topic}; there are poses on {nearest(topic, poses)}"
    return f"nobody publishes {topic}, and there are no poses on any other topic"
