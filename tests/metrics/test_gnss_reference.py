"""Wheel odometry against GNSS fixes, and two systems against surveyed points: known numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from trajeval_ros import Protocol, evaluate
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.noise_corrected_ate import debiased

BAG = "gnss/husky_outdoor.bag"
ODOMETRY = f"{BAG}:/husky_velocity_controller/odom"
PRISM = (-0.00594496, -0.00721288, 0.272943)
WEIGHTS = {"none": "none", "scalar": "groundtruth-covariance"}
EXACT = {"rel": 1e-9, "abs": 1e-12}
Recording = Callable[[str], Trajectory]


@pytest.fixture(scope="module")
def husky(reference: Callable[[str], Any]) -> Any:
    return reference("gnss")["husky"]


def test_fixes_are_where_they_are(recording: Recording, husky: Any) -> None:
    fixes = recording(f"{BAG}:/fix")
    np.testing.assert_allclose(fixes.positions[-1], husky["enu_last_m"], rtol=0, atol=5e-9)
    np.testing.assert_allclose(fixes.positions[500], husky["enu_500_m"], rtol=0, atol=5e-9)
    assert fixes.reading.fixes is not None
    assert fixes.reading.fixes.datum is not None
    assert fixes.reading.fixes.datum.coordinates.tolist() == husky["datum"]
    assert np.unique(fixes.reading.fixes.status).tolist() == [1]
    assert np.unique(fixes.reading.fixes.covariance_types).tolist() == [1]


@pytest.mark.slow
@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("gauge", ["planar", "yaw", "se3", "sim3"])
def test_a_wheeled_robot(gauge: str, weights: str, recording: Recording, husky: Any) -> None:
    known = husky["wheel_odometry"][f"{gauge}/{weights}"]
    protocol = Protocol(gauge=gauge, align_weights=WEIGHTS[weights], lengths=())
    result = evaluate(recording(f"{BAG}:/fix"), recording(ODOMETRY), protocol)
    assert len(result.association) == 989
    for metric, value in (
        ("position_m", known["ate_3d"]["rmse"]),
        ("horizontal_m", known["horizontal_rmse"]),
        ("vertical_m", known["vertical_rmse"]),
    ):
        statistics = result.ate[metric]
        if gauge == "planar" and metric == "vertical_m":
            assert statistics is None
            continue
        assert statistics is not None
        assert statistics.rmse == pytest.approx(value, **EXACT)
    assert result.alignment.similarity.scale == pytest.approx(known["scale"], **EXACT)
    tilt_deg = np.degrees(np.arccos(np.clip(result.alignment.similarity.rotation[2, 2], -1, 1)))
    assert tilt_deg == pytest.approx(known["tilt_deg"], abs=1e-6)
    tilts = any(f"gauge {gauge} tilts the estimate" in warning for warning in result.warnings)
    assert not tilts  # the pipeline's, which knows of fixes


@pytest.mark.parametrize("length", [20, 40, 80])
def test_relative_errors_of_positions(length: int, recording: Recording, husky: Any) -> None:
    known = husky["wheel_odometry"][f"fitted_re_planar_{length}m"]
    protocol = Protocol(gauge="planar", lengths=(length,))
    result = evaluate(recording(f"{BAG}:/fix"), recording(ODOMETRY), protocol)
    assert result.relative is not None
    errors, travelled = result.relative[0].errors, result.association.estimate.travelled
    # The reference takes no sub-trajectory that ends with the path, a little short of the length.
    whole = travelled[errors.starts] + length <= travelled[-1]
    assert np.count_nonzero(whole) == known["count"]
    rmse = np.sqrt(np.mean(np.square(errors.position_m[whole])))
    assert rmse == pytest.approx(known["rmse"], **EXACT)


@pytest.mark.slow
@pytest.mark.parametrize("correlation_s", [0, 30, 100])
def test_the_error_without_the_noise(correlation_s: int, recording: Recording, husky: Any) -> None:
    known = husky["wheel_odometry"]["planar_debiased"][f"tau_{correlation_s}"]
    protocol = Protocol(gauge="planar", lengths=())
    result = evaluate(recording(f"{BAG}:/fix"), recording(ODOMETRY), protocol)
    truth = result.association.groundtruth
    assert truth.covariances is not None
    apart = np.abs(truth.seconds[:, None] - truth.seconds)
    noise = np.exp(-apart / correlation_s) if correlation_s else np.eye(len(truth))
    flat = truth.covariances[:, :3, :3] * np.outer([1.0, 1.0, 0.0], [1.0, 1.0, 0.0])
    own = debiased(
        truth.positions - result.aligned.positions, result.aligned.positions, flat, noise,
        Gauge.PLANAR,
    )  # fmt: skip
    assert own.ate_m == pytest.approx(known["ate_m"], rel=1e-9)
    assert own.interval_m == pytest.approx(known["interval_m"], rel=1e-7)
    assert own.noise_rms_m == pytest.approx(known["noise_rms_m"], rel=1e-7)
    assert own.effective == pytest.approx(known["effective_fixes"], rel=1e-7)


@pytest.mark.parametrize("lever", [None, PRISM], ids=["no_lever", "prism_lever"])
@pytest.mark.parametrize("name", ["svo2", "hdl"])
@pytest.mark.parametrize("gauge", ["se3", "yaw"])
def test_surveyed_points(
    gauge: str,
    name: str,
    lever: tuple[float, float, float] | None,
    recording: Recording,
    reference: Callable[[str], Any],
) -> None:
    key = f"{name}/{'prism_lever' if lever else 'no_lever'}/interpolate_0.5/{gauge}"
    known = reference("gnss")["hilti_2021"][key]
    points, estimate = (recording(f"hilti_2021/Campus_2_{item}.txt") for item in ("prism", name))
    result = evaluate(points, estimate, Protocol(gauge=gauge, lever_m=lever, lengths=()))
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].rmse == pytest.approx(known["error_3d"]["rmse"], **EXACT)
    np.testing.assert_allclose(result.absolute.position_m, known["errors_m"], rtol=1e-9, atol=1e-9)
    # Theirs are along the axes of the total station.
    assert result.absolute.horizontal_m is not None
    np.testing.assert_allclose(result.absolute.horizontal_m, known["errors_2d_m"], atol=1e-9)
    assert result.association.groundtruth_coverage == 1.0


@pytest.mark.parametrize("name", ["svo2", "hdl"])
def test_half_an_estimate(
    name: str, recording: Recording, reference: Callable[[str], Any]
) -> None:
    known = reference("gnss")["hilti_2021"][f"{name}/first_half/interpolate_0.5/se3"]
    points, estimate = (recording(f"hilti_2021/Campus_2_{item}.txt") for item in ("prism", name))
    half = estimate[: len(estimate) // 2]
    result = evaluate(points, half, Protocol(lever_m=PRISM, lengths=()))
    assert result.association.groundtruth_coverage == pytest.approx(9 / 19)
    assert result.association.dropped == {"after_estimate": 10}
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].rmse == pytest.approx(known["error_3d"]["rmse"], **EXACT)


@pytest.mark.slow
def test_dense_positions(recording: Recording, reference: Callable[[str], Any]) -> None:
    known = reference("gnss")["hilti_2021"]["uzh"]
    truth, estimate = (recording(f"hilti_2021/uzh_run2_{item}.txt") for item in ("mocap", "hdl"))
    for method, name in (
        ("linear", "groundtruth_interpolated_se3"),
        ("groundtruth-stamps", "estimate_interpolated_se3"),
    ):
        result = evaluate(truth, estimate, Protocol(association=method, lengths=()))
        assert result.ate["position_m"] is not None
        assert result.ate["position_m"].rmse == pytest.approx(known[name]["rmse"], **EXACT)
        assert result.ate["position_m"].count == known[name]["count"]


@pytest.mark.parametrize(("name", "rmse_m"), [("svo2", 8.949275), ("hdl", 0.353299)])
def test_evo_s_numbers_stay(name: str, rmse_m: float, recording: Recording) -> None:
    from trajeval_ros.io.requests.request_from import protocol_from

    points, estimate = (recording(f"hilti_2021/Campus_2_{item}.txt") for item in ("prism", name))
    result = evaluate(points, estimate, protocol_from("evo", max_time_difference=1.0))
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].rmse == pytest.approx(rmse_m, abs=5e-7)
