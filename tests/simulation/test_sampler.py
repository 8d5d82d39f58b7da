"""Samples of the estimator's Gaussian, short and long."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from visual_inertial_scenes import frobenius, scene_of

from trajeval_ros.exceptions import DegenerateGeometryError, SettingsError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.banded_matrices import BandedGaussian
from trajeval_ros.papers.flight import Sampler
from trajeval_ros.papers.gauge_trials import fixed_covariance
from trajeval_ros.papers.scene import PROFILES, Scene, make_scene
from trajeval_ros.simulation.motion import shape


@pytest.fixture(scope="module")
def long() -> Scene:
    paper = PROFILES["paper"]
    return make_scene(shape("sine", 30.0), "random", paper, 0, 60, 700, track=5)


@pytest.mark.parametrize(("size", "width"), [(1, 0), (7, 6), (50, 3), (50, 20), (51, 50)])
def test_banded_gaussian_is_the_dense_one(size: int, width: int) -> None:
    generator = np.random.default_rng(size + width)
    root = np.triu(np.tril(generator.normal(size=(size, size))), -width) + 5.0 * np.eye(size)
    information = root @ root.T
    gaussian = BandedGaussian(scipy.sparse.csr_matrix(information))
    covariance = np.linalg.inv(information)
    # The samples of all unit vectors are a square root of the covariance.
    root = gaussian.sampled(np.eye(size))
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-12)
    columns = generator.normal(size=(size, 2))
    np.testing.assert_allclose(gaussian.solved(columns), covariance @ columns, atol=1e-12)
    block = min(size, 3)
    starts = np.arange(size - block + 1)
    blocks = gaussian.marginals(starts, block)
    for start, computed in zip(starts, blocks, strict=True):
        rows = slice(start, start + block)
        np.testing.assert_allclose(computed, covariance[rows, rows], atol=1e-12)


def test_banded_gaussian_refuses_what_is_no_information() -> None:
    with pytest.raises(DegenerateGeometryError, match="do not determine all directions"):
        BandedGaussian(scipy.sparse.csr_matrix(np.diag([1.0, 0.0, 1.0])))


@pytest.mark.parametrize("of_a_track", [False, True])
def test_run_states_the_estimators_own_covariance(long: Scene, *, of_a_track: bool) -> None:
    scene = long if of_a_track else scene_of("arc", "plane")
    fixed = fixed_covariance(scene.noise_free(), scene.groundtruth)
    run = Sampler(scene).draw(np.random.default_rng(4))
    state, truth = run.state, scene.groundtruth
    count = len(truth.positions)
    # Back from the run's frame, which is turned about gravity as its landmarks are.
    rotation = _turn_between(truth.landmarks, state.landmarks)
    assert rotation[2, 2] == pytest.approx(1.0)
    wide = np.kron(np.eye(3), rotation)
    expected = fixed.reshape(count, 9, count, 9)[np.arange(count), :, np.arange(count)]
    assert frobenius(run.marginals, wide @ expected @ wide.T) < 1e-9
    everywhere = np.kron(np.eye(3 * count), rotation)
    rotated = everywhere @ fixed @ everywhere.T
    # Any generalised inverse: S H S = S.
    assert frobenius(rotated @ (run.information @ rotated), rotated) < 1e-8


def _turn_between(points: np.ndarray, moved: np.ndarray) -> np.ndarray:
    centred, rotated = points - points.mean(axis=0), moved - moved.mean(axis=0)
    rotation = np.linalg.lstsq(centred, rotated, rcond=None)[0].T
    return so3.exp(so3.log(rotation[None]))[0]


def test_tracks_end(long: Scene) -> None:
    for landmark in (0, 100, 600):
        seen = long.keyframe_of[long.landmark_of == landmark]
        assert len(seen) >= 3
        assert np.ptp(seen) <= 10


def test_same_seed_gives_the_same_run(long: Scene) -> None:
    first, again, other = (Sampler(long).draw(np.random.default_rng(s)).state for s in (0, 0, 1))
    np.testing.assert_array_equal(first.positions, again.positions)
    assert not np.array_equal(first.positions, other.positions)


def test_landmarks_are_drawn_in_the_layouts_that_exist() -> None:
    with pytest.raises(SettingsError, match="layout"):
        make_scene(shape("sine"), "cloud", PROFILES["paper"], 0)
