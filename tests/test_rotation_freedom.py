"""How far the alignment's rotation is open, and alignment with poses where it is."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import START, along_line, make_element, make_groundtruth, moved, seeds

from trajeval_ros import PROTOCOLS, Evaluation, Gauge, Protocol, Trajectory, evaluate
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.cli.app import main
from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import DegenerateGeometryError, InputError, SettingsError
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.metrics.alignment import Alignment, align, solve
from trajeval_ros.metrics.evaluation import evaluate as measured
from trajeval_ros.metrics.moments import Moments
from trajeval_ros.metrics.orientation_sum import OrientationSum
from trajeval_ros.metrics.rotation_freedom import OrientationEvidence, RotationFreedom
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.state_rows import states
from trajeval_ros.pipeline.pipeline import run
from trajeval_ros.pipeline.request import Request

TURNING = (Gauge.YAW, Gauge.PLANAR, Gauge.SE3, Gauge.SIM3)
X = Rotation.from_rotvec(np.radians(20.0) * np.array([0.48, 0.6, 0.64]))


def on(gauge: Gauge = Gauge.SE3, way: str = "positions") -> Protocol:
    return Protocol(gauge=gauge, align_with=way, lengths=())


def road(roll_deg: float, *, error_m: float = 0.3, seed: int = 1) -> tuple[Trajectory, Trajectory]:
    """Return 150 m of a road that bends by 1 m, and an estimate whose drift looks like a roll.

    Its orientations are right to 0.1 deg.
    """
    random = np.random.default_rng(seed)
    along = np.linspace(0.0, 150.0, 301)
    side = np.sin(along / 25.0)
    positions = np.column_stack([along, side, 0.3 * np.cos(along / 40.0)])
    heading = np.arctan(np.cos(along / 25.0) / 25.0)
    rotations = Rotation.from_rotvec(heading[:, None] * [0.0, 0.0, 1.0])
    stamps = START + np.arange(len(along), dtype=np.int64) * 50_000_000
    truth = Trajectory(stamps, positions, rotations.as_quat())
    drift = Rotation.from_rotvec([np.radians(roll_deg), 0.0, 0.0]).apply(positions)
    drift += error_m * np.sin(along[:, None] / 150.0 * np.array([13.0, 17.0, 15.0]))
    noise = Rotation.from_rotvec(np.radians(0.1 / math.sqrt(3.0)) * random.normal(size=(301, 3)))
    return truth, Trajectory(stamps, drift, (noise * rotations).as_quat())


def flight(seed: int, count: int = 200) -> tuple[Trajectory, Trajectory]:
    """Return a motion in space, and an estimate with errors of 0.1 m and 0.02 rad."""
    truth = dataclasses.replace(
        make_groundtruth(seed, count), gyroscope_biases=None, accelerometer_biases=None
    )
    random = np.random.default_rng(seed + 1)
    assert truth.rotations is not None
    turned = Rotation.from_rotvec(random.normal(scale=0.02, size=(count, 3))) * truth.rotations
    drift = np.cumsum(random.normal(scale=0.02, size=(count, 3)), axis=0)
    return truth, dataclasses.replace(
        truth, positions=truth.positions + drift, quaternions=turned.as_quat(), velocities=None
    )


def of_marker(truth: Trajectory, turn: Rotation = X) -> Trajectory:
    assert truth.rotations is not None
    return dataclasses.replace(truth, quaternions=(truth.rotations * turn).as_quat())


def freedom_numbers(alignment: Alignment) -> list[float]:
    freedom = alignment.freedom
    assert freedom is not None
    assert freedom.orientations is not None
    return [freedom.std_deg, *dataclasses.astuple(freedom.orientations)]


def rotation_warnings(found: Evaluation) -> list[str]:
    words = ("constant rotation", "do not determine", "withheld", "another body")
    return [each for each in found.warnings if any(word in each for word in words)]


def rmse(found: Evaluation, metric: str) -> float:
    statistics = found.ate[metric]
    assert statistics is not None
    return statistics.rmse


def write_tum(path: Path, trajectory: Trajectory) -> None:
    assert trajectory.quaternions is not None
    seconds = trajectory.stamps[:, None] * 1e-9
    np.savetxt(path, np.hstack([seconds, trajectory.positions, trajectory.quaternions]), "%.9f")


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
    turn = Rotation.random(random_state=seed % 2**31 + 2)
    halves = np.sin((a * b.inv() * turn.inv()).magnitude() / 2.0)
    chord = math.sqrt(np.average(np.square(halves), weights=weights))
    assert whole.error(turn.as_matrix()) == pytest.approx(2.0 * math.asin(chord), rel=1e-9)


def test_one_turn_throughout_is_its_angle() -> None:
    b = Rotation.random(50, random_state=3)
    turned = OrientationSum.of_pairs((X * b).as_quat(), b.as_quat())
    assert math.degrees(turned.error(np.eye(3))) == pytest.approx(20.0, rel=1e-12)
    assert turned.error(X.as_matrix()) == 0.0


# The standard deviation.


@settings(max_examples=10)
@given(seed=seeds, gauge=st.sampled_from(TURNING), way=st.sampled_from(["positions", "poses"]))
def test_the_covariance_is_the_sandwich_of_all_places_with_all_errors(
    seed: int, gauge: Gauge, way: str
) -> None:
    truth, estimate = flight(seed, 40)
    similarity = (found := evaluate(truth, estimate, on(gauge, way))).alignment.similarity
    q = found.association.estimate.positions
    p = found.association.groundtruth.positions
    linear = similarity.rotation
    scale = np.sum((p - p.mean(0)) * ((q - q.mean(0)) @ linear.T)) / np.sum((q - q.mean(0)) ** 2)
    a = similarity.scale * (q - q.mean(0)) @ linear.T
    e = (p - p.mean(0)) - scale * (q - q.mean(0)) @ linear.T
    torques = np.cross(a[:, None], e[None, :]).reshape(-1, 3)
    axes = slice(2, 3) if gauge.turns_about_gravity_only else slice(0, 3)
    curvature = (np.sum(a * a) * np.eye(3) - a.T @ a)[axes, axes] / len(a)
    gradient = (torques.T @ torques / len(torques))[axes, axes]
    _, error, least, _, in_stds = np.radians(freedom_numbers(found.alignment))
    if found.alignment.by_positions is not None:
        moments = Moments.of_pairs(p, q)
        arm = moments.rmse(found.alignment.by_positions) / math.radians(2.0)
        curvature += arm**2 * np.eye(len(curvature))
        gradient += arm**4 * error**2 / 3.0 * np.eye(len(curvature))
    inverse = np.linalg.inv(curvature)
    covariance = inverse @ gradient @ inverse
    assert found.alignment.freedom is not None
    std = math.degrees(math.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    assert found.alignment.freedom.std_deg == pytest.approx(std, rel=1e-9)
    turned, other = found.association.groundtruth.rotations, found.association.estimate.rotations
    assert turned is not None
    assert other is not None
    mean = (turned * other.inv()).as_matrix().mean(axis=0)
    if gauge.turns_about_gravity_only:
        yaw = math.atan2(mean[1, 0] - mean[0, 1], mean[0, 0] + mean[1, 1])
        alone = Rotation.from_rotvec([0.0, 0.0, yaw])
    else:
        alone = (turned * other.inv()).mean()
    turn = (alone * Rotation.from_matrix(similarity.rotation).inv()).as_rotvec()[axes]
    spread = covariance + (least**2 / 3.0 + math.radians(0.4) ** 2) * np.eye(len(turn))
    expected = math.sqrt(turn @ np.linalg.solve(spread, turn))
    assert math.degrees(in_stds) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("gauge", [Gauge.SE3, Gauge.SIM3])
def test_an_exactly_straight_line_is_free(gauge: Gauge) -> None:
    truth = along_line(np.linspace(0.0, 30.0, 300), [1.0, -2.0, 0.5])
    found = evaluate(truth, moved(truth, make_element(gauge, 1)), on(gauge))
    assert found.alignment.freedom is not None
    assert found.alignment.freedom.std_deg == math.inf
    assert found.ate["rotation_deg"] is None
    assert "the positions do not constrain it" in found.withheld
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
    found = evaluate(truth, estimate, on(gauge, way))
    assert rmse(found, "yaw_deg") < 1e-6
    assert rotation_warnings(found) == []
    with pytest.raises(DegenerateGeometryError, match="at least 3"):
        evaluate(truth, estimate, on(Gauge.SE3, way))


# Warnings and what is withheld.


@pytest.mark.parametrize(
    ("std_deg", "error", "least", "turn", "stds", "expected"),
    [
        # error, least and turn in degrees; misleading, disagreeing, withheld
        (5.0, 3.81, 1.0, 3.7, 1.0, (True, False, False)),
        (5.0, 3.79, 1.0, 3.6, 1.0, (False, False, False)),
        (5.0, 2.01, 0.1, 2.0, 1.0, (True, False, False)),
        (5.0, 1.99, 0.1, 1.9, 9.0, (False, False, False)),
        (5.0, 12.0, 0.1, 10.1, 1.0, (True, False, True)),
        (5.0, 12.0, 0.1, 9.9, 1.0, (True, False, False)),
        (5.0, 12.0, 11.0, 12.0, 1.0, (False, False, False)),
        (5.0, 5.0, 0.1, 5.0, 4.9, (True, False, False)),
        (5.0, 5.0, 0.1, 5.0, 5.1, (True, True, False)),
        (29.9, 1.0, 1.0, 0.1, 0.1, (False, False, False)),
        (30.1, 1.0, 1.0, 0.1, 0.1, (False, False, True)),
    ],
)
def test_limits(
    std_deg: float,
    error: float,
    least: float,
    turn: float,
    stds: float,
    expected: tuple[bool, bool, bool],
) -> None:
    freedom = RotationFreedom(False, std_deg, OrientationEvidence(error, least, turn, stds))
    found = freedom.is_misleading, freedom.disagrees, bool(freedom.untrustworthy)
    assert found == expected
    assert bool(freedom.misleading) is expected[0]


def test_a_turn_that_positions_hardly_determine_is_said_and_withheld() -> None:
    truth, estimate = road(20.0)
    found = evaluate(truth, estimate, on())
    freedom = found.alignment.freedom
    assert freedom is not None
    assert freedom.orientations is not None
    assert 2.0 < freedom.std_deg < 30.0
    assert freedom.orientations.error_deg == pytest.approx(20.0, abs=6.0)
    assert freedom.orientations.turn_deg == pytest.approx(freedom.orientations.error_deg, rel=1e-2)
    assert freedom.orientations.least_deg == pytest.approx(0.1, abs=0.02)
    assert found.ate["rotation_deg"] is None
    assert found.ate["position_m"] is not None
    (warning,) = rotation_warnings(found)
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
    found = evaluate(*road(roll_deg, error_m=0.1), on())
    assert (found.ate["rotation_deg"] is None) is withheld
    (warning,) = rotation_warnings(found)
    assert warning.startswith("rotation and velocity errors are withheld") is withheld


def test_what_drift_does_not_explain_is_a_disagreement() -> None:
    # A robot that hardly turns on a path that is not straight: the body's turn is the world's.
    truth, estimate = flight(5)
    level = dataclasses.replace(truth, quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (200, 1)))
    still = dataclasses.replace(estimate, quaternions=level.quaternions)
    found = evaluate(of_marker(level), still, on())
    assert found.alignment.freedom is not None
    assert found.alignment.freedom.disagrees
    (warning,) = rotation_warnings(found)
    assert "positions and orientations disagree by a constant rotation of" in warning
    assert "--hand-eye auto" in warning
    assert found.ate["rotation_deg"] is None


@pytest.mark.parametrize("protocol", ["evo", "rpg"])
def test_protocols_of_programs_print_what_these_print(protocol: str) -> None:
    truth, estimate = road(20.0)
    settings = dataclasses.replace(PROTOCOLS[protocol], lengths=())
    found = evaluate(truth, estimate, settings)
    assert rmse(found, "rotation_deg") > 10.0
    (warning,) = rotation_warnings(found)
    assert warning.startswith("of the rotation error of")


@pytest.mark.parametrize("roll_deg", [20.0, 0.0])
def test_positions_alone_are_no_reason_for_a_warning(roll_deg: float) -> None:
    truth, estimate = road(roll_deg)
    found = evaluate(dataclasses.replace(truth, quaternions=None), estimate, on())
    assert rotation_warnings(found) == [
        each for each in found.warnings if "no orientations in the" in each
    ]
    freedom = found.alignment.freedom
    assert freedom is not None
    assert freedom.orientations is None
    assert freedom.std_deg > 2.0


@given(seed=seeds)
def test_runs_that_determine_their_rotation_are_silent(seed: int) -> None:
    truth, estimate = flight(seed)
    for gauge in TURNING:
        assert rotation_warnings(evaluate(truth, estimate, on(gauge))) == []


# Alignment with poses.


@settings(max_examples=10)
@given(seed=seeds, gauge=st.sampled_from(TURNING))
def test_no_other_alignment_has_less_of_both_errors(seed: int, gauge: Gauge) -> None:
    truth, estimate = flight(seed, 60)
    random = np.random.default_rng(seed)
    assert truth.quaternions is not None
    assert estimate.quaternions is not None
    # Other orientations than the positions have, so that there is something to weigh.
    turned = make_element(gauge, seed + 2, reach_m=0.0).rotation
    some = Rotation.from_rotvec(0.2 * Rotation.from_matrix(turned).as_rotvec())
    a, b = truth.quaternions, (some * Rotation.from_quat(estimate.quaternions)).as_quat()
    p, q = truth.positions, moved(estimate, make_element(gauge, seed + 3)).positions
    moments, orientations = Moments.of_pairs(p, q), OrientationSum.of_pairs(a, b)
    found = solve(gauge, moments, orientations, align_with="poses")
    assert found.by_positions is not None
    arm = moments.rmse(found.by_positions) / math.radians(2.0)

    def cost(similarity: Similarity) -> float:
        chord = 2.0 * math.sin(orientations.error(similarity.rotation) / 2.0)
        return moments.rmse(similarity) ** 2 + arm**2 * chord**2

    least, centre = cost(found.similarity), found.similarity.positions(q).mean(axis=0)
    for _ in range(20):
        step = 10.0 ** random.uniform(-4, -1) * random.normal(size=3)
        step[:2] *= gauge.turns_freely
        growth = math.exp(step[2]) if gauge.has_scale else 1.0
        turn = growth * Rotation.from_rotvec(step).as_matrix()
        other = Similarity(
            turn @ found.similarity.rotation / growth,
            turn @ (found.similarity.translation - centre) + centre,
            found.similarity.scale * growth,
        )
        assert cost(other) >= least * (1.0 - 1e-9)


@given(
    seed=seeds,
    gauge=st.sampled_from(TURNING),
    way=st.sampled_from(["positions", "poses"]),
    units=st.sampled_from([1e-3, 1.0, 1e3]),
)
def test_worlds_and_units_change_nothing(seed: int, gauge: Gauge, way: str, units: float) -> None:
    truth, estimate = flight(seed, 80)
    assert truth.quaternions is not None
    assert estimate.quaternions is not None
    world, other = make_element(gauge, seed + 1), make_element(gauge, seed + 2)
    # Both in other units; the estimate's own scale is the gauge's.
    stretch = Similarity(np.eye(3), np.zeros(3), units)
    rigid = dataclasses.replace(world, scale=1.0)

    def found(a: Trajectory, b: Trajectory) -> Alignment:
        assert a.quaternions is not None
        assert b.quaternions is not None
        orientations = a.quaternions, b.quaternions
        return align(gauge, a.positions, b.positions, orientations=orientations, align_with=way)

    plain = found(truth, estimate)
    turned = found(moved(moved(truth, rigid), stretch), moved(moved(estimate, other), stretch))
    expected = rigid.rotation @ plain.similarity.rotation @ other.rotation.T
    np.testing.assert_allclose(turned.similarity.rotation, expected, atol=1e-9)
    scale = plain.similarity.scale / other.scale
    assert turned.similarity.scale == pytest.approx(scale, rel=1e-9)
    assert freedom_numbers(turned) == pytest.approx(freedom_numbers(plain), rel=1e-6, abs=1e-8)


def test_orientations_have_no_say_where_positions_have_no_error() -> None:
    truth, _ = flight(1)
    estimate = moved(
        of_marker(truth, Rotation.from_rotvec([0.01, 0.0, 0.0])), make_element(Gauge.SE3, 2)
    )
    one, two = (evaluate(truth, estimate, on(way=way)) for way in ("positions", "poses"))
    np.testing.assert_allclose(
        one.alignment.similarity.rotation, two.alignment.similarity.rotation, atol=1e-12
    )


def test_weights_hold_for_orientations_too() -> None:
    truth, estimate = flight(2, 60)
    assert truth.quaternions is not None
    assert estimate.quaternions is not None
    times = np.random.default_rng(3).integers(1, 5, size=60)
    p, q = truth.positions, estimate.positions
    a, b = truth.quaternions, estimate.quaternions
    one = align("se3", p, q, times.astype(float), (a, b), align_with="poses")
    p, q, a, b = (np.repeat(each, times, axis=0) for each in (p, q, a, b))
    two = align("se3", p, q, orientations=(a, b), align_with="poses")
    np.testing.assert_allclose(one.similarity.rotation, two.similarity.rotation, atol=1e-11)
    assert (one.states_used, two.states_used) == (60, int(times.sum()))
    assert freedom_numbers(one) == pytest.approx(freedom_numbers(two), rel=1e-9)


# Where poses are refused, or spoil.


def test_poses_of_another_body_are_refused_and_taken_once_it_is_known() -> None:
    truth, estimate = flight(7, 600)
    marked = of_marker(truth)
    with pytest.raises(InputError, match=r"another body frame, rotated by 20 deg.*--hand-eye"):
        evaluate(marked, estimate, on(way="poses"))
    request = Request(on(way="poses"), CalibrationRequest(hand_eye=True))
    (found,) = run(marked, [estimate], request).runs
    assert found.calibrated is not None
    assert found.calibrated.rotation_applied
    assert rmse(found.evaluation, "rotation_deg") < 2.5


def test_a_body_that_calibration_leaves_open_is_refused() -> None:
    truth, estimate = road(0.0, error_m=0.05)
    level = np.tile([0.0, 0.0, 0.0, 1.0], (301, 1))
    truth, estimate = (dataclasses.replace(each, quaternions=level) for each in (truth, estimate))
    with pytest.raises(InputError, match=r"can't estimate the rotation between"):
        run(truth, [estimate], Request(on(way="poses"), CalibrationRequest(hand_eye=True)))


@pytest.mark.parametrize(("turned_deg", "is_said"), [(3.0, False), (4.0, True)])
def test_positions_that_get_much_worse_are_said(turned_deg: float, is_said: bool) -> None:
    truth, estimate = flight(5)
    level = dataclasses.replace(truth, quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (200, 1)))
    still = dataclasses.replace(estimate, quaternions=level.quaternions)
    marked = of_marker(level, Rotation.from_rotvec(turned_deg / 20.0 * X.as_rotvec()))
    found = evaluate(marked, still, on(way="poses"))
    before, after = rmse(evaluate(marked, still, on()), "position_m"), rmse(found, "position_m")
    assert (after > 1.25 * before) is is_said
    said = [each for each in found.warnings if "increases the position ATE" in each]
    assert len(said) == is_said
    assert all(f"from {before:.4g} m to {after:.4g} m" in each for each in said)


def test_poses_need_orientations_and_something_to_turn() -> None:
    truth, estimate = flight(1)
    bare = dataclasses.replace(truth, quaternions=None)
    with pytest.raises(InputError, match="orientations on both sides"):
        evaluate(bare, estimate, on(way="poses"))
    with pytest.raises(SettingsError, match="has no rotation"):
        on(Gauge.TRANSLATION, "poses")
    with pytest.raises(SettingsError, match="is always aligned by its pose"):
        Protocol(align_with="poses", align_states=1)
    with pytest.raises(SettingsError, match="did you mean poses"):
        Protocol(align_with="pose")
    covariances = np.broadcast_to(np.eye(6) * 1e-2, (len(estimate), 6, 6))
    known = dataclasses.replace(estimate, covariances=covariances)
    with pytest.raises(InputError, match="align with positions"):
        run(truth, [known], Request(on(way="poses"), covariances=CovarianceRequest("message")))


def test_the_command_aligns_with_poses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth, estimate = road(20.0)
    marked = of_marker(flight(7, 600)[0])
    for name, each in (("g", truth), ("e", estimate), ("m", marked), ("f", flight(7, 600)[1])):
        write_tum(tmp_path / f"{name}.txt", each)
    words = ["evaluate", "--lengths", "none", "--align-with", "poses"]
    files = ["-g", str(tmp_path / "g.txt"), "-e", str(tmp_path / "e.txt")]
    result = tmp_path / "result.json"
    assert main([*words, *files, f"--json={result}"]) == 0
    assert "all 301 states with orientations" in capsys.readouterr().out
    found = json.loads(result.read_text())
    assert found["provenance"]["settings"]["align_with"] == "poses"
    assert found["runs"][0]["ate"]["rotation_deg"]["rmse"] < 2.0
    other = ["-g", str(tmp_path / "m.txt"), "-e", str(tmp_path / "f.txt")]
    assert main([*words, *other]) == 2
    said = capsys.readouterr().err
    assert "another body" in said
    assert len(said.strip().splitlines()) == 1


# Live.


def live(
    truth: Trajectory, estimate: Trajectory, settings: OnlineSettings, batch: int = 7
) -> OnlineEvaluator:
    evaluator = OnlineEvaluator(settings)
    rows = [states(each.positions, each.quaternions) for each in (truth, estimate)]
    for begin in range(0, len(truth), batch):
        part = slice(begin, begin + batch)
        evaluator.add_groundtruth(truth.stamps[part], rows[0][part])
        evaluator.add_estimate(estimate.stamps[part], rows[1][part])
        evaluator.update()
    evaluator.update(at_end=True)
    return evaluator


@pytest.mark.parametrize("window", ["0", "2s", "37"])
@pytest.mark.parametrize("way", ["positions", "poses"])
@pytest.mark.parametrize("states_used", [None, 120])
@settings(max_examples=5)
@given(seed=seeds, gauge=st.sampled_from(TURNING))
def test_live_is_offline(
    seed: int, gauge: Gauge, window: str, way: str, states_used: int | None
) -> None:
    pairs = road(20.0, seed=seed) if gauge.turns_freely else flight(seed)
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


# Recordings.


@pytest.fixture(scope="module")
def kitti(recording: Callable[[str], Trajectory]) -> tuple[Trajectory, Trajectory]:
    return recording("kitti/KITTI_00_gt.txt"), recording("kitti/KITTI_00_ORB.txt")


def by_frame(way: str = "positions") -> Protocol:
    return Protocol(association="index", align_with=way, lengths=())


def test_a_straight_street_of_kitti(kitti: tuple[Trajectory, Trajectory]) -> None:
    truth, estimate = (each[4200:4350] for each in kitti)
    found = evaluate(truth, estimate, by_frame())
    assert found.ate["rotation_deg"] is None
    assert found.alignment.freedom is not None
    std_deg, error_deg, least_deg, turn_deg, _ = freedom_numbers(found.alignment)
    assert std_deg == pytest.approx(27.1, abs=0.1)
    assert [error_deg, turn_deg] == pytest.approx([33.56, 33.56], abs=0.005)
    assert least_deg == pytest.approx(0.09, abs=0.005)
    (warning,) = rotation_warnings(found)
    assert "of the rotation error of 33.6 deg, 33.6 deg are a constant rotation" in warning
    with_poses = evaluate(truth, estimate, by_frame("poses"))
    assert rmse(with_poses, "rotation_deg") == pytest.approx(0.46, abs=0.005)
    assert rmse(with_poses, "position_m") == pytest.approx(0.6532, abs=5e-5)
    assert rotation_warnings(with_poses) == []


def test_kitti_with_a_marker_is_refused(kitti: tuple[Trajectory, Trajectory]) -> None:
    truth, estimate = kitti
    assert rotation_warnings(evaluate(truth, estimate, by_frame())) == []
    marked = dataclasses.replace(of_marker(truth), matrices=None)
    with pytest.raises(InputError, match="another body"):
        evaluate(marked, estimate, by_frame("poses"))
    # The whole run determines its rotation: 1.303 m either way.
    with_poses = evaluate(truth, estimate, by_frame("poses"))
    before = rmse(evaluate(truth, estimate, by_frame()), "position_m")
    assert rmse(with_poses, "position_m") == pytest.approx(before, rel=5e-4)


@pytest.mark.slow
def test_full_recordings_are_silent(
    recording: Callable[[str], Trajectory], shared_data: Path
) -> None:
    euroc = [
        (f"euroc/groundtruth/{sequence}.txt", str(path.relative_to(shared_data)))
        for sequence in ("MH_01", "MH_05", "V2_03")
        for path in (
            shared_data / f"euroc/vio_mono/{sequence}.txt",
            *sorted((shared_data / "euroc/vislam_ba").glob(f"{sequence}_trial*.txt")),
        )
    ]
    assert len(euroc) == 33
    desk = ("tum/fr2_desk_groundtruth.txt", "tum/fr2_desk_ORB.txt")
    for truth, estimate in (*euroc, desk):
        for gauge in (Gauge.SE3, Gauge.YAW) if truth.startswith("euroc") else (Gauge.SE3,):
            found = evaluate(recording(truth), recording(estimate), on(gauge))
            assert rotation_warnings(found) == [], (estimate, gauge)


@pytest.mark.slow
def test_windows_of_kitti_that_are_wrong_are_said_and_no_others(
    kitti: tuple[Trajectory, Trajectory], recording: Callable[[str], Trajectory]
) -> None:
    nine = (
        recording("kitti_odom_eval/09_groundtruth.txt"),
        recording("kitti_odom_eval/09_full.txt"),
    )
    first_state = dataclasses.replace(by_frame(), align_states=1)
    counts = dict.fromkeys(("windows", "wrong", "missed", "others", "withheld", "needlessly"), 0)
    for truth, estimate in (kitti, nine):
        for length in (60, 100, 150, 200):
            for begin in range(0, len(truth) - length + 1, 30):
                part = slice(begin, begin + length)
                window = measured(truth[part], estimate[part], by_frame())
                by_first = rmse(measured(truth[part], estimate[part], first_state), "rotation_deg")
                freedom = window.alignment.freedom
                assert freedom is not None
                _, error_deg, least_deg, _, _ = freedom_numbers(window.alignment)
                wrong = error_deg > 2.0 and error_deg > 3.0 * by_first
                counts["windows"] += 1
                counts["wrong"] += wrong
                counts["missed"] += wrong and not freedom.is_misleading
                counts["others"] += freedom.is_misleading and not wrong
                counts["withheld"] += bool(window.withheld)
                fine = error_deg < 2.0 or error_deg <= 2.0 * least_deg
                counts["needlessly"] += bool(window.withheld) and fine
    assert tuple(counts.values()) == (789, 153, 0, 0, 41, 1)
