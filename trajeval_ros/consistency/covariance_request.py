"""Requests for tests of covariances: consistency, and protection levels (integrity).

A constant covariance is no estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats

if TYPE_CHECKING:
    from trajeval_ros.consistency.joint_covariance import JointCovariance
    from trajeval_ros.geometry.marker import HandEye
    from trajeval_ros.geometry.trajectory import Trajectory

SOURCES = ("none", "message", "joint")
FRAMES = ("world", "body")
_FEWEST_CONSTANT = 10  # equal covariances


@dataclass(frozen=True, eq=False)
class CovarianceRequest:
    """Source and convention of the covariances to test.

    Attributes:
        source: `none`, `message` for covariances of single poses, or `joint` for all poses.
        joint: The joint covariance.
        name: Name of the joint covariance, such as its file's name.
        rotation_frame: Axes of rotation errors in messages: `world`, as ROS defines them, or
            `body`.
        groundtruth_noise: Standard deviations of groundtruth positions (m) and rotations (deg);
            None for exact groundtruth.
        marker_lever_m: Position of the marker in the body, metres, if the groundtruth was
            measured at the marker and moved to the body; None if it was measured at the body.

    Raises:
        SettingsError: Unknown or contradictory settings.

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
    marker_lever_m: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.source not in SOURCES or (self.source == "joint") != (self.joint is not None):
            raise SettingsError(
                f"the covariance source must be one of {', '.join(SOURCES)}, not "
                f"{self.source!r}; joint also needs a joint covariance"
            )
        if self.rotation_frame not in FRAMES:
            raise SettingsError(
                f"unknown rotation covariance frame {self.rotation_frame!r}; use world, or body "
                "for estimators with right perturbations of rotations, such as OpenVINS"
            )
        if self.rotation_frame == "body" and self.source != "message":
            raise SettingsError(
                "--rotation-covariance-frame body needs covariances from messages; add "
                "--covariance message"
            )
        if self.groundtruth_noise is not None:
            position_m, rotation_deg = self.groundtruth_noise
            if not (0.0 < position_m < math.inf and 0.0 < rotation_deg < math.inf):
                raise SettingsError(
                    "the groundtruth noise must be two standard deviations greater than zero, "
                    f"in metres and degrees, not {position_m:g},{rotation_deg:g}"
                )

    def about_world(self, estimate: Trajectory) -> Trajectory:
        """Return the estimate, as it was read, with rotation covariances about the world's axes.

        All later conversions (lever arms, up axes, alignments) assume these axes.

        Raises:
            InputError: They are about the body's axes, and the estimate has no orientations.
        """
        if self.rotation_frame == "world" or estimate.covariances is None:
            return estimate
        if estimate.quaternions is None:
            raise InputError("covariances can't be rotated without the estimate's orientations")
        from trajeval_ros.geometry.covariance_frames import world_from_body_rotations

        rotations = lie.to_matrix(estimate.quaternions)
        rotated = world_from_body_rotations(estimate.covariances, rotations)
        return replace(estimate, covariances=rotated)

    def of_moved_groundtruth(self, hand_eye: HandEye) -> CovarianceRequest:
        """Return the request for groundtruth that was moved from a marker to the body."""
        x, y, z = hand_eye.lever_m.tolist()
        return replace(self, marker_lever_m=(x, y, z))

    @property
    def once_turned(self) -> CovarianceRequest:
        """The request after `about_world` has been applied."""
        return replace(self, rotation_frame="world")


@dataclass(frozen=True)
class IntegrityRequest:
    """Largest acceptable errors, and the probability of larger ones without an alert."""

    alert_limit_m: float  # limit of horizontal and of vertical errors, metres
    alert_limit_deg: float | None = None  # limit of the heading error, degrees; None for none
    risk: float = 1e-5  # probability that an error exceeds its protection level

    def __post_init__(self) -> None:
        limits = [self.alert_limit_m]
        limits += [] if self.alert_limit_deg is None else [self.alert_limit_deg]
        if not all(0.0 < limit < math.inf for limit in limits):
            raise SettingsError(
                "the alert limit must be greater than zero, in metres and, for the heading, in "
                "degrees, as in --alert-limit 0.5,2"
            )
        if not 0.0 < self.risk < 1.0:
            raise SettingsError(f"the risk must be a probability such as 1e-5, not {self.risk:g}")


def constant_covariances(covariances: Floats) -> str:
    """Return that covariances (N, 6, 6) are constant, so no estimates; empty if they vary.

    The first pose can have another one.
    """
    if len(covariances) <= _FEWEST_CONSTANT or (covariances[1:] != covariances[1]).any():
        return ""
    variances = covariances[1].diagonal()
    return (
        f"all are equal ({variances[:3].mean():.3g} m^2, {variances[3:].mean():.3g} rad^2): a "
        "constant that the estimator publishes as a placeholder"
    )
