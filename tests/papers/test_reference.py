"""The estimator against numbers worked out with 50 digits and numerical derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gauge_reference import Case
from visual_inertial_scenes import gradient, relative, to_left

from trajeval_ros.geometry import so3
from trajeval_ros.papers.gauge_trials import (
    fixed_covariance,
    free_covariance,
    transform,
)
from trajeval_ros.papers.solver import GaugeHandling, solve

NUMBERS, COVARIANCES = 1e-9, 1e-10


@pytest.fixture(scope="module")
def case(reference: Callable[[str], Any]) -> Case:
    return Case(reference("gauge"))


def test_preintegration(case: Case) -> None:
    assert len(case.numbers["preint"]) > 0
    for k, expected in enumerate(case.numbers["preint"]):
        computed = case.preintegrated
        assert relative(so3.log(computed.rotations[k]), np.array(expected["dR_rotvec"])) < NUMBERS
        assert relative(computed.velocities[k], np.array(expected["dv"])) < NUMBERS
        assert relative(computed.positions[k], np.array(expected["dp"])) < NUMBERS
        assert relative(computed.covariances[k], np.array(expected["cov"])) < COVARIANCES


def test_residuals_cost_gradient_and_curvature(case: Case) -> None:
    expected = case.numbers["at_estimate"]
    assert relative(case.state.first_turn, np.array(expected["dphi0"])) < NUMBERS
    visual, inertial = case.problem.residuals(case.state)
    assert relative(visual, np.array(expected["residual_visual_px"])) < NUMBERS
    # The reference's are not whitened: r^T Sigma^-1 r must agree.
    raw = np.array(expected["residual_imu_unwhitened_phi_v_p"])
    weighed = np.linalg.solve(case.preintegrated.covariances, raw[:, :, None])[:, :, 0]
    np.testing.assert_allclose(
        (inertial**2).sum(axis=1), (raw * weighed).sum(axis=1), rtol=NUMBERS
    )
    normal = case.problem.normal_equations(case.state)
    assert normal.cost == pytest.approx(expected["cost"], rel=NUMBERS)
    assert relative(gradient(normal), np.array(expected["gradient"])) < NUMBERS
    diagonal = np.concatenate(
        [
            np.diagonal(blocks, axis1=1, axis2=2).ravel()
            for blocks in (normal.diagonal, normal.landmark)
        ]
    )
    assert relative(diagonal, np.array(expected["hessian_diag"])) < NUMBERS


def test_covariances(case: Case) -> None:
    expected = case.numbers["at_estimate"]
    fixed = fixed_covariance(case.problem, case.state)
    assert relative(fixed, np.array(expected["cov_fixed"])) < COVARIANCES
    free = free_covariance(case.problem, case.state)
    assert relative(free, np.array(expected["cov_free_pinv"])) < COVARIANCES
    left = to_left(free, case.state)
    assert relative(left, np.array(case.numbers["cov_free_left"])) < COVARIANCES


def test_transformation_of_covariance(case: Case) -> None:
    free = free_covariance(case.problem, case.state)
    rotation = so3.exp(np.array([0.0, 0.0, 0.7]))
    expected = case.numbers["eq12"]
    covariance, state = transform(
        free, case.state, rotation @ case.reference_rotation, np.array(expected["new_ref_p0"])
    )
    assert relative(covariance, np.array(expected["cov"])) < COVARIANCES
    assert relative(state.positions, np.array(expected["thetaC_p"])) < NUMBERS
    assert relative(so3.log(state.rotations), np.array(expected["thetaC_rotvec"])) < NUMBERS
    assert relative(state.velocities, np.array(expected["thetaC_v"])) < NUMBERS
    assert relative(state.first_turn, np.array(expected["thetaC_dphi0"])) < NUMBERS

    expected = case.numbers["eq12_same_reference"]
    covariance, state = transform(
        free, case.state, case.reference_rotation, case.state.reference_position
    )
    assert relative(covariance, np.array(expected["cov"])) < COVARIANCES
    assert relative(state.positions, np.array(expected["thetaC_p"])) < NUMBERS


@pytest.mark.parametrize(
    ("handling", "name"),
    [
        (GaugeHandling.FIXATION, "fix"),
        (GaugeHandling.PRIOR, "prior"),
        (GaugeHandling.FREE, "free"),
    ],
)
def test_solver_takes_the_steps_of_ceres(case: Case, handling: GaugeHandling, name: str) -> None:
    expected = case.numbers["solver"][name]
    solution = solve(case.problem, case.state, handling, keep_last_step=False)
    assert solution.iterations == expected["ceres_iterations"]
    assert solution.reason == expected["ceres_reason"]
    assert solution.cost == pytest.approx(expected["ceres_cost"], rel=NUMBERS)
    converged = solve(case.problem, case.state, handling, function_tolerance=1e-14)
    assert converged.cost == pytest.approx(expected["converged_cost"], rel=NUMBERS)
    again = solve(case.problem, converged.state, handling, function_tolerance=1e-14)
    # A cost that is within 1e-14 of the least one is of an estimate that is within
    # sqrt(2 * 1e-14 * cost) standard deviations of the most likely one.
    fixed = handling is GaugeHandling.FIXATION
    covariance = (fixed_covariance if fixed else free_covariance)(case.problem, converged.state)
    sigmas = np.sqrt(np.diagonal(covariance)).reshape(-1, 9)
    short = np.sqrt(2e-14 * converged.cost)
    for name, sigma in (("positions", sigmas[:, :3].max()), ("velocities", sigmas[:, 6:].max())):
        result = getattr(converged.state, name)
        there = np.array(expected[f"converged_{name[0]}"])
        assert np.abs(getattr(again.state, name) - result).max() < short * sigma
        assert np.abs(result - there).max() < short * sigma
