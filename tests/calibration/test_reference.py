"""Reference numbers of the calibration: closed forms, the correlation, the fit, the sandwich."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from calibration_flights import EPOCH, Fault, marked, stamps_of
from scipy.spatial.transform import Rotation
from scipy.special import fdtrc, stdtrit

from trajeval_ros.calibration.clock_offset import guess_offset, masked_correlation, refined_peak
from trajeval_ros.calibration.hand_eye import closest_rotation, lever_arm
from trajeval_ros.calibration.increments import (
    BODY_ROTATION,
    COLUMNS,
    LEVER,
    OFFSET,
    SCALE,
    SKEW,
    Increments,
    Unknowns,
)
from trajeval_ros.calibration.observability import observability
from trajeval_ros.calibration.robust_fit import fit, sandwich
from trajeval_ros.geometry.trajectory import Trajectory

Reference = Callable[[str], Any]


def test_closed_form_rotation_and_lever_arm(reference: Reference) -> None:
    numbers = reference("calibration")["handeye_rotation"]
    rotated = np.array(numbers["estimate_rotation_vectors"])
    rotation = closest_rotation(rotated, np.array(numbers["groundtruth_rotation_vectors"]))
    expected = Rotation.from_quat(numbers["R_X_quat"])
    assert np.allclose(rotation, expected.as_matrix(), atol=2e-9)

    numbers = reference("calibration")["lever_arm"]
    increments = Rotation.from_rotvec(numbers["estimate_rotation_vectors"]).as_matrix()
    marker = np.array(numbers["groundtruth_translations"]) @ expected.as_matrix().T
    lever_m, scale = lever_arm(
        increments - np.eye(3), np.array(numbers["estimate_translations"]), marker, with_scale=True
    )
    assert np.allclose(lever_m, numbers["lever"], atol=2e-9)
    assert scale == pytest.approx(numbers["scale"], abs=2e-9)


def test_masked_correlation(reference: Reference) -> None:
    numbers = reference("calibration")["masked_ncc"]
    n = np.arange(40)

    def signal(n: Any) -> Any:
        return np.sin(0.5 * n) + 0.3 * np.sin(1.3 * n + 0.4)

    in_a, in_b = np.ones(40), np.ones(40)
    in_a[numbers["mask_zero_estimate"]] = 0.0
    in_b[numbers["mask_zero_groundtruth"]] = 0.0
    lags, correlation, _ = masked_correlation(
        signal(n) * in_a, in_a, signal(n - numbers_shift(numbers)) * in_b, in_b
    )
    result = dict(zip(lags.tolist(), correlation.tolist(), strict=True))
    for lag, expected in numbers["rho"].items():
        assert result[int(lag)] == pytest.approx(expected, abs=1e-9)
    peak = int(np.flatnonzero(lags == numbers["peak_lag"])[0])
    refined = numbers["peak_lag"] + refined_peak(correlation, peak)
    assert refined == pytest.approx(numbers["refined_lag"], abs=1e-9)


def numbers_shift(numbers: dict[str, Any]) -> float:
    return float(numbers["formula_groundtruth"].split("n-")[1])


def test_sandwich_and_quantiles(reference: Reference) -> None:
    numbers = reference("calibration")["cluster_sandwich"]
    gradients = np.array(numbers["block_gradients"])
    covariance = sandwich(np.array(numbers["H"]), gradients)
    assert np.allclose(covariance, numbers["covariance"], atol=1e-9)
    assert np.allclose(np.sqrt(np.diag(covariance)), numbers["sigma"], atol=1e-9)
    assert stdtrit(numbers["df"], 0.975) == pytest.approx(numbers["t975"], abs=1e-8)
    numbers = reference("calibration")["significance"]
    assert stdtrit(11, 0.99865) == pytest.approx(numbers["t_99865_df11"], abs=1e-6)
    assert fdtrc(3, 11, 10.0) == pytest.approx(numbers["F_3_11_sf_at_10"], abs=1e-8)


def flown(true: dict[str, Any], *, disturbed: bool) -> tuple[Trajectory, Trajectory]:
    """Return the reference's flight."""

    def positions(t: Any) -> Any:
        return np.column_stack(
            [
                2.0 * np.sin(0.7 * t) + 0.5 * np.sin(1.9 * t),
                1.5 * np.cos(0.6 * t),
                0.4 * np.sin(1.1 * t),
            ]
        )

    def rotations(t: Any) -> Rotation:
        yaw = 0.8 * np.sin(0.5 * t) + 0.3 * np.sin(1.7 * t)
        angles = np.column_stack([yaw, 0.25 * np.sin(0.9 * t), 0.2 * np.cos(1.3 * t)])
        return Rotation.from_euler("ZYX", angles)

    s, g = np.arange(601) * 0.1, -3.0 + np.arange(13201) * 0.005
    fault = Fault(
        true["offset"],
        true["skew"],
        true["R_X_rotvec"] or [0.0, 0.0, 0.0],
        true["lever"] or [0.0, 0.0, 0.0],
    )
    truth = marked(g, Trajectory(stamps_of(g), positions(g), rotations(g).as_quat()), 60.0, fault)
    wander = np.column_stack(
        [0.05 * np.sin(0.11 * s), 0.04 * np.sin(0.17 * s + 1.0), 0.03 * np.cos(0.13 * s)]
    )
    wander += 0.003 * np.sin(np.outer(s, [37.0, 41.0, 43.0]))
    rotation_list = np.column_stack(
        [0.002 * np.sin(0.3 * s), 0.002 * np.cos(0.4 * s), 0.01 * np.sin(0.05 * s)]
    )
    size = 1.0 if disturbed else 0.0
    world = Rotation.from_rotvec([0.0, 0.0, 0.9])
    estimate = Trajectory(
        stamps_of(s),
        world.apply(positions(s) + size * wander) / true["scale"] + [3.0, -2.0, 1.0],
        (world * Rotation.from_rotvec(size * rotation_list) * rotations(s)).as_quat(),
    )
    return truth, estimate


@pytest.mark.parametrize("away_s", [0.0, 0.3])
@pytest.mark.parametrize("name", ["exact", "exact_scale_skew", "disturbed", "offset_only"])
def test_fit(reference: Reference, name: str, away_s: float) -> None:
    numbers = reference("calibration")["fit"]["cases"][name]
    true = numbers["true"]
    truth, estimate = flown(true, disturbed=numbers["disturbed"])
    guess = guess_offset(truth, estimate)
    assert guess.offset_s == pytest.approx(numbers["ncc"]["offset"], abs=1e-6)
    assert guess.peak == pytest.approx(numbers["ncc"]["peak"], abs=1e-6)

    free = [OFFSET]
    free += [BODY_ROTATION, LEVER] if true["lever"] else []
    free += [SKEW, SCALE] if name == "exact_scale_skew" else []
    basis = np.concatenate([np.eye(COLUMNS)[:, columns] for columns in free], axis=1)
    increments = Increments(truth, estimate)
    begin = guess.offset_s + away_s
    start = Unknowns(begin, 0.0, np.eye(3), np.zeros(3), 1.0)
    if true["lever"]:
        start = increments.start(begin, with_scale=true["scale"] != 1.0, about_z=False)
    fitted = fit(increments, start, basis)
    assert fitted is not None
    assert fitted.settled
    assert fitted.blocks == numbers["blocks"]
    assert len(fitted.linearised.rows) == numbers["pairs"]
    exact = not numbers["disturbed"]
    result, expected = fitted.unknowns, numbers["fit"]
    assert result.offset_s == pytest.approx(expected["offset"], abs=1e-7 if exact else 2e-5)
    assert 1e6 * result.skew == pytest.approx(expected["skew_ppm"], abs=1e-3)
    rotation = Rotation.from_matrix(result.rotation).as_rotvec()
    assert np.allclose(rotation, expected["R_X_rotvec"], rtol=0.0, atol=1e-6 if exact else 2e-5)
    assert np.allclose(result.lever_m, expected["lever"], rtol=0.0, atol=1e-5 if exact else 5e-4)
    assert result.scale == pytest.approx(expected["scale"], abs=1e-6 if exact else 1e-4)
    if numbers["sigma"] is not None:
        names = ["offset", "skew", "xx", "xy", "xz", "lx", "ly", "lz", "c"]
        sigmas = dict(zip(names, np.sqrt(np.diag(fitted.covariance)), strict=True))
        for item, sigma in numbers["sigma"].items():
            assert sigmas[item] == pytest.approx(sigma, rel=0.05)
    seen = observability(increments, fitted)
    for actual, theirs in (("offset", "offset"), ("rotation", "X"), ("lever", "l")):
        if theirs in numbers["reliability"]:
            expected_reliability = numbers["reliability"][theirs]
            assert np.allclose(seen[actual].reliability, expected_reliability, atol=0.01)


def test_noise_on_a_straight_line_is_not_taken_for_an_offset(reference: Reference) -> None:
    numbers = reference("calibration")["unobservable_straight"]

    def side(t: Any, of_position: float, of_rotation: float) -> Trajectory:
        def chirp(s: float) -> Any:
            return 1e-3 * np.sin(np.outer(np.square(t), s + np.arange(3)))

        line = np.column_stack([10.0 * t, 0.0 * t, 0.0 * t])
        return Trajectory(
            EPOCH + np.rint(t * 1e9).astype(np.int64),
            line + chirp(of_position),
            Rotation.from_rotvec(chirp(of_rotation)).as_quat(),
        )

    estimate = side(np.arange(601) * 0.1, 31.0, 41.0)
    truth = side(-3.0 + np.arange(13201) * 0.005, 51.0, 61.0)
    increments = Increments(truth, estimate)
    start = Unknowns(0.0, 0.0, np.eye(3), np.zeros(3), 1.0)
    fitted = fit(increments, start, np.eye(COLUMNS)[:, OFFSET])
    assert fitted is not None
    seen = observability(increments, fitted)["offset"]
    assert not seen.seen.any()
    assert abs(float(seen.reliability[0])) < 0.1
    assert abs(numbers["reliability_offset"]) < 0.1


def flown_for(
    duration_s: float, away_s: float = 0.0, *, turns: bool = True
) -> tuple[Increments, Unknowns]:
    true: dict[str, Any] = {"offset": 0.0, "skew": 0.0, "R_X_rotvec": None, "lever": None}
    truth, estimate = flown({**true, "scale": 1.0}, disturbed=True)
    estimate = estimate[estimate.seconds <= estimate.seconds[0] + duration_s]
    if not turns:
        estimate = dataclasses.replace(estimate, quaternions=None)
    start = Unknowns(away_s, 0.0, np.eye(3), np.zeros(3), 1.0)
    return Increments(truth, estimate), start


def test_a_standard_deviation_takes_three_blocks_more_than_parameters() -> None:
    # Blocks are of three horizons, which are 1 s; the last increment begins 1 s before the end.
    basis = np.eye(COLUMNS)[:, OFFSET]
    fitted = fit(*flown_for(13.3), basis)
    assert fitted is not None
    assert fitted.blocks == 4
    assert fit(*flown_for(12.7), basis) is None
    assert fit(*flown_for(0.5), basis) is None  # no increment at all


def test_without_turns_of_the_estimate_a_lever_arm_changes_nothing() -> None:
    increments, start = flown_for(20.0, turns=False)
    np.testing.assert_array_equal(increments.linearise(start).jacobian[..., LEVER], 0.0)
