"""Runs too long for a dense covariance, judged by their sparse information."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from consistency_runs import ALIGNMENTS, alignment_of, band_of_mean
from scipy.spatial.transform import Rotation
from visual_inertial_scenes import frobenius

from trajeval_ros.consistency import joint_covariance
from trajeval_ros.consistency.consistency_assessment import (
    AlignedStates,
    assess_joint,
    assess_marginals,
)
from trajeval_ros.consistency.joint_covariance import JointCovariance
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.papers.flight import Flight, Odometry, fly
from trajeval_ros.papers.scene import PROFILES

RUNS = 4  # with 2394 degrees of freedom: their mean NEES is known to 1.4 %


def _joint(odometry: Odometry) -> JointCovariance:
    estimate = odometry.estimate
    quaternions = np.asarray(estimate.quaternions)
    parts = estimate.stamps, estimate.positions, quaternions, 9, None, odometry.information
    return JointCovariance(*parts, "free")


@functools.cache
def _long_runs() -> tuple[Flight, list[Odometry]]:
    """Return a flight of 400 keyframes, and runs of the estimator on it."""
    flight = fly(5, 40.0, PROFILES["euroc"])
    return flight, list(flight.runs(5, RUNS))


def _measured(truth: Trajectory, sigmas: np.ndarray, seed: int) -> Trajectory:
    noise = sigmas * np.random.default_rng(seed).standard_normal((len(truth), 6))
    return Trajectory(
        truth.stamps,
        truth.positions + noise[:, :3],
        (Rotation.from_rotvec(noise[:, 3:]) * truth.rotations).as_quat(),
    )


def _condition(odometry: Odometry) -> float:
    """Return the condition number of the information in units of its diagonal, gauge apart."""
    information = odometry.information.toarray()
    units = np.sqrt(np.diagonal(information))
    values = np.linalg.eigvalsh(information / units / units[:, None])
    return float(values[-1] / values[4])  # position and yaw are open


def _noise(sigmas: Floats, count: int) -> Floats:
    """Return the covariances (N, 6, 6) of independent errors."""
    return np.tile(np.diag(sigmas**2), (count, 1, 1))


@pytest.mark.slow
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("alignment", ALIGNMENTS)
def test_bands_of_a_long_run_are_those_of_the_dense_covariance(
    alignment: tuple[Gauge, int | None], monkeypatch: pytest.MonkeyPatch, *, noisy: bool
) -> None:
    flight = fly(5, 6.0, PROFILES["euroc"])
    [odometry] = flight.runs(3, 1)
    estimate = odometry.estimate[::2]  # not all of its poses have groundtruth
    truth = flight.groundtruth[np.searchsorted(flight.groundtruth.stamps, estimate.stamps)]
    similarity = alignment_of(*alignment, truth, estimate)
    noise = _noise(np.repeat([0.002, np.radians(0.1)], 3), len(truth)) if noisy else None
    aligned = AlignedStates(truth, estimate, similarity, *alignment, noise)
    dense = assess_joint(aligned, _joint(odometry), "run")
    monkeypatch.setattr(joint_covariance, "MOST_DENSE", 120)
    assert not _joint(odometry).is_dense
    long = assess_joint(aligned, _joint(odometry), "run")
    assert dense.covariances is not None
    assert long.covariances is not None
    # Two inverses of one matrix, each known to u times its condition number.
    rounding = np.finfo(np.float64).eps * _condition(odometry)
    assert rounding < 1e-6
    assert frobenius(long.covariances, dense.covariances) < rounding
    assert long.joint is not None
    assert dense.joint is not None
    assert long.joint.nees == pytest.approx(dense.joint.nees, rel=1e-5)
    assert long.per_pose is not None
    assert long.per_pose.effective_dof is None


@pytest.mark.slow
def test_more_keyframes_than_a_dense_covariance_has_are_honest_in_every_gauge() -> None:
    flight, runs = _long_runs()
    sigmas = np.repeat([0.002, np.radians(0.1)], 3)
    shares: dict[object, list[float]] = {alignment: [] for alignment in ALIGNMENTS}
    means, dof = [], 0
    for seed, odometry in enumerate(runs):
        assert not _joint(odometry).is_dense
        estimate = odometry.estimate
        truth = flight.groundtruth[np.searchsorted(flight.groundtruth.stamps, estimate.stamps)]
        truth = _measured(truth, sigmas, seed)
        for gauge, states in ALIGNMENTS:
            similarity = alignment_of(gauge, states, truth, estimate)
            noise = _noise(sigmas, len(truth))
            aligned = AlignedStates(truth, estimate, similarity, gauge, states, noise)
            judged = assess_joint(aligned, _joint(odometry), "run")
            assert judged.per_pose is not None
            means.append(judged.per_pose.mean)
            assert judged.joint is not None
            dof = judged.joint.dof
            shares[gauge, states].append(judged.joint.nees / dof)
    assert 0.75 < np.mean(means) < 1.33  # each of few degrees of freedom
    low, high = band_of_mean(dof, RUNS)
    for values in shares.values():
        assert low < np.mean(values) < high


@pytest.mark.slow
def test_states_without_groundtruth_and_a_late_start_are_handled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flight = fly(1, 8.0, PROFILES["paper"])
    (odometry,) = flight.runs(1, 1)
    everything = odometry.estimate
    gauge, states = ALIGNMENTS[0]
    matched = everything[10::3]
    truth = flight.groundtruth[np.searchsorted(flight.groundtruth.stamps, matched.stamps)]
    similarity = alignment_of(gauge, states, truth, matched)
    aligned = AlignedStates(truth, matched, similarity, gauge, states)
    judged = assess_joint(aligned, _joint(odometry), "run")
    assert judged.joint is not None
    assert judged.joint.dof == 6 * len(matched) - 4
    low, high = band_of_mean(judged.joint.dof, 1)
    assert low < judged.joint.nees / judged.joint.dof < high
    monkeypatch.setattr("trajeval_ros.consistency.joint_covariance.MOST_DENSE", 0)
    sparse = assess_joint(aligned, _joint(odometry), "run")
    assert sparse.joint is not None
    assert sparse.per_pose is not None
    assert judged.per_pose is not None
    assert sparse.per_pose.mean == pytest.approx(judged.per_pose.mean, rel=1e-6)
    assert sparse.joint.nees == pytest.approx(judged.joint.nees, rel=1e-3)
    # A bag that begins later has another first pose than the estimator's own: only a bound.
    assert assess_marginals(aligned, from_the_start=False).exactness == "bound"
