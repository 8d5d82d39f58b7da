"""Continuous-time models against continuous-time.json, computed once with other programs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dense_joint import dense_covariance
from solved_process import solved

from trajeval_ros.continuous_time.kernels import (
    MATERN_52,
    SQUARED_EXPONENTIAL,
    Hyperparameters,
    negative_log_likelihood,
)
from trajeval_ros.continuous_time.manifolds import Positions, Rotations
from trajeval_ros.continuous_time.piecewise_gp import GPSegments, PiecewiseGP
from trajeval_ros.continuous_time.samples import Noise, Samples
from trajeval_ros.likelihood.correlated_groundtruth import JointPosterior

KERNELS = {"se": SQUARED_EXPONENTIAL, "m52": MATERN_52}
CLOSE: Any = {"rtol": 1e-11, "atol": 1e-11}


@pytest.fixture(scope="module")
def numbers(reference: Any) -> Any:
    return reference("continuous-time")


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


@pytest.mark.parametrize("group", ["r3", "so3"])
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
    }[group]
    process = solved(manifold, order, times, measured, 0.01, 0.5)
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
