"""The poses of the IMU at the groundtruth's timestamps, with covariances."""

from __future__ import annotations

import numpy as np

from trajeval_ros.calibration.groundtruth_doctor.joint_fit import JointFit
from trajeval_ros.calibration.groundtruth_doctor.sample_checks import PoseSpan
from trajeval_ros.calibration.groundtruth_doctor.sample_rows import rig_at
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.covariance_frames import world_from_body_rotations
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

_LONGEST_BRIDGE_S = 2.0
_POSE = [6, 7, 8, 0, 1, 2]  # columns of a state: position, then rotation


def repaired(
    fit: JointFit, groundtruth: Trajectory, shift_ns: int, gaps: tuple[PoseSpan, ...]
) -> Trajectory:
    """Return the IMU's states by its clock; gaps of up to 2 s are bridged.

    `shift_ns` is the part of the clock's offset that the fit's samples already have. Covariances
    are those of the fit times the median ratio of the sandwich and the model variance of the
    calibration. They are lower limits: the IMU does not reveal errors of the groundtruth that last
    for more than about a second.
    """
    stamps, rig, steps = _with_bridges(groundtruth.stamps, gaps), fit.rig, fit.steps
    first_s, first = float(fit.samples.seconds[0]), int(groundtruth.stamps[0])
    since_s = (stamps - first) / NANOSECONDS
    later_s = rig.offset_s + rig.skew * (first_s + since_s - fit.samples.middle_s)
    seconds = first_s + since_s + later_s
    within = (seconds >= steps.knots[0]) & (seconds < steps.knots[-1])
    stamps = stamps + shift_ns + np.rint(later_s * NANOSECONDS).astype(np.int64)
    states = rig_at(seconds[within], steps, fit.motions, rig)
    knots, _, _, _, rotations, positions, velocities, _ = states
    covariances = fit.state_covariances()[:, _POSE][:, :, _POSE] * _inflation(fit)
    return Trajectory(
        stamps[within],
        positions,
        lie.from_matrices(rotations),
        velocities=velocities,
        gyroscope_biases=rig.gyro_biases[knots],
        accelerometer_biases=rig.acceleration_biases[knots],
        covariances=world_from_body_rotations(covariances[knots], rotations),
        frame=groundtruth.frame,
        name=groundtruth.name,
    )


def _with_bridges(stamps: Stamps, gaps: tuple[PoseSpan, ...]) -> Stamps:
    usual = int(np.median(np.diff(stamps)))
    bridges = [
        np.arange(gap.start_ns + usual, gap.start_ns + round(gap.duration_s * NANOSECONDS), usual)
        for gap in gaps
        if gap.duration_s <= _LONGEST_BRIDGE_S
    ]
    found: Stamps = np.unique(np.concatenate([stamps, *bridges]))
    return found


def _inflation(fit: JointFit) -> float:
    """Return the factor on the variances for errors that are correlated over time."""
    by_blocks: Floats = np.diag(fit.covariance_of_blocks)[fit.free]
    by_model = np.diag(fit.covariance_of_model)[fit.free]
    return max(1.0, float(np.median(by_blocks / by_model)))
