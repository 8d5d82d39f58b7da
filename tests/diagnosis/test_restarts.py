"""Restarts of an estimate, on circles that are tracked without an error but for the jumps."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.diagnosis import dropout_tests
from trajeval_ros.diagnosis.dropout_tests import restart
from trajeval_ros.diagnosis.findings import Examined
from trajeval_ros.diagnosis.input_pair import TimedPoses
from trajeval_ros.geometry.arrays import Floats

STEP_S, BEGIN_S = 0.125, 50.0
AHEAD = 40  # rows of the groundtruth before the estimate begins


def about(axis: str, degrees: Floats) -> Rotation:
    """Return rotations by angles (N,) about an axis."""
    return Rotation.from_rotvec(np.radians(np.outer(degrees, np.eye(3)["xyz".index(axis)])))


def circle(rows: int, radius: float, turn: float, *, oriented: bool = False) -> TimedPoses:
    """Return poses on a circle, a constant turn (rad) apart; the first one is at its right."""
    angles = turn * np.arange(rows)
    positions = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(rows)])
    turned = about("z", np.degrees(angles)).as_quat()
    return TimedPoses(BEGIN_S + STEP_S * np.arange(rows), positions, turned if oriented else None)


def stepping(poses: TimedPoses, row: int, length: float) -> TimedPoses:
    """Return the poses with another length of the step to a row, and the rest shifted."""
    positions = poses.positions.copy()
    step = positions[row] - positions[row - 1]
    positions[row:] += step * (length / np.linalg.norm(step) - 1.0)
    return dataclasses.replace(poses, positions=positions)


def turning(poses: TimedPoses, row: int, degrees: float) -> TimedPoses:
    """Return the poses with those from a row on turned about the position of that row."""
    turn = Rotation.from_euler("z", degrees, degrees=True)
    positions, quaternions = poses.positions.copy(), poses.quaternions
    positions[row:] = turn.apply(positions[row:] - positions[row]) + positions[row]
    if quaternions is not None:
        quaternions = quaternions.copy()
        quaternions[row:] = (turn * Rotation.from_quat(quaternions[row:])).as_quat()
    return dataclasses.replace(poses, positions=positions, quaternions=quaternions)


def beginning_again(poses: TimedPoses, rows: list[int]) -> TimedPoses:
    """Return the poses with the first one repeated at some rows, from which the motion goes on."""
    assert poses.quaternions is not None
    positions, turned = poses.positions.copy(), Rotation.from_quat(poses.quaternions)
    quaternions = poses.quaternions.copy()
    for begin, end in zip(rows, [*rows[1:], len(poses)], strict=True):
        back = turned[0] * turned[begin].inv()
        moved = poses.positions[begin:end] - poses.positions[begin]
        positions[begin:end] = back.apply(moved) + poses.positions[0]
        quaternions[begin:end] = (back * turned[begin:end]).as_quat()
    return dataclasses.replace(poses, positions=positions, quaternions=quaternions)


def unit_of(true: Floats, own: Floats) -> float:
    """Return the ratio of path lengths, where a step counts as at most 20 usual ones."""
    return float(true.sum() / np.minimum(own, 20.0 * np.median(own)).sum())


def values_of(found: Examined) -> dict[str, Any]:
    [seen] = found.seen
    assert seen.cause == "restart"
    assert seen.explained == found.scores["gain"]
    return dict(seen.values)


@pytest.mark.parametrize(
    ("radius", "turn", "true_m", "wobble", "limit_m"),
    [
        (1.0, 0.0125, 0.0, 0.0, 0.2),
        (10.0, 0.0125, 0.0, 0.0, 1.5),  # of an extent of 10 m
        (1.0, 0.0125, 1.0, 0.0, 1.5),  # beside a true step of 1 m
        (1.0, 0.0125, 0.0, 0.6, None),  # errors of about 60 % of a step
    ],
)
@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_a_jump_is_larger_than_errors_motion_and_a_part_of_the_path(
    radius: float, turn: float, true_m: float, wobble: float, limit_m: float | None, factor: float
) -> None:
    rows, row = 503, 200  # about one turn
    true = circle(rows, radius, turn)
    angles = turn * (np.arange(rows) + wobble / 2.0 * (-1.0) ** np.arange(rows))
    own = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(rows)]) * radius
    estimate = dataclasses.replace(true, positions=own)
    if true_m:
        true = stepping(true, row, true_m)
    steps, length = true.moved, 1.0
    for _ in range(20):  # the jump is a part of the path that gives the unit
        own_steps = stepping(estimate, row, length).moved
        unit = unit_of(steps, own_steps)
        typical = 40.0 * np.median(np.abs(unit * own_steps - steps))
        length = (factor * (limit_m or typical) + steps[row - 1]) / unit
    found = restart(true, stepping(estimate, row, length))
    if factor < 1.0:
        assert not found.seen
        assert found.scores == {"jumps": 0.0}
        return
    values = values_of(found)
    left = values.pop("left_percent")
    assert left == pytest.approx(100.0 * (1.0 - found.scores["gain"]), abs=1e-9)
    assert left == pytest.approx(0.0, abs=1e-6 if not wobble else 1.0)
    assert values == pytest.approx(
        {
            "jump_m": unit * length,
            "jump_deg": 0.0,
            "at_s": STEP_S * row,
            "cut_s": STEP_S * (row - 0.5),
            "true_m": steps[row - 1],
            "where": "",
        }
    )


def test_the_times_of_a_restart_are_since_the_begin_of_each_side() -> None:
    """Of 3000 poses, a part is used."""
    true = circle(3000 + AHEAD, 10.0, 0.02)
    estimate = stepping(true[AHEAD:], 1701, 5.0)
    values = values_of(restart(true, estimate))
    assert values["at_s"] == pytest.approx(STEP_S * 1701)
    assert values["cut_s"] == pytest.approx(STEP_S * (1701 + AHEAD - 0.5))


@pytest.mark.parametrize(
    ("number", "steps", "is_judged"), [(50, 1000, True), (51, 1000, False), (51, 2600, True)]
)
@pytest.mark.parametrize("by", ["metres", "degrees"])
def test_many_large_steps_are_usual_for_an_estimate(
    number: int, steps: int, by: str, *, is_judged: bool
) -> None:
    """Ten times the usual length, or 20 deg; others are slightly smaller."""
    lengths, degrees = np.ones(steps), np.zeros(steps)
    column, limit = (lengths, 10.0) if by == "metres" else (degrees, 20.0)
    column[5 : 5 + 4 * number : 4] = 1.01 * limit
    column[6 : 6 + 4 * number : 4] = 0.99 * limit
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    angles = np.concatenate([[0.0], np.cumsum(degrees)])
    turned = about("x", angles).as_quat()
    signs = (-1.0) ** np.arange(steps + 1)  # of quaternions, which mean the same
    poses = TimedPoses(
        STEP_S * np.arange(steps + 1), np.outer(along, np.ones(3)), turned * signs[:, None]
    )
    found = restart(poses, poses)
    assert found.scores == ({"jumps": 0.0} if is_judged else {"strange_steps": float(number)})
    assert restart(poses[:5], poses[:5]).scores == {"strange_steps": 0.0}


@pytest.mark.parametrize(("steps", "is_known"), [(10, True), (9, False)])
def test_ten_steps_with_groundtruth_are_needed(steps: int, *, is_known: bool) -> None:
    true = circle(400, 10.0, 0.0125)
    estimate = stepping(true, 200, 5.0)
    found = restart(true[195 : 196 + steps], estimate)
    assert (found.why_not == "too few steps with groundtruth") != is_known
    assert found.test == "restart"


@pytest.mark.parametrize(("missing", "is_known"), [(7, True), (8, False)])
def test_the_groundtruth_is_interpolated_across_a_second(missing: int, *, is_known: bool) -> None:
    true = circle(400, 10.0, 0.0125)
    estimate = stepping(true, 200, 5.0)
    kept = np.delete(np.arange(400), np.arange(198, 198 + missing))
    assert bool(restart(true[kept], estimate).seen) == is_known


@pytest.mark.parametrize(("number", "is_seen"), [(1, True), (2, True), (20, True), (21, False)])
def test_up_to_twenty_parts_begin_at_the_first_pose(number: int, *, is_seen: bool) -> None:
    turn = 2.0 * np.pi / 57.0  # after 46 steps, the first pose is 11 steps ahead
    true = circle(47 * (number + 1), 10.0, turn, oriented=True)
    rows = list(range(47, len(true), 47))
    found = restart(true, beginning_again(true, rows))
    assert found.scores["jumps"] == number
    if not is_seen:
        assert list(found.scores) == ["jumps"]
        return
    values = values_of(found)
    assert values["where"] == " at its first pose"
    assert values["left_percent"] == pytest.approx(0.0, abs=1e-6)
    assert values["jump_deg"] == pytest.approx(np.degrees((11 - 1) * turn))


@pytest.mark.parametrize(
    ("noise_deg", "limit_deg"), [(0.0, 25.0), (1.0, 40.0)], ids=["least", "of the noise"]
)
@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_a_heading_that_changes_at_the_first_pose_is_a_restart(
    noise_deg: float, limit_deg: float, factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second turn of the circle enters the surroundings of the first pose."""
    monkeypatch.setattr(dropout_tests, "_gain", lambda *_: 1.0)
    true = circle(900, 10.0, 0.02, oriented=True)
    row = 250
    while np.linalg.norm(true.positions[row] - true.positions[0]) > 0.05 * np.hypot(20.0, 20.0):
        row += 1
    assert true.quaternions is not None
    for near in (row - 1, row, row + 1):
        degrees = noise_deg / 2.0 * (-1.0) ** (np.arange(900) - near)
        degrees[near:] += factor * limit_deg - noise_deg
        quaternions = (Rotation.from_quat(true.quaternions) * about("z", degrees)).as_quat()
        turned = dataclasses.replace(true, quaternions=quaternions)
        found = restart(true, turned)
        assert bool(found.seen) == (factor > 1.0 and near == row)


@pytest.mark.parametrize(("share", "is_home"), [(0.0495, True), (0.0505, False)])
def test_a_part_begins_near_the_first_pose(share: float, *, is_home: bool) -> None:
    true = circle(700, 10.0, 0.01, oriented=True)
    estimate = beginning_again(true, [350])
    size = np.linalg.norm(np.ptp(estimate.positions, axis=0))
    estimate.positions[350:] += [0.0, 0.0, share * size]
    size = np.linalg.norm(np.ptp(estimate.positions, axis=0))
    estimate.positions[350:, 2] = share * size
    values = values_of(restart(true, estimate))
    assert values["where"] == (" at its first pose" if is_home else "")


@pytest.mark.parametrize(
    ("where", "gain", "is_seen"),
    [("", 0.91, True), ("", 0.9, False), (" at its first pose", 0.51, True),
     (" at its first pose", 0.5, False)],
)  # fmt: skip
def test_separate_alignments_must_explain_the_error(
    where: str, gain: float, monkeypatch: pytest.MonkeyPatch, *, is_seen: bool
) -> None:
    true = circle(700, 10.0, 0.01, oriented=True)
    estimate = stepping(turning(true, 350, 90.0), 350, 5.0)
    if where:
        estimate = beginning_again(true, [350])
    monkeypatch.setattr(dropout_tests, "_gain", lambda *_: gain)
    found = restart(true, estimate)
    assert found.scores == {"jumps": 1.0, "gain": gain}
    if is_seen:
        values = values_of(found)
        assert values["where"] == where
        assert values["left_percent"] == pytest.approx(100.0 * (1.0 - gain))
    else:
        assert not found.seen


@pytest.mark.parametrize(
    ("lengths", "degrees", "worst"),
    [((5.0, 4.0), (90.0, 90.0), 0), ((4.0, 5.0), (90.0, 90.0), 1),
     ((5.0, 4.0), (60.0, 90.0), 1), ((7.0, 5.0), (60.0, 90.0), 0)],
)  # fmt: skip
def test_the_largest_jump_is_the_restart(
    lengths: tuple[float, float],
    degrees: tuple[float, float],
    worst: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A jump of the size of the path, 10 m, counts as much as half a turn."""
    cuts: list[list[int]] = []
    monkeypatch.setattr(dropout_tests, "_gain", lambda *given: cuts.append(list(given[3])) or 1.0)
    true = estimate = circle(629, 10.0, 0.01, oriented=True)
    for row, length, turn in zip((200, 400), lengths, degrees, strict=True):
        estimate = turning(stepping(estimate, row, length), row, turn)
    found = restart(true, estimate)
    assert found.scores["jumps"] == 2.0
    assert values_of(found)["at_s"] == pytest.approx(STEP_S * (200, 400)[worst])
    assert cuts == [[(200, 400)[worst]]]


def test_a_jump_that_keeps_the_heading_is_no_restart() -> None:
    true = circle(629, 10.0, 0.01, oriented=True)
    found = restart(true, stepping(true, 300, 5.0))
    assert found.scores == {"jumps": 1.0}
    assert not found.seen
    assert not found.why_not
    for side in (0, 1):
        sides = [true, stepping(true, 300, 5.0)]
        sides[side] = dataclasses.replace(sides[side], quaternions=None)
        assert restart(*sides).seen


@pytest.mark.parametrize(
    ("begin", "end", "is_seen"), [(298, 300, True), (297, 300, False), (296, 299, True)]
)
def test_a_jump_after_three_equal_poses_is_no_restart(
    begin: int, end: int, *, is_seen: bool
) -> None:
    true = circle(629, 10.0, 0.01)
    estimate = stepping(true, 300, 5.0)
    estimate.positions[begin:end] = estimate.positions[begin]
    found = restart(true, estimate)
    assert bool(found.seen) == is_seen
    if not is_seen:
        assert found.why_not == "the jump ends an interval of repeated poses"


@pytest.mark.parametrize(("factor", "is_seen"), [(0.98, False), (1.02, True)])
def test_what_the_estimate_did_before_the_groundtruth_does_not_count(
    factor: float, *, is_seen: bool
) -> None:
    """It has shorter steps there, and more of them."""
    true = circle(1400, 10.0, 0.0125)
    row, length = 1200, 1.5 * factor
    for _ in range(20):  # of the steps that both sides have, as above
        steps = true[897:].moved
        unit = unit_of(steps, stepping(true, row, length)[897:].moved)
        length = (1.5 * factor + steps[0]) / unit
    estimate = stepping(true, row, length)
    angles = 0.006 * np.arange(-897.0, 0.0)
    before = np.column_stack([np.cos(angles) - 1.0, np.sin(angles), np.zeros(897)])
    first = estimate.positions[897]
    estimate.positions[:897] = 10.0 * before + first
    found = restart(true[897:], estimate[50:])  # less than 1350 rows, more are before it
    assert found.scores["jumps"] == float(is_seen)


@pytest.mark.parametrize(("number", "is_seen"), [(16, False), (17, True)])
def test_outliers_are_no_restart(
    number: int, monkeypatch: pytest.MonkeyPatch, *, is_seen: bool
) -> None:
    """Up to two seconds."""
    monkeypatch.setattr(dropout_tests, "_gain", lambda *_: 1.0)
    true = circle(629, 10.0, 0.01)
    estimate = dataclasses.replace(true, positions=true.positions.copy())
    estimate.positions[300 : 300 + number, 2] = 12.0
    found = restart(true, estimate)
    assert found.scores["jumps"] == 2.0
    assert bool(found.seen) == is_seen


@pytest.mark.parametrize(
    ("scale", "is_unit"), [(1.2, False), (1.25, True), (0.84, False), (0.8, True)]
)
def test_another_unit_is_converted_before_the_parts_are_aligned(
    scale: float, *, is_unit: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A smaller difference is an error of the estimate. The logarithms' limit is 0.2."""
    given: list[Floats] = []
    monkeypatch.setattr(dropout_tests, "_gain", lambda ours, *_: given.append(ours) or 1.0)
    true = circle(950, 10.0, 0.01)
    estimate = stepping(true, 500, 5.0)
    estimate = dataclasses.replace(estimate, positions=estimate.positions / scale)
    unit = unit_of(true.moved, estimate.moved)
    values = values_of(restart(true, estimate))
    assert values["jump_m"] == pytest.approx(unit * 5.0 / scale)
    factor = unit if is_unit else 1.0
    np.testing.assert_allclose(given[0], factor * estimate.positions, rtol=1e-12, atol=1e-12)
