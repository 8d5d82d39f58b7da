"""Gauges: the groups of transformations that a set of sensors cannot observe.

Tutorial, section III-A and Table I. A monocular camera cannot distinguish similar trajectories. A
stereo camera or a lidar cannot distinguish rigidly moved ones. With gravity from an IMU, the
rotation about gravity and the translation remain. An alignment removes these before errors are
computed.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats

POSE_DOF = 6  # of a perturbation: position first, rotation second


class Gauge(Enum):
    """A group that acts on whole trajectories: p -> s R p + t, R_i -> R R_i, v -> s R v (eq. 8).

    The value is the gauge's name on the command line and in results.

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
        """Return a gauge from its name.

        Raises:
            SettingsError: The name is unknown.
        """
        if isinstance(gauge, Gauge):
            return gauge
        require_one_of(gauge, (member.value for member in cls), "gauge")
        return cls(gauge)

    @property
    def has_translation(self) -> bool:
        """Whether the group has translations."""
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
        """Least number of states whose positions determine an element (not on a line, for 3)."""
        if self.turns_freely:
            return 3
        return 2 if self.turns_about_gravity_only else 1

    @property
    def description(self) -> str:
        """The group in words, for messages and tables."""
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
"""Sensor sets and their gauges (tutorial, Table I; section V for those not in the table).

Example:
    >>> from trajeval_ros import MODALITIES
    >>> MODALITIES["mono-inertial"].value
    'yaw'
"""


def gauge_for(gauge: Gauge | str | None, modality: str | None, default: Gauge) -> Gauge:
    """Return the gauge from an optional name and an optional sensor set.

    Raises:
        SettingsError: An unknown name, or a gauge that contradicts the modality.
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
    """Return the derivatives of N poses by the gauge's generators: gauge paper, eq. (15).

    Args:
        gauge: `none`, `yaw`, `se3` or `sim3`.
        positions: (N, 3), metres.

    Returns:
        U (N, 6, k). Rows are position and rotation (applied on the left). Columns are the gauge's
        rotations about the world's axes, three translations, and the scale.
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
    """Return the gradients of the conditions of an alignment by the first state.

    Args:
        gauge: `yaw` or `se3`.
        count: Number of poses N.
        first_turn: (3,), rotation vector of R' R^T of the first pose, rad.

    Returns:
        V (N, 6, k), zero for all poses except the first.
    """
    axes = _axes(gauge)
    turns = len(axes)
    normals = np.zeros((count, POSE_DOF, dimension(gauge)))
    normals[0, :3, turns:] = np.eye(3)
    normals[0, 3:6, :turns] = (axes @ so3.inverse_left_jacobian(first_turn)).T
    return normals


def least_squares_normals(
    gauge: Gauge, groundtruth: Floats, aligned: Floats, weights: Floats
) -> Floats:
    """Return the gradients of the optimality conditions of the tutorial's eq. (13).

    Args:
        gauge: `none`, `yaw`, `se3` or `sim3`.
        groundtruth: (N, 3) positions, metres.
        aligned: (N, 3) aligned positions, metres.
        weights: (N,) with sum 1; zero for states outside the alignment.

    Returns:
        V (N, 6, k); the rows of the rotation are zero.
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
    """Return the dimension of gauge `none`, `yaw`, `se3` or `sim3`.

    Raises:
        SettingsError: Another gauge, which has no transformation of covariances.
    """
    dimensions = {Gauge.NONE: 0, Gauge.YAW: 4, Gauge.SE3: 6, Gauge.SIM3: 7}
    if gauge not in dimensions:
        raise SettingsError(
            f"covariances can't be transformed to gauge {gauge.value}; use yaw, se3 or sim3"
        )
    return dimensions[gauge]


def _axes(gauge: Gauge) -> Floats:
    """Return the rotation axes of a gauge, (0, 3), (1, 3) or (3, 3)."""
    return np.eye(3)[{4: slice(2, 3), 0: slice(0, 0)}.get(dimension(gauge), slice(0, 3))]
