"""When segments of a live run start, by the node's parameters."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.exceptions import require_one_of


@dataclass(frozen=True)
class Segmentation:
    """When a segment ends and another one begins, each a run of its own.

    Attributes:
        on_time_jump: When stamps step back: `segment`; `reset`, in a folder of its own; `ignore`.
        on_restart: When an estimate jumps: `segment` or `ignore`.

    Raises:
        SettingsError: There is no such answer.
    """

    on_time_jump: str = "segment"
    on_restart: str = "ignore"

    def __post_init__(self) -> None:
        """Refuse unknown values."""
        require_one_of(self.on_time_jump, ("reset", "segment", "ignore"), "on_time_jump")
        require_one_of(self.on_restart, ("segment", "ignore"), "on_restart")
