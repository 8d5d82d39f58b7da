"""Covariances as messages carry them: pose by pose, or not known at all."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from consistency_runs import aligned_run, some_covariance, trajectory_of
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from strategies import make_groundtruth
from visual_inertial_scenes import frobenius, scene_of

from trajeval_ros.consistency.consistency_assessment import (
    AlignedStates,
    assess_consistency,
    assess_marginals,
)
from trajeval_ros.consistency.covariance_request import CovarianceRequest, IntegrityRequest
from trajeval_ros.consistency.integrity import integrity_of
from trajeval_ros.consistency.joint_covariance import JointCovariance
from trajeval_ros.consistency.nees import diagonal_blocks
from trajeval_ros.consistency.s_transformation import (
    STransformation,
    initial_uncertainty,
    is_covariance,
    unknown_covariances,
    upper_bounds,
    without_initial_prior,
)
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.covariance_frames import world_from_body_rotations
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.papers.gauge_trials import fixed_covariance
from trajeval_ros.papers.solver import GAUGE_INDICES
from trajeval_ros.pipeline.pipeline import evaluate


def _good(count: int = 5) -> np.ndarray:
    root = np.random.default_rng(0).normal(size=(count, 6, 6))
    return root @ np.swapaxes(root, 1, 2) * 1e-3


def _spoilt(row: int, value: float | np.ndarray) -> np.ndarray:
    covariances = _good()
    covariances[row] = value
    return covariances


def _variance(value: float) -> np.ndarray:
    covariances = _good()
    covariances[2, 4, 4] = value
    return covariances


def _skew() -> np.ndarray:
    covariances = _good()
    covariances[2, 0, 1] *= 3.0
    return covariances


@pytest.mark.parametrize(
    ("covariances", "why"),
    [
        (np.zeros((5, 6, 6)), "all are zero"),
        (_spoilt(3, 0.0), "some are all zero"),
        (_spoilt(3, -np.eye(6)), "negative"),
        (_variance(-1.0), "negative"),
        (_variance(1e9), "1e\\+09"),
        (_variance(np.nan), "not finite"),
        (_variance(0.0), "some variances are zero"),
        (np.tile(np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 1.0]), (5, 1, 1)), "variances are zero"),
        (_variance(1e-9), "not symmetric"),
        (_skew(), "not symmetric"),
    ],
)
def test_covariances_that_say_nothing(covariances: np.ndarray, why: str) -> None:
    assert why.replace("\\", "") in unknown_covariances(covariances)


def test_covariances_that_say_something() -> None:
    assert unknown_covariances(_good()) == ""
    # Of the first pose zero is an answer: the estimator's world begins there.
    assert unknown_covariances(_spoilt(0, 0.0)) == ""
    assert is_covariance(_good().astype(np.float32).astype(float)).all()


@pytest.mark.parametrize(
    ("gauge", "states"), [(Gauge.YAW, 2), (Gauge.SE3, 3), (Gauge.SIM3, 3)], ids=str
)
def test_states_that_an_alignment_makes_exact_have_no_nees(gauge: Gauge, states: int) -> None:
    """Three positions that determine an alignment have no error perpendicular to their plane."""
    generator = np.random.default_rng(1)
    truth = make_groundtruth(2, 8)
    noisy = truth.positions + 1e-3 * generator.normal(size=(8, 3))
    estimate = dataclasses.replace(truth, positions=noisy, covariances=_good(8))
    joint = JointCovariance(
        truth.stamps, noisy, truth.quaternions, 6, scipy.linalg.block_diag(*_good(8))
    )
    protocol = Protocol(gauge=gauge, align_states=states, lengths=())
    evaluation = evaluate(truth, estimate, protocol)
    for covariance in (CovarianceRequest("joint", joint), CovarianceRequest("message")):
        nees = assess_consistency(evaluation, covariance).pose_nees
        np.testing.assert_array_equal(np.isfinite(nees.pose), np.arange(8) >= states)
    few = evaluate(truth[:states], estimate[:states], protocol)
    with pytest.raises(InputError, match=f"needs at least {states + 1} pairs, found {states}"):
        assess_consistency(few, CovarianceRequest("message"))


def _in_plane(unset: float) -> AlignedStates:
    """Return a robot whose x, y and yaw have the errors that their covariances state."""
    count, random = 400, np.random.default_rng(5)
    root = 0.02 * random.normal(size=(count, 3, 3)) + 0.05 * np.eye(3)
    errors = np.einsum("nij,nj->ni", root, random.normal(size=(count, 3)))
    covariances = np.zeros((count, 6, 6))
    covariances[:, range(6), range(6)] = unset
    covariances[np.ix_(range(count), [0, 1, 5], [0, 1, 5])] = root @ root.swapaxes(1, 2)
    positions = np.column_stack([random.normal(size=(count, 2)), np.zeros(count)])
    headings = random.uniform(-3.0, 3.0, count)
    stamps = np.arange(count) * 10**8
    truth, estimate = (
        Trajectory(
            stamps,
            positions + moved,
            Rotation.from_rotvec(np.outer(headings + rotated, [0.0, 0.0, 1.0])).as_quat(),
        )
        for moved, rotated in ((0.0, 0.0), (np.c_[errors[:, :2], np.ones(count)], errors[:, 2]))
    )
    estimate = dataclasses.replace(estimate, covariances=covariances)
    return AlignedStates(truth, estimate, Similarity.identity(), Gauge.NONE, None)


@pytest.mark.parametrize("unset", [0.0, 1e9])
def test_a_robot_in_a_plane_is_tested_in_three_degrees_of_freedom(unset: float) -> None:
    run = _in_plane(unset)
    result = assess_marginals(run, from_the_start=True)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 3 * 400) / (3 * 400)
    assert low < result.per_pose.mean < high
    assert result.per_pose.limit_95 == pytest.approx(chi2.isf(0.05 / 400, 3) / 3)
    assert result.axes == (2, 1)
    assert not result.errors[:, 2:5].any()  # the height is wrong by 1 m, and has no variance
    bounds = [
        assess_marginals(dataclasses.replace(run, gauge=gauge), from_the_start=True)
        for gauge in (Gauge.PLANAR, Gauge.YAW)
    ]
    assert [bound.exactness for bound in bounds] == ["bound", "bound"]
    np.testing.assert_allclose(bounds[0].nees, bounds[1].nees, rtol=1e-12)
    assert (bounds[0].nees <= result.nees + 1e-12).mean() > 0.9
    parts = integrity_of(result, IntegrityRequest(0.5, 5.0), run.estimate.stamps).parts
    assert [part.part for part in parts] == ["horizontal", "heading"]
    with pytest.raises(InputError, match="use gauge planar or yaw"):
        assess_marginals(dataclasses.replace(run, gauge=Gauge.SE3), from_the_start=True)


def test_gauge_planar_uses_the_block_of_x_y_and_yaw() -> None:
    run = dataclasses.replace(_in_plane(0.0), gauge=Gauge.PLANAR)
    full = run.estimate.covariances + np.diag([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])
    other = dataclasses.replace(run.estimate, covariances=full)
    nees = [
        assess_marginals(dataclasses.replace(run, estimate=item), from_the_start=True).nees
        for item in (run.estimate, other)
    ]
    np.testing.assert_array_equal(*nees)


@pytest.mark.parametrize("shape", [(6,), (6, 6), (1, 6, 6), (4, 6, 6), (5, 6), (5, 3, 3)])
def test_noise_is_a_covariance_per_state(shape: tuple[int, ...]) -> None:
    run = dataclasses.replace(make_groundtruth(0, 5), covariances=_good())
    aligned = AlignedStates(run, run, Similarity.identity(), Gauge.YAW, 1, _good())
    with pytest.raises(ValueError, match=rf"noise has shape {re.escape(str(shape))}, expected"):
        dataclasses.replace(aligned, noise=np.ones(shape))


@given(st.integers(0, 1000))
def test_body_axes_are_turned_into_the_worlds(seed: int) -> None:
    generator = np.random.default_rng(seed)
    rotation = Rotation.random(3, random_state=seed)
    covariance = _good(3)
    matrices = rotation.as_matrix()
    rotated = world_from_body_rotations(covariance, matrices)
    # R exp(d) = exp(R d) R: a body-frame error d is R d in the world.
    error = generator.normal(size=(3, 6))
    world = error.copy()
    world[:, 3:] = rotation.apply(error[:, 3:])
    body_nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    world_nees = np.einsum("ni,nij,nj->n", world, np.linalg.inv(rotated), world)
    np.testing.assert_allclose(world_nees, body_nees, rtol=1e-6)


@pytest.fixture(scope="module")
def with_prior() -> tuple[np.ndarray, np.ndarray, STransformation]:
    """Marginals with a prior of position and yaw, those of fixation, and the gauge."""
    scene = scene_of("sine", "plane")
    fixed = fixed_covariance(scene.noise_free(), scene.groundtruth)
    basis = scene.groundtruth.gauge_basis[: len(fixed)]
    oblique = basis @ np.linalg.inv(basis[GAUGE_INDICES])
    prior = oblique @ np.diag([1e-4, 2e-4, 1e-4, 3e-5]) @ oblique.T
    truth = trajectory_of(scene, scene.groundtruth)
    transformation = STransformation.of_alignment(Gauge.YAW, 1, truth, truth)
    blocks = (diagonal_blocks(item, 9)[:, :6, :6] for item in (fixed + prior, fixed))
    return (*blocks, transformation)


def test_a_prior_of_position_and_yaw_comes_off_pose_by_pose(
    with_prior: tuple[np.ndarray, np.ndarray, STransformation],
) -> None:
    published, fixed, transformation = with_prior
    stripped = without_initial_prior(published, transformation)
    assert frobenius(stripped, fixed) < 1e-8
    assert np.abs(initial_uncertainty(stripped, transformation)).max() < 1e-15
    wrong = published.copy()
    wrong[0] *= 100.0
    with pytest.raises(InputError, match="is not only a prior"):
        without_initial_prior(wrong, transformation)


def test_bound_contains_the_covariance_and_is_tight_in_the_estimators_gauge() -> None:
    scene = scene_of("arc", "random")
    truth = trajectory_of(scene, scene.groundtruth)
    problem = scene.noise_free()
    from trajeval_ros.papers.reduction import information_of

    covariance = some_covariance(information_of(problem, scene.groundtruth).toarray())
    published = aligned_run(Gauge.YAW, 1, truth, truth, covariance).covariance
    marginals = diagonal_blocks(published, 6)
    own = STransformation.of_alignment(Gauge.YAW, 1, truth, truth)
    assert frobenius(upper_bounds(marginals, own), marginals) < 1e-6
    for gauge, states in ((Gauge.YAW, None), (Gauge.YAW, 4), (Gauge.SIM3, None)):
        item = STransformation.of_alignment(gauge, states, truth, truth)
        exact = aligned_run(gauge, states, truth, truth, covariance).covariance
        slack = upper_bounds(marginals, item) - diagonal_blocks(exact, 6)
        units = np.sqrt(np.diagonal(slack, axis1=1, axis2=2).max(axis=0))
        assert np.linalg.eigvalsh(slack / units / units[:, None]).min() > -1e-9
    none = STransformation.of_alignment(Gauge.NONE, None, truth, truth)
    np.testing.assert_array_equal(upper_bounds(marginals, none), marginals)


@pytest.mark.parametrize(
    ("gauge", "states", "without"),
    [(Gauge.YAW, 1, 1), (Gauge.SE3, 1, 1), (Gauge.NONE, 1, 0), (Gauge.YAW, None, 0)],
)
def test_only_a_first_pose_that_is_aligned_by_has_no_nees(
    gauge: Gauge, states: int | None, without: int
) -> None:
    run = dataclasses.replace(make_groundtruth(0, 12), covariances=_good(12))
    aligned = AlignedStates(run, run, Similarity.identity(), gauge, states)
    assert aligned.first_with_nees == without
    judged = assess_marginals(aligned, from_the_start=True)
    assert judged.per_pose is not None
    assert judged.per_pose.poses == 12 - without


@pytest.mark.parametrize(
    ("gauge", "states", "from_the_start", "exactness"),
    [
        (Gauge.NONE, None, False, "exact"),
        (Gauge.YAW, 1, True, "exact"),
        (Gauge.YAW, 1, False, "bound"),
        (Gauge.YAW, None, True, "bound"),
        (Gauge.SE3, 1, True, "bound"),
    ],
)
def test_single_poses_are_exact_in_the_estimators_own_gauge_alone(
    gauge: Gauge, states: int | None, from_the_start: bool, exactness: str
) -> None:
    # The estimator fixes position and yaw at its first pose.
    first = np.zeros((1, 6, 6))
    first[0, 3:5, 3:5] = 1e-4 * np.eye(2)
    run = make_groundtruth(0, 12)
    run = dataclasses.replace(run, covariances=np.concatenate([first, _good(11)]))
    aligned = AlignedStates(run, run, Similarity.identity(), gauge, states)
    assert assess_marginals(aligned, from_the_start=from_the_start).exactness == exactness


@pytest.mark.parametrize("gauge", ["free", "prior"])
def test_an_indefinite_information_is_told_with_what_may_be_open(gauge: str) -> None:
    run = make_groundtruth(0, 2)
    information = scipy.sparse.csr_matrix(np.diag([*np.ones(11), -1.0]))
    parts = run.stamps, run.positions, np.asarray(run.quaternions), 6, None, information
    with pytest.raises(InputError, match="information matrix is not positive definite") as told:
        JointCovariance(*parts, gauge).pose_covariance(np.arange(2))
    assert ("except for position and yaw" in str(told.value)) == (gauge == "free")


@pytest.mark.parametrize("gauge", [Gauge.NONE, Gauge.YAW])
def test_a_single_pair_is_told_so_and_nothing_of_its_covariance(gauge: Gauge) -> None:
    run = dataclasses.replace(make_groundtruth(0, 2), covariances=_good(2))
    two = AlignedStates(run, run, Similarity.identity(), gauge, 1)
    assert assess_marginals(two, from_the_start=True).per_pose is not None
    one = dataclasses.replace(two, groundtruth=run[:1], estimate=run[:1])
    with pytest.raises(InputError, match="needs at least 2 pairs"):
        assess_marginals(one, from_the_start=True)
