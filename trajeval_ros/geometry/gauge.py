"""Gauges: the groups of transformations that a set of sensors cannot observe, and their elements.

Tutorial, section III-A and Table I. A monocular camera cannot distinguish similar trajectories. A
stereo camera or a lidar cannot distinguish rigidly moved ones. With gravity from an IMU, the
rotation about gravity and the translation remain. An alignment removes these before errors are
computed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Similarity:
    """x -> scale * rotation x + translation, from the estimate's frame to the groundtruth's.

    Attributes:
        rotation: (3, 3) rotation matrix.
        translation: (3,), metres.
        scale: Positive factor; 1 for rigid transformations.

    Example:
        >>> import numpy as np
        >>> from trajeval_ros import Similarity, simulate
        >>> estimate = simulate(seed=1, duration_s=30.0).estimate
        >>> similarity = Similarity(np.eye(3), np.array([1.0, 0.0, 0.0]), scale=2.0)
        >>> moved = similarity.trajectory(estimate)
        >>> bool(np.allclose(moved.positions, 2.0 * estimate.positions + [1.0, 0.0, 0.0]))
        True
    """

    rotation: Floats
    translation: Floats
    scale: float = 1.0

    @classmethod
    def identity(cls) -> Similarity:
        """Return the identity transformation."""
        return cls(np.eye(3), np.zeros(3))

    @cached_property
    def linear(self) -> Floats:
        """The scaled rotation, (3, 3)."""
        return self.scale * self.rotation

    def positions(self, points: Floats) -> Floats:
        """Return transformed points, (N, 3) or (3,)."""
        moved: Floats = points @ self.linear.T
        moved += self.translation
        return moved

    def quaternions(self, quaternions: Floats) -> Floats:
        """Return transformed orientations, (N, 4) xyzw: R_i -> R R_i."""
        rotation = lie.from_matrix(self.rotation)
        return lie.by_blocks(lambda rows: (lie.multiply(rotation, rows),), quaternions)[0]

    def trajectory(self, trajectory: Trajectory) -> Trajectory:
        """Return transformed states, eq. (14); biases are in the body frame and do not change."""
        quaternions, velocities = trajectory.quaternions, trajectory.velocities
        return replace(
            trajectory,
            positions=self.positions(trajectory.positions),
            quaternions=None
            if quaternions is None
            else lie.normalized(self.quaternions(quaternions)),
            velocities=None if velocities is None else self.vectors(velocities),
            covariances=None,
            reading=trajectory.reading.without("matrices", "fixes"),
        )

    def vectors(self, vectors: Floats) -> Floats:
        """Return free vectors (N, 3), such as velocities, scaled and rotated."""
        rotated: Floats = vectors @ self.linear.T
        return rotated

    @property
    def rotation_xyzw(self) -> Floats:
        """The rotation as a quaternion with w >= 0, (4,)."""
        return lie.from_matrix(self.rotation)


POSE_DOF = 6  # of a perturbation: position first, rotation second


class Gauge(Enum):
    """A group that acts on whole trajectories: p -> s R p + t, R_i -> R R_i, v -> s R v (eq. 8).

    The value is the gauge's name on the command line and in results.

    Example:
        >>> from trajeval_ros import Gauge
        >>> Gauge.of("yaw").yaw_only
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
    def yaw_only(self) -> bool:
        """Whether its rotations are about z alone, eq. (12)."""
        return self in (Gauge.YAW, Gauge.PLANAR)

    @property
    def has_so3(self) -> bool:
        """Whether its rotations are all of SO(3)."""
        return self in (Gauge.SE3, Gauge.SIM3)

    @property
    def has_scale(self) -> bool:
        """Whether it changes the scale."""
        return self is Gauge.SIM3

    @property
    def minimum_states(self) -> int:
        """Least number of states whose positions determine an element (not on a line, for 3)."""
        if self.has_so3:
            return 3
        return 2 if self.yaw_only else 1

    def enough_pairs(self, align_states: int | None) -> int:
        """Return the least number of pairs of a meaningful absolute error.

        With the minimal number of states, the alignment fits all errors exactly. With twice as
        many, at least half of the errors remain. The first state alone is aligned by its pose.
        """
        return 2 * (1 if align_states == 1 else self.minimum_states)

    @property
    def description(self) -> str:
        """What an alignment fits, for messages and tables."""
        return _DESCRIPTIONS[self]


_DESCRIPTIONS = {
    Gauge.NONE: "no alignment, same frame",
    Gauge.TRANSLATION: "position",
    Gauge.YAW: "yaw and position (4-DoF)",
    Gauge.PLANAR: "heading and position in the horizontal plane (SE(2))",
    Gauge.SE3: "rotation and position (SE(3))",
    Gauge.SIM3: "rotation, position and scale (Sim(3))",
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
    """Return the gauge from an optional name and an optional sensor set."""
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

    The gauge is `none`, `yaw`, `se3` or `sim3`; positions are (N, 3), metres. U is (N, 6, k): rows
    are position and rotation (applied on the left); columns are the gauge's rotations about the
    world's axes, three translations, and the scale.
    """
    axes = _axes(gauge)
    basis = np.zeros((len(positions), POSE_DOF, dimension(gauge)))
    if gauge is Gauge.NONE:
        return basis
    rotation_dof = len(axes)
    basis[:, :3, :rotation_dof] = np.cross(axes, positions[:, None]).swapaxes(1, 2)
    basis[:, 3:6, :rotation_dof] = axes.T
    basis[:, :3, rotation_dof : rotation_dof + 3] = np.eye(3)
    if gauge.has_scale:
        basis[:, :3, -1] = positions
    return basis


def first_state_normals(gauge: Gauge, count: int, first_turn: Floats) -> Floats:
    """Return the gradients of the conditions of an alignment by the first of N states.

    The gauge is `yaw` or `se3`; `first_turn` (3,) is the rotation vector of R' R^T of the first
    pose, rad. V is (N, 6, k), zero for all poses except the first.
    """
    axes = _axes(gauge)
    rotation_dof = len(axes)
    normals = np.zeros((count, POSE_DOF, dimension(gauge)))
    normals[0, :3, rotation_dof:] = np.eye(3)
    normals[0, 3:6, :rotation_dof] = (axes @ so3.inverse_left_jacobian(first_turn)).T
    return normals


def least_squares_normals(
    gauge: Gauge, groundtruth: Floats, aligned: Floats, weights: Floats
) -> Floats:
    """Return the gradients (N, 6, k) of the optimality conditions of the tutorial's eq. (13).

    The gauge is `none`, `yaw`, `se3` or `sim3`. Positions are (N, 3), metres. Weights (N,) have
    the sum 1 and are zero for states outside the alignment. The rows of the rotation are zero.
    """
    axes = _axes(gauge)
    rotation_dof = len(axes)
    normals = np.zeros((len(groundtruth), POSE_DOF, dimension(gauge)))
    if gauge is Gauge.NONE:
        return normals
    p = groundtruth - weights @ groundtruth
    q = aligned - weights @ aligned
    weight = weights[:, None]
    normals[:, :3, :rotation_dof] = weight[:, None] * np.cross(p[:, None], axes).swapaxes(1, 2)
    normals[:, :3, rotation_dof : rotation_dof + 3] = weight[:, None] * np.eye(3)
    if gauge.has_scale:
        normals[:, :3, -1] = weight * (p - 2.0 * q)
    return normals


def dimension(gauge: Gauge) -> int:
    """Return the dimension of gauge `none`, `yaw`, `se3` or `sim3`."""
    dimensions = {Gauge.NONE: 0, Gauge.YAW: 4, Gauge.SE3: 6, Gauge.SIM3: 7}
    if gauge not in dimensions:
        raise SettingsError(
            f"covariances can't be transformed to gauge {gauge.value}; use yaw, se3 or sim3"
        )
    return dimensions[gauge]


def _axes(gauge: Gauge) -> Floats:
    """Return the rotation axes of a gauge, (0, 3), (1, 3) or (3, 3)."""
    return np.eye(3)[{4: slice(2, 3), 0: slice(0, 0)}.get(dimension(gauge), slice(0, 3))]
