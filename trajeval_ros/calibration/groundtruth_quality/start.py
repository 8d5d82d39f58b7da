"""The start of an examination: checks of its input, clock, body rotation, and first states."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.clock_offset import SEARCH_S, OffsetGuess, guess_offset_by
from trajeval_ros.calibration.groundtruth_quality.inertial_steps import (
    ImuSeconds,
    turns_about_one_axis,
)
from trajeval_ros.calibration.groundtruth_quality.rig import BODY, GRAVITY, LEVER, SKEW, UNITS, Rig
from trajeval_ros.calibration.groundtruth_quality.sample_rows import TruthSamples
from trajeval_ros.calibration.hand_eye import closest_rotation, robust_rotation
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.inertial import InertialReadings, rotations_by_gyro
from trajeval_ros.geometry.interpolation import columns_at, slerp_at
from trajeval_ros.geometry.se3 import times
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

_CERTAIN_CORRELATION = 0.95
_IN_PLACE_M = 0.3
_LIGHTEST_MPS2, _HEAVIEST_MPS2 = 5.0, 20.0
_INCREMENT_S = 0.25
_PASSES = 6
_LITTLE = 0.05  # weight of swings relative to that of turns about their axis
_SWING_S, _WINDOW_S = (-0.25, 0.25), 5.0
_SPEED_S = 0.1  # half of the span over which a velocity is a difference of positions
_INSIDE_S = 0.1  # between the ends of the recordings and the knots
_GRAVITY_MPS2 = 9.81
# Correlation of the lengths of swings, and a ratio that no error of an accelerometer reaches.
_ALIKE, _OTHER_UNIT = 0.8, 2.0


@dataclass(frozen=True, eq=False)
class Prepared:
    """A groundtruth and an IMU, by seconds of the IMU."""

    samples: TruthSamples
    imu: ImuSeconds
    shift_ns: int  # first offset of the groundtruth's clock, which the samples have
    free: Booleans  # (10,), the parameters that sensors and motion may determine
    notes: list[str]  # on the others, one sentence each


def prepared(
    groundtruth: Trajectory, readings: InertialReadings, time_offset_s: float | None
) -> Prepared:
    """Return a groundtruth in order and an IMU by one approximate clock.

    Raises:
        InputError: Their motions are not related, or a sensor is missing.
    """
    name, imu = groundtruth.name or "the groundtruth", imu_of(readings)
    quaternions, has_rotations = groundtruth.quaternions, groundtruth.quaternions is not None
    if quaternions is None and readings.accelerations is None:
        raise InputError(f"{name} has no orientations and the IMU no accelerations; give one")
    free, notes = _determined(groundtruth, imu, has_forces=readings.accelerations is not None)
    if time_offset_s is None:
        time_offset_s = _first_offset(groundtruth, imu, name)
    shift_ns = round(time_offset_s * NANOSECONDS)
    seconds = (groundtruth.stamps + (shift_ns - imu.origin)) / NANOSECONDS
    if quaternions is None:
        quaternions = rough_orientations(seconds, groundtruth.positions, imu)
    samples = TruthSamples(seconds, groundtruth.positions, quaternions, has_rotations)
    _require_metres(samples, imu, name)
    return Prepared(samples, imu, shift_ns, free, notes)


def imu_of(readings: InertialReadings) -> ImuSeconds:
    """Return the readings by time, in seconds since the first one."""
    name, accelerations = readings.source or "the IMU", readings.accelerations
    stamps, rows = np.unique(readings.stamps, return_index=True)
    if len(stamps) < 2:
        raise InputError(f"{name} has fewer than two readings")
    if accelerations is None:
        accelerations = np.zeros_like(readings.rates)
    else:
        usual = float(np.median(np.linalg.norm(accelerations, axis=1)))
        if not _LIGHTEST_MPS2 < usual < _HEAVIEST_MPS2:
            raise InputError(
                f"{name} measures a median acceleration of {usual:.3g}, not about 9.81; give "
                "specific forces in m/s^2"
            )
    seconds = (stamps - stamps[0]) / NANOSECONDS
    return ImuSeconds(seconds, readings.rates[rows], accelerations[rows], int(stamps[0]))


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
        (imu.turns and turns_in_place(groundtruth.positions, imu.rates), slice(6),
            "the rig turns about one axis in place: rotation and lever arm are unknown"),
    ):  # fmt: skip
        if applies:
            free[columns] = False
            notes.append(note)
    return free, notes


def _first_offset(groundtruth: Trajectory, imu: ImuSeconds, name: str) -> float:
    """Return the offset of the groundtruth's clock at which the motions match, s."""
    poses = groundtruth.positions if groundtruth.quaternions is None else groundtruth.quaternions
    if imu.turns and not np.diff(poses, axis=0).any():
        kind = "positions" if groundtruth.quaternions is None else "orientations"
        raise InputError(f"all {kind} of {name} are equal, but the IMU turns; give measured ones")
    guess = guess_of(groundtruth, imu)
    # So high a correlation is not a coincidence, even if periodic motion has a second peak.
    if guess.is_usable or guess.peak > _CERTAIN_CORRELATION:
        return guess.offset_s
    if not imu.turns:
        return 0.0
    raise InputError(
        f"the motion of {name} matches that of the IMU at no single offset (correlation "
        f"{guess.peak:.2f}); use recordings of the same run, or give --time-offset"
    )


def turns_in_place(positions: Floats, rates: Floats) -> bool:
    """Return whether neither a turn about a second axis nor accelerations determine the body."""
    extent_m = float(np.linalg.norm(np.std(positions, axis=0)))
    return extent_m < _IN_PLACE_M and turns_about_one_axis(rates)


def guess_of(groundtruth: Trajectory, imu: ImuSeconds) -> OffsetGuess:
    """Return the offset of the groundtruth's clock by the correlation of turn rates or swings."""

    def at(seconds: Floats, positions: Floats, rotated: Floats | None = None) -> Trajectory:
        return Trajectory(imu.origin + np.rint(seconds * 1e9).astype(np.int64), positions, rotated)

    # Without repeated poses a frozen interval is a gap, and its end no fast turn.
    poses = groundtruth.positions if groundtruth.quaternions is None else groundtruth.quaternions
    groundtruth = groundtruth[np.asarray(np.diff(poses, axis=0, prepend=np.nan).any(axis=1))]
    own_s = (groundtruth.stamps - imu.origin) / NANOSECONDS
    meets = imu.seconds[0] < own_s[-1] and own_s[0] < imu.seconds[-1]
    search_s = SEARCH_S if meets else None  # all overlaps, for clocks of different epochs
    rotated = rotations_by_gyro(imu.seconds, imu.rates)
    if groundtruth.quaternions is None:
        signal, by_imu = "speed", at(*_swings_of(imu, rotated))
        groundtruth = at(*_swings(own_s, groundtruth.positions))
    else:
        signal, by_imu = "angular rate", at(imu.seconds, np.zeros_like(imu.rates), rotated)
    return guess_offset_by(by_imu, groundtruth, 0.0, search_s, signal)


def _swings(seconds: Floats, positions: Floats) -> tuple[Floats, Floats]:
    """Return third differences of positions (N, 3) over half a second, and their times.

    Their changes hardly depend on gravity, also if it turns slowly.
    """
    for _ in range(3):
        before, after = (columns_at(seconds, positions, seconds + item) for item in _SWING_S)
        positions = after - before
    inside = np.minimum(seconds - seconds[0], seconds[-1] - seconds) > 3.0 * _SWING_S[1]
    return seconds[inside], positions[inside]


def _swings_of(imu: ImuSeconds, rotated: Floats) -> tuple[Floats, Floats]:
    """Return the times and swings of an IMU, in the axes of its orientations (N, 4)."""
    from scipy.integrate import cumulative_trapezoid

    moved = lie.rotate(rotated, imu.accelerations)
    for _ in range(2):
        moved = cumulative_trapezoid(moved, imu.seconds, axis=0, initial=0.0)
    return _swings(imu.seconds, moved)


def _both_swings(
    seconds: Floats, positions: Floats, imu: ImuSeconds
) -> list[tuple[Floats, Floats]]:
    """Return the times and swings of positions (N, 3) and of an IMU, each in its own axes."""
    by_gyro = rotations_by_gyro(imu.seconds, imu.rates)
    return [_swings(seconds, positions), _swings_of(imu, by_gyro)]


def _require_metres(samples: TruthSamples, imu: ImuSeconds, name: str) -> None:
    """Refuse positions whose swings are clearly longer or shorter than those of the IMU."""
    begins, ends = (samples.seconds + item for item in _SWING_S)
    by_pose, by_imu = (
        np.linalg.norm(columns_at(*swing, ends) - columns_at(*swing, begins), axis=1)
        for swing in _both_swings(samples.seconds, samples.positions, imu)
    )
    if not (by_pose.any() and by_imu.any()):
        return
    ratio, alike = float(by_pose @ by_imu / (by_imu @ by_imu)), np.corrcoef(by_pose, by_imu)[0, 1]
    if alike > _ALIKE and abs(math.log(ratio)) > math.log(_OTHER_UNIT):
        raise InputError(
            f"the motion of {name} is {ratio:.3g} times that of the IMU; give positions in metres"
        )


def rough_orientations(seconds: Floats, positions: Floats, imu: ImuSeconds) -> Floats:
    """Return orientations (N, 4) of the IMU at positions (N, 3) by its clock.

    Of a few seconds, the gyroscope gives them up to the rotation between swings in both axes.
    """
    by_gyro = rotations_by_gyro(imu.seconds, imu.rates)
    by_pose, by_imu = (
        np.gradient(columns_at(*swings, seconds), axis=0)
        for swings in _both_swings(seconds, positions, imu)
    )
    count = max(1, int((seconds[-1] - seconds[0]) / _WINDOW_S))
    windows = np.array_split(np.arange(len(seconds)), count)
    rotations = np.stack([robust_rotation(by_pose[window], by_imu[window]) for window in windows])
    of_rows = np.repeat(lie.from_matrices(rotations), [len(window) for window in windows], axis=0)
    return lie.multiply(of_rows, slerp_at(imu.seconds, by_gyro, seconds))


def knots_of(samples: TruthSamples, imu: ImuSeconds, step_s: float) -> Floats:
    """Return knots (N,) inside both recordings, seconds of the IMU."""
    low = max(samples.seconds[0], imu.seconds[0]) + _INSIDE_S
    high = min(samples.seconds[-1], imu.seconds[-1]) - _INSIDE_S
    return np.arange(low, high, step_s)


def first_rig(samples: TruthSamples, imu: ImuSeconds, knots: Floats) -> Rig:
    """Return the rig at the knots (N,) from the interpolated groundtruth.

    The body's rotation is that of the increments, and without turns the identity.
    """
    body, biases = np.eye(3), np.zeros((len(knots), 6))
    if imu.turns and samples.has_rotations:
        body, biases[:, :3] = _body_and_bias(samples, imu, knots)
    rotations = lie.to_matrix(slerp_at(samples.seconds, samples.quaternions, knots)) @ body.T
    measured = columns_at(imu.seconds, imu.accelerations, knots)
    force = np.median(times(rotations, measured), axis=0)
    length = float(np.linalg.norm(force))
    up = force / length if length else np.array([0.0, 0.0, 1.0])
    before, positions, after = (
        columns_at(samples.seconds, samples.positions, knots + item)
        for item in (-_SPEED_S, 0.0, _SPEED_S)
    )
    velocities = (after - before) / (2.0 * _SPEED_S)
    return Rig(
        rotations, velocities, positions, biases, body, np.zeros(3), 0.0, 0.0,
        -_GRAVITY_MPS2 * up,
    )  # fmt: skip


def _body_and_bias(samples: TruthSamples, imu: ImuSeconds, knots: Floats) -> tuple[Floats, Floats]:
    """Return R_IM (3, 3) and the bias (3,), rad/s, from rotations over a quarter of a second."""
    ends = np.arange(knots[0], knots[-1], _INCREMENT_S)
    of_marker, of_imu = (
        lie.rotation_vector(lie.multiply(lie.conjugate(rotations[:-1]), rotations[1:]))
        for rotations in (
            slerp_at(samples.seconds, samples.quaternions, ends),
            slerp_at(imu.seconds, rotations_by_gyro(imu.seconds, imu.rates), ends),
        )
    )
    bias = np.zeros(3)
    for _ in range(_PASSES):
        body = robust_rotation(of_imu - bias * _INCREMENT_S, of_marker)
        bias = np.median(of_imu - of_marker @ body.T, axis=0) / _INCREMENT_S
    if turns_about_one_axis(imu.rates) and not turns_in_place(samples.positions, imu.rates):
        # They do not determine the angle about this axis, and swings do.
        by_swings = rough_orientations(samples.seconds, samples.positions, imu)
        apart = lie.multiply(lie.conjugate(by_swings), samples.quaternions)
        little = _LITTLE * np.square(of_imu).sum() * lie.to_matrix(apart).mean(axis=0)
        rotations = np.vstack([of_imu - bias * _INCREMENT_S, little.T])
        body = closest_rotation(rotations, np.vstack([of_marker, np.eye(3)]))
    return body, bias
