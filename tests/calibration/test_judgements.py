"""What a calibration makes of a fit: exact flights, free parameters, warnings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from calibration_flights import Fault, fly
from exact_flights import FAULT, SCALE_OF_ESTIMATE, flown
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration.calibrate import SystematicErrors, calibrate
from trajeval_ros.calibration.increments import Increments
from trajeval_ros.calibration.observability import basis_of, observability, solve
from trajeval_ros.calibration.robust_fit import fit
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory

NONE = SystematicErrors(0.0, 0.0)
MOVED = Fault(0.08, 0.0, (0.4, -0.7, 1.1), (0.1, -0.05, 0.2))


@pytest.fixture(scope="module")
def long() -> tuple[Trajectory, Trajectory]:
    truth, estimate = fly(5, 70.0, fault=MOVED)
    return truth[::2], estimate[::4]


def test_a_smooth_flight_has_its_exact_calibration() -> None:
    truth, estimate, unknowns = flown(duration_s=60.0)
    estimate = estimate[::2]
    result = calibrate(truth, estimate, Gauge.SIM3, systematic=NONE, with_skew=True)
    assert result.offset.value is not None
    assert result.offset.value[0] == pytest.approx(FAULT.offset_s, abs=1e-5)
    assert result.skew is not None
    assert result.skew.value is not None
    assert result.skew.value[0] == pytest.approx(FAULT.skew, abs=3e-6)
    assert result.rotation.value is not None
    rotated = Rotation.from_rotvec(result.rotation.value).as_matrix()
    np.testing.assert_allclose(rotated, unknowns.rotation, atol=1e-5)
    np.testing.assert_allclose(result.lever.value, unknowns.lever_m, atol=1e-5)
    assert result.scale == pytest.approx(SCALE_OF_ESTIMATE, rel=1e-5)
    assert result.fitted == 9
    assert result.horizon_s == 1.0
    assert result.pairs == 601 - 8
    rigid = calibrate(truth, estimate, Gauge.SE3, systematic=NONE)
    assert (rigid.scale, rigid.skew) == (1.0, None)
    assert rigid.fitted == 7


def test_a_skew_of_less_than_two_minutes_is_warned_of(
    long: tuple[Trajectory, Trajectory],
) -> None:
    truth, estimate = long
    result = calibrate(truth, estimate, with_skew=True, systematic=NONE)
    assert [remark.code for remark in result.remarks] == ["short_for_clock_skew"]
    assert "from 69 s is unreliable; use at least 120 s" in result.remarks[0].text


def test_a_fit_stops_at_the_least_squares_solution() -> None:
    """Without outliers, at a normal matrix times the step of zero."""
    truth, estimate, unknowns = flown(duration_s=40.0)
    estimate = estimate[::2]
    generator = np.random.default_rng(0)
    estimate = dataclasses.replace(
        estimate, positions=estimate.positions + 1e-3 * generator.normal(size=(401, 3))
    )
    increments = Increments(truth, estimate)
    basis = np.eye(9)
    result = fit(increments, unknowns.moved(np.full(9, 1e-3)), basis)
    assert result is not None
    assert result.settled
    assert result.free == 9
    assert result.blocks == 12
    rows = np.repeat(result.weights, 3, axis=1)
    weighted = result.linearised.jacobian * rows[..., None]
    hessian = np.einsum("nap,naq->pq", weighted, result.linearised.jacobian)
    gradient = np.einsum("nap,na->p", weighted, result.linearised.residual)
    step = np.linalg.solve(hessian, gradient)
    assert (np.abs(step) * np.sqrt(np.diag(hessian)) < 1e-3).all()


def test_a_fit_of_few_directions_moves_along_them_alone(
    long: tuple[Trajectory, Trajectory],
) -> None:
    truth, estimate = long
    increments = Increments(truth, estimate)
    begin = increments.start(0.05, with_scale=False, about_z=False)
    axis = np.array([[0.6, 0.0, 0.8]])
    result = fit(increments, begin, basis_of({"offset": np.eye(1), "lever": axis}))
    assert result is not None
    moved = result.unknowns.lever_m - begin.lever_m
    np.testing.assert_allclose(moved, axis[0] * (axis[0] @ moved), atol=1e-12)
    np.testing.assert_array_equal(result.unknowns.rotation, begin.rotation)
    assert result.unknowns.skew == 0.0
    fixed = [1, 2, 3, 4, 6, 8]
    assert not result.covariance[fixed].any()
    seen = observability(increments, result)
    assert set(seen) == {"offset", "skew", "rotation", "lever"}


def test_what_is_fitted_depends_on_sensors_and_gauge(long: tuple[Trajectory, Trajectory]) -> None:
    truth, estimate = long
    bare = dataclasses.replace(truth, quaternions=None)
    nothing = dataclasses.replace(estimate, quaternions=None)
    body = {"offset": 1, "rotation": 3, "lever": 3}
    for one, other, gauge, skew, expected in (
        (truth, estimate, Gauge.SE3, False, body),
        (truth, estimate, Gauge.SIM3, True, {**body, "scale": 1, "skew": 1}),
        (bare, estimate, Gauge.YAW, False, {"offset": 1, "rotation": 1, "lever": 3}),
        (bare, nothing, Gauge.SE3, False, {"offset": 1, "rotation": 3}),
    ):  # fmt: skip
        solution = solve(Increments(one, other), gauge, skew)
        assert solution is not None
        assert {name: len(axes) for name, axes in solution.free.items()} == expected
        assert solution.left_out == ""
        assert solution.fit.free == sum(expected.values())
