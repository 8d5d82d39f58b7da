"""Conventions in which a source writes poses: unit, quaternion order, direction, axes, clock."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError, SettingsError, require_one_of
from trajeval_ros.formatting.remarks import note
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory

# Of the columns that were read as x, y, z, w. The last one: x, y, z, w read as w, x, y, z.
ORDERS = ("xyzw", "wxyz", "yzwx")
POSES, ROTATIONS = "poses", "rotations"
# Columns of x, y, z, w, if the columns that were read as these are in other orders.
W_FIRST, W_THIRD = [1, 2, 3, 0], [3, 0, 1, 2]
_ALL, _POSITIONS, _ROTATIONS = "", "positions=", "rotations="
_SLOWEST_PPM, _FASTEST_PPM = -0.9e6, 9e6


@dataclass(frozen=True)
class Conventions:
    """Conventions of a source that differ from those that its reader assumed."""

    scale: float = 1.0  # metres per unit of the positions
    # Order of the columns that were read as x, y, z, w: one of `ORDERS`.
    quaternion_order: str = ORDERS[0]
    inverse: str = ""  # `poses` or `rotations` if these are inverse (world in body); "" if not
    # New axes of the fixed frame, such as "x,-y,z"; "positions=y,z,x" and "rotations=y,z,x" change
    # only these.
    axes: str = "x,y,z"
    # Correction of the clock, parts per million, from the first timestamp on.
    clock_rate: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.scale < np.inf:
            raise SettingsError(
                f"a scale must be greater than zero and finite, not {self.scale:g}"
            )
        require_one_of(self.quaternion_order, ORDERS, "quaternion order")
        if self.inverse:
            require_one_of(self.inverse, (POSES, ROTATIONS), "kind of inversion")
        self._permutation()
        if not _SLOWEST_PPM <= self.clock_rate <= _FASTEST_PPM:
            raise SettingsError(
                f"the clock rate correction must be from {_SLOWEST_PPM:.0f} to "
                f"{_FASTEST_PPM:.0f} ppm, not {self.clock_rate:g}"
            )

    def corrected(self, trajectory: Trajectory) -> Trajectory:
        """Return a trajectory in the conventions of this package, with remarks.

        Columns that a correction invalidates are removed.
        """
        if self.quaternion_order != ORDERS[0]:
            trajectory = _in_order(trajectory, self.quaternion_order)
        if self.inverse:
            trajectory = _inverted(trajectory, self.inverse)
        axes, of = self._permutation()
        if (axes != np.eye(3)).any():
            trajectory = _in_axes(trajectory, axes, of)
        if self.clock_rate and len(trajectory):
            trajectory = _at_clock_rate(trajectory, self.clock_rate)
        return trajectory if self.scale == 1.0 else _scaled(trajectory, self.scale)

    def _permutation(self) -> tuple[Floats, str]:
        """Return the signed permutation (3, 3), and what it applies to: the prefix."""
        prefixes = (item for item in (_POSITIONS, _ROTATIONS) if self.axes.startswith(item))
        of = next(prefixes, _ALL)
        names = [word.strip() for word in self.axes.removeprefix(of).split(",")]
        if sorted(item.removeprefix("-") for item in names) != ["x", "y", "z"]:
            raise SettingsError(
                f"the axes {self.axes!r} are not valid; give x, y and z once, with a minus for a "
                "flipped axis, as in x,-y,z"
            )
        axes = np.zeros((3, 3))
        for row, name in enumerate(names):
            axes[row, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
        if of == _ROTATIONS and np.linalg.det(axes) < 0.0:
            raise SettingsError(f"the axes {self.axes!r} are left-handed, and rotations are not")
        return axes, of


def mirrored_quaternions(quaternions: Floats, axes: Floats) -> Floats:
    """Return the quaternions (N, 4) of M R M^T, M a signed permutation (3, 3) of either hand."""
    rotated = quaternions.copy()
    rotated[:, :3] = np.linalg.det(axes) * quaternions[:, :3] @ axes.T
    return rotated


def _corrected(reading: SourceInfo, sentence: str) -> SourceInfo:
    return reading.remarked(note("corrected", sentence))


def _scaled(trajectory: Trajectory, scale: float) -> Trajectory:
    covariances = trajectory.covariances
    if covariances is not None:
        units = np.array([scale] * 3 + [1.0] * 3)
        covariances = covariances * np.outer(units, units)
    return dataclasses.replace(
        trajectory,
        positions=trajectory.positions * scale,
        reading=_corrected(trajectory.reading, f"positions multiplied by {scale:g}"),
        velocities=None if trajectory.velocities is None else trajectory.velocities * scale,
        covariances=covariances,
    )


def _in_order(trajectory: Trajectory, order: str) -> Trajectory:
    if trajectory.quaternions is None:
        raise InputError("no orientations, which a quaternion order needs")
    columns = W_FIRST if order == ORDERS[1] else W_THIRD
    quaternions = np.ascontiguousarray(trajectory.quaternions[:, columns])
    reading = trajectory.reading.without("matrices")
    reading = _corrected(reading, f"quaternions read in the order {', '.join(order)}")
    return dataclasses.replace(trajectory, quaternions=quaternions, reading=reading)


def _inverted(trajectory: Trajectory, what: str) -> Trajectory:
    if trajectory.quaternions is None:
        raise InputError("only positions, and an inversion needs orientations")
    positions, inverse = trajectory.positions, lie.conjugate(trajectory.quaternions)
    if what == POSES:
        positions = -lie.rotate(inverse, positions)
    return dataclasses.replace(
        trajectory,
        positions=positions,
        quaternions=inverse,
        reading=_corrected(trajectory.reading.without("matrices"), f"{what} inverted"),
        velocities=None,
        covariances=None,
    )


def _in_axes(trajectory: Trajectory, axes: Floats, of: str) -> Trajectory:
    """Return the states in other axes of the world, and of the body if the handedness changes."""
    quaternions = trajectory.quaternions
    if quaternions is not None and of != _POSITIONS:
        if np.linalg.det(axes) < 0.0:
            quaternions = mirrored_quaternions(quaternions, axes)
        else:
            quaternions = lie.multiply(lie.from_matrix(axes), quaternions)
    axes = np.eye(3) if of == _ROTATIONS else axes
    velocities = trajectory.velocities
    return dataclasses.replace(
        trajectory,
        positions=trajectory.positions @ axes.T,
        quaternions=quaternions,
        reading=_corrected(trajectory.reading.without("matrices"), "axes exchanged or flipped"),
        velocities=None if velocities is None else velocities @ axes.T,
        covariances=None,
    )


def _at_clock_rate(trajectory: Trajectory, ppm: float) -> Trajectory:
    if not trajectory.reading.stamped:
        raise InputError("no timestamps, which a clock rate needs")
    first = int(trajectory.stamps.min())
    longer = np.rint((trajectory.stamps - first) * (1e-6 * ppm)).astype(np.int64)
    reading = _corrected(trajectory.reading, f"timestamps rescaled by {ppm:g} ppm")
    return dataclasses.replace(trajectory, stamps=trajectory.stamps + longer, reading=reading)
