"""Samples of continuous groundtruth, and the choice of its model, in cases worked out by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from groundtruth_samples import samples_at
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.continuous_time import continuous_trajectory
from trajeval_ros.continuous_time.continuous_trajectory import (
    LinearInterpolation,
    MarkovPoses,
    NearestSample,
    fit_trajectory,
)
from trajeval_ros.continuous_time.samples import Belief, Noise, Samples
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.trajectory import Trajectory

Array = NDArray[np.float64]


def of_stamps(seconds: Array, positions: Array, turns: Array | None = None) -> Trajectory:
    quaternions = None if turns is None else Rotation.from_rotvec(turns).as_quat()
    stamps = 10**18 + np.rint(1e9 * seconds).astype(np.int64)
    return Trajectory(stamps, positions, quaternions)


def test_close_samples_are_merged_by_their_means() -> None:
    seconds = np.array([0.0, 1.0, 2.0, 2.004, 2.008, 3.0, 4.0, 4.0099, 5.0])
    positions = np.arange(27.0).reshape(9, 3)
    rotations = np.outer(np.array([0, 1, 2, 2.3, 2.6, 3, 4, 4.5, 5]) * 0.1, [0.0, 1.0, 0.0])
    samples = Samples.of(of_stamps(seconds, positions, rotations), Noise())
    # The median step is 0.995 s, of which 1 % is 9.95 ms.
    assert samples.merged == 3
    np.testing.assert_allclose(samples.times, [0, 1, 2.004, 3, 4.00495, 5], atol=1e-9)
    np.testing.assert_allclose(
        samples.poses[:, :3, 3],
        [positions[0], positions[1], positions[3], positions[5], positions[6] + 1.5, positions[8]],
    )
    angles = np.linalg.norm(so3.log(samples.poses[:, :3, :3]), axis=1)
    np.testing.assert_allclose(angles, [0, 0.1, 0.23, 0.3, 0.425, 0.5], atol=1e-12)
    apart = seconds.copy()
    apart[[3, 4, 7]] = [2.0101, 2.0202, 4.0101]
    assert Samples.of(of_stamps(apart, positions), Noise()).merged == 0
    # Below a microsecond, samples are merged however fast they are.
    fast = 1e-7 * np.array([0.0, 20.0, 40.0, 49.0, 60.0, 80.0])
    assert Samples.of(of_stamps(fast, np.zeros((6, 3))), Noise()).merged == 1


def test_samples_of_two_poses_are_enough() -> None:
    two = of_stamps(np.array([0.0, 1.0]), np.zeros((2, 3)))
    assert len(Samples.of(two, Noise())) == 2
    near = dataclasses.replace(two, stamps=two.stamps[0] + np.array([0, 999]))
    with pytest.raises(InputError, match="too short"):
        Samples.of(near, Noise())


def test_simple_rules_between_two_samples() -> None:
    rotations = np.outer([0.0, 0.4, 0.4], [0.0, 0.0, 1.0])
    samples = samples_at(np.array([0.0, 2.0, 3.0]), np.outer([0, 4, 10], [1.0, 0, 0]), rotations)
    asked = np.array([0.5, 1.0, 1.5, 2.25, 3.0])
    linear = LinearInterpolation(samples).at(asked)
    np.testing.assert_allclose(linear.poses[:, 0, 3], [1, 2, 3, 5.5, 10], atol=1e-12)
    angles = so3.log(linear.poses[:, :3, :3])[:, 2]
    np.testing.assert_allclose(angles, [0.1, 0.2, 0.3, 0.4, 0.4], atol=1e-12)
    nearest = NearestSample(samples).at(asked)
    np.testing.assert_array_equal(nearest.poses[:, 0, 3], [0, 0, 4, 4, 10])
    expected = np.diag(np.repeat([0.01**2, 0.02**2], 3))
    for belief in (linear, nearest):
        np.testing.assert_allclose(belief.covariances, np.tile(expected, (5, 1, 1)))
    bare = NearestSample(dataclasses.replace(samples, oriented=False)).at(asked)
    expected[3:] = 0.0
    np.testing.assert_allclose(bare.covariances[0], expected)


def test_the_span_of_samples_includes_its_ends() -> None:
    seconds = np.arange(12.0)
    fitted = fit_trajectory(of_stamps(seconds, np.outer(seconds, [1.0, 0, 0])), "linear")
    stamps = 10**18 + np.array([-1, 0, 11 * 10**9, 11 * 10**9 + 1])
    assert fitted.covers(stamps).tolist() == [False, True, True, False]
    assert fitted.statements == ()
    assert isinstance(fitted.markov, MarkovPoses)
    assert fitted.markov.positions.process.order == 2
    jerk = fit_trajectory(of_stamps(seconds, np.outer(seconds, [1.0, 0, 0])), "wnoj")
    assert jerk.markov is jerk.poses
    assert jerk.markov.positions.process.order == 3


@pytest.mark.parametrize("oriented", [True, False])
def test_auto_is_the_candidate_of_the_largest_held_out_likelihood(
    monkeypatch: pytest.MonkeyPatch, oriented: bool
) -> None:
    """Candidates that differ in their covariances; the best one is that of the actual errors."""
    generator = np.random.default_rng(5)
    seconds = np.arange(240.0)
    noise = Noise(0.05, 0.02)
    positions = generator.normal(scale=0.05, size=(240, 3))
    rotations = generator.normal(scale=0.02, size=(240, 3))

    class Constant:
        """The mean at rest, with a covariance."""

        def __init__(self, factor: float) -> None:
            self.factor = factor

        def at(self, times: Array) -> Belief:
            spread = np.diag(np.repeat([0.05**2, 0.02**2], 3)) * self.factor
            return Belief(
                np.tile(np.eye(4), (len(times), 1, 1)), np.tile(spread, (len(times), 1, 1))
            )

    # Independent errors of samples add their noise: the likelihood is largest without more.
    factors = {"matern": 1.0, "wnoa": 1e-6, "wnoj": 10.0}
    fits = {name: lambda _, f=f: Constant(f) for name, f in factors.items()}
    monkeypatch.setattr(continuous_trajectory, "_FITS", {**continuous_trajectory._FITS, **fits})
    samples = Samples.of(of_stamps(seconds, positions, rotations if oriented else None), noise)
    assert continuous_trajectory._most_predictive(samples) == "wnoa"
    few = samples[np.arange(7)]
    assert continuous_trajectory._most_predictive(few) == "matern"
