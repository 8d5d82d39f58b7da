"""Frames of ROS in the picture, so that other recordings of the robot are drawn in it."""

from __future__ import annotations

from typing import Any

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.viewer import scene_entities
from trajeval_ros.viewer.sdk import sdk


def frame_of(entity: str) -> str:
    """Return Rerun's name of the frame of an entity."""
    return f"tf#/{entity}"


class NamedFrames:
    """Attaches each named frame to one entity: a frame has one parent, as in TF.

    A frame of poses is at the picture's coordinates without its origin. A body's frame is at the
    newest pose. If another recording has a transform of the body's frame, Rerun uses that one.
    """

    def __init__(self) -> None:
        self._rows: dict[str, tuple[str, Floats | None]] = {}  # entity and origin, by frame

    def attach(self, frame: str, entity: str, origin: Floats | None = None) -> str | None:
        """Attach a frame unless it has no name or a parent; return its name if it is new.

        `origin` (3,), metres, is subtracted from the coordinates of the entity.
        """
        name = frame.lstrip("/")
        if not name or name in self._rows:
            return None
        self._rows[name] = entity, origin
        return name

    def send(self, recording: Any, only: str | None = None) -> None:
        """Log all frames, or one."""
        rerun, _ = sdk()
        for name in self._rows if only is None else [only]:
            entity, origin = self._rows[name]
            transform = rerun.Transform3D(
                translation=None if origin is None else -origin,
                parent_frame=frame_of(entity),
                child_frame=name,
            )
            place = f"{scene_entities.FRAMES}/{rerun.escape_entity_path_part(name)}"
            recording.log(place, transform, static=True)
