"""Likelihoods against continuous-time.json, computed once with other programs."""

from __future__ import annotations

from typing import Any

import first_order_likelihood as first_order
import numpy as np
import pytest
from alignment_integrals import by_laplace, by_quadrature
from paper_density import DENSITIES
from position_likelihood import position_error

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood import relative_density
from trajeval_ros.likelihood.alignment_chart import scales
from trajeval_ros.likelihood.marginal import generalised_absolute_error, laplace
from trajeval_ros.likelihood.residuals import Residuals

GAUGES = {"se3": Gauge.SE3, "yaw4": Gauge.YAW, "sim3": Gauge.SIM3}
NODES = {"yaw4": 15, "sim3": 7}
TIGHT: Any = {"rtol": 1e-11, "atol": 1e-12}


@pytest.fixture(scope="module")
def numbers(reference: Any) -> Any:
    return reference("continuous-time")


def metric_case(numbers: Any, name: str) -> tuple[Belief, Any, Any]:
    given = numbers["metrics"]
    (case,) = (item for item in given["cases"] if item["gauge"] == name)
    belief = Belief(np.array(given["T_gt"]), np.array(given["Sigma"]))
    return belief, np.array(case["T_est"]), case


def test_relative_error_of_eq_10_to_17(numbers: Any) -> None:
    belief, estimate, case = metric_case(numbers, "se3")
    carriers = relative_density.transports(belief.poses)
    np.testing.assert_allclose(carriers, case["B"], **TIGHT)
    errors = first_order.relative_errors(belief.poses, estimate)
    np.testing.assert_allclose(errors, case["e_r"], **TIGHT)
    diagonal, lower = relative_density.relative_covariance(carriers, belief.covariances)
    np.testing.assert_allclose(diagonal, case["Vr_diag"], **TIGHT)
    np.testing.assert_allclose(se3.transposed(lower), case["Vr_upper"], **TIGHT)
    result = first_order.generalised_relative_error(belief, estimate)
    np.testing.assert_allclose(result.whitened, case["whitened"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(result.edges, case["per_edge_prequential_logp"], rtol=1e-9)
    assert result.log_likelihood == pytest.approx(case["log_P_RE_mp"], rel=1e-11)


@pytest.mark.parametrize("density", ["log", "haar"])
@pytest.mark.parametrize("name", GAUGES)
def test_absolute_error_of_eq_19(numbers: Any, name: str, density: str) -> None:
    belief, estimate, case = metric_case(numbers, name)
    expected = case[density]
    residuals = DENSITIES[density](belief, estimate, GAUGES[name])
    result = generalised_absolute_error(residuals)
    mode, scale = result.mode.element, scales(result.mode.element)
    assert scale == pytest.approx(expected["mode_scale"], abs=1e-9)
    np.testing.assert_allclose(mode[:3, :3] / scale, expected["mode_R"], atol=1e-9)
    np.testing.assert_allclose(mode[:3, 3], expected["mode_t"], atol=1e-9)
    assert result.mode.log_density == pytest.approx(expected["logf_mode"], abs=1e-9)
    approximate = laplace(result.mode, result.mode.slope.information)
    assert approximate == pytest.approx(expected["log_L_laplace_gn"], abs=1e-9)
    np.testing.assert_allclose(result.information, expected["H_full"], rtol=1e-6, atol=1e-3)
    assert result.log_likelihood == pytest.approx(expected["log_L_laplace_full"], abs=1e-9)
    np.testing.assert_allclose(residuals.at(result.mode.element), expected["eps_mode"], atol=1e-9)
    np.testing.assert_allclose(result.mahalanobis2, expected["mahalanobis2_per_pose"], rtol=1e-7)
    assert result.mahalanobis2.sum() == pytest.approx(expected["nees_total"], rel=1e-9)


# Of the larger gauges one; the density of all of them is compared at its mode above.
@pytest.mark.parametrize(
    ("density", "name"),
    [("log", "yaw4"), ("haar", "yaw4"), pytest.param("haar", "sim3", marks=pytest.mark.slow)],
)
def test_quadrature_of_eq_19(numbers: Any, density: str, name: str) -> None:
    belief, estimate, case = metric_case(numbers, name)
    residuals = DENSITIES[density](belief, estimate, GAUGES[name])
    result = generalised_absolute_error(residuals)
    value = by_quadrature(result, NODES[name])
    assert value == pytest.approx(case[density]["log_L_quadrature"], abs=1e-9)


@pytest.mark.parametrize("place", range(6))
def test_positions_alone(numbers: Any, place: int) -> None:
    given = numbers["position_only"]
    case = given["cases"][place]
    gauge = GAUGES[case["gauge"]]
    truth = np.array(given["P_gt"])
    estimate = np.array(given[f"P_est_{case['gauge']}"])
    result = position_error(truth, estimate, case["sigma"], gauge)
    assert result == pytest.approx(case["log_L_exact"], rel=1e-11, abs=1e-9)
    covariances = np.tile(np.diag([case["sigma"] ** 2] * 3 + [0.0] * 3), (len(truth), 1, 1))
    residuals = Residuals(
        Belief(se3.poses(np.eye(3), truth), covariances),
        se3.poses(np.eye(3), estimate),
        gauge,
        oriented=False,
    )
    found_by_laplace = by_laplace(generalised_absolute_error(residuals))
    assert found_by_laplace == pytest.approx(case["log_L_laplace"], abs=1e-7)
