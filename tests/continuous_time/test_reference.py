"""Continuous-time models against continuous-time.json, computed once with other programs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dense_joint import dense_covariance
from se3_manifold import Poses
from solved_process import solved

from trajeval_ros.continuous_time.joint_groundtruth import JointPosterior
from trajeval_ros.continuous_time.kernels import (
    MATERN_52,
    SQUARED_EXPONENTIAL,
    Hyperparameters,
    negative_log_likelihood,
)
from trajeval_ros.continuous_time.manifolds import Positions, Rotations
from trajeval_ros.continuous_time.piecewise_gp import GPSegments, PiecewiseGP
from trajeval_ros.continuous_time.samples import Belief, Noise, Samples
from trajeval_ros.geometry import se3

KERNELS = {"se": SQUARED_EXPONENTIAL, "m52": MATERN_52}
CLOSE: Any = {"rtol": 1e-11, "atol": 1e-11}


@pytest.fixture(scope="module")
def numbers(reference: Any) -> Any:
    return reference("continuous-time")


def test_lie_groups(numbers: Any) -> None:
    lie = {name: np.array(value) for name, value in numbers["lie"].items()}
    exact: Any = {"rtol": 1e-12, "atol": 1e-12}
    np.testing.assert_allclose(se3.exp(lie["xi"]), lie["Exp"], **exact)
    np.testing.assert_allclose(se3.log(lie["Exp"]), lie["xi"], **exact)
    np.testing.assert_allclose(se3.adjoint(lie["Exp"]), lie["Ad"], **exact)
    np.testing.assert_allclose(se3.left_jacobian(lie["xi"]), lie["Jl"], **exact)
    np.testing.assert_allclose(se3.inverse_left_jacobian(lie["xi"]), lie["Jl_inv"], **exact)
    determinants = 2.0 * se3.log_determinant(lie["xi"][:, 3:])
    np.testing.assert_allclose(determinants, lie["logabsdet_Jl"], **exact)


def piecewise_process(given: Any, case: Any) -> PiecewiseGP:
    hyperparameters = [Hyperparameters(*case[f"hyper_{name}"]) for name in ("trans", "rot")]
    noise = Noise(hyperparameters[0].noise, hyperparameters[1].noise)
    samples = Samples(0, np.array(given["t"]), np.array(given["T"]), True, noise)
    segments = GPSegments.of(samples, case["n"], joint=case["coords"] == "se3")
    kernel = KERNELS[case["kernel"]]
    return PiecewiseGP.conditioned(
        segments, [(kernel, hyperparameter) for hyperparameter in hyperparameters]
    )


@pytest.mark.parametrize("place", range(4))
def test_piecewise_gp_of_eq_30_to_32(numbers: Any, place: int) -> None:
    given = numbers["piecewise_gp"]
    case = given["cases"][place]
    kernel = KERNELS[case["kernel"]]
    process = piecewise_process(given, case)
    for expected, belief in (
        (case["pou"], process.at(np.array(given["tq"]))),
        (
            case["segment1"],
            process.in_segment(np.ones(3, dtype=np.int64), np.array(case["segment1"]["tq"])),
        ),
    ):
        np.testing.assert_allclose(belief.poses, expected["mean"], **CLOSE)
        np.testing.assert_allclose(belief.covariances, expected["cov"], **CLOSE)
    times = process.segments.times
    lags = times[:, :, None] - times[:, None, :]
    for block, name in enumerate(("trans", "rot")):
        value, gradient = negative_log_likelihood(
            kernel,
            lags,
            process.segments.coordinates[..., 3 * block : 3 * block + 3],
            np.log(case[f"hyper_{name}"]),
        )
        assert -value == pytest.approx(case[f"logml_{name}"], rel=1e-11)
        np.testing.assert_allclose(-gradient, case[f"dlogml_{name}_dlog"], rtol=1e-9)


def averaged_precisions(process: PiecewiseGP, times: np.ndarray) -> Belief:
    """Blend by generalised products of experts, which are too sure where experts disagree."""
    first, second, weight = process.segments.around(times)
    one, other = process.in_segment(first, times), process.in_segment(second, times)
    apart = se3.log(se3.inverse(one.poses) @ other.poses)
    carried = se3.congruent(se3.inverse_left_jacobian(-apart), other.covariances)
    share = weight[:, None, None]
    theirs = np.linalg.inv(carried)
    covariances = np.linalg.inv((1.0 - share) * np.linalg.inv(one.covariances) + share * theirs)
    mean = weight[:, None] * se3.times(covariances @ theirs, apart)
    moved = se3.congruent(se3.left_jacobian(-mean), covariances)
    return Belief(one.poses @ se3.exp(mean), moved)


@pytest.mark.parametrize("place", range(4))
def test_experts_and_their_weights_by_another_blending(numbers: Any, place: int) -> None:
    given = numbers["piecewise_gp"]
    case = given["cases"][place]
    process = piecewise_process(given, case)
    result = averaged_precisions(process, np.array(given["tq"]))
    np.testing.assert_allclose(result.poses, case["gpoe"]["mean"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(result.covariances, case["gpoe"]["cov"], rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("group", ["r3", "so3", "se3"])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_markov_processes(numbers: Any, group: str, order: int) -> None:
    given = numbers["state_space_gp"]
    (case,) = (
        item for item in given["cases"] if item["group"] == group and item["order"] == order
    )
    poses, times = np.array(given["T"]), np.array(given["t"])
    manifold, measured = {
        "r3": (Positions(), poses[:, :3, 3]),
        "so3": (Rotations(), poses[:, :3, :3]),
        "se3": (Poses(), poses),
    }[group]
    process = solved(manifold, order, times, measured, 0.01, 0.5)
    if group == "se3":
        # Its translations and rotations have noises of their own.
        process = replace(
            process,
            information=np.tile(1.0 / np.array(case["R_diag"]), (len(times), 1)),
            density=np.array(case["Qc_diag"]),
        ).solved()
    np.testing.assert_allclose(process.states, case["X"], atol=1e-9)
    assert process.log_likelihood() == pytest.approx(case["logml"], abs=1e-10)

    asked = np.array(given["tq"])
    inside = asked <= times[-1]
    interpolator = process.interpolator()
    states, covariances = interpolator.at(asked[inside])
    np.testing.assert_allclose(states, np.array(case["query_mean"])[inside], atol=1e-9)
    np.testing.assert_allclose(interpolator.marginals[0], case["P0"], rtol=1e-8, atol=1e-12)
    dimension = len(case["Qc_diag"])
    joint = dense_covariance(JointPosterior.of(process, times))
    blocks = joint.reshape(len(times), dimension, len(times), dimension)
    item = np.arange(len(times))
    marginals = blocks[item, :, item]
    alone = interpolator.marginals[:, :dimension, :dimension]
    np.testing.assert_allclose(marginals, alone, rtol=1e-6, atol=1e-12)
    if "query_cov" in case:
        expected = np.array(case["query_cov"])[inside]
        np.testing.assert_allclose(covariances, expected, rtol=1e-9, atol=1e-13)
    else:
        expected = np.array(case["query_cov_first_order"])[inside]
        scale = np.abs(expected).max()
        np.testing.assert_allclose(covariances / scale, expected / scale, atol=1e-3)


def test_joint_posterior(numbers: Any) -> None:
    given = numbers["joint_posterior_r3_wnoj"]
    process = solved(Positions(), 3, np.array(given["t"]), np.array(given["X"]), 0.01, given["Qc"])
    asked = np.array(given["tq"])
    joint = JointPosterior.of(process, asked)
    np.testing.assert_allclose(dense_covariance(joint), given["P_qq"], rtol=1e-8, atol=1e-14)
    np.testing.assert_allclose(process.interpolator().at(asked)[0], given["mean"], rtol=1e-8)
    tolerance = np.tile(given["tolerance_var"] * np.eye(3), (len(asked), 1, 1))
    density = joint.observed(tolerance).log_density(np.array(given["residual"]))
    assert density == pytest.approx(given["loglik"], rel=1e-8)
