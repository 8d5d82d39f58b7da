"""A `diagnostic_msgs/DiagnosticStatus`: a level, a sentence, and values by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.online.error_topics import status_texts


def status_message(level: int, name: str, text: str, values: Mapping[str, Any]) -> Any:
    """Return the message without values that are None; control characters are escaped."""
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    return DiagnosticStatus(
        level=bytes([level]),
        name=name,
        message=one_line(text),
        values=[
            KeyValue(key=key, value=one_line(value)) for key, value in status_texts(values).items()
        ],
    )
