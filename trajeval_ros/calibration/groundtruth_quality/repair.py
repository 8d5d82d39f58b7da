"""The poses of the IMU at the groundtruth's timestamps, with covariances."""

from __future__ import annotations

import math

import numpy as np

from trajeval_ros.calibration.groundtruth_quality.joint_fit import JointFit
from trajeval_ros.calibration.groundtruth_quality.sample_checks import PoseSpan
from trajeval_ros.calibration.groundtruth_quality.sample_rows import rig_at
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.covariance_frames import world_from_body_rotations
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

_LONGEST_BRIDGE_S = 2.0
_LARGEST_SIGMA_RAD = math.radians(3.0)  # of an orientation from positions


def repaired(
    fit: JointFit, groundtruth: Trajectory, gaps: tuple[PoseSpan, ...], scale: float
) -> Trajectory:
    """Return the IMU's states by its clock; gaps of up to 2 s are bridged.

    Covariances are those of the fit times `scale` and the median ratio of the sandwich and the
    model variance of the calibration. They are lower limits: the IMU does not reveal errors of the
    groundtruth that last for more than about a second.

    Raises:
        InputError: Positions and IMU do not determine the orientations.
    """
    stamps, rig, steps = _with_bridges(groundtruth.stamps, gaps), fit.rig, fit.steps
    own_s = fit.samples.seconds[0] + (stamps - groundtruth.stamps[0]) / NANOSECONDS
    later_s = rig.offset_s + rig.skew * (own_s - fit.samples.middle_s)
    seconds = own_s + later_s
    within = (seconds >= steps.knots[0]) & (seconds < steps.knots[-1])
    later_ns = np.rint(later_s * NANOSECONDS).astype(np.int64)
    stamps = stamps + later_ns + round(rig.shift_s * NANOSECONDS)
    by_blocks, by_model = (
        np.diag(item)[fit.free] for item in (fit.covariance_of_blocks, fit.covariance_of_model)
    )
    inflation = max(1.0, float(np.median(by_blocks / by_model)))
    covariances = fit.pose_covariances() * (scale * inflation)
    variance = float(np.median(np.einsum("nii->n", covariances[:, 3:, 3:])))
    if not fit.samples.has_rotations and variance > _LARGEST_SIGMA_RAD**2:
        raise InputError(
            f"{groundtruth.name or 'the groundtruth'} and the IMU do not determine the "
            f"orientation (standard deviation {math.degrees(math.sqrt(variance)):.2g} deg); "
            "examine it without --imu"
        )

    def states(seconds: Floats) -> tuple[Floats | Indices, ...]:
        result = rig_at(seconds, steps, fit.motions, rig)
        rotated = world_from_body_rotations(covariances[result.knots], result.rotations)
        quaternions = lie.from_matrices(result.rotations)
        return result.positions, quaternions, result.velocities, rig.biases[result.knots], rotated

    positions, quaternions, velocities, biases, rotated = lie.by_blocks(states, seconds[within])
    return Trajectory(
        stamps[within],
        positions,
        quaternions,
        velocities=velocities,
        gyroscope_biases=biases[:, :3],
        accelerometer_biases=biases[:, 3:],
        covariances=rotated,
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
    result: Stamps = np.unique(np.concatenate([stamps, *bridges]))
    return result
