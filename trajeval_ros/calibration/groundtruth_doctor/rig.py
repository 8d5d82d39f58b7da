"""The unknowns of a rig: states of the IMU at the knots, and ten calibration parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.se3 import times

# Columns of the calibration: R_IM (right perturbation), lever arm, clock, tilt of gravity.
BODY, LEVER, OFFSET, SKEW, GRAVITY = slice(0, 3), slice(3, 6), 6, 7, slice(8, 10)


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

    @property
    def biases(self) -> Floats:
        """Biases of gyroscope and accelerometer (N, 6)."""
        return np.hstack([self.gyro_biases, self.acceleration_biases])

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

    def values(self) -> tuple[Floats, Floats]:
        """Return the calibration (10,), and its derivative (10, 10) by a step.

        Rotation vector, lever arm, offset, skew, and the components of gravity, over its
        magnitude, along the two axes of W that are not the nearest to the vertical.
        """
        up, change = int(np.abs(self.gravity).argmax()), np.eye(10)
        relative = np.column_stack([self.gravity, tangents(self.gravity)])
        tilt = np.delete(relative, up, axis=0) / np.linalg.norm(self.gravity)
        change[GRAVITY, GRAVITY] = tilt[:, 1:]
        turn = so3.log(self.body[None])[0]
        clock = [self.offset_s, self.skew]
        return np.concatenate([turn, self.lever, clock, tilt[:, 0]]), change

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
