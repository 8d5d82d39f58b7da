"""The uncertainty of an alignment's rotation: its size, warnings, and what is withheld."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotation_runs import (
    TURNING,
    X,
    flight,
    freedom_numbers,
    of_marker,
    on,
    rmse,
    road,
    rotation_warnings,
)
from scipy.spatial.transform import Rotation
from state_rows import states, trajectory
from strategies import along_line, make_element, make_groundtruth, moved, seeds

from trajeval_ros import PROTOCOLS, Gauge, Trajectory, evaluate
from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.metrics.moments import Moments, OrientationSum
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings

# The sums.


@settings(max_examples=10)
@given(seed=seeds, cut=st.integers(1, 59), weighted=st.booleans())
def test_orientation_sums_merge_and_subtract(seed: int, cut: int, weighted: bool) -> None:
    random = np.random.default_rng(seed)
    a, b = (Rotation.random(60, random_state=seed % 2**31 + k) for k in (0, 1))
    weights = random.uniform(0.1, 10.0, size=60) if weighted else None
    products = np.einsum("nij,nkj->nik", a.as_matrix(), b.as_matrix())
    whole = OrientationSum.of_pairs(a.as_quat(), b.as_quat(), weights)
    np.testing.assert_allclose(
        whole.mean, np.average(products, axis=0, weights=weights), atol=1e-13
    )
    first, second = (
        OrientationSum.of_pairs(
            a[rows].as_quat(), b[rows].as_quat(), None if weights is None else weights[rows]
        )
        for rows in (slice(cut), slice(cut, None))
    )
    for left, right in ((first + second, whole), (whole - first, second)):
        assert left.weight == pytest.approx(right.weight, rel=1e-12)
        np.testing.assert_allclose(left.total, right.total, atol=1e-11)
    rotation = Rotation.random(random_state=seed % 2**31 + 2)
    halves = np.sin((a * b.inv() * rotation.inv()).magnitude() / 2.0)
    chord = math.sqrt(np.average(np.square(halves), weights=weights))
    assert whole.error(rotation.as_matrix()) == pytest.approx(2.0 * math.asin(chord), rel=1e-9)


def test_one_turn_throughout_is_its_angle() -> None:
    b = Rotation.random(50, random_state=3)
    rotated = OrientationSum.of_pairs((X * b).as_quat(), b.as_quat())
    assert math.degrees(rotated.error(np.eye(3))) == pytest.approx(20.0, rel=1e-12)
    assert rotated.error(X.as_matrix()) == 0.0


# The standard deviation.


@settings(max_examples=10)
@given(seed=seeds, gauge=st.sampled_from(TURNING), way=st.sampled_from(["positions", "poses"]))
def test_the_covariance_is_the_sandwich_of_all_places_with_all_errors(
    seed: int, gauge: Gauge, way: str
) -> None:
    truth, estimate = flight(seed, 40)
    similarity = (result := evaluate(truth, estimate, on(gauge, way))).alignment.similarity
    q = result.association.estimate.positions
    p = result.association.groundtruth.positions
    linear = similarity.rotation
    scale = np.sum((p - p.mean(0)) * ((q - q.mean(0)) @ linear.T)) / np.sum((q - q.mean(0)) ** 2)
    a = similarity.scale * (q - q.mean(0)) @ linear.T
    e = (p - p.mean(0)) - scale * (q - q.mean(0)) @ linear.T
    torques = np.cross(a[:, None], e[None, :]).reshape(-1, 3)
    axes = slice(2, 3) if gauge.yaw_only else slice(0, 3)
    curvature = (np.sum(a * a) * np.eye(3) - a.T @ a)[axes, axes] / len(a)
    gradient = (torques.T @ torques / len(torques))[axes, axes]
    _, error, least, _, in_stds = np.radians(freedom_numbers(result.alignment))
    if result.alignment.by_positions is not None:
        moments = Moments.of_pairs(p, q)
        arm = moments.rmse(result.alignment.by_positions) / math.radians(2.0)
        curvature += arm**2 * np.eye(len(curvature))
        gradient += arm**4 * error**2 / 3.0 * np.eye(len(curvature))
    inverse = np.linalg.inv(curvature)
    covariance = inverse @ gradient @ inverse
    assert result.alignment.freedom is not None
    std = math.degrees(math.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    assert result.alignment.freedom.std_deg == pytest.approx(std, rel=1e-9)
    rotated, other = (
        result.association.groundtruth.rotations,
        result.association.estimate.rotations,
    )
    assert rotated is not None
    assert other is not None
    mean = (rotated * other.inv()).as_matrix().mean(axis=0)
    if gauge.yaw_only:
        yaw = math.atan2(mean[1, 0] - mean[0, 1], mean[0, 0] + mean[1, 1])
        alone = Rotation.from_rotvec([0.0, 0.0, yaw])
    else:
        alone = (rotated * other.inv()).mean()
    rotation = (alone * Rotation.from_matrix(similarity.rotation).inv()).as_rotvec()[axes]
    spread = covariance + (least**2 / 3.0 + math.radians(0.4) ** 2) * np.eye(len(rotation))
    expected = math.sqrt(rotation @ np.linalg.solve(spread, rotation))
    assert math.degrees(in_stds) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("gauge", [Gauge.SE3, Gauge.SIM3])
def test_an_exactly_straight_line_is_free(gauge: Gauge) -> None:
    truth = along_line(np.linspace(0.0, 30.0, 300), [1.0, -2.0, 0.5])
    result = evaluate(truth, moved(truth, make_element(gauge, 1)), on(gauge))
    assert result.alignment.freedom is not None
    assert result.alignment.freedom.std_deg == math.inf
    assert result.ate["rotation_deg"] is None
    assert "the positions do not constrain it" in result.withheld
    # Positions without any error leave no weight for orientations.
    again = evaluate(truth, moved(truth, make_element(gauge, 1)), on(gauge, "poses"))
    assert again.ate["rotation_deg"] is None
    # With errors, orientations determine what positions can't.
    random = np.random.default_rng(2)
    noisy = dataclasses.replace(
        truth, positions=truth.positions + random.normal(scale=0.05, size=(300, 3))
    )
    estimate = moved(noisy, make_element(gauge, 1))
    assert evaluate(truth, estimate, on(gauge)).ate["rotation_deg"] is None
    assert rmse(evaluate(truth, estimate, on(gauge, "poses")), "rotation_deg") < 0.2


@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.PLANAR])
@pytest.mark.parametrize("way", ["positions", "poses"])
def test_two_pairs_determine_a_yaw(gauge: Gauge, way: str) -> None:
    truth = make_groundtruth(3, 2)
    estimate = moved(truth, make_element(gauge, 4))
    result = evaluate(truth, estimate, on(gauge, way))
    assert rmse(result, "yaw_deg") < 1e-6
    assert rotation_warnings(result) == []
    with pytest.raises(DegenerateGeometryError, match="at least 3"):
        evaluate(truth, estimate, on(Gauge.SE3, way))


# Warnings and what is withheld.


def test_a_turn_that_positions_hardly_determine_is_said_and_withheld() -> None:
    truth, estimate = road(20.0)
    result = evaluate(truth, estimate, on())
    freedom = result.alignment.freedom
    assert freedom is not None
    assert freedom.orientations is not None
    assert 2.0 < freedom.std_deg < 30.0
    assert freedom.orientations.error_deg == pytest.approx(20.0, abs=6.0)
    assert freedom.orientations.turn_deg == pytest.approx(freedom.orientations.error_deg, rel=1e-2)
    assert freedom.orientations.least_deg == pytest.approx(0.1, abs=0.02)
    assert result.ate["rotation_deg"] is None
    assert result.ate["position_m"] is not None
    (warning,) = rotation_warnings(result)
    assert warning.startswith("rotation and velocity errors are withheld: of the rotation error")
    assert f"{freedom.orientations.turn_deg:.3g} deg are a constant rotation" in warning
    assert f"standard deviation {freedom.std_deg:.2g} deg about the direction" in warning
    least = f"{freedom.orientations.least_deg:.2g} deg"
    assert f"aligned by orientations, the rotation error is {least}" in warning
    assert "--align-with poses" in warning


@pytest.mark.parametrize("seed", range(5))
def test_with_poses_the_rotation_is_right_and_positions_nearly_as_good(seed: int) -> None:
    truth, estimate = road(20.0, seed=seed)
    before, after = (evaluate(truth, estimate, on(way=way)) for way in ("positions", "poses"))
    assert rmse(after, "rotation_deg") < 2.0
    assert rotation_warnings(after) == []
    assert (
        rmse(before, "position_m") < rmse(after, "position_m") < 1.25 * rmse(before, "position_m")
    )
    assert after.alignment.by_positions is not None
    np.testing.assert_array_equal(
        after.alignment.by_positions.rotation, before.alignment.similarity.rotation
    )


@pytest.mark.parametrize(("roll_deg", "withheld"), [(9.0, False), (25.0, True)])
def test_a_small_turn_is_printed_with_its_warning(roll_deg: float, withheld: bool) -> None:
    result = evaluate(*road(roll_deg, error_m=0.1), on())
    assert (result.ate["rotation_deg"] is None) is withheld
    (warning,) = rotation_warnings(result)
    assert warning.startswith("rotation and velocity errors are withheld") is withheld


def test_what_drift_does_not_explain_is_a_disagreement() -> None:
    # A robot that hardly turns on a path that is not straight: the body's turn is the world's.
    # Both are stated: another body, and a disagreement.
    truth, estimate = flight(5)
    level = dataclasses.replace(truth, quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (200, 1)))
    still = dataclasses.replace(estimate, quaternions=level.quaternions)
    result = evaluate(of_marker(level), still, on())
    assert result.alignment.freedom is not None
    assert result.alignment.freedom.disagrees
    body, warning = rotation_warnings(result)
    assert "the body frames differ by a constant rotation" in body
    assert "positions and orientations disagree by a constant rotation of" in warning
    assert "--hand-eye auto" in warning
    assert result.ate["rotation_deg"] is None


@pytest.mark.parametrize("protocol", ["evo", "rpg"])
def test_protocols_of_programs_print_what_these_print(protocol: str) -> None:
    truth, estimate = road(20.0)
    settings = dataclasses.replace(PROTOCOLS[protocol], lengths=())
    result = evaluate(truth, estimate, settings)
    assert rmse(result, "rotation_deg") > 10.0
    (warning,) = rotation_warnings(result)
    assert warning.startswith("of the rotation error of")


@pytest.mark.parametrize("roll_deg", [20.0, 0.0])
def test_positions_alone_are_no_reason_for_a_warning(roll_deg: float) -> None:
    truth, estimate = road(roll_deg)
    result = evaluate(dataclasses.replace(truth, quaternions=None), estimate, on())
    assert rotation_warnings(result) == [
        warning for warning in result.warnings if "no orientations in the" in warning
    ]
    freedom = result.alignment.freedom
    assert freedom is not None
    assert freedom.orientations is None
    assert freedom.std_deg > 2.0


@pytest.mark.slow
@given(seed=seeds)
def test_runs_that_determine_their_rotation_are_silent(seed: int) -> None:
    truth, estimate = flight(seed)
    for gauge in TURNING:
        assert rotation_warnings(evaluate(truth, estimate, on(gauge))) == []


# Live.


def live(
    truth: Trajectory, estimate: Trajectory, settings: OnlineSettings, batch: int = 7
) -> OnlineEvaluator:
    evaluator = OnlineEvaluator(settings)
    rows = [states(item.positions, item.quaternions) for item in (truth, estimate)]
    for begin in range(0, len(truth), batch):
        part = slice(begin, begin + batch)
        evaluator.add_groundtruth(trajectory(truth.stamps[part], rows[0][part]))
        evaluator.add_estimate(trajectory(estimate.stamps[part], rows[1][part]))
        evaluator.update()
    evaluator.update(at_end=True)
    return evaluator


@pytest.mark.slow
@pytest.mark.parametrize("window", ["0", "2s", "37"])
@pytest.mark.parametrize("way", ["positions", "poses"])
@pytest.mark.parametrize("states_used", [None, 120])
@settings(max_examples=5)
@given(seed=seeds, gauge=st.sampled_from(TURNING))
def test_live_is_offline(
    seed: int, gauge: Gauge, window: str, way: str, states_used: int | None
) -> None:
    pairs = road(20.0, seed=seed) if gauge.has_so3 else flight(seed)
    protocol = dataclasses.replace(on(gauge, way), align_states=states_used)
    snapshot = live(*pairs, OnlineSettings(protocol, window)).snapshot()
    offline = evaluate(*pairs, protocol)
    assert snapshot.alignment is not None
    assert freedom_numbers(snapshot.alignment) == pytest.approx(
        freedom_numbers(offline.alignment), rel=1e-9, abs=1e-12
    )
    assert snapshot.alignment.why_withheld(protocol) == offline.withheld
    np.testing.assert_allclose(
        snapshot.alignment.similarity.rotation, offline.alignment.similarity.rotation, atol=1e-12
    )
    assert (snapshot.ate["rotation_deg"] is None) is (offline.ate["rotation_deg"] is None)
    if window == "0" and offline.ate["rotation_deg"] is not None:
        assert snapshot.ate["rotation_deg"] is not None
        assert snapshot.ate["rotation_deg"].rmse == pytest.approx(
            offline.ate["rotation_deg"].rmse, rel=1e-9
        )


def test_live_poses_wait_for_orientations() -> None:
    truth, estimate = road(20.0)
    bare = dataclasses.replace(truth, quaternions=None)
    snapshot = live(bare, estimate, OnlineSettings(on(way="poses"))).snapshot()
    assert snapshot.alignment is None
    assert "orientations on both sides" in snapshot.warming_up
