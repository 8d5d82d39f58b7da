"""Gauges: the groups of transformations that a sensor set can't observe.

Tutorial, section III-A and Table I: a camera can't tell a trajectory from its similar copies, a
stereo rig or a lidar not from its rigid copies, and gravity leaves an inertial system only the
rotation about itself and the translation. What can't be observed is neither right nor wrong, so
it is taken out by alignment before errors are measured.
"""

from __future__ import annotations

from enum import Enum

from trajeval_ros.exceptions import SettingsError


class Gauge(Enum):
    """A group that acts on whole trajectories: p -> s R p + t, R_i -> R R_i, v -> s R v (eq. 8).

    The value is its name on the command line and in results.
    """

    NONE = "none"
    TRANSLATION = "translation"
    YAW = "yaw"
    PLANAR = "planar"
    SE3 = "se3"
    SIM3 = "sim3"

    @property
    def has_translation(self) -> bool:
        """Whether the group moves the origin."""
        return self is not Gauge.NONE

    @property
    def turns_about_gravity_only(self) -> bool:
        """Whether its rotations are about z alone, eq. (12)."""
        return self in (Gauge.YAW, Gauge.PLANAR)

    @property
    def turns_freely(self) -> bool:
        """Whether its rotations are all of SO(3)."""
        return self in (Gauge.SE3, Gauge.SIM3)

    @property
    def has_scale(self) -> bool:
        """Whether it changes the scale."""
        return self is Gauge.SIM3

    @property
    def minimum_states(self) -> int:
        """Fewest states, not on one line for SE(3) and Sim(3), whose positions determine it."""
        if self.turns_freely:
            return 3
        return 2 if self.turns_about_gravity_only else 1

    @property
    def description(self) -> str:
        """What the alignment may change, for a verdict or a table."""
        return _DESCRIPTIONS[self]


_DESCRIPTIONS = {
    Gauge.NONE: "no alignment, the frames are taken to be the same",
    Gauge.TRANSLATION: "translation only",
    Gauge.YAW: "yaw and translation, 4-DoF",
    Gauge.PLANAR: "SE(2) in the groundtruth's xy plane, 2-D errors",
    Gauge.SE3: "SE(3), rigid body",
    Gauge.SIM3: "Sim(3), similarity with scale",
}

MODALITIES: dict[str, Gauge] = {
    "mono": Gauge.SIM3,
    "stereo": Gauge.SE3,
    "rgbd": Gauge.SE3,
    "lidar": Gauge.SE3,
    "mono-inertial": Gauge.YAW,
    "stereo-inertial": Gauge.YAW,
    "rgbd-inertial": Gauge.YAW,
    "lidar-inertial": Gauge.YAW,
    "wheel": Gauge.PLANAR,
    "gnss-aided": Gauge.NONE,
}
"""Sensor sets and what they can't observe (tutorial, Table I, and section V for the others)."""


def gauge_for(gauge: str | None, modality: str | None, default: Gauge) -> Gauge:
    """Return the gauge that a user asked for by name, by sensor set, or not at all.

    Raises:
        SettingsError: Unknown name, or a gauge that contradicts the modality.
    """
    named = default
    if gauge is not None:
        try:
            named = Gauge(gauge)
        except ValueError:
            names = ", ".join(each.value for each in Gauge)
            raise SettingsError(f"there is no gauge {gauge!r}; use one of {names}") from None
    if modality is None:
        return named
    if modality not in MODALITIES:
        raise SettingsError(
            f"there is no modality {modality!r}; use one of {', '.join(MODALITIES)}"
        )
    implied = MODALITIES[modality]
    if gauge is not None and named is not implied:
        raise SettingsError(
            f"modality {modality} means gauge {implied.value}, not {named.value}; give only one"
        )
    return implied
