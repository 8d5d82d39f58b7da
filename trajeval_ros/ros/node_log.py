"""The log of a node; control characters in texts are escaped."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.formatting.escaping import one_line

if TYPE_CHECKING:
    from rclpy.node import Node


def log(node: Node, text: str, warn: bool = False) -> None:
    """Log a sentence, as information or as a warning."""
    logger, line = node.get_logger(), one_line(text)
    if warn:  # rclpy needs a separate call for every severity
        logger.warning(line)
    else:
        logger.info(line)
