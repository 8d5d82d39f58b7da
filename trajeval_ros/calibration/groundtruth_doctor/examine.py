"""The examination of a groundtruth, alone or with an IMU, and its repair."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.calibration.groundtruth_doctor import doctor_causes
from trajeval_ros.calibration.groundtruth_doctor.doctor_causes import PARAMETERS, GroundtruthCause
from trajeval_ros.calibration.groundtruth_doctor.joint_fit import LEVER_M, HorizonFit, JointFit
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
from trajeval_ros.calibration.groundtruth_doctor.start import Prepared, prepared
from trajeval_ros.calibration.groundtruth_doctor.two_horizons import (
    Calibration,
    combined,
    two_fits,
)
from trajeval_ros.calibration.significance import SIGNIFICANT, axis_name
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, runs_of
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.preintegration import ImuNoise
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

# Effective densities: those of data sheets are too small on real recordings (vibration, scale).
IMU_NOISE = ImuNoise(8e-4, 2e-2)
_LIKELY_SIGMAS = np.sqrt(2.0)  # Akaike: a smaller value is better left at zero
_LARGEST_SIGMA_RAD = math.radians(3.0)  # of an orientation from positions
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
        causes = {each.name: each for each in doctor_causes.sample_causes(checks, None, first)}
        return ExaminedGroundtruth(causes, checks, None, tuple(_notes(checks)))
    return _with_imu(groundtruth, readings, imu_noise, time_offset_s)


def _with_imu(
    groundtruth: Trajectory,
    readings: InertialReadings,
    imu_noise: ImuNoise,
    time_offset_s: float | None,
) -> ExaminedGroundtruth:
    ordered = groundtruth.in_order()
    case = prepared(ordered, readings, time_offset_s)
    short, long, lasting = two_fits(case, imu_noise)
    brief = short.summary()
    found = combined(case, brief, lasting)
    poses = check_poses(groundtruth, case.imu, case.origin)
    residuals = check_residuals(short, ordered.stamps)
    causes = _causes(case, found, brief, lasting)
    causes += doctor_causes.sample_causes(poses, residuals, int(ordered.stamps[0]))
    by_name = {each.name: each for each in causes}
    noise_m, noise_rad = short.rows.scales
    chosen, scale = long if found.disagree else short, 1.0
    _apply(chosen, short, by_name, _noisy(case, found))
    if not case.samples.has_rotations:
        by_name |= {each.name: each for each in doctor_causes.OF_ROTATION}
        scale = float(np.median(np.square(found.sigmas[case.free] / brief.sigmas[case.free])))
    fits = Fits(
        brief,
        lasting,
        found.disagree,
        replace(chosen.rig, offset_s=case.shift_s + chosen.rig.offset_s, shift_s=0.0),
        _hand_eye_covariance(chosen.rig, found.sigmas, brief),
        noise_m,
        noise_rad if case.samples.has_rotations else None,
        residuals,
        repaired(chosen, ordered, poses.gaps, scale),
    )
    _refuse_open_orientations(case, fits.repaired)
    notes = [*case.notes, *_notes_on_imu(case), *_notes(poses)]
    if brief.fixed_directions:
        notes.append(
            f"the motion does not determine the lever arm along {_axes(brief)}: the repaired "
            "groundtruth has the groundtruth's point there"
        )
    for kind in residuals.noisy_steps:
        notes.append(f"{kind} noise is not white: it has more than 20 steps per minute")
    return ExaminedGroundtruth(by_name, poses, fits, tuple(notes))


def _causes(
    case: Prepared, found: Calibration, brief: HorizonFit, lasting: HorizonFit
) -> list[GroundtruthCause]:
    """Return the verdicts on the calibration."""
    causes = [
        doctor_causes.parameter_cause(each, found.values, found.sigmas, case.free, _axes(brief))
        for each in PARAMETERS
    ]
    short_deg, long_deg = (float(np.linalg.norm(each.values[BODY])) for each in (brief, lasting))
    slow_deg = float(np.degrees(np.linalg.norm(lasting.noise[3:])))
    return [
        *causes,
        doctor_causes.fused_cause(short_deg, long_deg, slow_deg, disagree=found.disagree),
    ]


def _axes(fit: HorizonFit) -> str:
    return " and ".join(map(axis_name, fit.fixed_directions))


def _noisy(case: Prepared, found: Calibration) -> Booleans:
    """Return which parameters (10,) are more probably zero than their values.

    Parts of the body's rotation are not applied alone.
    """
    limits = np.full(len(UNITS), _LIKELY_SIGMAS)
    # Along gravity, the lever arm's error is mainly that of the accelerometer's scale.
    limits[LEVER][np.abs(case.imu.accelerations.mean(axis=0)).argmax()] = doctor_causes.HALF_WIDTH
    if not case.samples.has_rotations:
        limits[[OFFSET, SKEW]] = doctor_causes.HALF_WIDTH
    ratios = np.abs(found.values) / found.sigmas
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
        fixed[PARAMETERS[name].columns] |= causes[name].verdict == doctor_causes.INCONCLUSIVE
    if chosen is not short:
        rig = replace(rig, offset_s=short.rig.offset_s, skew=short.rig.skew)
        free[[OFFSET, SKEW]] = False
    chosen.solve_again(rig.without(fixed), free & ~fixed)


def _hand_eye_covariance(rig: Rig, sigmas: Floats, brief: HorizonFit) -> Floats:
    """Return the covariance (6, 6) of T_I_M; along fixed directions it is that of the prior."""
    covariance = np.diag(np.square(np.roll(sigmas[:6] / UNITS[:6], 3)))
    for each in brief.fixed_directions:
        covariance[:3, :3] += LEVER_M**2 * np.outer(each, each)
    covariance[3:, 3:] = rig.body @ covariance[3:, 3:] @ rig.body.T
    return covariance


def _refuse_open_orientations(case: Prepared, repaired: Trajectory) -> None:
    assert repaired.covariances is not None
    variance = float(np.median(np.einsum("nii->n", repaired.covariances[:, 3:, 3:])))
    if not case.samples.has_rotations and variance > _LARGEST_SIGMA_RAD**2:
        raise InputError(
            f"{repaired.name or 'the groundtruth'} and the IMU do not determine the orientation "
            f"(standard deviation {math.degrees(math.sqrt(variance)):.2g} deg); examine it "
            "without --imu"
        )


def _notes_on_imu(case: Prepared) -> Iterator[str]:
    stamps = np.rint(case.imu.seconds * NANOSECONDS).astype(np.int64)
    first_ns = round(case.samples.seconds[0] * NANOSECONDS)
    for what, steps in (("gap", case.imu.gaps), ("saturated interval", case.imu.saturated)):
        if steps.any():
            spans = spans_of(stamps, runs_of(steps))
            yield f"the IMU has {doctor_causes.longest_of(spans, what, first_ns)[:-1]}"


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
