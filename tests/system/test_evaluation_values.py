"""Values of an evaluation: velocities and biases, weights, axes, and what is said or refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from evaluation_settings import BASE
from scipy.spatial.transform import Rotation
from strategies import assert_same_numbers, make_element, make_estimate, make_groundtruth, moved

from trajeval_ros.exceptions import DegenerateGeometryError, InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.alignment import align
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.pipeline.pipeline import evaluate
from trajeval_ros.report.verdict_lines import definitions


def test_biases_and_velocities_are_compared_where_both_have_them() -> None:
    groundtruth = make_groundtruth(1)
    estimate = moved(groundtruth, make_element(Gauge.SE3, 2))
    assert estimate.velocities is not None
    assert estimate.gyroscope_biases is not None
    assert estimate.accelerometer_biases is not None
    estimate = dataclasses.replace(
        estimate,
        velocities=estimate.velocities + [0.3, 0.0, 0.4],
        gyroscope_biases=estimate.gyroscope_biases + [0.0, 0.02, 0.0],
        accelerometer_biases=estimate.accelerometer_biases - [0.0, 0.0, 0.2],
    )
    ate = evaluate(groundtruth, estimate, BASE).ate
    for metric, size in (("velocity_mps", 0.5), ("gyroscope_bias", 0.02)):
        statistics = ate[metric]
        assert statistics is not None
        assert statistics.rmse == pytest.approx(size)
        assert statistics.std == pytest.approx(0.0, abs=1e-9)
    accelerometer = ate["accelerometer_bias"]
    assert accelerometer is not None
    assert accelerometer.rmse == pytest.approx(0.2)

    without = dataclasses.replace(groundtruth, velocities=None, gyroscope_biases=None)
    ate = evaluate(without, estimate, BASE).ate
    assert ate["velocity_mps"] is None
    assert ate["gyroscope_bias"] is None
    assert ate["accelerometer_bias"] is not None


def test_velocities_take_the_alignments_scale() -> None:
    groundtruth = make_groundtruth(5)
    estimate = moved(groundtruth, Similarity(np.eye(3), np.zeros(3), 0.8))
    by_similarity = evaluate(groundtruth, estimate, dataclasses.replace(BASE, gauge=Gauge.SIM3))
    rigid = evaluate(groundtruth, estimate, BASE)
    assert by_similarity.alignment.similarity.scale == pytest.approx(1.25)
    assert by_similarity.ate["velocity_mps"] is not None
    assert by_similarity.ate["velocity_mps"].max < 1e-9
    assert rigid.ate["velocity_mps"] is not None
    assert rigid.ate["velocity_mps"].rmse > 0.1


@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.SE3, Gauge.SIM3, Gauge.PLANAR])
def test_equal_covariances_weigh_as_none(gauge: Gauge) -> None:
    groundtruth = make_groundtruth(7)
    estimate = dataclasses.replace(
        make_estimate(groundtruth, 8), covariances=np.tile(0.04 * np.eye(6), (59, 1, 1))
    )
    plain = dataclasses.replace(BASE, gauge=gauge)
    weighted = dataclasses.replace(plain, align_weights="covariance")
    assert_same_numbers(
        evaluate(groundtruth, estimate, plain), evaluate(groundtruth, estimate, weighted)
    )


def test_weights_without_covariances_are_refused() -> None:
    groundtruth = make_groundtruth(11)
    protocol = dataclasses.replace(BASE, align_weights="covariance")
    with pytest.raises(InputError, match="covariance"):
        evaluate(groundtruth, groundtruth, protocol)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0])
def test_covariances_that_cannot_be_are_refused(value: float) -> None:
    groundtruth = make_groundtruth(11)
    covariances = np.tile(np.eye(6), (len(groundtruth), 1, 1))
    covariances[3, 0, 0] = value
    estimate = dataclasses.replace(groundtruth, covariances=covariances)
    protocol = dataclasses.replace(BASE, align_weights="covariance")
    with pytest.raises(InputError, match="covariance"):
        evaluate(groundtruth, estimate, protocol)


def test_nothing_is_fitted_that_was_not_asked_for() -> None:
    # A clock offset and a lever arm stay in the errors: neither is estimated on the side.
    groundtruth = make_groundtruth(12, 600)
    assert groundtruth.rotations is not None
    late = dataclasses.replace(groundtruth, stamps=groundtruth.stamps + 100_000_000)
    lever = dataclasses.replace(
        groundtruth,
        positions=groundtruth.positions + groundtruth.rotations.apply([0.5, 0.0, 0.0]),
    )
    for estimate, least in ((late, 0.1), (lever, 0.1)):
        result = evaluate(groundtruth, estimate, BASE)
        assert result.association.rule.time_offset_s == 0.0
        assert result.ate["position_m"] is not None
        assert result.ate["position_m"].rmse > least
    offset = AssociationRule(time_offset_s=-0.1)
    result = evaluate(groundtruth, late, dataclasses.replace(BASE, association=offset))
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].max < 1e-9
    # Without a gauge not even a shift is taken out.
    none = dataclasses.replace(BASE, gauge=Gauge.NONE)
    shifted = moved(groundtruth, Similarity(np.eye(3), np.array([3.0, 0.0, 4.0])))
    position = evaluate(groundtruth, shifted, none).ate["position_m"]
    assert position is not None
    assert position.min == pytest.approx(5.0)
    assert position.max == pytest.approx(5.0)


def test_planar_errors_are_two_dimensional() -> None:
    groundtruth = make_groundtruth(13)
    raised = dataclasses.replace(
        groundtruth, positions=groundtruth.positions * [1.0, 1.0, -3.0] + [5.0, 0.0, 70.0]
    )
    result = evaluate(groundtruth, raised, dataclasses.replace(BASE, gauge=Gauge.PLANAR))
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].max < 1e-9
    assert result.ate["tilt_deg"] is None
    assert all(item.statistics["tilt_deg"] is None for item in result.relative or ())


def test_yaw_and_tilt_are_the_errors_about_gravity_and_level_axes() -> None:
    groundtruth = make_groundtruth(14)
    assert groundtruth.rotations is not None
    none = dataclasses.replace(BASE, gauge=Gauge.NONE, lengths=())
    for rotvec, yaw, tilt in (([0, 0, -0.3], 0.3, 0.0), ([0.12, 0.16, 0.0], 0.0, 0.2)):
        estimate = dataclasses.replace(
            groundtruth,
            quaternions=(Rotation.from_rotvec(rotvec) * groundtruth.rotations).as_quat(),
        )
        absolute = evaluate(groundtruth, estimate, none).absolute
        assert absolute.rotation_deg is not None
        assert absolute.yaw_deg is not None
        assert absolute.tilt_deg is not None
        np.testing.assert_allclose(absolute.yaw_deg, np.degrees(yaw), atol=1e-9)
        np.testing.assert_allclose(absolute.tilt_deg, np.degrees(tilt), atol=1e-9)
        np.testing.assert_allclose(absolute.rotation_deg, np.degrees(max(yaw, tilt)), atol=1e-9)


def test_estimates_at_an_exact_rate_keep_all_states() -> None:
    stamps = 1_700_000_000_000_000_000 + np.arange(1000, dtype=np.int64) * 10_000_000
    truth = make_groundtruth(15, 1000)
    groundtruth = dataclasses.replace(truth, stamps=stamps)
    for method in ("linear", "nearest", "rpg", "evo"):
        protocol = dataclasses.replace(BASE, association=AssociationRule(method))
        result = evaluate(groundtruth, groundtruth, protocol)
        assert len(result.association) == 1000
        assert result.association.estimate_coverage == 1.0
        assert result.association.groundtruth_coverage == 1.0


def test_a_pose_at_the_origin_is_a_pose() -> None:
    groundtruth = make_groundtruth(16)
    assert groundtruth.quaternions is not None
    positions = groundtruth.positions - groundtruth.positions[0]
    quaternions = groundtruth.quaternions.copy()
    quaternions[0] = [0.0, 0.0, 0.0, 1.0]
    read = Trajectory.from_columns(groundtruth.stamps, positions, quaternions)
    assert len(read) == len(groundtruth)
    assert len(evaluate(groundtruth, read, BASE).association) == len(groundtruth)


def test_a_low_coverage_is_said() -> None:
    groundtruth = make_groundtruth(17, 400)
    lost = make_estimate(groundtruth, 18)[:60]
    result = evaluate(groundtruth, lost, BASE)
    assert result.association.groundtruth_coverage == pytest.approx(60 / 199, abs=0.02)
    # From the first to the last pair nothing is lost, so this is a note.
    [text] = [remark for remark in result.remarks if "groundtruth's time" in remark.text]
    assert text.level is Level.NOTE


def test_groundtruth_that_is_slow_is_said_with_the_options_that_help() -> None:
    """Of the groundtruth, 0.3 s of every 2 s exist."""
    dense = make_groundtruth(17, 400)
    seconds = np.round(dense.seconds - dense.seconds[0], 6)
    result = evaluate(dense[seconds % 2.0 <= 0.3], make_estimate(dense, 18), BASE)
    [text] = [remark.text for remark in result.remarks if remark.code == "low_coverage"]
    assert "--association groundtruth-stamps or a larger --max-gap" in text
    [few] = [
        remark.text
        for remark in evaluate(dense[:200], make_estimate(dense, 18), BASE).remarks
        if remark.code == "low_coverage"
    ]
    assert "--max-gap" not in few


def test_one_rounding_of_coverage() -> None:
    """99.97 % are not printed as 100.0 %."""
    dense = make_groundtruth(17, 6000)
    result = evaluate(dense, make_estimate(dense, 18)[1:], BASE)
    assert 0.999 < result.association.groundtruth_coverage < 1.0
    assert "99 % of groundtruth" in repr(result)
    assert any(
        "99 % of the groundtruth's time" in definition for definition in definitions(result)
    )


def test_a_reason_for_dropping_that_is_new_breaks_no_evaluation() -> None:
    groundtruth = make_groundtruth(17, 400)
    lost = dataclasses.replace(
        make_estimate(groundtruth, 18)[:60], reading=SourceInfo(dropped={"half_a_line": 3})
    )
    result = evaluate(groundtruth, lost, BASE)
    assert result.association.dropped["half_a_line"] == 3
    assert any("half a line" in remark.text for remark in result.remarks)


def test_lengths_beyond_the_path_are_said_not_counted_as_zero() -> None:
    groundtruth = make_groundtruth(19)
    protocol = dataclasses.replace(BASE, lengths=(Length(1e4, "m"),))
    result = evaluate(groundtruth, groundtruth, protocol)
    assert result.relative is not None
    assert set(result.relative[0].statistics.values()) == {None}
    assert any("10000 m" in warning for warning in result.warnings)


@pytest.mark.parametrize("re_form", ["gauge", "se3", "tutorial", "euler"])
def test_no_sub_trajectory_is_no_error_in_any_form(re_form: str) -> None:
    groundtruth = make_groundtruth(19)
    protocol = dataclasses.replace(BASE, lengths=(Length(1e4, "m"),), re_form=re_form)
    result = evaluate(groundtruth, groundtruth, protocol)
    assert result.relative is not None
    assert result.relative[0].statistics["position_m"] is None


def test_states_that_are_not_finite_are_refused_not_measured() -> None:
    # Readers drop such rows; whoever builds columns by hand must hear of it.
    groundtruth = make_groundtruth(20)
    positions = groundtruth.positions.copy()
    positions[5, 1] = np.nan
    with pytest.raises((InputError, ValueError), match="finite"):
        evaluate(groundtruth, dataclasses.replace(groundtruth, positions=positions), BASE)


@pytest.mark.slow
def test_many_states_are_evaluated_at_all_lengths() -> None:
    count = 200_000
    random = np.random.default_rng(21)
    stamps = 1_700_000_000_000_000_000 + np.arange(count, dtype=np.int64) * 50_000_000
    rotations = np.zeros((count, 3))
    rotations[:, 2] = np.linspace(0.0, 60.0, count)
    positions = np.cumsum(random.normal(scale=0.1, size=(count, 3)), axis=0)
    groundtruth = Trajectory(stamps, positions, Rotation.from_rotvec(rotations).as_quat())
    estimate = dataclasses.replace(
        groundtruth,
        stamps=stamps + 7_000_000,
        positions=positions + random.normal(scale=0.01, size=(count, 3)),
    )
    result = evaluate(groundtruth, estimate)
    assert len(result.association) == count - 1
    assert result.relative is not None
    assert len(result.relative) == 5
    assert all(len(item.errors.ends) > 0.98 * count for item in result.relative)


def test_sim3_by_one_state_is_refused_with_the_reason() -> None:
    groundtruth = make_groundtruth(22)
    protocol = dataclasses.replace(BASE, gauge=Gauge.SIM3, align_states=1)
    with pytest.raises(DegenerateGeometryError, match="does not determine a scale"):
        evaluate(groundtruth, groundtruth, protocol)


@pytest.mark.parametrize("gauge", [Gauge.TRANSLATION, Gauge.YAW, Gauge.SE3, Gauge.SIM3])
def test_weights_are_by_the_error_of_the_round_before_in_two_rounds(gauge: Gauge) -> None:
    groundtruth = make_groundtruth(12, 200)
    estimate = make_estimate(groundtruth, 13, error_m=0.5)
    sigmas_m = 10.0 ** np.random.default_rng(14).uniform(-2.0, 1.0, len(estimate))
    covariances = np.einsum("n,ij->nij", sigmas_m**2, np.eye(6))
    estimate = dataclasses.replace(estimate, covariances=covariances)
    if gauge.has_scale:
        estimate = moved(estimate, Similarity(np.eye(3), np.zeros(3), 0.5))
    protocol = dataclasses.replace(BASE, gauge=gauge, lengths=(), align_weights="covariance")
    evaluation = evaluate(groundtruth, estimate, protocol)
    truth, own = evaluation.association.groundtruth, evaluation.association.estimate
    assert own.covariances is not None
    traces = np.trace(own.covariances[:, :3, :3], axis1=1, axis2=2)
    rounds = [align(gauge, truth.positions, own.positions).similarity]
    for _ in range(3):
        last = rounds[-1]
        apart = truth.positions - (own.positions @ last.linear.T + last.translation)
        error_m2 = np.mean(np.sum(apart**2, axis=1))
        weights = 1.0 / (last.scale**2 * traces / 3.0 + error_m2 / 3.0)
        rounds.append(align(gauge, truth.positions, own.positions, weights).similarity)
    result = evaluation.alignment.similarity.translation
    assert result == pytest.approx(rounds[2].translation, abs=1e-12)
    for other in (0, 1, 3):
        assert np.abs(result - rounds[other].translation).max() > 1e-9
