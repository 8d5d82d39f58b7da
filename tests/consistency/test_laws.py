"""What a change of gauge must and must not do to a covariance."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from consistency_runs import (
    ALIGNMENTS,
    aligned_run,
    alignment_of,
    poses_of,
    some_covariance,
    trajectory_of,
)
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from visual_inertial_scenes import frobenius, scene_of, to_left

from trajeval_ros.consistency.nees import (
    chi_square_band,
    diagonal_blocks,
    effective_dof,
    extra_directions,
    joint_nees,
    joint_nees_by_information,
    pose_nees,
)
from trajeval_ros.consistency.s_transformation import (
    STransformation,
    carried,
    carried_information,
    errors_of,
)
from trajeval_ros.exceptions import DegenerateGeometryError, InputError, SettingsError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.marker import at_arms
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.papers.flight import SampledEstimate, Sampler
from trajeval_ros.papers.gauge_trials import (
    fixed_covariance,
    free_covariance,
)
from trajeval_ros.papers.scene import Scene

SUBSETS = [*ALIGNMENTS, (Gauge.YAW, 4), (Gauge.SE3, 5), (Gauge.SIM3, 5)]
DOWN = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of("rec", "random")


@pytest.fixture(scope="module")
def run(scene: Scene) -> SampledEstimate:
    return Sampler(scene).draw(np.random.default_rng(8))


@pytest.fixture(scope="module")
def sides(scene: Scene, run: SampledEstimate) -> tuple[Trajectory, Trajectory]:
    return trajectory_of(scene, scene.groundtruth), trajectory_of(scene, run.state)


def _dense(transformation: STransformation) -> np.ndarray:
    orbit = transformation.orbit.reshape(-1, transformation.orbit.shape[2])
    return np.eye(len(orbit)) - orbit @ transformation.coefficients


@pytest.mark.parametrize(("gauge", "states"), SUBSETS)
def test_it_is_an_oblique_projector(
    sides: tuple[Trajectory, Trajectory], gauge: Gauge, states: int | None
) -> None:
    truth, estimate = sides
    moved = alignment_of(gauge, states, truth, estimate).trajectory(estimate)
    item = STransformation.of_alignment(gauge, states, truth, moved)
    projector = _dense(item)
    np.testing.assert_allclose(projector @ projector, projector, atol=1e-12)
    open_ = item.orbit.shape[2]
    np.testing.assert_allclose(projector @ item.orbit.reshape(-1, open_), 0.0, atol=1e-12)
    np.testing.assert_allclose(item.normals.reshape(-1, open_).T @ projector, 0.0, atol=1e-12)
    some = np.random.default_rng(1).normal(size=projector.shape)
    some = some @ some.T
    np.testing.assert_allclose(item.covariance(some), projector @ some @ projector.T, atol=1e-9)


@pytest.mark.parametrize(("gauge", "states"), SUBSETS)
def test_it_is_the_derivative_of_perturb_and_align_again(
    sides: tuple[Trajectory, Trajectory], gauge: Gauge, states: int | None
) -> None:
    truth, estimate = sides
    similarity = alignment_of(gauge, states, truth, estimate)
    moved = similarity.trajectory(estimate)
    item = STransformation.of_alignment(gauge, states, truth, moved)
    generator, step = np.random.default_rng(2), 1e-5
    for _ in range(5):
        direction = generator.normal(size=(len(truth), 6))
        ends = []
        for sign in (1.0, -1.0):
            part = sign * step * direction
            other = Trajectory(
                estimate.stamps,
                estimate.positions + part[:, :3],
                (Rotation.from_rotvec(part[:, 3:]) * estimate.rotations).as_quat(),
            )
            again = alignment_of(gauge, states, truth, other).trajectory(other)
            ends.append(errors_of(moved, again))
        numeric = (ends[0] - ends[1]) / (2.0 * step)
        rotated = np.concatenate(
            [
                similarity.vectors(direction[:, :3]),
                direction[:, 3:] @ similarity.rotation.T,
            ],
            axis=1,
        )
        expected = (_dense(item) @ rotated.ravel()).reshape(numeric.shape)
        assert np.abs(numeric - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize(("gauge", "states"), ALIGNMENTS)
def test_it_forgets_which_gauge_the_covariance_came_from(
    scene: Scene, gauge: Gauge, states: int | None
) -> None:
    problem, state = scene.measured(np.random.default_rng(0)), scene.groundtruth
    truth = trajectory_of(scene, scene.groundtruth)
    rotation, shift = so3.exp(0.9 * DOWN), np.array([4.0, -1.0, 2.0])
    elsewhere = trajectory_of(scene, state.transformed(rotation, shift))
    # Turned with its states, velocities as well.
    there = np.kron(np.eye(3 * len(truth)), rotation)
    outcomes = [
        aligned_run(gauge, states, truth, elsewhere, there @ covariance @ there.T).covariance
        for covariance in (
            to_left(free_covariance(problem, state), state),
            to_left(fixed_covariance(problem, state), state),
        )
    ]
    assert frobenius(outcomes[1], outcomes[0]) < 1e-10


def test_first_state_and_all_states_are_one_gauge_for_yaw(
    sides: tuple[Trajectory, Trajectory], run: SampledEstimate
) -> None:
    truth, estimate = sides
    covariance = some_covariance(run.information.toarray())
    first = aligned_run(Gauge.YAW, 1, truth, estimate, covariance)
    everywhere = aligned_run(Gauge.YAW, None, truth, estimate, covariance)
    between = Similarity(everywhere.similarity.rotation @ first.similarity.rotation.T, np.zeros(3))
    back = everywhere.transformation.covariance(carried(first.covariance, between))
    assert frobenius(back, everywhere.covariance) < 1e-8
    # Through Sim(3) there is no way back: what it removes was information.
    lost = aligned_run(Gauge.SIM3, None, truth, estimate, covariance).covariance
    assert frobenius(everywhere.transformation.covariance(lost), everywhere.covariance) > 0.1


@pytest.mark.parametrize("seed", range(5))
def test_joint_nees_is_the_same_in_every_gauge_of_the_group(scene: Scene, seed: int) -> None:
    run = Sampler(scene).draw(np.random.default_rng(seed))
    truth, estimate = trajectory_of(scene, scene.groundtruth), trajectory_of(scene, run.state)
    covariance = some_covariance(run.information.toarray())
    first, everywhere = (
        joint_nees(item.errors, item.covariance, item.transformation.normals)
        for item in (
            aligned_run(Gauge.YAW, states, truth, estimate, covariance) for states in (1, None)
        )
    )
    assert first == pytest.approx(everywhere, rel=1e-3)


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize(("gauge", "states"), ALIGNMENTS)
def test_sparse_information_gives_the_nees_of_the_dense_covariance(
    scene: Scene, gauge: Gauge, states: int | None, *, noisy: bool
) -> None:
    """Both linearised at the estimate, so that only rounding may tell them apart."""
    problem, state = scene.measured(np.random.default_rng(0)), scene.groundtruth
    estimate = trajectory_of(scene, state)
    shift = np.random.default_rng(3).normal(0.0, 0.01, (len(estimate), 3))
    truth = Trajectory(
        estimate.stamps,
        estimate.positions + shift,
        (Rotation.from_rotvec(shift / 10.0) * estimate.rotations).as_quat(),
    )
    covariance = to_left(free_covariance(problem, state), state)
    from trajeval_ros.papers.reduction import information_of

    information = information_of(problem, state)
    similarity = alignment_of(gauge, states, truth, estimate)
    moved = similarity.trajectory(estimate)
    item = STransformation.of_alignment(gauge, states, truth, moved)
    noise = None
    rotated = carried(poses_of(covariance), similarity)
    if noisy:  # of another marker for each state, to tell their blocks apart
        variances = np.repeat([0.002**2, np.radians(0.1) ** 2], 3)
        independent = np.broadcast_to(np.diag(variances), (len(truth), 6, 6))
        noise = at_arms(independent, np.random.default_rng(4).normal(size=(len(truth), 3)))
        rotated += scipy.linalg.block_diag(*noise)
    # What the conditions leave open to second order is no part of the comparison.
    errors = (_dense(item) @ errors_of(truth, moved).ravel()).reshape(-1, 6)
    dense = joint_nees(errors, item.covariance(rotated), item.normals)
    sparse = carried_information(scipy.sparse.csr_matrix(information), similarity, 9)
    extra = extra_directions(item)
    assert joint_nees_by_information(errors, sparse, extra, noise) == pytest.approx(
        dense, rel=1e-6
    )


def test_effective_dof_of_independent_and_of_equal_states() -> None:
    generator = np.random.default_rng(0)
    root = generator.normal(size=(6, 6))
    one = root @ root.T + np.eye(6)
    assert effective_dof(np.kron(np.eye(5), one), 6) == pytest.approx(30.0)
    assert effective_dof(np.kron(np.ones((5, 5)), one), 6) == pytest.approx(6.0)
    assert diagonal_blocks(np.kron(np.eye(5), one), 6)[3] == pytest.approx(one)


def test_band_of_chi_square() -> None:
    low, high = chi_square_band(6)
    assert (low, high) == pytest.approx((chi2.ppf(0.025, 6) / 6, chi2.ppf(0.975, 6) / 6))
    narrow = chi_square_band(500 * 6)
    assert 0.9 < narrow[0] < 1.0 < narrow[1] < 1.1


def test_refuses_what_has_no_covariance_in_the_gauge(
    sides: tuple[Trajectory, Trajectory], run: SampledEstimate
) -> None:
    truth, estimate = sides
    for gauge in (Gauge.PLANAR, Gauge.TRANSLATION):
        with pytest.raises(SettingsError, match=gauge.value):
            STransformation.of_alignment(gauge, None, truth, estimate)
    bare = Trajectory(truth.stamps, truth.positions)
    with pytest.raises(InputError, match="no orientations"):
        STransformation.of_alignment(Gauge.YAW, None, bare, estimate)
    still = Trajectory(truth.stamps, np.ones_like(truth.positions), truth.quaternions)
    with pytest.raises(DegenerateGeometryError, match="do not determine"):
        STransformation.of_alignment(Gauge.SE3, None, still, still)
    item = aligned_run(
        Gauge.YAW, None, truth, estimate, some_covariance(run.information.toarray())
    )
    low_rank = np.diag(np.r_[np.ones(25), np.zeros(35)])
    with pytest.raises(InputError, match="rank is too low"):
        joint_nees(
            item.errors, item.transformation.covariance(low_rank), item.transformation.normals
        )


def test_large_coordinates_cost_no_digits(
    sides: tuple[Trajectory, Trajectory], run: SampledEstimate
) -> None:
    truth, estimate = sides
    covariance = some_covariance(run.information.toarray())
    far = Trajectory(
        truth.stamps, truth.positions + [6e5, 5e6, 300.0], truth.quaternions, truth.velocities
    )
    near, away = (
        aligned_run(Gauge.SE3, None, item, estimate, covariance) for item in (truth, far)
    )
    assert frobenius(away.covariance, near.covariance) < 1e-6


def test_nees_of_poses_is_by_the_inverse_of_their_covariances_in_any_units() -> None:
    random = np.random.default_rng(4)
    roots = random.normal(size=(20, 6, 6)) * (10.0 ** random.uniform(-4.0, 4.0, 6))[:, None]
    errors = np.einsum("nij,nj->ni", roots, random.normal(size=(20, 6)))
    covariances = roots @ np.swapaxes(roots, 1, 2)
    # Errors are roots times white numbers w, so that their NEES is |w|^2, whatever the units.
    white = np.linalg.solve(roots, errors[:, :, None])[:, :, 0]
    assert pose_nees(errors, covariances) == pytest.approx(np.sum(white**2, axis=1), rel=1e-6)
