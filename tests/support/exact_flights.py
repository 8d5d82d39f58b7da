"""A smooth flight without noise, with a known clock and body."""

from __future__ import annotations

import dataclasses

import numpy as np
from calibration_flights import Fault, marked, stamps_of
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration.increments import Unknowns
from trajeval_ros.geometry.trajectory import Trajectory

Array = NDArray[np.float64]
FAULT = Fault(0.013, 2e-4, (0.4, -0.7, 1.1), (0.3, -0.2, 0.5))
SCALE_OF_ESTIMATE = 1.7
DURATION_S = 20.0


def states(seconds: Array) -> Trajectory:
    positions = np.column_stack(
        [2.0 * np.sin(0.7 * seconds), 1.5 * np.cos(0.9 * seconds), np.sin(1.1 * seconds)]
    )
    rotations = np.column_stack(
        [0.5 * np.sin(0.9 * seconds), 0.4 * np.cos(1.3 * seconds), 1.2 * np.sin(0.6 * seconds)]
    )
    return Trajectory(stamps_of(seconds), positions, Rotation.from_rotvec(rotations).as_quat())


def flown(
    *, oriented: bool = True, fault: Fault = FAULT, duration_s: float = DURATION_S
) -> tuple[Trajectory, Trajectory, Unknowns]:
    """Return a smooth flight without noise, and its true unknowns."""
    own = np.arange(0.0, duration_s + 1e-9, 0.05)
    other = np.arange(-1.0, duration_s + 1.0, 0.002)
    truth = marked(other, states(other), duration_s, fault)
    estimate = states(own)
    world = Rotation.from_rotvec([0.2, -0.3, 1.5])
    assert estimate.rotations is not None
    estimate = dataclasses.replace(
        estimate,
        positions=world.apply(estimate.positions) / SCALE_OF_ESTIMATE + 4.0,
        quaternions=(world * estimate.rotations).as_quat(),
    )
    rotation = Rotation.from_rotvec(np.asarray(fault.rotation_vector))
    if not oriented:
        truth, rotation = dataclasses.replace(truth, quaternions=None), world.inv()
    unknowns = Unknowns(
        fault.offset_s,
        fault.skew,
        rotation.as_matrix(),
        np.array(fault.lever_m),
        SCALE_OF_ESTIMATE,
    )
    return truth, estimate, unknowns
