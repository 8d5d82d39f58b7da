"""The unknowns of a rig: states of the IMU at the knots, and ten calibration parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.se3 import times

# Columns of the calibration: R_IM (right perturbation), lever arm, clock, tilt of gravity.
BODY, LEVER, OFFSET, SKEW, GRAVITY = slice(0, 3), slice(3, 6), 6, 7, slice(8, 10)
GRAVITY_MPS2 = 9.81


@dataclass(frozen=True, eq=False)
class Rig:
    """States at N knots, each with 15 columns in this order, and the calibration."""

    rotations: Floats  # (N, 3, 3), R_WI, perturbed on the right
    velocities: Floats  # (N, 3), m/s, in W
    positions: Floats  # (N, 3), metres, in W
    gyro_biases: Floats  # (N, 3), rad/s
    acceleration_biases: Floats  # (N, 3), m/s^2
    body: Floats  # (3, 3), R_IM
    lever: Floats  # (3,), metres, origin of M in I
    offset_s: float
    skew: float
    gravity: Floats  # (3,), m/s^2, in W, of fixed magnitude

    def moved(self, states: Floats, calibration: Floats) -> Rig:
        """Return the rig after a step of the states (N, 15) and of the calibration (10,)."""
        gravity = self.gravity + tangents(self.gravity) @ calibration[GRAVITY]
        return Rig(
            self.rotations @ so3.exp(states[:, 0:3]),
            self.velocities + states[:, 3:6],
            self.positions + states[:, 6:9],
            self.gyro_biases + states[:, 9:12],
            self.acceleration_biases + states[:, 12:15],
            self.body @ so3.exp(calibration[BODY]),
            self.lever + calibration[LEVER],
            self.offset_s + float(calibration[OFFSET]),
            self.skew + float(calibration[SKEW]),
            gravity * (np.linalg.norm(self.gravity) / np.linalg.norm(gravity)),
        )

    @property
    def up_axis(self) -> int:
        """The axis of W that is nearest to the vertical."""
        return int(np.abs(self.gravity).argmax())

    @property
    def values(self) -> Floats:
        """The calibration (10,): rotation vector, lever arm, offset, skew, horizontal gravity.

        The last two are the components of gravity, over its magnitude, along the horizontal axes.
        """
        tilt = np.delete(self.gravity, self.up_axis) / np.linalg.norm(self.gravity)
        return np.concatenate(
            [so3.log(self.body[None])[0], self.lever, [self.offset_s, self.skew], tilt]
        )

    @property
    def values_by_step(self) -> Floats:
        """Derivative (10, 10) of `values` by a step of the calibration."""
        change = np.eye(10)
        along = tangents(self.gravity) / np.linalg.norm(self.gravity)
        change[GRAVITY, GRAVITY] = np.delete(along, self.up_axis, axis=0)
        return change

    def without(self, fixed: Booleans, shift_s: float) -> Rig:
        """Return the rig with the marked parameters (10,) at zero; the states keep its marker.

        `shift_s` is the part of the clock's offset that the samples already have.
        """
        body = np.eye(3) if fixed[BODY].all() else self.body
        lever = np.where(fixed[LEVER], 0.0, self.lever)
        rotations = self.rotations @ self.body @ body.T
        marker = self.positions + times(self.rotations, self.lever)
        return replace(
            self,
            body=body,
            lever=lever,
            rotations=rotations,
            positions=marker - times(rotations, lever),
            offset_s=-shift_s if fixed[OFFSET] else self.offset_s,
            skew=0.0 if fixed[SKEW] else self.skew,
        )


def tangents(gravity: Floats) -> Floats:
    """Return the derivative (3, 2) of gravity (3,) by rotations about two horizontal axes."""
    down = gravity / np.linalg.norm(gravity)
    first = np.cross(down, np.eye(3)[int(np.abs(down).argmin())])
    first = first / np.linalg.norm(first)
    return float(np.linalg.norm(gravity)) * np.stack([first, np.cross(down, first)], axis=1)
