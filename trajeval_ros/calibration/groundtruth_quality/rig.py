"""The unknowns of a rig: states of the IMU at the knots, and ten calibration parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.se3 import times

# Columns of the calibration: R_IM (right perturbation), lever arm, clock, tilt of gravity.
BODY, LEVER, OFFSET, SKEW, GRAVITY = slice(0, 3), slice(3, 6), 6, 7, slice(8, 10)
CLOCK = slice(6, 8)
# Their units in results: deg, mm, ms, ppm, deg.
UNITS = np.array([np.degrees(1.0)] * 3 + [1e3] * 4 + [1e6] + [np.degrees(1.0)] * 2)


@dataclass(frozen=True, eq=False)
class Rig:
    """States at N knots, each with 15 columns in this order, and the calibration."""

    rotations: Floats  # (N, 3, 3), R_WI, perturbed on the right
    velocities: Floats  # (N, 3), m/s, in W
    positions: Floats  # (N, 3), metres, in W
    biases: Floats  # (N, 6), of the gyroscope, rad/s, and of the accelerometer, m/s^2
    body: Floats  # (3, 3), R_IM
    lever: Floats  # (3,), metres, origin of M in I
    offset_s: float  # of the clock, without `shift_s`
    skew: float
    gravity: Floats  # (3,), m/s^2, in W, of fixed magnitude
    shift_s: float = 0.0  # the part of the clock's offset that the samples already have

    def moved(self, states: Floats, calibration: Floats) -> Rig:
        """Return the rig after a step of the states (N, 15) and of the calibration (10,)."""
        gravity = self.gravity + tangents(self.gravity) @ calibration[GRAVITY]
        return Rig(
            self.rotations @ so3.exp(states[:, 0:3]),
            self.velocities + states[:, 3:6],
            self.positions + states[:, 6:9],
            self.biases + states[:, 9:15],
            self.body @ so3.exp(calibration[BODY]),
            self.lever + calibration[LEVER],
            self.offset_s + float(calibration[OFFSET]),
            self.skew + float(calibration[SKEW]),
            gravity * (np.linalg.norm(self.gravity) / np.linalg.norm(gravity)),
            self.shift_s,
        )

    def values(self) -> Floats:
        """Return the calibration (10,); its covariance is that of a step.

        Rotation vector, lever arm, offset, skew, and the components of gravity, over its
        magnitude, along the two axes of W that are not the nearest to the vertical.
        """
        up, length = int(np.abs(self.gravity).argmax()), np.linalg.norm(self.gravity)
        rotation, tilt = so3.log(self.body[None])[0], np.delete(self.gravity, up) / length
        return np.concatenate(
            [rotation, self.lever, [self.shift_s + self.offset_s, self.skew], tilt]
        )

    def without(self, fixed: Booleans) -> Rig:
        """Return the rig with the marked parameters (10,) at zero; the states keep its marker."""
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
            offset_s=-self.shift_s if fixed[OFFSET] else self.offset_s,
            skew=0.0 if fixed[SKEW] else self.skew,
        )


def tangents(gravity: Floats) -> Floats:
    """Return the derivative (3, 2) of gravity (3,) by its two components in `Rig.values`."""
    up = int(np.abs(gravity).argmax())
    change = np.insert(np.eye(2), up, -np.delete(gravity, up) / gravity[up], axis=0)
    return np.linalg.norm(gravity) * change
