"""Corrections of trajectories as they are read, on request of the user."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajeval_ros.diagnosis.hypotheses import W_FIRST, mirrored_quaternions
from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory

SIDES = ("groundtruth", "estimate")
ORDERS = ("xyzw", "wxyz")
INVERTED = (*SIDES, "groundtruth-rotations", "estimate-rotations")
_POSITIONS = "positions="


@dataclass(frozen=True)
class Mends:
    """Corrections of both sides; by default none.

    Attributes:
        groundtruth_scale: Metres per unit of the positions of the groundtruth.
        estimate_scale: Metres per unit of the positions of the estimates.
        quaternion_order: Order of the columns that were read as x, y, z, w: one of `ORDERS` for
            both sides, or one for the groundtruth and one for the estimates, separated by a comma.
        inverse: Poses or rotations to invert: values of `INVERTED`, separated by commas.
        estimate_axes: New axes of the estimates' frame, such as "x,-y,z"; "positions=y,z,x"
            applies to positions only.
        clock_rate: Correction of the estimates' clock, parts per million, from the first
            timestamp on.
        swap: Whether groundtruth and estimate are exchanged.

    Raises:
        SettingsError: A value is not valid.

    Example:
        >>> from trajeval_ros import simulate
        >>> from trajeval_ros.diagnosis.mends import Mends
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> _, longer = Mends(estimate_scale=1000.0).applied(flight.groundtruth, flight.estimate)
        >>> round(longer.path_length_m / flight.estimate.path_length_m)
        1000
    """

    groundtruth_scale: float = 1.0
    estimate_scale: float = 1.0
    quaternion_order: str = "xyzw"
    inverse: str = ""
    estimate_axes: str = "x,y,z"
    clock_rate: float = 0.0
    swap: bool = False

    def __post_init__(self) -> None:
        """Refuse values that are not valid."""
        for scale in (self.groundtruth_scale, self.estimate_scale):
            if not 0.0 < scale < np.inf:
                raise SettingsError(f"a scale must be greater than zero and finite, not {scale:g}")
        for order in self._orders:
            require_one_of(order, ORDERS, "quaternion order")
        for what in self._inverted:
            require_one_of(what, INVERTED, "side to invert")
        self._axes()
        if not abs(self.clock_rate) < 1e5:
            raise SettingsError(
                f"the clock rate correction must be within 100000 ppm, not {self.clock_rate:g}"
            )

    @classmethod
    def of(cls, words: Mapping[str, Any]) -> Mends:
        """Return the corrections among the options of the command line.

        Raises:
            SettingsError: A value is not valid.
        """
        return cls().changed(words)

    def changed(self, words: Mapping[str, Any]) -> Mends:
        """Return these corrections with changes by option name; other options are ignored."""
        known = {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}
        changes: dict[str, Any] = {
            name: True if isinstance(value, bool) else type(value)(words[name])
            for name, value in known.items()
            if words.get(name) is not None
        }
        return dataclasses.replace(self, **changes)

    @property
    def anything(self) -> bool:
        """Whether there is a correction."""
        return self != Mends()

    def applied(
        self, groundtruth: Trajectory, estimate: Trajectory
    ) -> tuple[Trajectory, Trajectory]:
        """Return both sides with the corrections; columns that they invalidate are removed.

        Raises:
            SettingsError: A side lacks the orientations or timestamps to correct.
        """
        if self.swap:
            groundtruth, estimate = estimate, groundtruth
            note = "exchanged with the other side"
            groundtruth, estimate = (
                dataclasses.replace(each, notes=(*each.notes, note))
                for each in (groundtruth, estimate)
            )
        orders, inverted = self._orders, self._inverted
        if set(orders) != {ORDERS[0]} and all(
            order == ORDERS[0] or each.quaternions is None
            for each, order in zip((groundtruth, estimate), orders, strict=True)
        ):
            raise SettingsError(
                f"--quaternion-order {self.quaternion_order} needs orientations, and no side that "
                "it names has them; remove it"
            )
        groundtruth, estimate = (
            _inverse(_ordered(each, order), side, inverted)
            for each, order, side in zip((groundtruth, estimate), orders, SIDES, strict=True)
        )
        estimate = _turned(estimate, *self._axes())
        estimate = _stretched(estimate, self.clock_rate)
        return (
            _scaled(groundtruth, self.groundtruth_scale),
            _scaled(estimate, self.estimate_scale),
        )

    @property
    def _orders(self) -> tuple[str, str]:
        orders = self.quaternion_order.split(",")
        if len(orders) > 2:
            raise SettingsError(
                f"the quaternion orders {self.quaternion_order!r} are not valid; give xyzw or "
                "wxyz, or one for the groundtruth and one for the estimates, as in xyzw,wxyz"
            )
        return orders[0].strip(), orders[-1].strip()

    @property
    def _inverted(self) -> tuple[str, ...]:
        return tuple(each.strip() for each in self.inverse.split(",") if each.strip())

    def _axes(self) -> tuple[Floats, bool]:
        """Return the signed permutation (3, 3), and whether it applies to positions only."""
        text = self.estimate_axes
        words = [each.strip() for each in text.removeprefix(_POSITIONS).split(",")]
        if sorted(each.removeprefix("-") for each in words) != ["x", "y", "z"]:
            raise SettingsError(
                f"the axes {text!r} are not valid; give x, y and z once, with a minus for a "
                "flipped axis, as in x,-y,z"
            )
        axes = np.zeros((3, 3))
        for row, word in enumerate(words):
            axes[row, "xyz".index(word[-1])] = -1.0 if word.startswith("-") else 1.0
        return axes, text.startswith(_POSITIONS)


def _scaled(trajectory: Trajectory, scale: float) -> Trajectory:
    if scale == 1.0:
        return trajectory
    covariances = trajectory.covariances
    if covariances is not None:
        units = np.array([scale] * 3 + [1.0] * 3)
        covariances = covariances * np.outer(units, units)
    return dataclasses.replace(
        trajectory,
        positions=trajectory.positions * scale,
        notes=(*trajectory.notes, f"positions multiplied by {scale:g}"),
        velocities=None if trajectory.velocities is None else trajectory.velocities * scale,
        covariances=covariances,
    )


def _ordered(trajectory: Trajectory, order: str) -> Trajectory:
    if order == ORDERS[0] or trajectory.quaternions is None:
        return trajectory
    quaternions = np.ascontiguousarray(trajectory.quaternions[:, W_FIRST])
    note = "quaternions read in the order w, x, y, z"
    notes = (*trajectory.notes, note)
    return dataclasses.replace(trajectory, quaternions=quaternions, matrices=None, notes=notes)


def _inverse(trajectory: Trajectory, side: str, inverted: tuple[str, ...]) -> Trajectory:
    quaternions = trajectory.quaternions
    whole, rotations = side in inverted, f"{side}-rotations" in inverted
    if not (whole or rotations):
        return trajectory
    if quaternions is None:
        raise SettingsError(f"the {side} has only positions, and inversion needs orientations")
    positions, inverse = trajectory.positions, lie.conjugate(quaternions)
    if whole:
        positions = -lie.rotate(inverse, positions)
    return dataclasses.replace(
        trajectory,
        positions=positions,
        quaternions=inverse,
        notes=(*trajectory.notes, f"{'poses' if whole else 'rotations'} inverted"),
        matrices=None,
        velocities=None,
        covariances=None,
    )


def _turned(trajectory: Trajectory, axes: Floats, positions_alone: bool) -> Trajectory:
    """Return the states in other axes of the world, and of the body if the handedness changes."""
    if (axes == np.eye(3)).all():
        return trajectory
    quaternions = trajectory.quaternions
    if quaternions is not None and not positions_alone:
        if np.linalg.det(axes) < 0.0:
            quaternions = mirrored_quaternions(quaternions, axes)
        else:
            quaternions = lie.multiply(lie.from_matrix(axes), quaternions)
    velocities = trajectory.velocities
    return dataclasses.replace(
        trajectory,
        positions=trajectory.positions @ axes.T,
        quaternions=quaternions,
        notes=(*trajectory.notes, "axes exchanged or flipped"),
        matrices=None,
        velocities=None if velocities is None else velocities @ axes.T,
        covariances=None,
    )


def _stretched(trajectory: Trajectory, ppm: float) -> Trajectory:
    if ppm == 0.0 or not len(trajectory):
        return trajectory
    if not trajectory.stamped:
        raise SettingsError("the estimate has no timestamps, which a clock rate needs")
    first = int(trajectory.stamps.min())
    longer = np.rint((trajectory.stamps - first) * (1e-6 * ppm)).astype(np.int64)
    notes = (*trajectory.notes, f"timestamps rescaled by {ppm:g} ppm")
    return dataclasses.replace(trajectory, stamps=trajectory.stamps + longer, notes=notes)
