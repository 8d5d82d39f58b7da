"""The examination of a groundtruth: verdicts, coverage, repair, refusals and real recordings."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examined_rigs import START_NS, ExaminedRig, real, reference, rig
from scipy.spatial.transform import Rotation

from trajeval_ros import InputError, Trajectory
from trajeval_ros.calibration.groundtruth_quality.examine import ExaminedGroundtruth, Fits, examine
from trajeval_ros.geometry.inertial import InertialReadings

FAULTS: dict[str, Any] = {
    "turn_deg": (3.0, -2.0, 1.5), "lever_m": (0.05, -0.03, 0.02), "offset_s": 0.012,
    "skew": 3e-4, "tilt_deg": 1.5,
}  # fmt: skip
CALIBRATION = ("body_rotation", "lever_arm", "clock_offset", "clock_skew", "tilted")


def fits_of(outcome: ExaminedGroundtruth) -> Fits:
    assert outcome.fits is not None
    return outcome.fits


def examined(made: ExaminedRig, **more: Any) -> ExaminedGroundtruth:
    return examine(made.groundtruth, made.readings, **more)


def positions_of(made: ExaminedRig) -> Trajectory:
    return dataclasses.replace(made.groundtruth, quaternions=None)


def verdicts(outcome: ExaminedGroundtruth) -> dict[str, str]:
    return {name: outcome.causes[name].verdict for name in CALIBRATION}


@pytest.fixture(scope="module")
def healthy() -> tuple[ExaminedRig, ExaminedGroundtruth]:
    made = rig(1)
    return made, examined(made)


@pytest.fixture(scope="module")
def faulty() -> tuple[ExaminedRig, ExaminedGroundtruth]:
    made = rig(2, **FAULTS)
    return made, examined(made)


def test_a_healthy_groundtruth_has_no_cause(
    healthy: tuple[ExaminedRig, ExaminedGroundtruth],
) -> None:
    made, result = healthy
    assert result.significant == []
    fits = fits_of(result)
    assert not fits.disagree
    # The fit takes a part of the noise: less than a tenth.
    assert fits.position_noise_m == pytest.approx(5e-4, rel=0.1)
    assert fits.rotation_noise_rad == pytest.approx(2e-3, rel=0.1)
    assert result.poses.position_noise_m == pytest.approx(5e-4, rel=0.1)
    # Insignificant parameters are not applied: timestamps and points are those of the input.
    assert set(fits.repaired.stamps.tolist()) <= set(made.groundtruth.stamps.tolist())
    assert not fits.hand_eye.lever_m.any()
    assert fits.hand_eye.rotation_xyzw.tolist() == [0.0, 0.0, 0.0, 1.0]
    position_m, rotation_rad = made.errors(fits.repaired)
    assert position_m < 5e-4 * np.sqrt(3.0)  # below the noise of the input
    assert rotation_rad < 0.5 * 2e-3 * np.sqrt(3.0)


def test_faults_are_significant_and_within_their_intervals(
    faulty: tuple[ExaminedRig, ExaminedGroundtruth],
) -> None:
    _, result = faulty
    assert set(verdicts(result).values()) == {"significant"}
    expected = {
        "body_rotation": FAULTS["turn_deg"], "lever_arm": np.multiply(1e3, FAULTS["lever_m"]),
        "clock_offset": [12.0], "clock_skew": [300.0],
    }  # fmt: skip
    for name, values in expected.items():
        cause = result.causes[name]
        assert cause.half_width is not None
        apart = np.linalg.norm(np.subtract(cause.components, values))
        assert apart < 2.0 * cause.half_width, name
    assert result.causes["tilted"].value == pytest.approx(1.5, abs=0.16)
    text = " ".join(item.sentence for item in result.significant)
    assert "early: add 12.0 ms" in text
    assert "ppm" in text
    assert "z axis is tilted by 1.5" in text


def test_the_repaired_groundtruth_is_of_the_imu(
    faulty: tuple[ExaminedRig, ExaminedGroundtruth],
) -> None:
    made, result = faulty
    repaired = fits_of(result).repaired
    assert repaired.rotations is not None
    # In the tilted world of the groundtruth.
    level = Rotation.from_rotvec([-FAULTS["tilt_deg"], 0.0, 0.0], degrees=True)
    rotated = level * repaired.rotations
    in_world = dataclasses.replace(
        repaired, positions=level.apply(repaired.positions), quaternions=rotated.as_quat()
    )
    position_m, rotation_rad = made.errors(in_world)
    lever_mm, rotation_deg = (
        result.causes[name].half_width for name in ("lever_arm", "body_rotation")
    )
    assert lever_mm is not None
    assert rotation_deg is not None
    assert 1e3 * position_m < 0.5 * lever_mm
    assert np.degrees(rotation_rad) < 0.5 * rotation_deg
    assert repaired.covariances is not None
    assert np.linalg.eigvalsh(repaired.covariances).min() > 0.0
    assert repaired.velocities is not None
    seconds = (repaired.stamps - START_NS) / 1e9
    speeds = level.apply(repaired.velocities) - made.motion.waves(seconds, 1)[:, :3]
    assert np.sqrt(np.square(speeds).sum(axis=1).mean()) < 0.02


@pytest.fixture(scope="module")
def positions_alone() -> tuple[ExaminedRig, ExaminedGroundtruth]:
    made = rig(8, lever_m=(0.05, -0.03, 0.02), offset_s=0.025)
    return made, examine(positions_of(made), made.readings)


def test_positions_alone_have_no_verdict_on_rotations(
    positions_alone: tuple[ExaminedRig, ExaminedGroundtruth],
) -> None:
    made, result = positions_alone
    for name in ("body_rotation", "fused", "rotation_jumps"):
        assert result.causes[name].verdict == "unobservable"
        assert result.causes[name].value is None
    assert any("errors of rotation are unobservable" in note for note in result.notes)
    assert {item.name for item in result.significant} == {"lever_arm", "clock_offset"}
    for name, values in (("lever_arm", (50.0, -30.0, 20.0)), ("clock_offset", (25.0,))):
        cause = result.causes[name]
        assert cause.half_width is not None
        assert np.linalg.norm(np.subtract(cause.components, values)) < cause.half_width
    fits = fits_of(result)
    assert fits.rotation_noise_rad is None
    position_m, rotation_rad = made.errors(fits.repaired)
    assert fits.repaired.covariances is not None
    variances = np.median(np.einsum("nii->ni", fits.repaired.covariances), axis=0)
    assert position_m < 2.2 * np.sqrt(variances[:3].sum()) < 0.02
    assert rotation_rad < 2.2 * np.sqrt(variances[3:].sum()) < np.radians(2.0)


@pytest.mark.slow
def test_exact_positions_do_not_bend_the_clock() -> None:
    made = rig(4, "car", duration_s=60.0, noise=(1e-4, 2e-3))
    clock = fits_of(examine(positions_of(made), made.readings)).short.values[6]
    assert abs(clock) < 2.0  # 5.9 ms if the fit trusts positions more than 1 mm


@pytest.mark.slow
def test_heavy_tails_have_no_false_verdict() -> None:
    result = examined(rig(5, tails=3.0))
    assert set(verdicts(result).values()) <= {"insignificant"}


@pytest.mark.slow
def test_verdicts_do_not_depend_on_world_origin_of_time_or_order(
    faulty: tuple[ExaminedRig, ExaminedGroundtruth],
) -> None:
    made, result = faulty
    up_is_y = Rotation.from_euler("x", -90.0, degrees=True) * Rotation.from_euler("z", 0.4)
    before = made.groundtruth
    assert before.rotations is not None
    rotated = dataclasses.replace(
        before,
        stamps=before.stamps - START_NS,
        positions=up_is_y.apply(before.positions) + 7.0,
        quaternions=(up_is_y * before.rotations).as_quat(),
    )[np.random.default_rng(0).permutation(len(before))]
    readings = made.readings
    order = np.random.default_rng(1).permutation(len(readings.stamps))
    assert readings.accelerations is not None
    shuffled = InertialReadings(
        readings.stamps[order] - START_NS, readings.rates[order], readings.accelerations[order]
    )
    again = examine(rotated, shuffled)
    assert verdicts(again) == verdicts(result)
    for name in CALIBRATION:
        value = result.causes[name].value
        assert again.causes[name].value == pytest.approx(value, rel=1e-6), name


@pytest.mark.slow
def test_clocks_of_different_epochs() -> None:
    made = rig(1, duration_s=22.0)
    apart = 1_034_771 * 10**9
    moved = dataclasses.replace(made.groundtruth, stamps=made.groundtruth.stamps - apart)
    fits = fits_of(examine(moved, made.readings))
    assert fits.rig.offset_s == pytest.approx(apart / 1e9, abs=1e-3)
    first = fits.repaired.stamps[0]
    assert abs(int(first) - START_NS) < 10**9


@pytest.mark.slow
def test_jumps_outliers_frozen_and_held_poses() -> None:
    made = rig(3, duration_s=40.0)
    truth = made.groundtruth
    assert truth.quaternions is not None
    positions, quaternions = truth.positions.copy(), truth.quaternions.copy()
    positions[2000:] += [0.02, 0.0, 0.0]
    generator = np.random.default_rng(8)
    bad = generator.choice(np.arange(100, 1400), 30, replace=False)
    positions[bad] += generator.normal(0.0, 0.05, (30, 3))
    positions[1500:1560], quaternions[1500:1560] = positions[1500], quaternions[1500]
    for begin in range(2500, 3000, 5):
        positions[begin + 1], quaternions[begin + 1] = positions[begin], quaternions[begin]
    kept = np.ones(len(positions), dtype=bool)
    kept[3300:3420] = False
    changed = dataclasses.replace(truth, positions=positions, quaternions=quaternions)[kept]
    result = examine(changed, made.readings)
    fits = fits_of(result)
    assert set(verdicts(result).values()) == {"insignificant"}
    # The pose also jumps at the end of the frozen interval.
    [jump] = [
        item
        for item in fits.checks.jumps
        if abs(item.stamp_ns - int(truth.stamps[2000])) <= 20_000_000
    ]
    # The error of lines through seven samples each is 1.1 times the noise of one, on every axis.
    assert jump.size == pytest.approx(0.02, abs=3.0 * 1.1 * 5e-4)
    # A held pose is behind the motion, and an outlier, too.
    assert fits.checks.outlier_share == pytest.approx(130 / len(changed), rel=0.15)
    [frozen] = result.poses.frozen
    assert frozen.start_ns == truth.stamps[1500]
    assert frozen.duration_s == pytest.approx(0.59)
    assert result.poses.held_share == pytest.approx(100 / len(changed), rel=0.1)
    [gap] = result.poses.gaps
    assert gap.duration_s == pytest.approx(1.21)
    names = {item.name for item in result.significant}
    assert {"position_jumps", "outliers", "frozen", "held", "gaps", "missing"} <= names
    # The gap is bridged.
    steps = np.diff(fits.repaired.stamps)
    assert steps.max() < 50_000_000


@pytest.mark.slow
@pytest.mark.parametrize("size_mm", [6.0, 10.0])
def test_small_jumps_have_their_size(size_mm: float) -> None:
    truth = rig(12)
    positions = truth.groundtruth.positions.copy()
    positions[1203:] += np.array([0.6, -0.64, 0.48]) * 1e-3 * size_mm
    result = examine(dataclasses.replace(truth.groundtruth, positions=positions), truth.readings)
    [jump] = fits_of(result).checks.jumps
    assert abs(jump.stamp_ns - int(truth.groundtruth.stamps[1203])) <= 30_000_000
    assert 1e3 * jump.size == pytest.approx(size_mm, abs=3.0 * 1.1 * 0.5)


@pytest.mark.slow
def test_scale_errors_of_an_accelerometer_are_no_lever_arm() -> None:
    made = rig(1)
    assert made.readings.accelerations is not None
    scaled = dataclasses.replace(made.readings, accelerations=0.995 * made.readings.accelerations)
    result = examine(made.groundtruth, scaled)
    assert result.significant == []
    size_mm = result.causes["lever_arm"].value
    assert size_mm is not None
    assert size_mm > 4.7  # larger than 1.4 standard deviations
    assert not fits_of(result).hand_eye.lever_m.any()
    position_m, _ = made.errors(fits_of(result).repaired)
    assert position_m < 5e-4 * np.sqrt(3.0)


@pytest.mark.slow
def test_clock_and_lever_arm_that_are_likely_but_not_significant_are_repaired() -> None:
    made = rig(4, offset_s=0.003, skew=-6e-5, lever_m=(0.004, -0.004, 0.0))
    result = examined(made)
    assert set(verdicts(result).values()) == {"insignificant"}
    lever_m = fits_of(result).hand_eye.lever_m
    np.testing.assert_allclose(lever_m, [0.004, -0.004, 0.0], atol=6e-4)
    assert lever_m[2] == 0.0  # not likely
    clock = fits_of(result).rig
    assert clock.offset_s == pytest.approx(0.003, abs=1e-4)
    assert clock.skew == pytest.approx(-6e-5, abs=1e-5)
    before_m, _ = made.errors(made.groundtruth)
    position_m, _ = made.errors(fits_of(result).repaired)
    assert position_m < 7e-4 < 6e-3 < before_m


@pytest.mark.slow
def test_jitter_of_timestamps() -> None:
    result = examined(rig(4, jitter_s=3e-3))
    jitter = result.causes["jitter"]
    assert jitter.verdict == "significant"
    assert jitter.value == pytest.approx(3.0, rel=0.15)
    # What wrong timestamps explain is no other fault.
    assert [item.name for item in result.significant] == ["jitter"]


def test_figure_of_a_groundtruth_without_noise_has_axes_of_a_readable_range(
    healthy: tuple[ExaminedRig, ExaminedGroundtruth],
) -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    from trajeval_ros.report.groundtruth_report import groundtruth_figure

    made, result = healthy
    fits = fits_of(result)
    small = dataclasses.replace(fits.short, residuals=1e-6 * fits.short.residuals)
    figure = groundtruth_figure(made.groundtruth, result, dataclasses.replace(fits, short=small))
    first, second, *_ = figure.axes
    for axes in (first, second):
        low, high = axes.get_ylim()
        assert 5e-4 < low < 1e-3 < 1e-2 < high < 2e-2


def test_figure_of_positions_has_no_axes_of_rotations(
    positions_alone: tuple[ExaminedRig, ExaminedGroundtruth],
) -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    from trajeval_ros.report.groundtruth_report import groundtruth_figure

    made, result = positions_alone
    figure = groundtruth_figure(made.groundtruth, result, fits_of(result))
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["position\nresidual [mm]", "lever arm [mm]"]


@pytest.mark.slow
def test_rest_is_inconclusive() -> None:
    result = examined(rig(1, "rest"))
    assert result.significant == []
    assert set(verdicts(result).values()) == {"inconclusive"}
    assert any("the rig does not turn" in note for note in result.notes)


@pytest.mark.slow
def test_a_car_does_not_determine_the_height_of_the_marker() -> None:
    result = examined(rig(2, "car", duration_s=60.0, offset_s=0.02))
    assert result.causes["lever_arm"].verdict == "inconclusive"
    assert result.causes["clock_offset"].verdict == "significant"
    assert result.causes["fused"].verdict == "insignificant"
    assert any("lever arm along z" in note for note in result.notes)
    # The value of zero is not a measurement: its standard deviation is that of the prior.
    assert fits_of(result).hand_eye_covariance[2, 2] == pytest.approx(0.25, rel=0.01)


@pytest.mark.slow
def test_a_turntable_has_no_false_verdict() -> None:
    result = examined(rig(4, "turntable", duration_s=40.0))
    assert "significant" not in verdicts(result).values()
    assert result.causes["fused"].verdict == "insignificant"


@pytest.mark.slow
def test_a_gyroscope_alone(faulty: tuple[ExaminedRig, ExaminedGroundtruth]) -> None:
    made, _ = faulty
    gyroscope = dataclasses.replace(made.readings, accelerations=None)
    result = examine(made.groundtruth, gyroscope)
    assert result.causes["body_rotation"].verdict == "significant"
    assert result.causes["clock_offset"].value == pytest.approx(12.0, abs=2.2)
    assert result.causes["lever_arm"].verdict == result.causes["tilted"].verdict == "inconclusive"


@pytest.mark.slow
def test_gaps_and_saturation_of_the_imu(faulty: tuple[ExaminedRig, ExaminedGroundtruth]) -> None:
    made, result = faulty
    readings = made.readings
    assert readings.accelerations is not None
    rates, force = readings.rates.copy(), readings.accelerations.copy()
    rates[:, 2] = np.clip(rates[:, 2], -0.8 * rates[:, 2].max(), 0.8 * rates[:, 2].max())
    kept = np.ones(len(rates), dtype=bool)
    kept[2000:2040] = False
    broken = InertialReadings(readings.stamps[kept], rates[kept], force[kept])
    again = examine(made.groundtruth, broken)
    assert verdicts(again) == verdicts(result)
    text = " ".join(again.notes)
    assert "the IMU has 1 gap; the longest is 0.20 s at 9.69 s" in text  # since the first pose
    assert "saturated interval" in text
    assert not any("the IMU has" in note for note in result.notes)
    cause = again.causes["body_rotation"]
    assert cause.half_width is not None
    assert np.linalg.norm(np.subtract(cause.components, FAULTS["turn_deg"])) < 2 * cause.half_width


def refused(groundtruth: Trajectory, readings: InertialReadings | None, **more: Any) -> str:
    with pytest.raises(InputError) as error:
        examine(groundtruth, readings, **more)
    return str(error.value)


@pytest.mark.slow
def test_refusals(healthy: tuple[ExaminedRig, ExaminedGroundtruth]) -> None:
    made, _ = healthy
    truth, readings = made.groundtruth, made.readings
    assert readings.accelerations is not None
    assert "overlap for 1" in refused(truth[:1500], readings)
    assert "and the examination needs 20 s" in refused(truth, readings, time_offset_s=1e4)
    other = rig(99).readings
    assert "at no single offset" in refused(truth, other)
    gyroscope = dataclasses.replace(readings, accelerations=None)
    assert "no accelerations; give one" in refused(positions_of(made), gyroscope)
    assert "at no single offset" in refused(positions_of(made), other)
    still = rig(1, "rest")
    assert "not determine the orientation" in refused(positions_of(still), still.readings)
    for unit in (1e3, 3.281, 1e-2):
        other_unit = dataclasses.replace(truth, positions=truth.positions * unit)
        assert "times that of the IMU; give positions in metres" in refused(other_unit, readings)
    assert "fewer than five poses" in refused(truth[:4], readings)
    in_g = dataclasses.replace(readings, accelerations=readings.accelerations / 9.81)
    assert "give specific forces in m/s^2" in refused(truth, in_g)
    one = InertialReadings(readings.stamps[:1], readings.rates[:1], readings.accelerations[:1])
    assert "fewer than two readings" in refused(truth, one)
    constant = dataclasses.replace(
        truth, quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (len(truth), 1))
    )
    assert "all orientations of the groundtruth are equal" in refused(constant, readings)
    unstamped = Trajectory.from_positions(truth.positions, truth.quaternions)
    assert "has no timestamps" in refused(unstamped, readings)


def test_poses_alone() -> None:
    truth = rig(7).groundtruth
    assert examine(truth[:5]).significant == []
    stamps = truth.stamps + np.random.default_rng(3).integers(0, 4_000_000, len(truth))
    stamps[100] = stamps[99]
    rough = dataclasses.replace(truth, stamps=stamps)
    result = examine(rough)
    assert result.fits is None
    assert {item.name for item in result.significant} == {
        "repeated_timestamps",
        "uneven_timestamps",
    }
    slow = examine(Trajectory(truth.stamps[::10], truth.positions[::10]))
    assert slow.significant == []
    assert slow.poses.rotation_noise_rad is None
    assert any("upper limit" in note for note in slow.notes)
    exact = examine(rig(7, noise=(0.0, 0.0)).groundtruth)
    assert any("the groundtruth is smooth" in note for note in exact.notes)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["V1_01_original", "mocap2gt"])
def test_positions_of_real_recordings_agree_with_their_references(name: str) -> None:
    truth, readings = real(name)
    result = examine(dataclasses.replace(truth, quaternions=None), readings)
    external = reference(Path("groundtruth_doctor.json"))["external"].get(name, {})
    for cause, key in (("lever_arm", "lever_mm"), ("clock_offset", "offset_ms")):
        known = np.zeros(3) if cause == "lever_arm" else np.zeros(1)
        half_width = result.causes[cause].half_width
        assert half_width is not None
        apart = np.subtract(result.causes[cause].components, external.get(key, known))
        assert np.linalg.norm(apart) < half_width, cause
    # The tilt of 0.44 deg of mocap2gt is near the limit of significance.
    calibration = {item for item in CALIBRATION if result.causes[item].verdict == "significant"}
    assert calibration - {"tilted"} == ({"lever_arm"} if name == "mocap2gt" else set())
    assert "tilted" not in calibration or name == "mocap2gt"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["V1_01_original", "V1_01_corrected", "mocap2gt", "MH_05"])
def test_real_recordings_give_the_reference(name: str) -> None:
    stored = reference(Path("groundtruth_doctor.json"))
    expected, external = stored["real"][name], stored["external"]
    truth, readings = real(name)
    result = examine(truth, readings)
    fits = fits_of(result)
    for horizon, fit in (("short", fits.short), ("long", fits.long)):
        sigmas = np.array(expected[f"{horizon}_sd"])
        assert (np.abs(fit.values - expected[horizon]) < 0.5 * sigmas).all()
        np.testing.assert_allclose(fit.sigmas[:8], sigmas[:8], rtol=0.1)
    assert fits.disagree == expected["disagree"]
    if name == "V1_01_original":
        names = {item.name for item in result.significant}
        assert {"body_rotation", "lever_arm", "fused"} == names
        for cause, key in (("body_rotation", "R_IM_deg"), ("lever_arm", "lever_mm")):
            apart = np.subtract(result.causes[cause].components, external[name][key])
            half_width = result.causes[cause].half_width
            assert half_width is not None
            assert np.linalg.norm(apart) < min(half_width, {"R": 1.2, "l": 8.0}[key[0]])
    elif name == "mocap2gt":
        truth_of = external[name]
        body = Rotation.from_rotvec(truth_of["R_IM_deg"], degrees=True)
        rotated = body.inv() * Rotation.from_quat(fits.hand_eye.rotation_xyzw)
        assert np.degrees(rotated.magnitude()) < 0.1
        assert np.linalg.norm(1e3 * fits.hand_eye.lever_m - truth_of["lever_mm"]) < 1.0
        assert abs(1e3 * fits.rig.offset_s - truth_of["offset_ms"]) < 1.0
        assert result.causes["tilted"].verdict == "significant"
    else:
        assert set(verdicts(result).values()) == {"insignificant"}
        assert result.causes["fused"].verdict == "insignificant"
    if name == "MH_05":
        jumps = {(jump.stamp_ns - START_NS) / 1e9: 1e3 * jump.size for jump in fits.checks.jumps}
        stated = {41.60: 17, 47.99: 15, 59.06: 21, 80.75: 51, 84.09: 30, 85.64: 34}
        for second, size_mm in stated.items():
            [size] = [jump for at, jump in jumps.items() if abs(at - second) < 0.03]
            assert size == pytest.approx(size_mm, rel=0.2)
