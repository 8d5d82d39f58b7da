"""Names for parts of ROS topics, from names of estimates, live and recorded."""

from __future__ import annotations

import re


def part_of_topic(name: str) -> str:
    """Return a name of letters, digits and underscores for a topic, a source or a file.

    Example:
        >>> from trajeval_ros.formatting.topic_names import part_of_topic
        >>> part_of_topic("/vio/odometry"), part_of_topic("/tf:map.base_link")
        ('vio_odometry', 'tf_map_base_link')
    """
    word = re.sub(r"\W+", "_", name.strip("/"), flags=re.ASCII)
    return f"topic_{word}" if word[:1].isdigit() else word
