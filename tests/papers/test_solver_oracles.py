"""The estimator against Ceres and GTSAM: run by `make oracles`, in an environment of their own."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from ceres_oracle import solve_with_ceres
from gtsam_oracle import GtsamProblem
from visual_inertial_scenes import CONFIGURATIONS, prior_covariance, relative, scene_of, to_left

from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.solver import GaugeHandling, solve
from trajeval_ros.papers.state import State

pytestmark = pytest.mark.oracles

TRIALS = range(3)
SWEEP = [10.0**power for power in range(11)]


def _trial(name: str, layout: str, trial: int) -> tuple[Problem, State]:
    scene = scene_of(name, layout)
    problem = scene.measured(np.random.default_rng([1, trial]))
    return problem, scene.disturbed(np.random.default_rng([2, trial]))


@pytest.fixture(scope="module")
def ceres() -> Any:
    return pytest.importorskip("pyceres", reason="Ceres is in the environment of `make oracles`")


@pytest.fixture(scope="module")
def gtsam() -> Any:
    return pytest.importorskip("gtsam", reason="GTSAM is in the environment of `make oracles`")


@pytest.mark.parametrize("trial", TRIALS)
@pytest.mark.parametrize("handling", GaugeHandling)
@pytest.mark.parametrize(("name", "layout"), CONFIGURATIONS)
def test_solver_goes_the_way_of_ceres(
    ceres: Any, name: str, layout: str, handling: GaugeHandling, trial: int
) -> None:
    problem, start = _trial(name, layout, trial)
    weight = 1e5 if handling is GaugeHandling.PRIOR else 0.0
    theirs = solve_with_ceres(ceres, problem, start, handling, weight)
    actual = solve(problem, start, handling, weight, keep_last_step=False)
    assert actual.iterations == theirs.iterations
    assert actual.cost == pytest.approx(theirs.cost, rel=1e-13)
    np.testing.assert_allclose(actual.state.positions, theirs.state.positions, atol=1e-9)
    np.testing.assert_allclose(actual.state.landmarks, theirs.state.landmarks, atol=1e-8)


@pytest.mark.parametrize("trial", range(4))
@pytest.mark.parametrize("weight", SWEEP)
def test_solver_goes_the_way_of_ceres_with_any_prior(
    ceres: Any, weight: float, trial: int
) -> None:
    problem, start = _trial("sine", "plane", trial)
    theirs = solve_with_ceres(ceres, problem, start, GaugeHandling.PRIOR, weight)
    actual = solve(problem, start, GaugeHandling.PRIOR, weight, keep_last_step=False)
    assert actual.iterations == theirs.iterations
    assert actual.cost == pytest.approx(theirs.cost, rel=1e-12)


@pytest.mark.parametrize(("name", "layout"), CONFIGURATIONS[:3])
def test_minimum_and_covariances_are_those_of_gtsam(gtsam: Any, name: str, layout: str) -> None:
    problem, start = _trial(name, layout, 0)
    weight = 1e5
    theirs = GtsamProblem(gtsam, problem, start, weight).solved()
    assert problem.cost(start) == pytest.approx(theirs.initial_cost, rel=1e-11)
    actual = solve(problem, start, GaugeHandling.PRIOR, weight, function_tolerance=1e-15)
    assert actual.cost == pytest.approx(theirs.cost, rel=3e-14)
    np.testing.assert_allclose(actual.state.positions, theirs.positions, atol=1e-8)
    np.testing.assert_allclose(actual.state.rotations, theirs.rotations, atol=1e-8)
    np.testing.assert_allclose(actual.state.landmarks, theirs.landmarks, atol=1e-7)
    # At GTSAM's minimum: where each solver stops depends on rounding, and so on the CPU.
    state = dataclasses.replace(
        actual.state,
        positions=theirs.positions,
        velocities=theirs.velocities,
        rotations=theirs.rotations,
        landmarks=theirs.landmarks,
    )
    covariance = to_left(prior_covariance(problem, state, weight), state)
    item = np.arange(problem.keyframes)
    marginals = covariance.reshape(problem.keyframes, 9, problem.keyframes, 9)[item, :, item]
    assert relative(marginals[:, :6, :6], theirs.marginals[:, :6, :6]) < 1e-9
    assert relative(marginals[:, 6:, 6:], theirs.marginals[:, 6:, 6:]) < 1e-9
