"""What measured data asks of the estimator: lever arm, weights, a stereo pair, uneven samples."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from visual_inertial_scenes import (
    dense_hessian,
    gradient,
    numeric_jacobian,
    relative,
    stacked_residuals,
    visual_errors,
)

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.inertial import GRAVITY, ImuNoise, preintegrate
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.reprojection_errors import Camera
from trajeval_ros.papers.scene import PROFILES, Scene, make_scene
from trajeval_ros.papers.solver import GAUGE_INDICES, GaugeHandling, solve
from trajeval_ros.papers.state import State
from trajeval_ros.simulation.motion import shape

LEVER_ARM = np.array([0.1, -0.2, 0.05])


def _scene(profile: str = "paper") -> Scene:
    return make_scene(shape("arc"), "random", PROFILES[profile], 1, keyframes=4, landmarks=12)


def _changed(problem: Problem, **changes: Any) -> Problem:
    """Return the problem with other measurements or options."""
    visibility = problem.visibility
    return Problem(
        problem.camera,
        problem.camera_in_body,
        changes.pop("pixels", problem.pixels),
        changes.pop("keyframe_of", visibility.keyframe_of),
        changes.pop("landmark_of", visibility.landmark_of),
        problem.landmarks,
        changes.pop("preintegrated", problem.preintegrated),
        **changes,
    )


def _weights(problem: Problem) -> np.ndarray:
    count, size = problem.pixels.shape
    return np.eye(size) + np.random.default_rng(3).uniform(-0.4, 0.4, (count, size, size))


@pytest.mark.parametrize("profile", ["paper", "stereo"])
def test_normal_equations_with_lever_arm_and_weights(profile: str) -> None:
    scene = _scene(profile)
    problem = scene.measured(np.random.default_rng(0))
    problem = _changed(problem, lever_arm=LEVER_ARM, weights=_weights(problem))
    state = scene.disturbed(np.random.default_rng(1))
    state = state.referred_to(so3.exp(np.full(3, 0.2)) @ state.rotations[0], state.positions[0])
    jacobian, normal = numeric_jacobian(problem, state), problem.normal_equations(state)
    residuals = stacked_residuals(problem, state)
    assert relative(gradient(normal), jacobian.T @ residuals) < 1e-6
    assert relative(dense_hessian(normal), jacobian.T @ jacobian) < 1e-6
    assert normal.cost == pytest.approx(problem.cost(state), rel=1e-12)


def test_lever_arm_is_where_the_camera_is() -> None:
    scene = _scene()
    problem = scene.noise_free()
    # The same images, seen by a body that is elsewhere.
    lever = np.einsum("nij,j->ni", scene.groundtruth.rotations, LEVER_ARM)
    body = dataclasses.replace(scene.groundtruth, positions=scene.groundtruth.positions - lever)
    visual, _ = _changed(problem, lever_arm=LEVER_ARM).residuals(body)
    assert np.abs(visual).max() < 1e-9
    assert np.abs(problem.residuals(body)[0]).max() > 1.0


def test_weights_multiply_errors() -> None:
    scene = _scene()
    problem, state = scene.noise_free(), scene.disturbed(np.random.default_rng(1))
    weights = _weights(problem)
    plain = problem.residuals(state)[0]
    weighted = _changed(problem, weights=weights).residuals(state)[0]
    expected = [weight @ error for weight, error in zip(weights, plain, strict=True)]
    np.testing.assert_allclose(weighted, expected, rtol=1e-12)


def test_gravity_is_what_is_given() -> None:
    scene = _scene()
    problem, truth = scene.noise_free(), scene.groundtruth
    stronger = _changed(problem, gravity=GRAVITY + [0.0, 0.0, -0.1])
    # What falls faster needs a body that accelerates: velocities and positions that follow it.
    times = scene.times_s[:, None]
    fallen = np.array([0.0, 0.0, -0.1])
    faster = dataclasses.replace(
        truth,
        positions=truth.positions + fallen * times**2 / 2.0,
        velocities=truth.velocities + fallen * times,
    )
    assert np.abs(stronger.residuals(faster)[1]).max() < 1e-6
    assert np.abs(problem.residuals(faster)[1]).max() > 0.1


def test_samples_that_hold_for_no_time_change_nothing() -> None:
    generator = np.random.default_rng(4)
    rates, forces = generator.normal(size=(2, 3, 7, 3))
    noise = ImuNoise(1e-3, 1e-2)
    steps = generator.uniform(0.002, 0.008, (3, 7))
    steps[1, 5:] = steps[2, 3:] = 0.0
    together = preintegrate(rates, forces, steps, noise)
    for interval, count in enumerate((7, 5, 3)):
        item = slice(interval, interval + 1)
        alone = preintegrate(rates[item, :count], forces[item, :count], steps[item, :count], noise)
        assert vars(alone)
        for name, column in vars(alone).items():
            np.testing.assert_allclose(
                getattr(together, name)[interval], column[0], rtol=1e-12, atol=1e-18
            )


def test_a_sample_may_be_cut_in_two() -> None:
    """The noise of a sample is white: two halves are as sure as the whole."""
    rates, forces = np.full((1, 2, 3), 0.3), np.full((1, 2, 3), 1.0)
    noise = ImuNoise(1e-3, 1e-2)
    whole = preintegrate(rates[:, :1], forces[:, :1], 0.01, noise)
    halves = preintegrate(rates, forces, np.array([[0.004, 0.006]]), noise)
    np.testing.assert_allclose(halves.durations_s, whole.durations_s, rtol=1e-12)
    np.testing.assert_allclose(halves.rotations, whole.rotations, atol=1e-12)
    np.testing.assert_allclose(halves.velocities, whole.velocities, atol=1e-5)
    own = slice(0, 6)
    np.testing.assert_allclose(
        halves.covariances[0, own, own], whole.covariances[0, own, own], rtol=1e-2, atol=1e-10
    )


def _visual_hessian(problem: Problem, state: State) -> np.ndarray:
    """Return J^T J (6N + 3K, 6N + 3K) of the images alone, for poses and landmarks."""
    count, (_, by_point, rays) = problem.keyframes, visual_errors(problem, state)
    jacobian = np.zeros((*by_point.shape[:2], 2 * count + problem.landmarks, 3))
    rows = np.arange(len(by_point))
    jacobian[rows, :, 2 * problem.visibility.keyframe_of] = -by_point
    jacobian[rows, :, 2 * problem.visibility.keyframe_of + 1] = by_point @ so3.skew(rays)
    jacobian[rows, :, 2 * count + problem.visibility.landmark_of] = by_point
    jacobian = jacobian.reshape(by_point.shape[0] * by_point.shape[1], -1)
    # Metres and radians apart.
    jacobian /= np.linalg.norm(jacobian, axis=0)
    return jacobian.T @ jacobian


def _nullity(hessian: np.ndarray) -> int:
    eigenvalues = np.linalg.eigvalsh(hessian)
    return int(np.count_nonzero(eigenvalues < 1e-12 * eigenvalues[-1]))


@pytest.mark.parametrize(("profile", "freedom"), [("paper", 7), ("stereo", 6)])
def test_images_alone_leave_a_similarity_or_a_rigid_motion_open(
    profile: str, freedom: int
) -> None:
    """The tutorial's Table I: Sim(3) for one camera, SE(3) for two."""
    scene = make_scene(shape("arc"), "random", PROFILES[profile], 1, keyframes=6, landmarks=30)
    problem, truth = scene.noise_free(), scene.groundtruth
    assert _nullity(_visual_hessian(problem, truth)) == freedom
    scaled = dataclasses.replace(
        truth, positions=1.1 * truth.positions, landmarks=1.1 * truth.landmarks
    )
    moves = np.abs(problem.residuals(scaled)[0]).max()
    assert moves > 0.1 if freedom == 6 else moves < 1e-9
    rotation = so3.exp(np.array([0.3, -0.5, 0.8]))
    rotated = truth.transformed(rotation, np.array([1.0, 2.0, 3.0]))
    assert np.abs(problem.residuals(rotated)[0]).max() < 1e-9


@pytest.mark.parametrize("profile", ["paper", "stereo"])
def test_an_imu_leaves_yaw_and_translation_open(profile: str) -> None:
    scene = make_scene(shape("arc"), "random", PROFILES[profile], 1, keyframes=6, landmarks=30)
    hessian = dense_hessian(scene.noise_free().normal_equations(scene.groundtruth))
    units = 1.0 / np.sqrt(np.diagonal(hessian))
    assert _nullity(hessian * units * units[:, None]) == 4


@pytest.mark.parametrize(("keyframes", "track"), [(4, None), (40, 2)])
@pytest.mark.parametrize("weight", [10.0, 1e5])
def test_prior_takes_part_in_the_damping(weight: float, keyframes: int, track: int | None) -> None:
    """Short tracks are eliminated and factorised by sparse and banded forms: the same step."""
    scene = make_scene(
        shape("arc"), "random", PROFILES["paper"], 1,
        keyframes=keyframes, landmarks=30, track=track,
    )  # fmt: skip
    problem, start = scene.noise_free(), scene.disturbed(np.random.default_rng(1))
    # The first step of Levenberg-Marquardt, with the prior as four more residuals.
    normal = problem.normal_equations(start)
    hessian = dense_hessian(normal)
    hessian[GAUGE_INDICES, GAUGE_INDICES] += weight
    step = np.linalg.solve(hessian + np.diag(np.diagonal(hessian) / 1e4), -gradient(normal))
    moved = start.moved(step)
    shift = np.append(moved.positions[0] - start.positions[0], moved.first_turn[2])
    expected = problem.cost(moved) + 0.5 * weight * float(shift @ shift)
    result = solve(problem, start, GaugeHandling.PRIOR, weight).trace
    assert result.cost[1] == pytest.approx(expected, rel=1e-9)


def test_nothing_observed_is_refused() -> None:
    problem = _scene().noise_free()
    nothing = np.zeros(0, dtype=np.int64)
    with pytest.raises(InputError, match=r"\(0\) from 4 keyframes"):
        _changed(problem, pixels=np.zeros((0, 2)), keyframe_of=nothing, landmark_of=nothing)
    no_interval = preintegrate(np.zeros((0, 5, 3)), np.zeros((0, 5, 3)), 0.005, ImuNoise(1.0, 1.0))
    with pytest.raises(InputError, match="from 1 keyframes"):
        _changed(problem, preintegrated=no_interval)


def test_a_camera_sees_what_is_in_front_of_it_and_in_range() -> None:
    depths = np.array([-40.0, -0.5, 0.0, 0.29, 0.31, 29.0, 31.0])
    seen = Camera(400.0, 640, 480).in_view(depths[:, None] * [0.0, 0.0, 1.0])
    assert seen.tolist() == [False, False, False, False, True, True, False]
