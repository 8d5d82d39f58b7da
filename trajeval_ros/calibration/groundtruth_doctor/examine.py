"""The examination of a groundtruth, alone or with an IMU, and its repair."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.calibration.groundtruth_doctor import start
from trajeval_ros.calibration.groundtruth_doctor.doctor_causes import (
    HALF_WIDTH,
    OF_ROTATION,
    PARAMETERS,
    GroundtruthCause,
    fused_cause,
    longest_of,
    parameter_cause,
    sample_causes,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_doctor.inertial_steps import ImuSeconds, InertialSteps
from trajeval_ros.calibration.groundtruth_doctor.joint_fit import (
    LEVER_M,
    Horizon,
    HorizonFit,
    JointFit,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_doctor.repair import repaired
from trajeval_ros.calibration.groundtruth_doctor.rig import (
    BODY,
    GRAVITY,
    LEVER,
    OFFSET,
    SKEW,
    UNITS,
    Rig,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_doctor.sample_checks import (
    PoseChecks,
    ResidualChecks,
    check_poses,
    check_residuals,
    spans_of,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_doctor.sample_rows import TruthSamples
from trajeval_ros.calibration.significance import INSIGNIFICANT, SIGNIFICANT, axis_name
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Booleans, Floats, runs_of
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.preintegration import ImuNoise
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

# Effective densities: those of data sheets are too small on real recordings (vibration, scale).
IMU_NOISE = ImuNoise(8e-4, 2e-2)
_ITERATIONS = 14
_OVERLAP_S = 20.0
_CERTAIN_CORRELATION = 0.95
_IN_PLACE_M, _SECOND_AXIS_RADPS = 0.3, 0.1
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
_CLOCK = [OFFSET, SKEW]
_LARGEST_SIGMA_RAD = math.radians(3.0)  # of an orientation from positions
_SLOW_HZ = 50.0
_SMOOTH_M = 2e-5  # a smaller high-frequency noise is that of a model
_LIGHTEST_MPS2, _HEAVIEST_MPS2 = 5.0, 20.0


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
        return [each for each in self.causes.values() if each.verdict == SIGNIFICANT]


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
        causes = {each.name: each for each in sample_causes(checks, None, first)}
        return ExaminedGroundtruth(causes, checks, None, tuple(_notes(checks)))
    return _with_imu(groundtruth, readings, imu_noise, time_offset_s)


def _with_imu(
    groundtruth: Trajectory,
    readings: InertialReadings,
    imu_noise: ImuNoise,
    time_offset_s: float | None,
) -> ExaminedGroundtruth:
    name, (imu, origin) = groundtruth.name or "the groundtruth", _imu_of(readings)
    ordered = groundtruth.in_order()
    only_positions, has_forces = ordered.quaternions is None, readings.accelerations is not None
    if not has_forces:
        imu_noise = replace(imu_noise, accelerometer=_GYROSCOPE_ONLY)
        if only_positions:
            raise InputError(f"{name} has no orientations and the IMU no accelerations; give one")
    free, notes = _determined(ordered, imu, has_forces=has_forces)
    if time_offset_s is None:
        time_offset_s = _first_offset(ordered, imu, origin, name)
    shift_ns = round(time_offset_s * NANOSECONDS)
    seconds, turned = (ordered.stamps + (shift_ns - origin)) / NANOSECONDS, ordered.quaternions
    if turned is None:
        turned = start.rough_orientations(seconds, ordered.positions, imu)
    samples = TruthSamples(seconds, ordered.positions, turned, not only_positions)
    shift_s = shift_ns / NANOSECONDS
    stiff = ImuNoise(imu_noise.gyroscope / 4.0, imu_noise.accelerometer / 2.0)
    long = _fitted(samples, imu, Horizon(0.1, stiff, (3e-3, 5e-3), 2.0), free, shift_s)
    # Over short times, noise of the attitude seems to determine the height of a car's lever arm.
    brief_horizon = Horizon(0.05, imu_noise, (1e-3, 3e-3), fixed=tuple(long.fixed_directions))
    short = _fitted(samples, imu, brief_horizon, free, shift_s)
    poses = check_poses(groundtruth, imu, origin - shift_ns)
    residuals = check_residuals(short, ordered.stamps)
    brief, lasting = short.summary(), long.summary()
    values, sigmas, disagree = _combined(short, long, brief, lasting, imu)
    axes = " and ".join(map(axis_name, short.fixed_directions))
    short_deg, long_deg = (float(np.linalg.norm(each.values[BODY])) for each in (brief, lasting))
    slow_deg = float(np.degrees(np.linalg.norm(long.sigmas[3:])))
    causes = [parameter_cause(each, values, sigmas, free, axes) for each in PARAMETERS]
    causes.append(fused_cause(short_deg, long_deg, slow_deg, disagree=disagree))
    causes += sample_causes(poses, residuals, int(ordered.stamps[0]))
    by_name = {each.name: each for each in causes}
    limits, scale = np.full(len(values), _LIKELY_SIGMAS), 1.0
    # Along gravity, the lever arm's error is mainly that of the accelerometer's scale.
    limits[LEVER][np.abs(imu.accelerations.mean(axis=0)).argmax()] = HALF_WIDTH
    if only_positions:
        by_name |= {each.name: each for each in OF_ROTATION}
        scale = float(np.median(np.square(sigmas[free] / brief.sigmas[free])))
        limits[_CLOCK] = HALF_WIDTH
    noise_m, noise_rad = short.rows.scales
    chosen = long if disagree else short
    _apply(chosen, short, by_name, np.abs(values) < limits * sigmas)
    rig = chosen.rig
    covariance = np.diag(np.square(np.roll(sigmas[:6] / UNITS[:6], 3)))
    for each in short.fixed_directions:
        covariance[:3, :3] += LEVER_M**2 * np.outer(each, each)
    covariance[3:, 3:] = rig.body @ covariance[3:, 3:] @ rig.body.T
    fits = Fits(
        brief,
        lasting,
        disagree,
        replace(rig, offset_s=shift_s + rig.offset_s, shift_s=0.0),
        covariance,
        noise_m,
        None if only_positions else noise_rad,
        residuals,
        repaired(chosen, ordered, poses.gaps, scale),
    )
    assert fits.repaired.covariances is not None
    variance = float(np.median(np.einsum("nii->n", fits.repaired.covariances[:, 3:, 3:])))
    if only_positions and variance > _LARGEST_SIGMA_RAD**2:
        raise InputError(
            f"{name} and the IMU do not determine the orientation (standard deviation "
            f"{math.degrees(math.sqrt(variance)):.2g} deg); examine it without --imu"
        )
    stamps, first_ns = np.rint(imu.seconds * NANOSECONDS).astype(np.int64), round(seconds[0] * 1e9)
    for what, steps in (("gap", imu.gaps), ("saturated interval", imu.saturated)):
        if steps.any():
            spans = spans_of(stamps, runs_of(steps))
            notes.append(f"the IMU has {longest_of(spans, what, first_ns)[:-1]}")
    notes += _notes(poses)
    if axes:
        notes.append(
            f"the motion does not determine the lever arm along {axes}: the repaired groundtruth "
            "has the groundtruth's point there"
        )
    for kind in residuals.noisy_steps:
        notes.append(f"{kind} noise is not white: it has more than 20 steps per minute")
    return ExaminedGroundtruth(by_name, poses, fits, tuple(notes))


def _determined(
    groundtruth: Trajectory, imu: ImuSeconds, *, has_forces: bool
) -> tuple[Booleans, list[str]]:
    """Return the parameters (10,) that sensors and motion may determine, and notes on others."""
    free, notes = np.ones(len(UNITS), dtype=bool), []
    for applies, columns, note in (
        (not has_forces, np.r_[LEVER, GRAVITY],
            "no accelerometer: lever arm and tilt are unknown"),
        (groundtruth.quaternions is None, BODY,
            "the groundtruth has no orientations: errors of rotation are unobservable, and the "
            "repaired orientations are from the IMU and the positions"),
        (not imu.turns, slice(SKEW + 1),
            "the rig does not turn: rotation, lever arm and clock are unknown"),
        (imu.turns and _turns_in_place(groundtruth.positions, imu.rates), slice(6),
            "the rig turns about one axis in place: rotation and lever arm are unknown"),
    ):  # fmt: skip
        if applies:
            free[columns] = False
            notes.append(note)
    return free, notes


def _first_offset(groundtruth: Trajectory, imu: ImuSeconds, origin: int, name: str) -> float:
    """Return the offset of the groundtruth's clock at which the motions match, s."""
    poses = groundtruth.positions if groundtruth.quaternions is None else groundtruth.quaternions
    if imu.turns and not np.diff(poses, axis=0).any():
        kind = "positions" if groundtruth.quaternions is None else "orientations"
        raise InputError(f"all {kind} of {name} are equal, but the IMU turns; give measured ones")
    guess = start.guess_of(groundtruth, imu, origin)
    # So high a correlation is not a coincidence, even if periodic motion has a second peak.
    if guess.is_usable or guess.peak > _CERTAIN_CORRELATION:
        return guess.offset_s
    if not imu.turns:
        return 0.0
    raise InputError(
        f"the motion of {name} matches that of the IMU at no single offset (correlation "
        f"{guess.peak:.2f}); use recordings of the same run, or give --time-offset"
    )


def _turns_in_place(positions: Floats, rates: Floats) -> bool:
    """Return whether neither a turn about a second axis nor accelerations determine the body."""
    extent_m = float(np.linalg.norm(np.std(positions, axis=0)))
    deviations = np.linalg.eigvalsh(np.cov(rates.T))
    return extent_m < _IN_PLACE_M and float(deviations[1]) < _SECOND_AXIS_RADPS**2


def _imu_of(readings: InertialReadings) -> tuple[ImuSeconds, int]:
    """Return the readings by time, and the timestamp of their second 0."""
    stamps, rows = np.unique(readings.stamps, return_index=True)
    if len(stamps) < 2:
        raise InputError(f"{readings.source or 'the IMU'} has fewer than two readings")
    accelerations = readings.accelerations
    if accelerations is None:
        accelerations = np.zeros_like(readings.rates)
    else:
        usual = float(np.median(np.linalg.norm(accelerations, axis=1)))
        if not _LIGHTEST_MPS2 < usual < _HEAVIEST_MPS2:
            raise InputError(
                f"{readings.source or 'the IMU'} measures a median acceleration of {usual:.3g}, "
                "not about 9.81; give specific forces in m/s^2"
            )
    origin = int(stamps[0])
    seconds = (stamps - origin) / NANOSECONDS
    return ImuSeconds(seconds, readings.rates[rows], accelerations[rows]), origin


def _fitted(
    samples: TruthSamples, imu: ImuSeconds, horizon: Horizon, free: Booleans, shift_s: float
) -> JointFit:
    knots = start.knots_of(samples, imu, horizon.knot_s)
    lasts_s = float(knots[-1] - knots[0]) if len(knots) else 0.0
    if lasts_s < _OVERLAP_S:
        raise InputError(
            f"groundtruth and IMU overlap for {lasts_s:.1f} s, and the examination needs "
            f"{_OVERLAP_S:g} s; give longer recordings, or the clocks' difference as --time-offset"
        )
    rig = replace(start.first_rig(samples, imu, knots), shift_s=shift_s)
    fit = JointFit(samples, InertialSteps(knots, imu), rig, horizon, free)
    fit.solve(_ITERATIONS)
    fit.fix_unobservable_lever()
    return fit


def _combined(
    short: JointFit, long: JointFit, brief: HorizonFit, lasting: HorizonFit, imu: ImuSeconds
) -> tuple[Floats, Floats, bool]:
    """Return values and standard deviations (10,) of two fits, and whether they disagree.

    They are in `UNITS`, and contain the errors that one recording does not reveal. `brief` and
    `lasting` are the summaries of the fits.
    """
    apart, disagree = _difference(short, long, brief, lasting)
    values, sigmas, floors = brief.values.copy(), brief.sigmas.copy(), _FLOORS.copy()
    # Scale errors of accelerometers shift the lever arm along gravity.
    force = np.mean(imu.accelerations, axis=0)
    along = force / max(float(np.linalg.norm(force)), 1e-9)
    floors[LEVER] = np.hypot(floors[LEVER], _FLOOR_ALONG_FORCE_MM * along)
    if disagree:
        values[:6], sigmas[:6] = lasting.values[:6], lasting.sigmas[:6]
        # The difference is a measure of the same systematic errors as the floors.
        floors[:6] = np.maximum(floors[:6], apart / _PART_OF_DIFFERENCE)
    if not short.samples.has_rotations:
        # They compare with accelerometers, whose delays and scale errors are larger than those of
        # gyroscopes, and differ by horizon.
        floors[3:] = np.maximum(floors[3:], np.abs(lasting.values - brief.values)[3:])
        floors[OFFSET] = max(floors[OFFSET], _FLOOR_BY_POSITIONS_MS)
    return values, np.hypot(sigmas, floors), disagree


def _difference(
    short: JointFit, long: JointFit, brief: HorizonFit, lasting: HorizonFit
) -> tuple[Floats, bool]:
    """Return the differences of both horizons (6,), deg and mm, and whether they disagree."""
    apart = np.abs(lasting.values - brief.values)[:6]
    for direction in (*short.fixed_directions, *long.fixed_directions):
        apart[LEVER] = np.abs(apart[LEVER] - direction * (direction @ apart[LEVER]))
    turned = so3.log((short.rig.body.T @ long.rig.body)[None])[0]
    apart[BODY] = np.abs(np.degrees(turned))
    limit = _DISAGREE_SIGMAS * np.hypot(brief.sigmas, lasting.sigmas)[:6]
    return apart, bool(((apart > _DISAGREE) & (apart > limit)).any())


def _apply(
    chosen: JointFit,
    short: JointFit,
    causes: Mapping[str, GroundtruthCause],
    noisy: Booleans,
) -> None:
    """Solve again with insignificant parameters at zero, and the clock of the short fit.

    Components of the clock and of an insignificant lever arm are at zero only if they are `noisy`.
    An inconclusive one is at zero: along the vertical of a car it can be wrong by 0.1 m.
    """
    free, rig = chosen.free.copy(), chosen.rig
    fixed = np.zeros(len(UNITS), dtype=bool)
    for name, parameter in PARAMETERS.items():
        if name != "tilted":
            fixed[parameter.columns] = causes[name].verdict != SIGNIFICANT
    fixed[_CLOCK] = (noisy | ~free)[_CLOCK]
    if causes["lever_arm"].verdict == INSIGNIFICANT:
        fixed[LEVER] = noisy[LEVER]
    if chosen is not short:
        rig = replace(rig, offset_s=short.rig.offset_s, skew=short.rig.skew)
        free[_CLOCK] = False
    chosen.solve_again(rig.without(fixed), free & ~fixed)


def _notes(poses: PoseChecks) -> list[str]:
    notes = []
    if poses.position_noise_m < _SMOOTH_M:
        notes.append(
            f"the groundtruth is smooth (noise {1e6 * poses.position_noise_m:.2g} um): short "
            "relative errors compare with a model and not with measurements"
        )
    if poses.rate_hz < _SLOW_HZ:
        notes.append(f"at {poses.rate_hz:.0f} Hz, the noise of a pose is an upper limit")
    return notes
