"""The present recording of a live picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.viewer import entity_data, scene_entities

NEVER = int(np.iinfo(np.int64).min)  # before all timestamps


class LiveRecording:
    """Draws on a recording; without one, nothing is drawn.

    Attributes:
        stream: The recording; None without one.
        begin: First time of the picture, nanoseconds.
    """

    def __init__(self) -> None:
        """Create it without a recording."""
        self.stream: Any = None
        self.begin = NEVER

    def send(self, draw: Callable[..., None], *values: object) -> None:
        """Call a function that draws values on a recording."""
        if self.stream is not None:
            draw(self.stream, *values)

    def log(self, stamp: int, entity: str, row: Any) -> None:
        """Log one row at a time of the picture."""
        self.send(entity_data.log, entity, stamp, row)

    def number(self, stamp: int, entity: str, value: float | None) -> None:
        """Log a value of a series, if there is one."""
        if value is not None:
            self.log(stamp, entity, entity_data.numbers([value]).row())

    def event(self, stamp: int, text: str, *, warn: bool = True) -> None:
        """Log a line of text, with the time since the start."""
        since = "" if self.begin == NEVER else f"{(stamp - self.begin) / NANOSECONDS:.1f} s: "
        self.log(stamp, scene_entities.EVENTS, entity_data.event(since + text, warn=warn))
