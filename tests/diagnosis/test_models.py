"""Models of short motions: known relations are recovered, and nothing that cannot matter does."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from paths import SHARED
from scipy.spatial.transform import Rotation

from benchmarks.diagnosis import diagnosis_of
from benchmarks.diagnosis_mistakes import MISTAKES, inverse, shifted
from benchmarks.diagnosis_runs import Pair, simulated
from benchmarks.diagnosis_users import USERS
from trajeval_ros import HandEye, InputError, read_trajectory
from trajeval_ros.diagnosis.clocks import ClockMatch, rates_of_both
from trajeval_ros.diagnosis.hypotheses import HYPOTHESES, PERMUTATIONS, euler_angles_changed
from trajeval_ros.diagnosis.input_pair import TimedPoses
from trajeval_ros.diagnosis.motion_models import ModelScores
from trajeval_ros.diagnosis.motion_parameters import BODY, LEVER, SPREADS, fit_parameters, log_odds
from trajeval_ros.diagnosis.short_motions import ShortMotions
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory

Array = NDArray[np.float64]
DRONE = simulated(640, "drone", "walk", 60.0)
EUROC = SHARED / "data" / "euroc"
CAMERA = lie.from_matrix(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))
seeds = st.integers(0, 10_000)


def poses(trajectory: Trajectory) -> TimedPoses:
    return TimedPoses.of(trajectory, int(DRONE.truth.stamps[0]))


def motions_of(estimate: Trajectory) -> ShortMotions:
    return ShortMotions.between(poses(DRONE.truth), poses(estimate), 0.3)


def quaternions_of(trajectory: Trajectory) -> Array:
    assert trajectory.quaternions is not None
    return trajectory.quaternions


def rotated(trajectory: Trajectory, world: Array, body: Array) -> Trajectory:
    quaternions = lie.multiply(lie.multiply(world, quaternions_of(trajectory)), body)
    positions = lie.rotate(np.broadcast_to(world, quaternions.shape), trajectory.positions)
    return dataclasses.replace(trajectory, positions=positions, quaternions=quaternions)


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_a_rotation_of_the_world_changes_no_likelihood(seed: int) -> None:
    world = Rotation.random(random_state=seed).as_quat()
    scores = []
    for estimate in (DRONE.estimate, rotated(DRONE.estimate, world, np.array([0, 0, 0, 1.0]))):
        models = ModelScores(motions_of(estimate)).likeliest(HYPOTHESES)
        scores.append(max(model.score for model in models))
    assert scores[0] == pytest.approx(scores[1], abs=1e-3)


@settings(max_examples=10, deadline=None)
@given(seeds, st.floats(0.1, 10.0))
def test_body_lever_arm_and_scale_are_fitted(seed: int, scale: float) -> None:
    body = Rotation.random(random_state=seed)
    lever = np.random.default_rng(seed).uniform(-0.5, 0.5, 3)
    # The groundtruth itself, of another point and with other axes of the body.
    truth = DRONE.truth[::5]
    quaternions = lie.multiply(quaternions_of(truth), body.as_quat())
    positions = truth.positions + lie.rotate(
        quaternions_of(truth), np.tile(lever, (len(truth), 1))
    )
    estimate = dataclasses.replace(truth, positions=positions / scale, quaternions=quaternions)
    scores = ModelScores(motions_of(estimate))
    best = max(scores.likeliest(HYPOTHESES[:1]), key=lambda model: model.score)
    fitted = fit_parameters(scores, best)
    # T_B_M of the groundtruth's point in the estimate's body.
    assert fitted.scale == pytest.approx(scale, rel=0.01)
    assert np.degrees(lie.angle(lie.from_matrix(fitted.body @ body.as_matrix().T))) < 0.5
    assert fitted.values[LEVER] == pytest.approx(-body.inv().apply(lever), abs=0.02)
    assert fitted.values[BODY].shape == (3,)


@pytest.mark.parametrize("offset_s", [-0.08, 0.03])
@pytest.mark.parametrize("rate", [0.0, 8e-4])
def test_the_clock_is_fitted(offset_s: float, rate: float) -> None:
    seconds = (DRONE.estimate.stamps - DRONE.estimate.stamps[0]) / 1e9
    middle_s = seconds[-1] / 2.0
    late = np.rint(1e9 * (offset_s + rate * (seconds - middle_s))).astype(np.int64)
    estimate = dataclasses.replace(DRONE.estimate, stamps=DRONE.estimate.stamps - late)
    scores = ModelScores(motions_of(estimate))
    fitted = fit_parameters(scores, scores.likeliest(HYPOTHESES[:1])[0])
    assert fitted.offset_s == pytest.approx(offset_s, abs=0.01)
    assert fitted.rate == pytest.approx(rate, abs=3e-4)


def test_rates_of_motion_show_the_offset_and_unrelated_ones_do_not() -> None:
    match = ClockMatch.between(*rates_of_both(poses(DRONE.truth), poses(DRONE.estimate)))
    other = simulated(641, "drone", "walk", 60.0)
    unrelated = ClockMatch.between(*rates_of_both(poses(DRONE.truth), poses(other.estimate)))
    assert match is not None
    assert unrelated is not None
    assert abs(match.offset_s) < 0.02
    assert match.peak > 0.95 > 0.7 > unrelated.peak


@given(st.permutations("XYZ"), st.permutations("XYZ"), seeds)
def test_euler_angles_are_those_of_scipy(read: list[str], written: list[str], seed: int) -> None:
    rotations = Rotation.random(5, random_state=seed)
    one, other = "".join(read), "".join(written)
    expected = Rotation.from_euler(other, rotations.as_euler(one)).as_quat()
    changed = euler_angles_changed(rotations.as_quat(), one, other)
    assert np.abs(np.sum(changed * expected, axis=1)) == pytest.approx(1.0, abs=1e-6)


def test_there_are_48_signed_permutations_and_the_first_is_none() -> None:
    assert len(np.unique(PERMUTATIONS, axis=0)) == 48
    assert (PERMUTATIONS[0] == np.eye(3)).all()


@given(st.sampled_from(sorted(SPREADS)), st.floats(0.0, 0.5))
def test_only_a_value_beyond_the_healthy_spread_is_a_mistake(name: str, healthy: float) -> None:
    spread = SPREADS[name]
    variance = np.array([[(0.1 * spread.healthy) ** 2]])
    assert log_odds(np.array([healthy * spread.healthy]), variance, spread) < 0.0
    assert log_odds(np.array([8.0 * spread.healthy]), variance, spread) > 12.0
    # An uncertain value is none, whatever it is.
    assert log_odds(np.array([8.0 * spread.healthy]), np.array([[1e4]]), spread) < 1.0


def test_a_pose_as_text_is_a_hand_eye_transform() -> None:
    pose = HandEye.from_text("1,2,3,0,0,0.7071,0.7071")
    assert pose is not None
    assert pose.lever_m.tolist() == [1.0, 2.0, 3.0]
    both = pose.after(pose)
    assert both.lever_m == pytest.approx([-1.0, 3.0, 6.0])
    assert HandEye.from_text("file.yaml") is None
    assert HandEye.from_text("1,2,3") is None
    for text in ("1,2,3,0,0,0,2", "nan,0,0,0,0,0,1"):
        with pytest.raises(InputError, match="quaternion of length 1"):
            HandEye.from_text(text)


@functools.cache
def recorded(name: str) -> Pair:
    truth = read_trajectory(EUROC / "groundtruth" / f"{name}.txt").in_order()
    return Pair(name, truth, read_trajectory(EUROC / "vio_mono" / f"{name}.txt"), Gauge.YAW)


def with_body(pair: Pair, side: str, body: Array) -> Pair:
    poses_of_side = getattr(pair, side)
    quaternions = lie.multiply(quaternions_of(poses_of_side), body)
    return dataclasses.replace(
        pair, **{side: dataclasses.replace(poses_of_side, quaternions=quaternions)}
    )


needs_data = pytest.mark.skipif(not EUROC.is_dir(), reason="the recordings are not here")


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["MH_01", "MH_05"])
@pytest.mark.parametrize(
    ("mistake", "cause", "size"),
    [
        ("4 deg of tilt", "tilted", "differ by 4."),
        ("500 ppm", "clock_drift", "-5"),
        ("40 ms", "small_clock_offset", " ms added"),
        ("z of 0", "flat", "all z of the estimate are equal"),
    ],
)
def test_small_mistakes_are_stated_with_their_sizes(
    name: str, mistake: str, cause: str, size: str
) -> None:
    pair, plain = recorded(name), np.array([0.0, 0.0, 0.0, 1.0])
    estimate = pair.estimate
    if mistake == "4 deg of tilt":
        estimate = rotated(estimate, Rotation.from_rotvec([0.0726, 0.0, 0.0]).as_quat(), plain)
    elif mistake == "500 ppm":
        growth = np.rint(5e-4 * (estimate.stamps - estimate.stamps[0])).astype(np.int64)
        estimate = dataclasses.replace(estimate, stamps=estimate.stamps + growth)
    elif mistake == "40 ms":
        estimate = dataclasses.replace(estimate, stamps=estimate.stamps + 40_000_000)
    else:
        flat = estimate.positions * [1.0, 1.0, 0.0]
        estimate = dataclasses.replace(estimate, positions=flat)
    first = diagnosis_of(dataclasses.replace(pair, estimate=estimate)).suggested
    assert first is not None
    assert first.cause == cause
    assert size in first.sentence


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("of_camera", ["truth", "estimate", ""])
@pytest.mark.parametrize("side", ["truth", "estimate"])
def test_inverse_poses_are_named_on_their_side(side: str, of_camera: str) -> None:
    pair = recorded("MH_01")
    if of_camera:
        pair = with_body(pair, of_camera, CAMERA)
    first = diagnosis_of(inverse(side)(pair)).suggested
    assert first is not None
    assert first.cause == "inverse"
    owner = "groundtruth" if side == "truth" else "estimate"
    assert first.sentence.startswith(f"the {owner}'s poses")


@pytest.mark.parametrize("mistake", ["compass heading", "roll and pitch swapped"])
def test_angles_with_other_signs_are_no_other_axes_on_a_plane(mistake: str) -> None:
    first = diagnosis_of(USERS[mistake].make(simulated(60415, "car", "walk", 100.0))).suggested
    assert first is not None
    assert first.cause == "rotations"
    assert "only with a correction" in first.sentence


def test_a_rate_is_searched_if_no_offset_is_clear() -> None:
    """The turns of a car match at -30 s."""
    pair = simulated(60416, "car", "heavy", 100.0)
    first = diagnosis_of(USERS["30 fps for 25"].make(pair)).suggested
    assert first is not None
    assert first.cause == "clock_drift"


def test_copied_rows_are_no_other_run() -> None:
    """In the order of time, they look like another rate of the clock."""
    pair = simulated(91238, "drone", "heavy", 100.0)
    causes = [
        finding.cause for finding in diagnosis_of(MISTAKES["duplicated"].make(pair)).findings
    ]
    assert causes == ["duplicated"]


def test_an_offset_whose_correction_increases_the_error_is_no_cause() -> None:
    """With a drift that is equal to the effect of an offset, the correction adds the error."""
    pair = simulated(640, "car", "walk", 100.0)
    for finding in diagnosis_of(shifted(0.1)(pair)).findings:
        assert finding.tried is None or finding.tried.ratios[0] < 1.05


@needs_data
def test_wrong_pairs_do_not_look_like_a_flip() -> None:
    """The body seems to flip between poses of 18 s apart, which changes no rate of motion."""
    finding = diagnosis_of(shifted(18.0)(recorded("MH_05"))).suggested
    assert finding is not None
    assert finding.cause == "clock_offset"
