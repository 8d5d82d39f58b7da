"""Gauges: the groups of transformations that a sensor set can't observe.

Tutorial, section III-A and Table I: a camera can't tell a trajectory from its similar copies, a
stereo rig or a lidar not from its rigid copies, and gravity leaves an inertial system only the
rotation about itself and the translation. What can't be observed is neither right nor wrong, so
it is taken out by alignment before errors are measured.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats

POSE_DOF = 6  # of a perturbation: position first, rotation second


class Gauge(Enum):
    """A group that acts on whole trajectories: p -> s R p + t, R_i -> R R_i, v -> s R v (eq. 8).

    The value is its name on the command line and in results.

    Example:
        >>> from trajeval_ros import Gauge
        >>> Gauge.of("yaw").turns_about_gravity_only
        True
    """

    NONE = "none"
    TRANSLATION = "translation"
    YAW = "yaw"
    PLANAR = "planar"
    SE3 = "se3"
    SIM3 = "sim3"

    @classmethod
    def of(cls, gauge: Gauge | str) -> Gauge:
        """Return a gauge, or that of a name.

        Raises:
            SettingsError: There is none of that name.
        """
        if isinstance(gauge, Gauge):
            return gauge
        require_one_of(gauge, (each.value for each in cls), "gauge")
        return cls(gauge)

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
    Gauge.NONE: "no alignment, same frame",
    Gauge.TRANSLATION: "translation only",
    Gauge.YAW: "yaw and translation, 4-DoF",
    Gauge.PLANAR: "SE(2) in the groundtruth's horizontal plane, 2-D errors",
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
"""Sensor sets and what they can't observe (tutorial, Table I, and section V for the others).

Example:
    >>> from trajeval_ros import MODALITIES
    >>> MODALITIES["mono-inertial"].value
    'yaw'
"""


def gauge_for(gauge: Gauge | str | None, modality: str | None, default: Gauge) -> Gauge:
    """Return the gauge that a user asked for by name, by sensor set, or not at all.

    Raises:
        SettingsError: Unknown name, or a gauge that contradicts the modality.
    """
    named = default if gauge is None else Gauge.of(gauge)
    if modality is None:
        return named
    require_one_of(modality, MODALITIES, "modality")
    implied = MODALITIES[modality]
    if gauge is not None and named is not implied:
        raise SettingsError(
            f"modality {modality} means gauge {implied.value}, not {named.value}; give only one"
        )
    return implied


def orbit_basis(gauge: Gauge, positions: Floats) -> Floats:
    """Return how the gauge's generators move N poses: eq. (15) of the gauge paper, any gauge.

    Args:
        gauge: `none`, `yaw`, `se3` or `sim3`.
        positions: (N, 3), metres.

    Returns:
        U (N, 6, k): rows are position and rotation (on the left); columns are the rotations about
        the world's axes that the gauge has, three translations, the scale.
    """
    axes = _axes(gauge)
    basis = np.zeros((len(positions), POSE_DOF, dimension(gauge)))
    if gauge is Gauge.NONE:
        return basis
    turns = len(axes)
    basis[:, :3, :turns] = np.cross(axes, positions[:, None]).swapaxes(1, 2)
    basis[:, 3:6, :turns] = axes.T
    basis[:, :3, turns : turns + 3] = np.eye(3)
    if gauge.has_scale:
        basis[:, :3, -1] = positions
    return basis


def first_state_normals(gauge: Gauge, count: int, first_turn: Floats) -> Floats:
    """Return the gradients of the conditions that an alignment by the first state fulfils.

    Args:
        gauge: `yaw` or `se3`.
        count: Number of poses N.
        first_turn: (3,), the rotation vector of R' R^T of the first pose.

    Returns:
        V (N, 6, k), zero for all poses but the first.
    """
    axes = _axes(gauge)
    turns = len(axes)
    normals = np.zeros((count, POSE_DOF, dimension(gauge)))
    normals[0, :3, turns:] = np.eye(3)
    normals[0, 3:6, :turns] = (axes @ lie.inverse_left_jacobian(first_turn)).T
    return normals


def least_squares_normals(
    gauge: Gauge, groundtruth: Floats, aligned: Floats, weights: Floats
) -> Floats:
    """Return the gradients of the optimality conditions of eq. (13) of the tutorial.

    Args:
        gauge: `none`, `yaw`, `se3` or `sim3`.
        groundtruth: (N, 3) positions, metres.
        aligned: (N, 3) aligned positions, metres.
        weights: (N,), that add up to one; zero for states that play no part.

    Returns:
        V (N, 6, k), about positions alone.
    """
    axes = _axes(gauge)
    turns = len(axes)
    normals = np.zeros((len(groundtruth), POSE_DOF, dimension(gauge)))
    if gauge is Gauge.NONE:
        return normals
    truth = groundtruth - weights @ groundtruth
    other = aligned - weights @ aligned
    weight = weights[:, None]
    normals[:, :3, :turns] = weight[:, None] * np.cross(truth[:, None], axes).swapaxes(1, 2)
    normals[:, :3, turns : turns + 3] = weight[:, None] * np.eye(3)
    if gauge.has_scale:
        normals[:, :3, -1] = weight * (truth - 2.0 * other)
    return normals


def dimension(gauge: Gauge) -> int:
    """Return the number of directions that `none`, `yaw`, `se3` or `sim3` leave open.

    Raises:
        SettingsError: Another gauge, whose covariances are of another kind.
    """
    dimensions = {Gauge.NONE: 0, Gauge.YAW: 4, Gauge.SE3: 6, Gauge.SIM3: 7}
    if gauge not in dimensions:
        raise SettingsError(
            f"covariances can't be transformed to gauge {gauge.value}; use yaw, se3 or sim3"
        )
    return dimensions[gauge]


def _axes(gauge: Gauge) -> Floats:
    """Return the axes (0, 1 or 3, 3) that the gauge turns about."""
    return np.eye(3)[{4: slice(2, 3), 0: slice(0, 0)}.get(dimension(gauge), slice(0, 3))]
