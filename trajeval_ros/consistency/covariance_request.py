"""Which covariances of an estimate are to be judged, and how to read them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trajeval_ros.exceptions import SettingsError

if TYPE_CHECKING:
    from trajeval_ros.consistency.joint_covariance import JointCovariance

SOURCES = ("none", "message", "joint")
FRAMES = ("world", "body")


@dataclass(frozen=True, eq=False)
class CovarianceRequest:
    """Where covariances come from, and what they are of.

    Attributes:
        source: `none`, `message` for those of each pose, or `joint` for one of all poses.
        joint: The joint covariance.
        name: What the joint covariance is called, such as its file's name.
        rotation_frame: Axes of rotation errors in messages: `world`, as ROS defines them, or
            `body`.
        groundtruth_noise: Standard deviations of groundtruth positions (m) and rotations (deg);
            None for exact groundtruth.

    Example:
        >>> from trajeval_ros import CovarianceRequest, Request
        >>> Request(covariances=CovarianceRequest("message")).reads_covariances
        True
    """

    source: str = "none"
    joint: JointCovariance | None = None
    name: str = ""
    rotation_frame: str = "world"
    groundtruth_noise: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse what means nothing, or nothing together.

        Raises:
            SettingsError: It does.
        """
        if self.source not in SOURCES or (self.source == "joint") != (self.joint is not None):
            raise SettingsError(
                f"covariances come from one of {', '.join(SOURCES)}, and joint needs a joint "
                f"covariance; {self.source!r} was given"
            )
        if self.rotation_frame not in FRAMES:
            raise SettingsError(
                f"there is no rotation covariance frame {self.rotation_frame!r}; use world, or "
                "body for OpenVINS and others that perturb rotations on the right"
            )
        if self.rotation_frame == "body" and self.source != "message":
            raise SettingsError(
                "--rotation-covariance-frame body is about covariances in messages; add "
                "--covariance message (a joint file says itself how rotations are perturbed)"
            )
        if self.groundtruth_noise is not None:
            position_m, rotation_deg = self.groundtruth_noise
            if not (0.0 < position_m < math.inf and 0.0 < rotation_deg < math.inf):
                raise SettingsError(
                    "the groundtruth noise must be two standard deviations above zero, in metres "
                    f"and degrees, not {position_m:g},{rotation_deg:g}"
                )
