"""Sums over observations, windows of landmarks, and the motion's matrix in both storages."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from visual_inertial_scenes import dense_hessian, frobenius, gradient, relative

from trajeval_ros.papers.gauge_trials import fixed_covariance
from trajeval_ros.papers.reduction import MotionMatrix, reduce_landmarks
from trajeval_ros.papers.scene import PROFILES, make_scene
from trajeval_ros.papers.solver import GAUGE_INDICES, GaugeHandling, solve
from trajeval_ros.papers.visibility import Visibility
from trajeval_ros.simulation.motion import shape

KEYFRAMES, LANDMARKS = 50, 12


def _banded(track: int, keyframes: int) -> Visibility:
    """Every landmark is seen from `track` keyframes in sequence."""
    landmarks = keyframes - track + 1
    landmark_of, offset = np.divmod(np.arange(track * landmarks), track)
    return Visibility(landmark_of + offset, landmark_of, keyframes, landmarks)


@pytest.mark.slow
@settings(max_examples=30)
@given(
    st.sampled_from([2, 3, 5, 30]),
    st.sampled_from([9, 15]),
    arrays(np.float64, 4, elements=st.floats(0.5, 2.0)),
)
def test_a_motion_matrix_is_the_dense_one(track: int, width: int, scales: np.ndarray) -> None:
    """With tracks of 2, 3 and 5 of 30 keyframes it is banded."""
    keyframes, generator = 30, np.random.default_rng(int(1e6 * scales[0]))
    visibility = _banded(track, keyframes)
    matrix = MotionMatrix(visibility, width)
    expected = np.zeros((keyframes, width, keyframes, width))
    item = np.arange(keyframes)
    diagonal = generator.normal(size=(keyframes, width, width)) * scales[1]
    diagonal = diagonal + diagonal.swapaxes(1, 2)
    below = generator.normal(size=(keyframes - 1, width, width)) * scales[2]
    expected[item, :, item] = diagonal
    expected[item[1:], :, item[:-1]] = below
    expected[item[:-1], :, item[1:]] = below.swapaxes(1, 2)
    matrix.blocks(0)[:] = diagonal
    matrix.blocks(1)[:] = below
    for window in visibility.windows:
        vector = generator.normal(size=(window.keyframes, width))
        # A landmark couples its own keyframes alone.
        vector[track:] = 0.0
        own = slice(window.first, window.last)
        product = np.einsum("ia,jb->iajb", vector, vector)
        matrix.window(window.first, window.last)[:] += product
        expected[own, :, own] += product
    size = width * keyframes
    expected = expected.reshape(size, size)
    np.testing.assert_allclose(matrix.dense(), expected, atol=1e-12)

    matrix.diagonal[:] += 50.0 * width
    expected[np.diag_indices(size)] += 50.0 * width
    matrix.hold(GAUGE_INDICES)
    expected[GAUGE_INDICES] = expected[:, GAUGE_INDICES] = 0.0
    expected[GAUGE_INDICES, GAUGE_INDICES] = 1.0
    np.testing.assert_allclose(matrix.dense(), expected, atol=1e-12)
    right = generator.normal(size=size)
    np.testing.assert_allclose(matrix.solved(right), np.linalg.solve(expected, right), rtol=1e-9)


@pytest.mark.parametrize(("track", "is_banded"), [(2, True), (None, False)])
def test_elimination_is_that_of_dense_matrices(track: int | None, is_banded: bool) -> None:
    scene = make_scene(
        shape("arc"), "random", PROFILES["paper"], 1, keyframes=40, landmarks=60, track=track
    )
    problem, state = scene.noise_free(), scene.groundtruth
    assert (problem.visibility.longest_track <= 10) is is_banded
    normal = problem.normal_equations(state)
    assert relative(normal.diagonal, normal.diagonal.swapaxes(1, 2)) < 1e-12
    damping = np.linspace(1.0, 2.0, 9 * 40), np.linspace(1.0, 2.0, 180).reshape(60, 3)
    reduced = reduce_landmarks(normal, *damping)
    hessian = dense_hessian(normal) + np.diag(np.concatenate([item.ravel() for item in damping]))
    own, cross, rest = hessian[360:, 360:], hessian[:360, 360:], hessian[:360, :360]
    expected = rest - cross @ np.linalg.solve(own, cross.T)
    assert relative(reduced.matrix.dense(), expected) < 1e-10
    forces = gradient(normal)
    own_gradient = forces[:360] - cross @ np.linalg.solve(own, forces[360:])
    assert relative(reduced.gradient.ravel(), own_gradient) < 1e-9
    motion = np.linspace(-1.0, 1.0, 360)
    step = np.linalg.solve(own, -forces[360:] - cross.T @ motion)
    assert relative(reduced.landmarks_after(motion), step) < 1e-9
    # Covariances use the same elimination.
    kept = np.setdiff1d(np.arange(540), GAUGE_INDICES)
    inverse = np.zeros((540, 540))
    inverse[np.ix_(kept, kept)] = np.linalg.inv(dense_hessian(normal)[np.ix_(kept, kept)])
    assert frobenius(fixed_covariance(problem, state), inverse[:360, :360]) < 1e-6


@pytest.mark.parametrize("track", [2, None])
def test_fixation_holds_position_and_yaw(track: int | None) -> None:
    scene = make_scene(
        shape("sine"), "random", PROFILES["paper"], 0, keyframes=40, landmarks=80, track=track
    )
    problem = scene.measured(np.random.default_rng(3))
    start = scene.disturbed(np.random.default_rng(4))
    result = solve(problem, start, GaugeHandling.FIXATION)
    np.testing.assert_array_equal(result.state.positions[0], start.positions[0])
    assert result.state.first_turn[2] == 0.0
    assert result.cost < problem.cost(start) / 10.0
