"""What holds for every scene: Jacobians, the gauge's null space, covariances and their gauges."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from visual_inertial_scenes import (
    CONFIGURATIONS,
    dense_hessian,
    frobenius,
    gradient,
    numeric_jacobian,
    prior_covariance,
    relative,
    scene_of,
    solved,
    stacked_residuals,
    visual_errors,
)

from trajeval_ros.exceptions import DegenerateGeometryError, SettingsError
from trajeval_ros.geometry import so3
from trajeval_ros.papers.gauge_trials import (
    fixed_covariance,
    free_covariance,
    transform,
)
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.reduction import reduce_landmarks
from trajeval_ros.papers.scene import PROFILES, Scene, make_scene, profile_named
from trajeval_ros.papers.solver import GAUGE_INDICES, GaugeHandling, solve
from trajeval_ros.papers.state import State
from trajeval_ros.simulation.motion import shape

E_Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def small() -> Scene:
    return make_scene(shape("arc"), "random", PROFILES["paper"], 1, keyframes=4, landmarks=12)


def _anywhere(scene: Scene, seed: int) -> State:
    """Return a state that is no minimum, with a first rotation away from its reference."""
    generator = np.random.default_rng(seed)
    state = scene.disturbed(generator)
    reference = so3.exp(generator.uniform(-0.5, 0.5, 3)) @ state.rotations[0]
    return state.referred_to(reference, state.positions[0] + 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_normal_equations_are_those_of_the_numeric_jacobian(small: Scene, seed: int) -> None:
    problem = small.measured(np.random.default_rng(seed))
    state = _anywhere(small, seed)
    jacobian, normal = numeric_jacobian(problem, state), problem.normal_equations(state)
    assert relative(gradient(normal), jacobian.T @ stacked_residuals(problem, state)) < 1e-6
    assert relative(dense_hessian(normal), jacobian.T @ jacobian) < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_gauge_moves_no_residual(small: Scene, seed: int) -> None:
    problem = small.measured(np.random.default_rng(seed))
    state = _anywhere(small, seed)
    basis = state.gauge_basis
    motion, landmarks = basis[: 9 * problem.keyframes], basis[9 * problem.keyframes :]
    motion = motion.reshape(-1, 9, 4)
    visual = visual_errors(problem, state)
    # E U, with the first rotation turned into left coordinates.
    rotated = motion[:, 3:6].copy()
    rotated[0] = so3.left_jacobian(state.first_turn) @ rotated[0]
    relative_motion = (
        landmarks.reshape(-1, 3, 4)[problem.visibility.landmark_of]
        - motion[problem.visibility.keyframe_of, :3]
        + so3.skew(visual.rays) @ rotated[problem.visibility.keyframe_of]
    )
    scale = np.abs(visual.by_point).max() * np.abs(basis).max()
    assert np.abs(visual.by_point @ relative_motion).max() < 1e-12 * scale
    inertial = problem.inertial(state)
    moved = inertial.by_before @ motion[:-1] + inertial.by_after @ motion[1:]
    assert np.abs(moved).max() < 1e-12 * np.abs(inertial.by_before).max() * np.abs(basis).max()


@pytest.mark.slow
@given(st.floats(-3.0, 3.0), st.lists(st.floats(-10.0, 10.0), min_size=3, max_size=3))
def test_cost_is_constant_on_the_orbit(small: Scene, yaw: float, translation: list[float]) -> None:
    problem, state = small.measured(np.random.default_rng(0)), _anywhere(small, 0)
    moved = state.transformed(so3.exp(yaw * E_Z), np.array(translation))
    assert problem.cost(moved) == pytest.approx(problem.cost(state), rel=1e-12)


@pytest.mark.parametrize(("name", "layout"), CONFIGURATIONS)
def test_perfect_sensors_leave_no_residual_at_the_truth(name: str, layout: str) -> None:
    scene = scene_of(name, layout, "euroc")
    assert np.abs(stacked_residuals(scene.noise_free(), scene.groundtruth)).max() < 1e-9


@pytest.mark.parametrize(("name", "layout"), CONFIGURATIONS)
def test_hessian_has_exactly_the_gauge_as_its_null_space(name: str, layout: str) -> None:
    scene = scene_of(name, layout)
    hessian = dense_hessian(scene.noise_free().normal_equations(scene.groundtruth))
    eigenvalues = np.linalg.eigvalsh(hessian)
    assert np.abs(eigenvalues[:4]).max() < 1e-12 * eigenvalues[-1]
    assert eigenvalues[4] > 1e-12 * eigenvalues[-1]
    basis = scene.groundtruth.gauge_basis
    assert np.abs(hessian @ basis).max() < 1e-12 * np.abs(hessian).max() * np.abs(basis).max()


def test_covariances_are_the_dense_inverse_and_pseudo_inverse() -> None:
    problem, state = solved(scene_of("arc", "plane"), 0)
    hessian = dense_hessian(problem.normal_equations(state))
    motion = 9 * problem.keyframes
    kept = np.setdiff1d(np.arange(len(hessian)), GAUGE_INDICES)
    expected = np.zeros_like(hessian)
    expected[np.ix_(kept, kept)] = np.linalg.inv(hessian[np.ix_(kept, kept)])
    assert frobenius(fixed_covariance(problem, state), expected[:motion, :motion]) < 1e-8

    values, vectors = np.linalg.eigh(hessian)
    pseudo_inverse = (vectors[:, 4:] / values[4:]) @ vectors[:, 4:].T
    free = free_covariance(problem, state)
    assert frobenius(free, pseudo_inverse[:motion, :motion]) < 1e-7


@pytest.mark.parametrize(("name", "layout"), CONFIGURATIONS)
def test_transformed_free_covariance_is_that_of_fixation(name: str, layout: str) -> None:
    problem, state = solved(scene_of(name, layout), 0)
    free = free_covariance(problem, state)
    reference = state.reference_rotation, state.reference_position
    moved_covariance, moved = transform(free, state, *reference)
    np.testing.assert_allclose(moved.positions[0], state.reference_position, atol=1e-12)
    assert abs(moved.first_turn[2]) < 1e-12
    fixed = fixed_covariance(problem, moved)
    assert frobenius(moved_covariance, fixed) < 1e-9
    # Without the transformation they have nothing to do with each other.
    assert frobenius(free, fixed) > 1e-2
    # Between two solves, only what they lack in convergence.
    separate = solve(
        problem, _start(problem, state), GaugeHandling.FIXATION, function_tolerance=1e-9
    )
    assert frobenius(moved_covariance, fixed_covariance(problem, separate.state)) < 1e-4


def _start(problem: Problem, state: State) -> State:
    """Return a state at the references, off the minimum by a little."""
    noise = np.random.default_rng(5).normal(0.0, 0.01, 9 * problem.keyframes)
    noise = np.concatenate([noise, np.zeros(state.landmarks.size)])
    start = state.moved(noise)
    rotation_step = state.reference_rotation
    angle = so3.yaw_of_matrix(rotation_step @ start.rotations[0].T)
    rotation = so3.exp(angle * E_Z)
    moved = start.transformed(rotation, state.reference_position - rotation @ start.positions[0])
    return moved.referred_to(state.reference_rotation, state.reference_position)


@pytest.mark.parametrize("yaw", [-2.0, 0.7])
def test_transformation_to_another_reference_rotation(yaw: float) -> None:
    """With a new reference, the appendix's J_r^-1 J_r would be off by a percent."""
    problem, state = solved(scene_of("rec", "random"), 3)
    tilt = so3.exp(np.array([0.05, -0.08, 0.0]))
    rotation = so3.exp(yaw * E_Z) @ tilt @ state.reference_rotation
    covariance, moved = transform(
        free_covariance(problem, state), state, rotation, np.array([3.0, -2.0, 1.0])
    )
    assert frobenius(covariance, fixed_covariance(problem, moved)) < 1e-9


@pytest.mark.parametrize("weight", [1e2, 1e5, 1e8])
def test_prior_adds_its_own_covariance_to_that_of_fixation(weight: float) -> None:
    problem, state = solved(scene_of("sine", "plane"), 2)
    reduced = reduce_landmarks(
        problem.normal_equations(state),
        np.zeros(9 * problem.keyframes),
        np.zeros((problem.landmarks, 3)),
    )
    reduced.matrix.diagonal[GAUGE_INDICES] += weight
    information = reduced.matrix.dense()
    prior = prior_covariance(problem, state, weight)
    assert frobenius(prior, np.linalg.inv(information)) < 1e-8
    moved_covariance, moved = transform(
        prior, state, state.reference_rotation, state.reference_position
    )
    assert frobenius(moved_covariance, fixed_covariance(problem, moved)) < 1e-8


def test_says_when_landmarks_leave_more_than_the_gauge_open() -> None:
    scene = scene_of()
    problem = scene.noise_free()
    seen = np.ones(len(problem.pixels), dtype=bool)
    for landmark in (7, 9):
        seen[np.flatnonzero(problem.visibility.landmark_of == landmark)[1:]] = False
    once = Problem(
        problem.camera,
        problem.camera_in_body,
        problem.pixels[seen],
        problem.visibility.keyframe_of[seen],
        problem.visibility.landmark_of[seen],
        problem.landmarks,
        problem.preintegrated,
    )
    with pytest.raises(DegenerateGeometryError, match=r"2 landmarks .* the first is 7"):
        free_covariance(once, scene.groundtruth)


def test_refuses_scenes_that_are_none() -> None:
    paper = PROFILES["paper"]
    with pytest.raises(SettingsError, match="unknown shape"):
        shape("circle")
    with pytest.raises(SettingsError, match="unknown layout"):
        make_scene(shape("arc"), "walls", paper, 0)
    with pytest.raises(SettingsError, match="unknown profile"):
        profile_named("honest")
    with pytest.raises(SettingsError, match="too few"):
        make_scene(shape("arc"), "plane", paper, 0, keyframes=2)
    with pytest.raises(SettingsError, match="too many"):
        make_scene(shape("arc"), "plane", paper, 0, keyframes=2000)
    with pytest.raises(SettingsError, match="too few"):
        make_scene(shape("arc"), "plane", paper, 0, landmarks=3)
    with pytest.raises(DegenerateGeometryError, match="observed by 3 keyframes"):
        make_scene(shape("arc", 200.0), "random", paper, 0, keyframes=5, track=1)


@pytest.mark.parametrize("free", [4, 6])
def test_only_position_and_yaw_may_be_free(free: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.random.default_rng(free).normal(size=(15 - free, 15))
    reduced = SimpleNamespace(matrix=SimpleNamespace(dense=lambda: rows.T @ rows))
    monkeypatch.setattr("trajeval_ros.papers.gauge_trials._undamped", lambda *_: reduced)
    nothing: Any = None
    if free == 4:
        covariance = fixed_covariance(nothing, nothing)
        kept = np.setdiff1d(np.arange(15), GAUGE_INDICES)
        product = covariance[np.ix_(kept, kept)] @ (rows.T @ rows)[np.ix_(kept, kept)]
        np.testing.assert_allclose(product, np.eye(11), atol=1e-6)
        return
    with pytest.raises(DegenerateGeometryError, match="do not determine all directions except"):
        fixed_covariance(nothing, nothing)
