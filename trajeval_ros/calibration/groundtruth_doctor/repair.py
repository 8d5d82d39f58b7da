"""The poses of the IMU at the groundtruth's timestamps, with covariances."""

from __future__ import annotations

import numpy as np

from trajeval_ros.calibration.groundtruth_doctor.joint_fit import JointFit
from trajeval_ros.calibration.groundtruth_doctor.sample_checks import PoseSpan
from trajeval_ros.calibration.groundtruth_doctor.sample_rows import rig_at
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.covariance_frames import world_from_body_rotations
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

_LONGEST_BRIDGE_S = 2.0


def repaired(
    fit: JointFit, groundtruth: Trajectory, gaps: tuple[PoseSpan, ...], scale: float
) -> Trajectory:
    """Return the IMU's states by its clock; gaps of up to 2 s are bridged.

    Covariances are those of the fit times `scale` and the median ratio of the sandwich and the
    model variance of the calibration. They are lower limits: the IMU does not reveal errors of the
    groundtruth that last for more than about a second.
    """
    stamps, rig, steps = _with_bridges(groundtruth.stamps, gaps), fit.rig, fit.steps
    own_s = fit.samples.seconds[0] + (stamps - groundtruth.stamps[0]) / NANOSECONDS
    later_s = rig.offset_s + rig.skew * (own_s - fit.samples.middle_s)
    seconds = own_s + later_s
    within = (seconds >= steps.knots[0]) & (seconds < steps.knots[-1])
    later_ns = np.rint(later_s * NANOSECONDS).astype(np.int64)
    stamps = stamps + later_ns + round(rig.shift_s * NANOSECONDS)
    states = rig_at(seconds[within], steps, fit.motions, rig)
    by_blocks, by_model = (
        np.diag(each)[fit.free] for each in (fit.covariance_of_blocks, fit.covariance_of_model)
    )
    inflation = max(1.0, float(np.median(by_blocks / by_model)))
    covariances = fit.pose_covariances() * (scale * inflation)
    return Trajectory(
        stamps[within],
        states.positions,
        lie.from_matrices(states.rotations),
        velocities=states.velocities,
        gyroscope_biases=rig.biases[states.knots, :3],
        accelerometer_biases=rig.biases[states.knots, 3:],
        covariances=world_from_body_rotations(covariances[states.knots], states.rotations),
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
