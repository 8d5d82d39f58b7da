"""Recovery, coverage and false alarms over many flights, and what real recordings give."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from calibration_flights import Fault, fly
from calibration_recordings import RECORDINGS
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration import apply
from trajeval_ros.calibration.apply import evaluate_calibrated
from trajeval_ros.calibration.calibrate import Calibration, SystematicErrors, calibrate
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.calibration.increments import OFFSET, Increments
from trajeval_ros.calibration.observability import solve
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.protocol import Protocol

NONE = SystematicErrors(0.0, 0.0)
YAW = Protocol(gauge=Gauge.YAW, lengths=())
Recording = Callable[[str], Trajectory]

QUICK = ("V1_02", "MH_01 OpenVINS", "fr2_desk")
NAMES = [
    name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in RECORDINGS
]


def protocol_of(name: str) -> Protocol:
    """A camera alone doesn't know where down is."""
    return dataclasses.replace(YAW, gauge=Gauge.SE3) if name == "fr2_desk" else YAW


def random_fault(random: np.random.Generator) -> Fault:
    return Fault(
        random.uniform(-2.0, 2.0),
        0.0,
        Rotation.random(random_state=int(random.integers(2**31))).as_rotvec(),
        random.uniform(-0.3, 0.3, 3),
    )


def flown(seed: int) -> tuple[Fault, Trajectory, Trajectory]:
    random = np.random.default_rng(seed + 1000)
    fault = random_fault(random)
    drift = float(np.exp(random.uniform(np.log(0.3), np.log(3.0))))
    return fault, *fly(seed, random.uniform(60.0, 120.0), fault=fault, drift=drift)


def misses(outcome: Calibration, fault: Fault) -> tuple[float, np.ndarray, np.ndarray]:
    assert outcome.offset.value is not None
    assert outcome.rotation.value is not None
    assert outcome.lever.value is not None
    # The perturbation that the covariance is of: on the left of the rotation.
    true = Rotation.from_rotvec(fault.rotation_vector)
    rotated = (Rotation.from_rotvec(outcome.rotation.value) * true.inv()).as_rotvec()
    offset = float(outcome.offset.value[0]) - fault.offset_s
    return offset, rotated, outcome.lever.value - np.asarray(fault.lever_m)


@pytest.mark.slow
def test_intervals_of_95_percent_cover_the_truth_and_naive_ones_do_not() -> None:
    # Intervals that cover 75 % would pass with a probability of 9 % by their 20 offsets, and of
    # 0.4 % by 60 rotations or lever arms.
    runs, offsets, rotations, levers, naive = 20, 0, 0, 0, 0
    errors = []
    for seed in range(runs):
        fault, truth, estimate = flown(seed)
        result = calibrate(truth, estimate, systematic=NONE)
        assert result.offset.is_significant
        offset, rotated, lever_m = misses(result, fault)
        assert result.offset.half_width_95 is not None
        assert result.rotation.half_width_95 is not None
        assert result.lever.half_width_95 is not None
        offsets += abs(offset) <= result.offset.half_width_95[0]
        rotations += int((np.abs(rotated) <= result.rotation.half_width_95).sum())
        levers += int((np.abs(lever_m) <= result.lever.half_width_95).sum())
        errors.append([abs(offset), *np.abs(rotated), *np.abs(lever_m)])

        # The information matrix alone, as a negative control.
        shift = round(result.guess.offset_s * 1e9)
        moved = dataclasses.replace(estimate, stamps=estimate.stamps + shift)
        solution = solve(Increments(truth, moved), Gauge.SE3, with_skew=False)
        assert solution is not None
        free = np.r_[OFFSET, 2:8]
        jacobian = solution.fit.linearised.jacobian[..., free]
        weights = np.repeat(solution.fit.weights, 3, axis=1)[..., None]
        information = np.tensordot(jacobian * weights, jacobian, axes=([0, 1], [0, 1]))
        sigma = float(np.sqrt(np.linalg.inv(information)[0, 0]))
        naive += abs(offset) <= 1.96 * sigma
    assert offsets >= 0.9 * runs
    assert rotations >= 0.9 * 3 * runs
    assert levers >= 0.9 * 3 * runs
    assert naive <= 0.75 * runs
    sizes = np.array(errors)
    assert np.median(sizes[:, 0]) < 0.1e-3
    assert np.degrees(np.median(sizes[:, 1:4])) < 0.02
    assert np.median(sizes[:, 4:]) < 2e-3


@pytest.mark.slow
def test_right_calibrations_are_left_alone_in_95_percent_of_flights(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(apply, "calibrate", partial(calibrate, systematic=NONE))
    applied = 0
    ratios = []
    runs = 20  # with two decisions each: a share of 20 % would pass with a probability of 0.1 %
    for seed in range(runs):
        kind = "car" if seed % 4 == 3 else "drone"
        result = evaluate_calibrated(
            *fly(seed, 60.0, kind), YAW, CalibrationRequest(offset=True, hand_eye=True)
        )
        applied += result.offset_applied + (result.hand_eye is not None)
        assert result.before is not None
        if result.if_applied is not None:
            ratios.append(result.if_applied.position_m / result.before.position_m)
    assert applied <= 0.05 * runs
    # Fitting anyway takes nothing off the ATE, as a fit of absolute residuals would.
    assert len(ratios) > 0.9 * runs
    assert 0.99 < np.median(ratios) < 1.01


@pytest.mark.parametrize("name", NAMES)
def test_recordings_with_one_clock_are_left_alone(recording: Recording, name: str) -> None:
    truth, estimate = (recording(item) for item in RECORDINGS[name])
    result = evaluate_calibrated(
        truth, estimate, protocol_of(name), CalibrationRequest(offset=True, hand_eye=True)
    )
    assert not result.offset_applied
    assert not result.lever_applied
    # fr2_desk has a constant rotation of a degree, which is there: it takes more than half off the
    # rotation error and leaves the position error.
    assert result.rotation_applied == (name == "fr2_desk")
    calibration = result.calibration
    assert calibration is not None
    if name.startswith("MH_01"):
        assert calibration.offset.value is not None
        assert calibration.lever.value is not None
        assert abs(calibration.offset.value[0]) < 2e-3
        assert np.linalg.norm(calibration.lever.value) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_show_a_clock_and_a_body_that_are_put_on_them(
    recording: Recording, name: str
) -> None:
    truth, estimate = (recording(item) for item in RECORDINGS[name])
    before = calibrate(truth, estimate, protocol_of(name).gauge)
    marker = HandEye.of(np.array([0.6, -1.0, 1.5]), np.array([0.1, -0.05, 0.1]))
    moved = marker.inverse().of_body(truth)
    moved = dataclasses.replace(moved, stamps=moved.stamps + 100_000_000)
    result = evaluate_calibrated(
        moved, estimate, protocol_of(name), CalibrationRequest(offset=True, hand_eye=True)
    )
    assert result.offset_applied
    assert result.rotation_applied
    assert result.calibration is not None
    offset = result.calibration.offset
    assert offset.value is not None
    assert before.offset.value is not None
    assert offset.value[0] - before.offset.value[0] == pytest.approx(0.1, abs=1e-3)
    assert result.after.rotation_deg is not None
    assert result.after.rotation_deg < 6.0
    plain = evaluate_calibrated(
        truth, estimate, protocol_of(name), CalibrationRequest(offset=True)
    )
    assert result.after.position_m == pytest.approx(plain.after.position_m, rel=0.08, abs=0.01)
