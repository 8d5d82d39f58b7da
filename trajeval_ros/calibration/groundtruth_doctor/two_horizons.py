"""Two fits, which trust the IMU over 0.1 s and over 2 s, and what they measure together.

A groundtruth that was fused with an IMU under a wrong body follows the gyroscope over short times
and the marker over long ones: the two fits disagree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.calibration.groundtruth_doctor import start
from trajeval_ros.calibration.groundtruth_doctor.inertial_steps import InertialSteps
from trajeval_ros.calibration.groundtruth_doctor.joint_fit import Horizon, HorizonFit, JointFit
from trajeval_ros.calibration.groundtruth_doctor.rig import BODY, LEVER, OFFSET, UNITS
from trajeval_ros.calibration.groundtruth_doctor.start import Prepared
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.preintegration import ImuNoise

_ITERATIONS = 14
_OVERLAP_S = 20.0
_GYROSCOPE_ONLY = 1e3  # m/s^2/sqrt(Hz), for an IMU without accelerometer
# Errors that one recording does not reveal, from differences to two published calibrations: deg,
# mm, ms, ppm, deg.
_FLOORS = np.array([0.05] * 3 + [1.0] * 4 + [20.0] + [0.07] * 2)
_FLOOR_ALONG_FORCE_MM = 3.0
_FLOOR_BY_POSITIONS_MS = 3.0  # real accelerometers differ from the gyroscope by 3 to 12 ms
# The two horizons disagree above these differences (deg, mm) and standard deviations.
_DISAGREE = np.array([1.0] * 3 + [20.0] * 3)
_DISAGREE_SIGMAS, _PART_OF_DIFFERENCE = 5.0, 4.0


@dataclass(frozen=True, eq=False)
class Calibration:
    """What both fits measure, in `UNITS`, with the errors that one recording does not reveal."""

    values: Floats  # (10,)
    sigmas: Floats  # (10,)
    disagree: (
        bool  # whether the fits differ; then rotation and lever arm are those of the long one
    )


def two_fits(case: Prepared, noise: ImuNoise) -> tuple[JointFit, JointFit, HorizonFit]:
    """Return the fits over 0.1 s and over 2 s, and the summary of the second.

    Raises:
        InputError: The recordings overlap for less than 20 s.
    """
    if not case.has_forces:
        noise = replace(noise, accelerometer=_GYROSCOPE_ONLY)
    stiff = ImuNoise(noise.gyroscope / 4.0, noise.accelerometer / 2.0)
    long = fitted(case, Horizon(0.1, stiff, (3e-3, 5e-3), window_s=2.0))
    lasting = long.summary()
    long.forget()
    # Over short times, noise of the attitude seems to determine the height of a car's lever arm.
    short = fitted(case, Horizon(0.05, noise, (1e-3, 3e-3), fixed=lasting.fixed_directions))
    return short, long, lasting


def fitted(case: Prepared, horizon: Horizon) -> JointFit:
    """Return the fit of one horizon."""
    knots = start.knots_of(case.samples, case.imu, horizon.knot_s)
    lasts_s = float(knots[-1] - knots[0]) if len(knots) else 0.0
    if lasts_s < _OVERLAP_S:
        raise InputError(
            f"groundtruth and IMU overlap for {lasts_s:.1f} s, and the examination needs "
            f"{_OVERLAP_S:g} s; give longer recordings, or the clocks' difference as --time-offset"
        )
    rig = replace(start.first_rig(case.samples, case.imu, knots), shift_s=case.shift_s)
    fit = JointFit(case.samples, InertialSteps(knots, case.imu), rig, horizon, case.free)
    fit.solve(_ITERATIONS)
    fit.fix_unobservable_lever()
    return fit


def combined(case: Prepared, short: HorizonFit, long: HorizonFit) -> Calibration:
    """Return values and standard deviations of both fits."""
    apart, disagree = difference(short, long)
    values, sigmas, floors = short.values.copy(), short.sigmas.copy(), _FLOORS.copy()
    # Scale errors of accelerometers shift the lever arm along gravity.
    force = np.mean(case.imu.accelerations, axis=0)
    along = force / max(float(np.linalg.norm(force)), 1e-9)
    floors[LEVER] = np.hypot(floors[LEVER], _FLOOR_ALONG_FORCE_MM * along)
    if disagree:
        values[:6], sigmas[:6] = long.values[:6], long.sigmas[:6]
        # The difference is a measure of the same systematic errors as the floors.
        floors[:6] = np.maximum(floors[:6], apart / _PART_OF_DIFFERENCE)
    if not case.samples.has_rotations:
        # They compare with accelerometers, whose delays and scale errors are larger than those of
        # gyroscopes, and differ by horizon.
        floors[3:] = np.maximum(floors[3:], np.abs(long.values - short.values)[3:])
        floors[OFFSET] = max(floors[OFFSET], _FLOOR_BY_POSITIONS_MS)
    return Calibration(values, np.hypot(sigmas, floors), disagree)


def difference(short: HorizonFit, long: HorizonFit) -> tuple[Floats, bool]:
    """Return the differences of both horizons (6,), deg and mm, and whether they disagree."""
    apart = np.abs(long.values - short.values)[:6]
    for direction in short.fixed_directions:  # they contain those of the long fit
        apart[LEVER] = np.abs(apart[LEVER] - direction * (direction @ apart[LEVER]))
    one, other = so3.exp(np.stack([short.values[BODY], long.values[BODY]]) / UNITS[BODY])
    apart[BODY] = np.abs(so3.log((one.T @ other)[None])[0] * UNITS[BODY])
    limit = _DISAGREE_SIGMAS * np.hypot(short.sigmas, long.sigmas)[:6]
    return apart, bool(((apart > _DISAGREE) & (apart > limit)).any())
