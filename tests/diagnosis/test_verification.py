"""Corrections are verified: mistakes that are easily confused are named and corrected."""

from __future__ import annotations

import dataclasses
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from advice import assert_no_advice_is_worse

from benchmarks.diagnosis import CORRECTED, diagnosis_of, left_by_corrections
from benchmarks.diagnosis_further import FURTHER
from benchmarks.diagnosis_mistakes import MISTAKES, Mistake, change, quaternions_of
from benchmarks.diagnosis_runs import Pair, simulated
from benchmarks.diagnosis_users import USERS
from trajeval_ros import Request, Trajectory, run
from trajeval_ros.calibration.apply import Ate
from trajeval_ros.cli.app import main
from trajeval_ros.diagnosis.findings import Verification
from trajeval_ros.geometry import lie

DRONE = simulated(5000, "drone", "walk", 100.0)
CAR = simulated(5004, "car", "walk", 100.0)
RUNS = {"drone": DRONE, "car": CAR}
# Of heights, which drift hides on a road.
NOT_ON_CARS = {"z alone flipped"}
# Corrected as far as a car shows the body, or as an estimate of the body is right.
WITHOUT_BODY = {"camera poses", "raw NED and FRD", "NWU for ENU"}
# The nearest convention leaves other angles.
ABOUT = {"compass heading", "Euler order", "roll and pitch swapped", "attitude NWU"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", RUNS)
@pytest.mark.parametrize("name", USERS)
def test_a_mistake_of_users_is_named_and_corrected(name: str, kind: str) -> None:
    pair = RUNS[kind]
    wrong = USERS[name].make(pair)
    diagnosis = diagnosis_of(wrong)
    assert_no_advice_is_worse(diagnosis)
    if kind == "car" and name in NOT_ON_CARS:
        return
    first = diagnosis.suggested
    assert first is not None
    assert first.cause in {*USERS[name].causes, "convention_tie"}
    if first.correction and name not in ABOUT and not (kind == "car" and name in WITHOUT_BODY):
        if name == "groundtruth in feet" and first.cause == "scale":
            return  # the ATE stays in feet
        assert left_by_corrections(pair, wrong) < CORRECTED


@pytest.mark.parametrize("side", ["estimate", "groundtruth"])
def test_inverse_poses_are_named_in_spite_of_a_clock_offset(side: str) -> None:
    wrong = FURTHER["clock +0.2 s"].make(MISTAKES[f"inverse, {side}"].make(DRONE))
    first = diagnosis_of(wrong).suggested
    assert first is not None
    assert (first.cause, first.option) == ("inverse", "--correct inverse")


def test_a_divergence_from_the_start_is_no_scale() -> None:
    """The estimate is as large as 3e6 times the groundtruth, and has this scale after 30 s."""
    pair = simulated(8124, "drone", "heavy", 100.0)
    first = diagnosis_of(FURTHER["diverging from the start"].make(pair)).suggested
    assert first is not None
    assert first.cause == "diverged_at_start"


@pytest.mark.slow
@pytest.mark.parametrize("mistake", ["Euler order", "z and qz flipped"])
def test_only_inverse_poses_may_leave_more_than_the_noise(mistake: str) -> None:
    for seed, kind in ((8123, "drone"), (8130, "robot")):
        pair = simulated(seed, kind, "walk" if kind == "drone" else "heavy", 100.0)
        first = diagnosis_of(USERS[mistake].make(pair)).suggested
        assert first is not None
        assert first.cause in USERS[mistake].causes


def test_corrections_are_repeated_until_nothing_is_left() -> None:
    wrong = MISTAKES["estimate in mm"].make(MISTAKES["wxyz, estimate"].make(DRONE))
    after = run(wrong.truth, [wrong.estimate], Request(wrong.protocol, correct="suggested"))
    steps = [item.cause for item in after.runs[0].corrected]
    assert sorted(steps) == ["unit", "wxyz"]
    assert not after.runs[0].diagnosis.findings


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("inverse, estimate", "estimate in mm"),  # both by --correct
        ("clock +18 s", "estimate in mm"),
        ("transposed rotations", "marker"),
        ("scale lost", "clock +0.2 s"),
    ],
)
def test_the_options_of_all_findings_give_the_stated_error(
    one: str, other: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mistakes = {**MISTAKES, **FURTHER}
    wrong = mistakes[one].make(mistakes[other].make(DRONE))
    first = diagnosis_of(wrong).suggested
    assert first is not None
    stated = re.search(r", with (.*) ([0-9.]+) (m|deg)", first.text)
    assert stated is not None
    options, files = shlex.split(stated[1].replace(" and ", " ")), []
    for name, side in (("truth", wrong.truth), ("estimate", wrong.estimate)):
        columns = side.stamps / 1e9, side.positions, quaternions_of(side)
        np.savetxt(tmp_path / f"{name}.txt", np.column_stack(columns), fmt="%.9f")
        files.append(str(tmp_path / f"{name}.txt"))
    if "--gauge" not in options:
        options += ["--gauge", wrong.protocol.gauge.value]
    assert main(["evaluate", *files, "--lengths", "none", *options]) == 0
    shown = capsys.readouterr().out.splitlines()[0]
    assert f" {stated[2]} {stated[3]}" in shown


def test_a_frozen_groundtruth_is_no_clock_offset() -> None:
    for seed in range(5004, 5008):
        pair = simulated(seed, "car" if seed < 5006 else "robot", "walk", 100.0)
        causes = {
            finding.cause
            for finding in diagnosis_of(MISTAKES["groundtruth frozen"].make(pair)).findings
        }
        assert causes == {"groundtruth_frozen"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pair", "mistake", "option"),
    [
        # Of the options that fit short motions, the whole path selects one.
        (CAR, USERS["x and y alone swapped"], ("estimate.axes", "positions=y,x,z")),
        (CAR, FURTHER["positions in other axes"], ("estimate.axes", "positions=z,x,y")),
        # The mirror leaves the least rotation of world and body.
        (DRONE, USERS["x and y swapped"], ("estimate.axes", "y,x,z")),
        # y is vertical in both frames, and no frame is tilted.
        (DRONE, USERS["both optical"], ("up", "-y,-y")),
    ],
)
def test_the_option_is_the_one_that_corrects(
    pair: Pair, mistake: Mistake, option: tuple[str, str]
) -> None:
    first = diagnosis_of(mistake.make(pair)).suggested
    assert first is not None
    assert tuple(first.correction.items()) == (option,)


def test_a_clock_offset_is_found_beside_a_frozen_groundtruth() -> None:
    """The frozen interval is left out of the correlation."""
    rows, count = np.arange(len(DRONE.truth)), len(DRONE.truth)
    rows[3 * count // 10 : 7 * count // 10] = 3 * count // 10
    frozen = dataclasses.replace(DRONE.truth[rows], stamps=DRONE.truth.stamps)
    wrong = USERS["clock +0.35 s"].make(dataclasses.replace(DRONE, truth=frozen))
    causes = {finding.cause for finding in diagnosis_of(wrong).findings}
    assert causes == {"clock_offset", "groundtruth_frozen"}


@pytest.mark.slow
def test_a_clock_offset_is_no_lever_arm() -> None:
    """The geometry is tested at the offset of the clocks, also at one that is not stated."""
    robot = simulated(5006, "robot", "walk", 100.0)
    for pair, mistake, cause in (
        (CAR, USERS["clock +0.8 s"], "clock_offset"),
        (robot, FURTHER["clock +0.2 s"], "small_clock_offset"),
    ):
        assert [finding.cause for finding in diagnosis_of(mistake.make(pair)).findings] == [cause]


@pytest.mark.slow
def test_roll_and_pitch_of_a_vehicle_are_compared() -> None:
    """They are small beside its yaw, and exchanged they can double the rotation error."""
    for kind, seed in (("car", 9711), ("car", 5004), ("robot", 9706), ("robot", 9716)):
        right = simulated(seed, kind, "walk", 100.0)
        assert not diagnosis_of(right).findings
        [text] = diagnosis_of(USERS["roll and pitch swapped"].make(right)).findings
        assert text.cause == "rotations"
        assert not text.correction


def test_a_constant_turn_rate_does_not_correlate_and_is_no_other_rotation() -> None:
    """A marker turned by 126 deg on a body that turns steadily."""
    times = np.arange(0.0, 60.0, 0.1)
    path = [3 * np.sin(0.5 * times), 2 * np.cos(0.7 * times), 0.5 * np.sin(0.9 * times)]
    sides = []
    for angle, seed in ((1.1, 0), (0.0, 1)):
        noise = np.random.default_rng(seed).normal(scale=0.01, size=(len(times), 3))
        half = 0.1 * times + angle
        zero = np.zeros_like(half)
        rotated = np.column_stack([zero, zero, np.sin(half), np.cos(half)])
        stamps = np.rint(1e9 * times).astype(np.int64)
        sides.append(Trajectory.from_columns(stamps, np.column_stack(path) + noise, rotated))
    causes = [
        finding.cause for finding in diagnosis_of(Pair("marker", sides[0], sides[1])).findings
    ]
    assert causes == ["body"]


def test_what_follows_from_wrong_pairs_is_no_divergence() -> None:
    car = simulated(9704, "car", "walk", 100.0)
    for name, cause in (("clock -37 s", "clock_offset"), ("degrees as x and y", "degrees")):
        mistakes = {**MISTAKES, **USERS}
        assert [finding.cause for finding in diagnosis_of(mistakes[name].make(car)).findings] == [
            cause
        ]


@pytest.mark.parametrize(("seed", "kind"), [(9705, "car"), (20276, "car"), (20278, "robot")])
def test_gravity_selects_axes_that_a_plane_does_not_show(seed: int, kind: str) -> None:
    """Positions that were flipped, and positions that were rotated, have equal planar motions."""
    vehicle = simulated(seed, kind, "heavy", 100.0)
    wrong = USERS["positions alone converted"].make(vehicle)
    assert [finding.cause for finding in diagnosis_of(wrong).findings] == ["axes_mixed", "body"]
    assert left_by_corrections(vehicle, wrong) < CORRECTED


@pytest.mark.parametrize("mistake", ["Euler order", "compass heading"])
def test_two_conventions_that_do_not_reduce_the_error_are_not_named(mistake: str) -> None:
    """In a plane, they can imitate other angles; the compass with another body in addition."""
    robot = simulated(20277, "robot", "walk", 100.0)
    [text] = diagnosis_of(USERS[mistake].make(robot)).findings
    assert text.cause == "rotations"
    assert not text.correction


def test_other_angles_of_a_car_are_no_other_order_of_the_quaternion() -> None:
    """About one axis, quaternions with w last imitated another order of the Euler angles."""
    car = simulated(3, "car", "loops", 200.0)
    [finding] = diagnosis_of(USERS["Euler order"].make(car)).findings
    assert finding.cause == "rotations"


def test_increments_are_named_where_noise_is_large_beside_steps() -> None:
    wrong = USERS["increments"].make(DRONE)
    noise = np.random.default_rng(0).normal(scale=0.01, size=wrong.estimate.positions.shape)
    noisy = dataclasses.replace(wrong.estimate, positions=wrong.estimate.positions + noise)
    first = diagnosis_of(dataclasses.replace(wrong, estimate=noisy)).suggested
    assert first is not None
    assert first.cause == "increments"


def test_jumps_of_wrong_rotations_are_no_restart() -> None:
    """Euler angles of a body that looks down jump, and so did a remark on the estimate."""
    down = lie.from_rotation_vector(np.radians([0.0, 80.0, 0.0]))
    pair = DRONE
    for side in ("truth", "estimate"):
        rotated = lie.multiply(quaternions_of(getattr(DRONE, side)), down)
        pair = change(pair, side, quaternions=rotated)
    wrong = USERS["Euler order"].make(pair)
    remarks = (
        run(wrong.truth, [wrong.estimate], Request(wrong.protocol)).runs[0].evaluation.remarks
    )
    codes = {remark.code for remark in remarks}
    assert "rotations" in codes
    assert "jumps" not in codes


def test_increments_of_keyframes_are_not_of_another_run() -> None:
    """They are as long as four tenths of the path."""
    sparse = dataclasses.replace(DRONE, estimate=DRONE.estimate[::30])
    first = diagnosis_of(USERS["increments"].make(sparse)).suggested
    assert first is not None
    assert first.cause == "increments"


@pytest.mark.parametrize("mistake", ["radians as degrees", "degrees as radians"])
def test_rotations_of_a_body_that_turns_slowly_are_compared(mistake: str) -> None:
    """Ten times slower than the car: its angular rates correlate, so they are not noise."""
    wrong = USERS[mistake].make(CAR)
    sides = {
        side: dataclasses.replace(
            item, stamps=item.stamps[0] + 10 * (item.stamps - item.stamps[0])
        )
        for side, item in (("truth", wrong.truth), ("estimate", wrong.estimate))
    }
    [text] = diagnosis_of(dataclasses.replace(wrong, **sides, max_gap_s=1.0)).findings
    assert text.cause == "rotations"


def test_a_convention_that_leaves_other_tilts_is_not_advised() -> None:
    """Inverse rotations have a compass's heading in a plane, and other roll and pitch."""
    pair = simulated(31004, "car", "walk", 100.0)
    [text] = diagnosis_of(USERS["compass heading"].make(pair)).findings
    assert text.cause == "rotations"
    assert not text.correction


def test_rotations_that_differ_too_much_are_no_other_body() -> None:
    causes = {
        finding.cause for finding in diagnosis_of(USERS["radians as degrees"].make(DRONE)).findings
    }
    assert causes == {"rotations"}


@pytest.mark.parametrize(
    ("kind", "rotations", "mistake", "causes"),
    [
        ("drone", "Euler order", "estimate in mm", ["rotations", "unit"]),
        ("drone", "radians as degrees", "camera axes", ["rotations", "up_axis"]),
        ("robot", "compass heading", "scale lost", ["rotations", "scale"]),
        # Wrong rotations look like another body here, and like a lever arm.
        ("robot", "roll and pitch swapped", "NED", ["rotations", "up_axis"]),
        ("robot", "roll and pitch swapped", "lever arm", ["rotations"]),
    ],
)
def test_beside_wrong_rotations_only_positions_are_compared(
    kind: str, rotations: str, mistake: str, causes: list[str]
) -> None:
    pair = DRONE if kind == "drone" else simulated(5006, "robot", "walk", 100.0)
    wrong = USERS[rotations].make(MISTAKES[mistake].make(pair))
    assert [finding.cause for finding in diagnosis_of(wrong).findings] == causes


def test_a_right_recording_is_not_evaluated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    from trajeval_ros.metrics import evaluation
    from trajeval_ros.pipeline import preparation

    calls: list[Pair] = []
    real = evaluation.evaluate

    def counted(*given: object) -> object:
        calls.append(DRONE)
        return real(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(preparation.metrics, "evaluate", counted)
    right = dataclasses.replace(DRONE)
    run(right.truth, [right.estimate], Request(right.protocol))
    assert len(calls) == 1


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (Ate(6.38, 15.47), Ate(6.379, 15.42), "rotation ATE 15.47 deg, with X 15.42 deg"),
        (Ate(6.38, 15.47), Ate(6.2, 15.3), "ATE 6.38 m, with X 6.2 m"),
        (Ate(0.5, 180.0), Ate(0.4, 1.0), "rotation ATE 180 deg, with X 1 deg"),
        (Ate(0.5, None), Ate(0.4, 1.0), "rotation ATE withheld, with X 1 deg"),
        (Ate(0.5, 1.0), Ate(0.1, None), "ATE 0.5 m, with X 0.1 m"),
        (None, Ate(0.4, 1.0), "ATE with X 0.4 m"),
    ],
)
def test_advice_states_the_error_that_falls(before: Ate | None, after: Ate, told: str) -> None:
    assert Verification(before, after).text("X") == told


def test_discontinuities_are_searched_for_after_a_convention_is_corrected() -> None:
    """Wrong conventions look like many discontinuities, and hide the real ones."""
    wrong = MISTAKES["wxyz, estimate"].make(MISTAKES["restart"].make(DRONE))
    before = run(wrong.truth, [wrong.estimate], Request(wrong.protocol)).runs[0]
    assert [finding.cause for finding in before.diagnosis.findings] == ["wxyz"]
    assert not before.evaluation.events
    request = Request(wrong.protocol, correct="suggested")
    after = run(wrong.truth, [wrong.estimate], request).runs[0]
    assert [finding.cause for finding in after.corrected] == ["wxyz"]
    assert [event.kind for event in after.evaluation.events] == ["restart"]
    assert after.diagnosis.named("restart") is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("radians as degrees", "rotations"),
        ("wxyz, estimate", "wxyz"),
        ("30 fps for 25", "clock_drift"),
        ("clock 1000 ppm", "clock_drift"),
    ],
)
def test_a_mistake_of_the_whole_run_leaves_no_discontinuity(name: str, cause: str) -> None:
    wrong = {**MISTAKES, **USERS}[name].make(DRONE)
    result = run(wrong.truth, [wrong.estimate], Request(wrong.protocol)).runs[0]
    assert [finding.cause for finding in result.diagnosis.findings] == [cause]
    assert result.evaluation.events == ()
