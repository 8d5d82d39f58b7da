"""Biases of the IMU as states: their derivatives, their limits, and what is found of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from visual_inertial_scenes import (
    dense_hessian,
    gradient,
    numeric_jacobian,
    relative,
    stacked_residuals,
)

from trajeval_ros.cli.app import main
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.preintegration import GRAVITY, ImuNoise, preintegrate
from trajeval_ros.simulation.motion import shape
from trajeval_ros.studies.examination import Examination, MeasurementModel, examine
from trajeval_ros.studies.gauge_trials import compare_handlings
from trajeval_ros.studies.keyframe_selection import KeyframeSelection, select
from trajeval_ros.studies.outliers import reject_outliers
from trajeval_ros.studies.tracks_folder import read_tracks_folder
from trajeval_ros.visual_inertial.gauge_covariance import (
    fixed_covariance,
    free_covariance,
    transform,
)
from trajeval_ros.visual_inertial.inertial_errors import BiasNoise
from trajeval_ros.visual_inertial.problem import Problem
from trajeval_ros.visual_inertial.scene import PROFILES, make_scene
from trajeval_ros.visual_inertial.solver import GAUGE_INDICES, GaugeHandling, solve
from trajeval_ros.visual_inertial.state import State

BIASES = BiasNoise(1e-3, 0.05, 1.9e-5, 3e-3)
NO_BIASES = BiasNoise(1e-9, 1e-9, 1e-12, 1e-12)


def _problem(noise: BiasNoise) -> tuple[Problem, State]:
    """Return a small problem with biases, and a state away from its minimum."""
    scene = make_scene(shape("arc"), "random", PROFILES["paper"], 1, keyframes=4, landmarks=12)
    known = scene.measured(np.random.default_rng(0))
    problem = Problem(
        known.camera,
        known.camera_in_body,
        known.pixels,
        known.visibility.keyframe_of,
        known.visibility.landmark_of,
        known.landmarks,
        known.preintegrated,
        bias_noise=noise,
    )
    state = scene.disturbed(np.random.default_rng(1))
    state = state.referred_to(so3.exp(np.full(3, 0.2)) @ state.rotations[0], state.positions[0])
    biases = 0.1 * np.random.default_rng(2).standard_normal((4, 6))
    return problem, dataclasses.replace(state, biases=biases)


def test_preintegrated_motion_follows_the_biases_to_first_order() -> None:
    generator = np.random.default_rng(3)
    rates, forces = generator.normal(size=(2, 3, 8, 3))
    steps = np.full((3, 8), 0.005)
    steps[1, 6:] = 0.0

    def integrated(biases: np.ndarray) -> tuple[np.ndarray, ...]:
        moved = preintegrate(rates - biases[:3], forces - biases[3:], steps, ImuNoise(1.0, 1.0))
        return moved.rotations, moved.velocities, moved.positions

    computed = preintegrate(rates, forces, steps, ImuNoise(1.0, 1.0))
    for place, unit in enumerate(1e-5 * np.eye(6)):
        ahead, behind = integrated(unit), integrated(-unit)
        turn = so3.log(np.swapaxes(behind[0], 1, 2) @ ahead[0])
        differences = np.concatenate([turn, ahead[1] - behind[1], ahead[2] - behind[2]], axis=1)
        np.testing.assert_allclose(
            computed.by_biases[:, :, place], differences / 2e-5, rtol=1e-6, atol=1e-10
        )


def test_normal_equations_are_those_of_the_numeric_jacobian() -> None:
    problem, state = _problem(BiasNoise(0.1, 0.2, 0.03, 0.04))
    assert problem.width == state.width == 15
    jacobian, normal = numeric_jacobian(problem, state), problem.normal_equations(state)
    residuals = stacked_residuals(problem, state)
    assert relative(gradient(normal), jacobian.T @ residuals) < 1e-6
    assert relative(dense_hessian(normal), jacobian.T @ jacobian) < 1e-6
    assert normal.cost == pytest.approx(problem.cost(state), rel=1e-12)
    assert normal.cost == pytest.approx(residuals @ residuals / 2.0, rel=1e-12)


def test_cost_does_not_depend_on_the_gauge() -> None:
    problem, state = _problem(BiasNoise(0.1, 0.2, 0.03, 0.04))
    moved = state.transformed(so3.exp(np.array([0.0, 0.0, 1.2])), np.array([3.0, -2.0, 1.0]))
    assert problem.cost(moved) == pytest.approx(problem.cost(state), rel=1e-9)
    slope = gradient(problem.normal_equations(state)) @ state.gauge_basis
    assert np.abs(slope).max() < 1e-9 * np.abs(gradient(problem.normal_equations(state))).max()


@pytest.fixture(scope="module")
def selection(tracks_flight: Path) -> KeyframeSelection:
    return _selected(tracks_flight, BIASES)


def _selected(folder: Path, noise: BiasNoise | None) -> KeyframeSelection:
    recording = read_tracks_folder(folder)
    return select(recording, 3, 30, 0.2, ImuNoise(1.7e-4, 2e-3), GRAVITY, noise)


def test_free_covariance_becomes_that_of_fixation(selection: KeyframeSelection) -> None:
    rejection = reject_outliers(selection)
    problem, state = rejection.selection.problem(), rejection.state
    fixed = fixed_covariance(problem, state)
    start = state.positions[0], state.rotations[0]
    carried, moved = transform(
        free_covariance(problem, state), state, state.reference_rotation, start[0]
    )
    np.testing.assert_allclose(carried, fixed, atol=1e-9 * np.abs(fixed).max())
    np.testing.assert_allclose(moved.biases, state.biases, atol=0.0)
    # In a world that is turned, biases stay as certain: they are in the body.
    turned = so3.exp(np.array([0.0, 0.0, 0.7])) @ state.reference_rotation
    carried, _ = transform(fixed, state, turned, start[0])
    places = np.setdiff1d(np.arange(len(fixed)), state.motion_places)
    np.testing.assert_allclose(
        carried[np.ix_(places, places)], fixed[np.ix_(places, places)], rtol=1e-6, atol=1e-15
    )
    assert np.abs(carried[GAUGE_INDICES]).max() < 1e-12


def test_biases_that_cannot_move_are_known_ones(tracks_flight: Path) -> None:
    known, held = (reject_outliers(_selected(tracks_flight, noise)) for noise in (None, NO_BIASES))
    assert np.abs(held.state.biases).max() < 1e-9
    np.testing.assert_allclose(held.state.positions, known.state.positions, atol=1e-6)
    covariance = fixed_covariance(held.selection.problem(), held.state)
    motion = held.state.motion_places
    expected = fixed_covariance(known.selection.problem(), known.state)
    np.testing.assert_allclose(
        covariance[np.ix_(motion, motion)], expected, atol=1e-5 * np.abs(expected).max()
    )


def test_wrong_biases_of_groundtruth_are_found(tracks_flight: Path) -> None:
    recording = read_tracks_folder(tracks_flight)
    truth = recording.groundtruth
    assert truth.gyroscope_biases is not None
    assert truth.accelerometer_biases is not None
    off = np.array([2e-3, -1e-3, 3e-3]), np.array([0.05, -0.08, 0.03])
    wrong = dataclasses.replace(
        recording,
        groundtruth=dataclasses.replace(
            truth,
            gyroscope_biases=truth.gyroscope_biases + off[0],
            accelerometer_biases=truth.accelerometer_biases + off[1],
        ),
    )
    noise = BiasNoise(5e-3, 0.2, 1.9e-6, 3e-4)
    whole = select(wrong, 3, 30, 0.2, ImuNoise(1.7e-4, 2e-3), GRAVITY, noise)
    rejection = reject_outliers(whole)
    problem, state = rejection.selection.problem(), rejection.state
    sigmas = np.sqrt(np.diagonal(fixed_covariance(problem, state)).reshape(-1, 15)[0, 9:])
    errors = state.biases[0] + np.concatenate(off)
    assert (np.abs(errors) < 4.0 * sigmas).all()
    assert (sigmas[:3] < 1e-3).all()


@pytest.fixture(scope="module")
def measured(shared_data: Path) -> Examination:
    recording = read_tracks_folder(shared_data / "euroc_v1_01_tracks")
    model = MeasurementModel(3, 30, 1.0, ImuNoise(6e-4, 2e-2), BIASES, 9.81, is_split=True)
    return examine(recording, model)


def test_biases_of_a_real_flight(measured: Examination) -> None:
    """Against GTSAM's estimate of the same flight with the same noise."""
    for trials in compare_handlings(measured.scene, 2, lambda: None).values():
        assert trials.position_m.mean() == pytest.approx(0.0116, abs=3e-4)
        assert trials.rotation_deg.mean() == pytest.approx(0.330, abs=0.01)
        assert trials.velocity_mps.mean() == pytest.approx(0.0077, abs=2e-4)
    state = measured.rejection.state
    mean = np.array([-0.020261, 0.10680831, 0.12327675])  # of groundtruth, which was subtracted
    np.testing.assert_allclose(state.biases[-1, 3:] + mean, [-0.038, 0.093, 0.097], atol=0.01)
    np.testing.assert_allclose(measured.biases_sigma[3:], 0.035, atol=0.02)
    assert np.abs(state.biases[:, :3]).max() < 1e-3
    # It comes out constant: nothing says that it walks.
    assert np.ptp(state.biases[:, 3:], axis=0).max() < 5e-3
    groups = {group.name: group for group in measured.groups}
    assert groups["IMU biases"].count == 180
    redundancy = sum(group.redundancy for group in measured.groups)
    rows = sum(group.count for group in measured.groups)
    problem = measured.scene.problem
    assert rows - redundancy == pytest.approx(
        problem.width * problem.keyframes + 3 * problem.landmarks - 4
    )


def test_ways_agree_with_biases(selection: KeyframeSelection) -> None:
    rejection = reject_outliers(selection)
    problem, start = rejection.selection.problem(), rejection.state
    solutions = [
        solve(problem, start, handling, function_tolerance=1e-13) for handling in GaugeHandling
    ]
    assert len(solutions) > 0
    for each in solutions:
        assert each.cost == pytest.approx(solutions[0].cost, rel=1e-9)
        np.testing.assert_allclose(each.state.biases, solutions[0].state.biases, atol=1e-7)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--estimate-biases"], "--estimate-biases needs measured data"),
        (["--estimate-biases", "--bias-noise", "1,2"], "--bias-noise needs 4 numbers"),
        (
            ["--estimate-biases", "--bias-noise", "1,2,3,0"],
            "--bias-noise must be greater than zero",
        ),
    ],
)
def test_options_are_refused_in_a_sentence(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", "gauge", "--output", str(tmp_path / "study"), *options]) == 2
    assert said in capsys.readouterr().err
