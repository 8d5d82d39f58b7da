"""Alignment with positions and orientations, and where it is refused."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotation_runs import TURNING, X, flight, freedom_numbers, of_marker, on, rmse, road
from scipy.spatial.transform import Rotation
from strategies import make_element, moved, seeds

from trajeval_ros import Gauge, Protocol, Trajectory, evaluate
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.cli.app import main
from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.metrics.alignment import Alignment, align, solve
from trajeval_ros.metrics.moments import Moments, OrientationSum
from trajeval_ros.pipeline.pipeline import run
from trajeval_ros.pipeline.request import Request


def write_tum(path: Path, trajectory: Trajectory) -> None:
    assert trajectory.quaternions is not None
    seconds = trajectory.stamps[:, None] * 1e-9
    np.savetxt(path, np.hstack([seconds, trajectory.positions, trajectory.quaternions]), "%.9f")


@settings(max_examples=10)
@given(seed=seeds, gauge=st.sampled_from(TURNING))
def test_no_other_alignment_has_less_of_both_errors(seed: int, gauge: Gauge) -> None:
    truth, estimate = flight(seed, 60)
    random = np.random.default_rng(seed)
    assert truth.quaternions is not None
    assert estimate.quaternions is not None
    # Other orientations than the positions have, so that there is something to weigh.
    rotated = make_element(gauge, seed + 2, reach_m=0.0).rotation
    some = Rotation.from_rotvec(0.2 * Rotation.from_matrix(rotated).as_rotvec())
    a, b = truth.quaternions, (some * Rotation.from_quat(estimate.quaternions)).as_quat()
    p, q = truth.positions, moved(estimate, make_element(gauge, seed + 3)).positions
    moments, orientations = Moments.of_pairs(p, q), OrientationSum.of_pairs(a, b)
    result = solve(gauge, moments, orientations, align_with="poses")
    assert result.by_positions is not None
    arm = moments.rmse(result.by_positions) / math.radians(2.0)

    def cost(similarity: Similarity) -> float:
        chord = 2.0 * math.sin(orientations.error(similarity.rotation) / 2.0)
        return moments.rmse(similarity) ** 2 + arm**2 * chord**2

    least, centre = cost(result.similarity), result.similarity.positions(q).mean(axis=0)
    for _ in range(20):
        step = 10.0 ** random.uniform(-4, -1) * random.normal(size=3)
        step[:2] *= gauge.has_so3
        growth = math.exp(step[2]) if gauge.has_scale else 1.0
        rotation = growth * Rotation.from_rotvec(step).as_matrix()
        other = Similarity(
            rotation @ result.similarity.rotation / growth,
            rotation @ (result.similarity.translation - centre) + centre,
            result.similarity.scale * growth,
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

    def detected(a: Trajectory, b: Trajectory) -> Alignment:
        assert a.quaternions is not None
        assert b.quaternions is not None
        orientations = a.quaternions, b.quaternions
        return align(gauge, a.positions, b.positions, orientations=orientations, align_with=way)

    plain = detected(truth, estimate)
    rotated = detected(moved(moved(truth, rigid), stretch), moved(moved(estimate, other), stretch))
    expected = rigid.rotation @ plain.similarity.rotation @ other.rotation.T
    np.testing.assert_allclose(rotated.similarity.rotation, expected, atol=1e-9)
    scale = plain.similarity.scale / other.scale
    assert rotated.similarity.scale == pytest.approx(scale, rel=1e-9)
    assert freedom_numbers(rotated) == pytest.approx(freedom_numbers(plain), rel=1e-6, abs=1e-8)


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
    p, q, a, b = (np.repeat(item, times, axis=0) for item in (p, q, a, b))
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
    (result,) = run(marked, [estimate], request).runs
    assert result.calibrated is not None
    assert result.calibrated.rotation_applied
    assert rmse(result.evaluation, "rotation_deg") < 2.5


def test_a_body_that_calibration_leaves_open_is_refused() -> None:
    truth, estimate = road(0.0, error_m=0.05)
    level = np.tile([0.0, 0.0, 0.0, 1.0], (301, 1))
    truth, estimate = (dataclasses.replace(item, quaternions=level) for item in (truth, estimate))
    with pytest.raises(InputError, match=r"can't estimate the rotation between"):
        run(truth, [estimate], Request(on(way="poses"), CalibrationRequest(hand_eye=True)))


@pytest.mark.parametrize(("turned_deg", "is_said"), [(3.0, False), (4.0, True)])
def test_positions_that_get_much_worse_are_said(turned_deg: float, is_said: bool) -> None:
    truth, estimate = flight(5)
    level = dataclasses.replace(truth, quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (200, 1)))
    still = dataclasses.replace(estimate, quaternions=level.quaternions)
    marked = of_marker(level, Rotation.from_rotvec(turned_deg / 20.0 * X.as_rotvec()))
    result = evaluate(marked, still, on(way="poses"))
    before, after = rmse(evaluate(marked, still, on()), "position_m"), rmse(result, "position_m")
    assert (after > 1.25 * before) is is_said
    text = [warning for warning in result.warnings if "increases the position ATE" in warning]
    assert len(text) == is_said
    assert all(f"from {before:.4g} m to {after:.4g} m" in item for item in text)


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
    for name, item in (("g", truth), ("e", estimate), ("m", marked), ("f", flight(7, 600)[1])):
        write_tum(tmp_path / f"{name}.txt", item)
    words = ["evaluate", "--lengths", "none", "--align-with", "poses"]
    files = ["-g", str(tmp_path / "g.txt"), "-e", str(tmp_path / "e.txt")]
    result = tmp_path / "result.json"
    assert main([*words, *files, f"--json={result}"]) == 0
    assert "all 301 pairs with orientations" in capsys.readouterr().out
    outcome = json.loads(result.read_text())
    assert outcome["provenance"]["settings"]["align_with"] == "poses"
    assert outcome["runs"][0]["ate"]["rotation_deg"]["rmse"] < 2.0
    other = ["-g", str(tmp_path / "m.txt"), "-e", str(tmp_path / "f.txt")]
    assert main([*words, *other]) == 2
    text = capsys.readouterr().err
    assert "another body" in text
    assert len(text.strip().splitlines()) == 1
