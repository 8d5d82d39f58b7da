"""The vertical axis of a fixed frame, and the permutation of axes that makes it z.

REP-103 has z up in the world. In a camera's axes (x right, y down, z forward), which KITTI's poses
use, -y is up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import require_one_of
from trajeval_ros.geometry.arrays import Floats

UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
GIVEN, ASSUMED, ROTATED_FROM = "given", "assumed", "rotated from "
OPTICAL_SUFFIXES = ("_optical", "_optical_frame")


@dataclass(frozen=True)
class UpAxis:
    """The axis of a trajectory's fixed frame that points up."""

    name: str = "z"  # one of `UP_AXES`
    # Where the axis is from: `given`, a format, a frame's name; `assumed` by default.
    origin: str = GIVEN

    def __post_init__(self) -> None:
        require_one_of(self.name, UP_AXES, "up axis")

    @classmethod
    def of_frame(cls, frame: str) -> UpAxis:
        """Return the up axis implied by a frame's name: -y for optical frames, else z."""
        if frame.endswith(OPTICAL_SUFFIXES):
            return cls("-y", f"frame {frame}")
        return cls("z", ASSUMED)

    def __str__(self) -> str:
        """Return the axis and its origin."""
        return f"{self.name} ({self.origin})"

    @property
    def is_given(self) -> bool:
        """Whether the user specified it."""
        return self.origin == GIVEN

    @property
    def applied(self) -> Floats:
        """The rotation (3, 3) from the frame that was read to this one with z up."""
        is_rotated = self.origin.startswith(ROTATED_FROM)
        axis = self.origin.removeprefix(ROTATED_FROM).partition(",")[0]
        return UpAxis(axis if is_rotated else "z").matrix

    @property
    def index(self) -> int:
        """Index of the axis, without its sign."""
        return "xyz".index(self.name[-1])

    @property
    def level(self) -> tuple[int, int]:
        """Indices of the horizontal axes, right-handed when seen from above."""
        first, second = (self.index + 1) % 3, (self.index + 2) % 3
        return (second, first) if self.name.startswith("-") else (first, second)

    @property
    def matrix(self) -> Floats:
        """The rotation (3, 3) from the frame to one whose z axis is the up axis."""
        rotated: Floats = np.zeros((3, 3))
        rotated[(0, 1, 2), (*self.level, self.index)] = 1.0
        rotated[2] *= -1.0 if self.name.startswith("-") else 1.0
        return rotated

    def to_z_up(self, vectors: Floats) -> Floats:
        """Return vectors (..., 3) in axes whose third is up; exact, since it permutes components.

        Of quaternions (..., 4) the vector part is permuted and w kept: E becomes W E W^T, where W
        is `matrix`.
        """
        if self.name == "z":
            return vectors
        vectors = np.asarray(vectors)
        rest = range(3, vectors.shape[-1])
        rotated: Floats = vectors[..., [*self.level, self.index, *rest]]
        if self.name.startswith("-"):
            rotated[..., 2] = -rotated[..., 2]
        return rotated


Z_UP = UpAxis("z", ASSUMED)
