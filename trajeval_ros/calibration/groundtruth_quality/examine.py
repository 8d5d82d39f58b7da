"""The examination of a groundtruth, alone or with an IMU, and its repair."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.calibration.groundtruth_quality import quality_causes, start
from trajeval_ros.calibration.groundtruth_quality.inertial_steps import InertialSteps
from trajeval_ros.calibration.groundtruth_quality.joint_fit import (
    LEVER_M,
    Horizon,
    HorizonFit,
    JointFit,
)
from trajeval_ros.calibration.groundtruth_quality.quality_causes import (
    HALF_WIDTH,
    PARAMETERS,
    GroundtruthCause,
)
from trajeval_ros.calibration.groundtruth_quality.repair import repaired
from trajeval_ros.calibration.groundtruth_quality.rig import (
    BODY,
    CLOCK,
    GRAVITY,
    LEVER,
    OFFSET,
    UNITS,
    Rig,
)
from trajeval_ros.calibration.groundtruth_quality.sample_checks import (
    PoseChecks,
    ResidualChecks,
    check_poses,
    check_residuals,
    spans_of,
)  # fmt: skip
from trajeval_ros.calibration.significance import SIGNIFICANT
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Booleans, Floats, runs_of
from trajeval_ros.geometry.inertial import ImuNoise, InertialReadings
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.discontinuities.events import GROUNDTRUTH
from trajeval_ros.metrics.discontinuities.recorded import stream_discontinuities

# Effective densities: those of data sheets are too small on real recordings (vibration, scale).
IMU_NOISE = ImuNoise(8e-4, 2e-2)
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
_LIKELY_SIGMAS = np.sqrt(2.0)  # Akaike: a smaller value is better left at zero
_SLOW_HZ = 50.0
_SMOOTH_M = 2e-5  # a smaller high-frequency noise is that of a model


@dataclass(frozen=True, eq=False)
class Fits:
    """The results of an examination with an IMU."""

    short: HorizonFit  # the fit in which an interval of the IMU counts over 0.1 s
    long: HorizonFit  # the fit in which it counts over 2 s
    disagree: bool  # whether they differ; then rotation and lever arm are those of `long`
    rig: Rig  # states and calibration, with insignificant parameters at zero
    hand_eye_covariance: Floats  # (6, 6), position first (m^2), rotation about I's axes (rad^2)
    position_noise_m: float  # robust standard deviation of a pose's position per axis
    rotation_noise_rad: float | None  # the same of its rotation
    checks: ResidualChecks  # faults that the residuals show
    # Poses, velocities and biases of the IMU by its clock. The covariances are lower limits: an
    # IMU does not reveal errors of a groundtruth that last for over a second.
    repaired: Trajectory

    @property
    def hand_eye(self) -> HandEye:
        """T_I_M, the pose of the groundtruth's body in the IMU."""
        return HandEye(lie.from_matrix(self.rig.body), self.rig.lever)


@dataclass(frozen=True, eq=False)
class ExaminedGroundtruth:
    """The verdicts on a groundtruth."""

    causes: dict[str, GroundtruthCause]  # by name, in the order of the table
    poses: PoseChecks  # faults of the poses alone
    fits: Fits | None  # the results with an IMU; None without one
    notes: tuple[str, ...]  # limits of the examination, one sentence per limit

    @property
    def significant(self) -> list[GroundtruthCause]:
        """The causes that the recording shows."""
        return [cause for cause in self.causes.values() if cause.verdict == SIGNIFICANT]


def examine(
    groundtruth: Trajectory,
    readings: InertialReadings | None = None,
    *,
    imu_noise: ImuNoise = IMU_NOISE,
    time_offset_s: float | None = None,
) -> ExaminedGroundtruth:
    """Return the verdicts on a groundtruth and, with an IMU of the same rig, its repair.

    Args:
        groundtruth: Poses in order of arrival.
        readings: Readings of the IMU; None for the checks of the poses alone.
        imu_noise: Effective noise densities of the IMU over 0.1 s.
        time_offset_s: Approximate offset to add to the groundtruth's timestamps, s; None to
            estimate it from the turn rates.

    Raises:
        SettingsError: The time offset is not finite.
        InputError: There are too few poses, the recordings overlap for less than 20 s, or their
            rotations are not related.
    """
    name = groundtruth.name or "the groundtruth"
    if not groundtruth.reading.stamped:
        raise InputError(f"{name} has no timestamps; give a groundtruth with timestamps")
    if len(groundtruth.in_order()) < 5:
        raise InputError(f"{name} has fewer than five poses; give a longer groundtruth")
    if time_offset_s is not None and not math.isfinite(time_offset_s):
        raise SettingsError(f"the time offset is {time_offset_s:g} s; give a finite number")
    first = int(groundtruth.stamps.min())
    if readings is None:
        checks = check_poses(groundtruth, None, first)
        events = stream_discontinuities(groundtruth, GROUNDTRUTH)
        causes = [
            *quality_causes.discontinuity_causes(events, first),
            *quality_causes.sample_causes(checks, None, first),
        ]
        by_name = {cause.name: cause for cause in causes}
        return ExaminedGroundtruth(by_name, checks, None, tuple(_notes(checks, groundtruth)))
    return _with_imu(groundtruth, readings, imu_noise, time_offset_s)


def _with_imu(
    groundtruth: Trajectory,
    readings: InertialReadings,
    imu_noise: ImuNoise,
    time_offset_s: float | None,
) -> ExaminedGroundtruth:
    ordered = groundtruth.in_order()
    case = start.prepared(ordered, readings, time_offset_s)
    short, long, lasting = _two_fits(case, imu_noise)
    brief = short.summary()
    result, disagree = _combined(case, brief, lasting)
    poses = check_poses(groundtruth, case.imu, case.imu.origin - case.shift_ns)
    residuals = check_residuals(short, ordered.stamps)
    causes = [
        *quality_causes.parameter_causes(result, case.free),
        quality_causes.fused_cause(brief, lasting, disagree=disagree),
        *quality_causes.sample_causes(poses, residuals, int(ordered.stamps[0])),
    ]
    by_name, scale = {cause.name: cause for cause in causes}, 1.0
    (noise_m, noise_rad), chosen = short.rows.scales, long if disagree else short
    _apply(chosen, short, by_name, _noisy(case, result))
    if not case.samples.has_rotations:
        by_name |= {item.name: item for item in quality_causes.OF_ROTATION}
        scale = float(np.median(np.square(result.sigmas[case.free] / brief.sigmas[case.free])))
    rig = chosen.rig
    fits = Fits(
        brief,
        lasting,
        disagree,
        replace(rig, offset_s=rig.shift_s + rig.offset_s, shift_s=0.0),
        _hand_eye_covariance(rig.body, result),
        noise_m,
        noise_rad if case.samples.has_rotations else None,
        residuals,
        repaired(chosen, ordered, poses.gaps, scale),
    )
    notes = [*case.notes, *_notes_on_imu(case), *_notes(poses, groundtruth)]
    if brief.fixed_axes:
        notes.append(
            f"the motion does not determine the lever arm along {brief.fixed_axes}: the repaired "
            "groundtruth has the groundtruth's point there"
        )
    notes += [
        f"{kind} noise is not white: it has more than 20 steps per minute"
        for kind in residuals.noisy_steps
    ]
    return ExaminedGroundtruth(by_name, poses, fits, tuple(notes))


def _two_fits(case: start.Prepared, noise: ImuNoise) -> tuple[JointFit, JointFit, HorizonFit]:
    """Return the fits over 0.1 s and over 2 s, and the summary of the second."""
    if not case.imu.accelerations.any():
        noise = replace(noise, accelerometer=_GYROSCOPE_ONLY)
    stiff = ImuNoise(noise.gyroscope / 4.0, noise.accelerometer / 2.0)
    long = _fitted(case, Horizon(0.1, stiff, (3e-3, 5e-3), window_s=2.0))
    lasting = long.summary()
    long.forget()
    # Over short times, noise of the attitude seems to determine the height of a car's lever arm.
    short = _fitted(case, Horizon(0.05, noise, (1e-3, 3e-3), fixed=lasting.fixed_directions))
    return short, long, lasting


def _fitted(case: start.Prepared, horizon: Horizon) -> JointFit:
    knots = start.knots_of(case.samples, case.imu, horizon.knot_s)
    lasts_s = float(knots[-1] - knots[0]) if len(knots) else 0.0
    if lasts_s < _OVERLAP_S:
        raise InputError(
            f"groundtruth and IMU overlap for {lasts_s:.1f} s, and the examination needs "
            f"{_OVERLAP_S:g} s; give longer recordings, or the clocks' difference as --time-offset"
        )
    rig = replace(
        start.first_rig(case.samples, case.imu, knots), shift_s=case.shift_ns / NANOSECONDS
    )
    fit = JointFit(case.samples, InertialSteps(knots, case.imu), rig, horizon, case.free)
    fit.solve(_ITERATIONS)
    fit.fix_unobservable_lever()
    return fit


def _combined(
    case: start.Prepared, short: HorizonFit, long: HorizonFit
) -> tuple[HorizonFit, bool]:
    """Return what both fits measure, and whether they disagree.

    Standard deviations contain the errors that one recording does not reveal.
    """
    apart, disagree = _difference(short, long)
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
    return replace(short, values=values, sigmas=np.hypot(sigmas, floors)), disagree


def _difference(short: HorizonFit, long: HorizonFit) -> tuple[Floats, bool]:
    """Return the differences of both horizons (6,), deg and mm, and whether they disagree."""
    apart = np.abs(long.values - short.values)[:6]
    for direction in short.fixed_directions:  # they contain those of the long fit
        apart[LEVER] = np.abs(apart[LEVER] - direction * (direction @ apart[LEVER]))
    one, other = so3.exp(np.stack([short.values[BODY], long.values[BODY]]) / UNITS[BODY])
    apart[BODY] = np.abs(so3.log((one.T @ other)[None])[0] * UNITS[BODY])
    limit = _DISAGREE_SIGMAS * np.hypot(short.sigmas, long.sigmas)[:6]
    return apart, bool(((apart > _DISAGREE) & (apart > limit)).any())


def _noisy(case: start.Prepared, result: HorizonFit) -> Booleans:
    """Return which parameters (10,) are more probably zero than their values.

    Parts of the body's rotation are not applied alone.
    """
    limits = np.full(len(UNITS), _LIKELY_SIGMAS)
    # Along gravity, the lever arm's error is mainly that of the accelerometer's scale.
    limits[LEVER][np.abs(case.imu.accelerations.mean(axis=0)).argmax()] = HALF_WIDTH
    if not case.samples.has_rotations:
        limits[CLOCK] = HALF_WIDTH
    ratios = np.abs(result.values) / result.sigmas
    ratios[BODY] = np.sqrt(np.square(ratios[BODY]).mean())
    return np.asarray((ratios < limits) | ~case.free)


def _apply(
    chosen: JointFit, short: JointFit, causes: dict[str, GroundtruthCause], noisy: Booleans
) -> None:
    """Solve again with `noisy` parameters at zero, and the clock of the short fit.

    A significant lever arm is applied whole. Inconclusive rotations and lever arms are at zero:
    along the vertical of a car it can be wrong by 0.1 m. The tilt is not applied: the repaired
    groundtruth is in the groundtruth's world.
    """
    free, rig, fixed = chosen.free.copy(), chosen.rig, noisy.copy()
    fixed[GRAVITY] = False
    fixed[LEVER] &= causes["lever_arm"].verdict != SIGNIFICANT
    for name in ("body_rotation", "lever_arm"):
        fixed[PARAMETERS[name].columns] |= causes[name].verdict == quality_causes.INCONCLUSIVE
    if chosen is not short:
        rig = replace(rig, offset_s=short.rig.offset_s, skew=short.rig.skew)
        free[CLOCK] = False
    chosen.solve_again(rig.without(fixed), free & ~fixed)


def _hand_eye_covariance(body: Floats, result: HorizonFit) -> Floats:
    """Return the covariance (6, 6) of T_I_M; along fixed directions it is that of the prior."""
    covariance = np.diag(np.square(np.roll(result.sigmas[:6] / UNITS[:6], 3)))
    covariance[:3, :3] += sum(
        LEVER_M**2 * np.outer(fixed_direction, fixed_direction)
        for fixed_direction in result.fixed_directions
    )
    covariance[3:, 3:] = body @ covariance[3:, 3:] @ body.T
    return covariance


def _notes_on_imu(case: start.Prepared) -> Iterator[str]:
    stamps = np.rint(case.imu.seconds * NANOSECONDS).astype(np.int64)
    first_ns = round(case.samples.seconds[0] * NANOSECONDS)
    for what, steps in (("gap", case.imu.gaps), ("saturated interval", case.imu.saturated)):
        if steps.any():
            spans = spans_of(stamps, runs_of(steps))
            yield f"the IMU has {quality_causes.longest_of(spans, what, first_ns)[:-1]}"


def _notes(poses: PoseChecks, groundtruth: Trajectory) -> list[str]:
    notes = [*groundtruth.reading.messages(Level.WARNING)]
    if poses.position_noise_m < _SMOOTH_M:
        notes.append(
            f"the groundtruth is smooth (noise {1e6 * poses.position_noise_m:.2g} um): short "
            "relative errors compare with a model and not with measurements"
        )
    if poses.rate_hz < _SLOW_HZ:
        notes.append(f"at {poses.rate_hz:.0f} Hz, the noise of a pose is an upper limit")
    return notes
