"""Rules for the start of new segments of a live run, from the node's parameters."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.exceptions import require_one_of


@dataclass(frozen=True)
class Segmentation:
    """Rules for the start of a new segment. Segments are evaluated like separate runs.

    Attributes:
        on_time_jump: If timestamps step back: `segment`, `reset` (a segment in a new folder) or
            `ignore`.
        on_restart: If an estimate jumps: `segment` or `ignore`.

    Raises:
        SettingsError: A value is not valid.
    """

    on_time_jump: str = "segment"
    on_restart: str = "ignore"

    def __post_init__(self) -> None:
        """Check the values."""
        require_one_of(self.on_time_jump, ("reset", "segment", "ignore"), "on_time_jump")
        require_one_of(self.on_restart, ("segment", "ignore"), "on_restart")
