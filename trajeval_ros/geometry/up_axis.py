"""Which axis of a fixed frame points up, and what that turns: gravity is no axis of every file.

REP-103 has z up in the world, and -y up in the axes of a camera (x right, y down, z forward), in
which KITTI's matrices are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import require_one_of
from trajeval_ros.geometry.arrays import Floats

UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
GIVEN, ASSUMED = "given", "assumed"
OPTICAL_SUFFIXES = ("_optical", "_optical_frame")


@dataclass(frozen=True)
class UpAxis:
    """The axis of a trajectory's fixed frame that points up.

    Attributes:
        name: One of `UP_AXES`.
        origin: What says so: `given`, a format, a frame's name; `assumed` if nothing does.

    Raises:
        SettingsError: There is no axis of that name.

    Example:
        >>> from trajeval_ros.geometry.up_axis import UpAxis
        >>> UpAxis("-y").turned([[1.0, 2.0, 3.0]]).tolist()
        [[1.0, 3.0, -2.0]]
    """

    name: str = "z"
    origin: str = GIVEN

    def __post_init__(self) -> None:
        """Refuse what is no axis."""
        require_one_of(self.name, UP_AXES, "up axis")

    @classmethod
    def of_frame(cls, frame: str) -> UpAxis:
        """Return what the name of a fixed frame says: z, but for REP-103's optical frames."""
        if frame.endswith(OPTICAL_SUFFIXES):
            return cls("-y", f"frame {frame}")
        return cls("z", ASSUMED)

    def __str__(self) -> str:
        """Return the axis, and what says so."""
        return f"{self.name} ({self.origin})"

    @property
    def is_given(self) -> bool:
        """Whether the user said so."""
        return self.origin == GIVEN

    @property
    def index(self) -> int:
        """0, 1 or 2: the axis without its sign."""
        return "xyz".index(self.name[-1])

    @property
    def level(self) -> tuple[int, int]:
        """The two other axes, in the order in which they are right-handed seen from above."""
        first, second = (self.index + 1) % 3, (self.index + 2) % 3
        return (second, first) if self.name.startswith("-") else (first, second)

    @property
    def matrix(self) -> Floats:
        """The rotation (3, 3) from the frame to one whose z axis is this one."""
        turned: Floats = np.zeros((3, 3))
        turned[(0, 1, 2), (*self.level, self.index)] = 1.0
        turned[2] *= -1.0 if self.name.startswith("-") else 1.0
        return turned

    def turned(self, vectors: Floats) -> Floats:
        """Return vectors (..., 3) in axes whose third is up: exact, since axes only change places.

        Rotations' quaternions (..., 4) keep their last element: those of E become those of
        W E W^T, with W the `matrix`.
        """
        if self.name == "z":
            return vectors
        vectors = np.asarray(vectors)
        rest = range(3, vectors.shape[-1])
        turned: Floats = vectors[..., [*self.level, self.index, *rest]]
        if self.name.startswith("-"):
            turned[..., 2] = -turned[..., 2]
        return turned


Z_UP = UpAxis("z", ASSUMED)
