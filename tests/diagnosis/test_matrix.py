"""Mistakes are called by their names, and right recordings get none, on what a plain clone has."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from advice import assert_no_advice_is_worse

from benchmarks.diagnosis import corrected, diagnosis_of
from benchmarks.diagnosis_discontinuities import DISCONTINUITIES
from benchmarks.diagnosis_further import FURTHER
from benchmarks.diagnosis_mistakes import MISTAKES
from benchmarks.diagnosis_runs import DRIFTS, KINDS, Pair, simulated, with_outliers
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory

DRONE = simulated(5000, "drone", "walk", 100.0)
CAR = simulated(5004, "car", "walk", 100.0)
# Of the car, whose turns are about one axis, and whose drift hides a small lever arm.
UNSEEN_ON_CARS = {
    "diverging, 0.3 m/s2",
    "wxyz, both",
    "transposed rotations",
    "lever arm",
    "clock 1000 ppm",
    "heights of the ellipsoid",
    "outlier",
}
# Where both worlds agree nearly, an order of both sides' columns may not show.
UNSEEN_ON_DRONES = {"wxyz, both", "KITTI by yaw"}
ALL = {**MISTAKES, **FURTHER, **DISCONTINUITIES}


def causes(diagnosis: Diagnosis) -> list[str]:
    return [finding.cause for finding in diagnosis.findings]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ALL.keys() - UNSEEN_ON_DRONES))
def test_a_mistake_is_named_on_a_drone(name: str) -> None:
    diagnosis = diagnosis_of(ALL[name].make(DRONE))
    assert_no_advice_is_worse(diagnosis)
    assert causes(diagnosis)[0] in ALL[name].causes


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ALL.keys() - UNSEEN_ON_CARS))
def test_a_mistake_is_named_on_a_car(name: str) -> None:
    diagnosis = diagnosis_of(ALL[name].make(CAR))
    assert_no_advice_is_worse(diagnosis)
    assert causes(diagnosis)[0] in ALL[name].causes


@pytest.mark.parametrize("name", sorted(UNSEEN_ON_CARS))
def test_what_a_car_can_not_show_is_a_tie_or_nothing(name: str) -> None:
    diagnosis = diagnosis_of(ALL[name].make(CAR))
    assert_no_advice_is_worse(diagnosis)
    allowed = {*ALL[name].causes, "convention_tie", "small_clock_offset"}
    assert set(causes(diagnosis)) <= allowed


@pytest.mark.parametrize("drift", DRIFTS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("worse", [1.0, 5.0])
def test_drift_is_no_mistake(kind: str, drift: str, worse: float) -> None:
    seed = 77 + 10 * KINDS.index(kind) + DRIFTS.index(drift)
    pair = simulated(seed, kind, drift, 60.0, worse=worse)
    assert not causes(diagnosis_of(pair))
    truth = dataclasses.replace(pair.truth, quaternions=None)
    assert not causes(diagnosis_of(dataclasses.replace(pair, truth=truth)))


@pytest.mark.parametrize(
    ("seed", "kind", "drift", "duration_s"),
    [
        (1050006, "car", "heavy", 115.57),  # a body, that its thirds do not agree on
        (1050135, "robot", "scale", 96.8),  # likewise a scale
        (1050218, "car", "tilt", 132.31448168796436),  # likewise a tilt
        (1050146, "car", "heavy", 129.2),  # an offset at which noise is interpolated away
        (3000466, "car", "heavy", 84.09),  # a turn at once, without a jump
        (3010238, "car", "t1.2", 126.65483503379976),  # likewise at the first pose
        (1050089, "handheld", "loops", 37.045043946653),  # a correction to the first pose
        (3010021, "handheld", "t1.2", 103.62757833798808),  # bad rates
    ],
)
def test_large_drift_that_looked_like_a_mistake(
    seed: int, kind: str, drift: str, duration_s: float
) -> None:
    # A path twice as long as the groundtruth's is a divergence, and a turn at once stays.
    pair = simulated(seed, kind, drift, duration_s, worse=5.0)
    assert set(causes(diagnosis_of(pair))) <= {"diverged", "flip_stays"}


@pytest.mark.parametrize("lost", [False, True])
@pytest.mark.parametrize("longest", [1, 5])
@pytest.mark.parametrize("pair", [DRONE, CAR], ids=["drone", "car"])
def test_outliers_are_no_restart(pair: Pair, longest: int, lost: bool) -> None:
    for seed in range(3):
        assert set(causes(diagnosis_of(with_outliers(pair, seed, 1, longest, lost=lost)))) <= {
            "outlier"
        }


def test_outliers_do_not_hide_a_restart() -> None:
    restarted = MISTAKES["restart"].make(DRONE)
    finding = diagnosis_of(with_outliers(restarted, 0, 1, 5, lost=False)).named("restart")
    assert finding is not None
    assert finding.evidence["end_s"] == pytest.approx(55.0, abs=0.2)


def test_a_restart_after_a_gap_is_found() -> None:
    restarted = MISTAKES["restart"].make(DRONE)
    row = int(0.55 * len(DRONE.estimate))
    kept = np.delete(np.arange(len(DRONE.estimate)), np.arange(row - 60, row))
    pair = dataclasses.replace(restarted, estimate=restarted.estimate[kept])
    assert causes(diagnosis_of(pair)) == ["restart"]


@pytest.mark.parametrize("oriented", [True, False])
def test_a_jump_elsewhere_is_a_step_and_no_restart(oriented: bool) -> None:
    positions = DRONE.estimate.positions.copy()
    positions[len(positions) // 2 :] += [20.0, 5.0, 0.0]
    truth = DRONE.truth if oriented else dataclasses.replace(DRONE.truth, quaternions=None)
    estimate = dataclasses.replace(DRONE.estimate, positions=positions)
    pair = dataclasses.replace(DRONE, truth=truth, estimate=estimate)
    assert causes(diagnosis_of(pair)) == ["step"]


@pytest.mark.slow
@pytest.mark.parametrize("first", ["mirrored", "wxyz, estimate", "clock +18 s"])
@pytest.mark.parametrize("second", ["estimate in mm", "marker", "scale lost"])
def test_after_the_graver_mistake_is_mended_the_other_is_named(first: str, second: str) -> None:
    wrong = MISTAKES[first].make(MISTAKES[second].make(DRONE))
    graver = diagnosis_of(wrong).suggested
    assert graver is not None
    assert graver.cause in MISTAKES[first].causes
    if not graver.correction:  # gauge sim3 withholds the rotation errors of this run
        assert (first, second) == ("wxyz, estimate", "scale lost")
        return
    rest = diagnosis_of(corrected(wrong, dict(graver.correction))).suggested
    assert rest is not None
    assert rest.cause in MISTAKES[second].causes


@pytest.mark.parametrize(
    "name",
    [
        "estimate in mm",
        "groundtruth in mm",
        "wxyz, estimate",
        "mirrored",
        "inverse, estimate",
        "inverse, groundtruth",
        "transposed rotations",
        "clock +18 s",
        "camera axes",
    ],
)
def test_the_correction_removes_what_is_named(name: str) -> None:
    from trajeval_ros import Request, run

    wrong = ALL[name].make(DRONE)
    before = run(DRONE.truth, [DRONE.estimate], Request(DRONE.protocol)).runs[0]
    request = Request(DRONE.protocol, correct="suggested")
    after = run(wrong.truth, [wrong.estimate], request).runs[0]
    (step,) = after.corrected
    assert step.tried is not None
    assert step.is_confirmed_by(step.tried)
    assert not causes(after.diagnosis)
    for metric in ("position_m", "rotation_deg"):
        ate, right = after.evaluation.ate[metric], before.evaluation.ate[metric]
        assert ate is not None
        assert right is not None
        # The clock is corrected to some milliseconds.
        assert ate.rmse == pytest.approx(right.rmse, rel=0.2 if "clock" in name else 1e-6)


def thinned(step: int) -> Callable[[Pair], Pair]:
    return lambda pair: dataclasses.replace(pair, estimate=pair.estimate[::step])


@pytest.mark.parametrize("step", [10, 20])
def test_sparse_estimates_are_told_by_the_same_names(step: int) -> None:
    sparse = thinned(step)
    assert not causes(diagnosis_of(sparse(DRONE)))
    for name in ("wxyz, estimate", "mirrored", "inverse, estimate", "marker"):
        assert causes(diagnosis_of(sparse(MISTAKES[name].make(DRONE))))[:1] in (
            [[cause] for cause in MISTAKES[name].causes] + [[]]
        )


@pytest.mark.parametrize("name", ["wxyz, estimate", "mirrored", "inverse, estimate", "marker"])
def test_three_seconds_are_no_ground_for_a_name(name: str) -> None:
    short = MISTAKES[name].make(DRONE).part(40.0, 3.0)
    assert not causes(diagnosis_of(short))


def moved(trajectory: Trajectory) -> Trajectory:
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return dataclasses.replace(trajectory, positions=trajectory.positions @ rotation.T + 7.0)


def test_another_run_is_told() -> None:
    other = simulated(5400, "drone", "walk", 100.0)
    stranger = dataclasses.replace(DRONE, truth=other.truth)
    assert causes(diagnosis_of(stranger))[0] == "other_run"


@pytest.mark.parametrize(("one", "other"), [("car", "drone"), ("car", "car")])
def test_another_run_does_not_diverge_from_this_one(one: str, other: str) -> None:
    """Motions agree before a divergence, and here they did not."""
    pair = simulated(61205, one, "walk", 100.0)
    truth = simulated(61206 if other == "car" else 61201, other, "heavy", 100.0).truth
    stamps = truth.stamps - truth.stamps[0] + pair.estimate.stamps[0]
    stranger = dataclasses.replace(pair, truth=dataclasses.replace(truth, stamps=stamps))
    assert causes(diagnosis_of(stranger)) == ["other_run"]


def test_a_divergence_after_a_rest_is_no_other_run() -> None:
    """Before it, noise is compared, which does not agree."""
    pair = simulated(901, "drone", "walk", 100.0)
    random, sides = np.random.default_rng(1), {}
    for name, noise_m in (("truth", 0.0005), ("estimate", 0.002)):
        side = getattr(pair, name)
        rests = side.stamps - side.stamps[0] < 10_000_000_000
        positions, quaternions = side.positions.copy(), side.known_quaternions.copy()
        count = int(rests.sum())
        positions[rests] = positions[count] + random.normal(scale=noise_m, size=(count, 3))
        vectors = random.normal(scale=2e-4, size=(count, 3))
        quaternions[rests] = lie.multiply(quaternions[count], lie.from_rotation_vector(vectors))
        sides[name] = dataclasses.replace(side, positions=positions, quaternions=quaternions)
    estimate = sides["estimate"]
    since_s = np.maximum(estimate.seconds - 12.0, 0.0)
    away = np.outer(since_s**2, [0.3, -0.2, 0.1])
    rotations = np.outer(np.minimum(0.3 * since_s, 2.5) * np.sin(since_s), [0.5, -1.0, 0.8])
    sides["estimate"] = dataclasses.replace(
        estimate,
        positions=estimate.positions + away,
        quaternions=lie.multiply(estimate.known_quaternions, lie.from_rotation_vector(rotations)),
    )
    assert causes(diagnosis_of(dataclasses.replace(pair, **sides))) == ["diverged"]
