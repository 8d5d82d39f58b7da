"""Constant and linear intervals and gaps of a groundtruth, on paths along one line.

On a line, forwards, the length of a path is the distance of its ends, whatever is sampled. So the
ratio of the units of both sides and every distance of a finding are known exactly.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from trajeval_ros.diagnosis.dropout_tests import _constant, groundtruth_defects, without_defects
from trajeval_ros.diagnosis.findings import Detection, TestResult
from trajeval_ros.diagnosis.input_pair import TimedPoses
from trajeval_ros.geometry.arrays import Floats

STEP_S, BEGIN_S = 0.0625, 100.0
LINE = np.array([2.0, -1.0, 2.0]) / 3.0
UNIT = 2.0  # metres per unit of the estimate


def steps_of(count: int) -> Floats:
    """Return step lengths, metres, of which no two neighbours are equal."""
    return 0.01 * (1.0 + np.arange(count) % 3)


def track(steps: Floats, step_s: float = STEP_S, begin_s: float = BEGIN_S) -> TimedPoses:
    along = np.concatenate([[0.0], np.cumsum(steps)])
    return TimedPoses(begin_s + step_s * np.arange(len(along)), np.outer(along, LINE))


def in_units(poses: TimedPoses) -> TimedPoses:
    return dataclasses.replace(poses, positions=poses.positions / UNIT)


def held(steps: Floats, begin: int, end: int) -> None:
    """Make rows from `begin` to `end` equal, and continue where the path would be."""
    steps[end] += steps[begin:end].sum()
    steps[begin:end] = 0.0


def seen_in(truth: Floats, own: Floats, max_gap_s: float = 0.5) -> dict[str, Detection]:
    examined = groundtruth_defects(track(truth), in_units(track(own)), max_gap_s)
    return {item.cause: item for item in examined.seen}


def frozen_at(intervals: list[tuple[int, int, float]], count: int = 200) -> dict[str, Detection]:
    """Return what is seen if the groundtruth is held while the estimate moves some metres."""
    own = steps_of(count)
    for begin, end, moved_m in intervals:
        own[begin:end] *= moved_m / own[begin:end].sum()
    truth = own.copy()
    for begin, end, _ in intervals:
        held(truth, begin, end)
    return seen_in(truth, own)


@pytest.mark.parametrize(
    ("rows", "moved_m", "is_frozen"),
    [(17, 1.0, True), (16, 1.0, False), (17, 0.151, True), (17, 0.149, False)],
)
def test_a_body_is_frozen_for_more_than_a_second_while_the_estimate_moves(
    rows: int, moved_m: float, is_frozen: bool
) -> None:
    found = frozen_at([(40, 40 + rows, moved_m)])
    assert list(found) == ["groundtruth_frozen"] * is_frozen


def test_the_longest_frozen_interval_is_stated_among_those_with_motion() -> None:
    found = frozen_at([(20, 40, 0.5), (60, 96, 0.7), (110, 160, 0.1)])["groundtruth_frozen"]
    assert dict(found.values) == pytest.approx(
        {
            "frozen_s": 36 * STEP_S,
            "at_s": 60 * STEP_S,
            "after_s": 96 * STEP_S,
            "moved_m": 0.7,
        }
    )


@pytest.mark.parametrize(
    ("times", "moved_m", "free", "is_held"),
    [
        (12, 0.021, 0, True),
        (11, 0.021, 0, False),
        (12, 0.019, 0, False),
        (12, 0.021, 70, True),  # 36 of 119 steps
        (12, 0.021, 72, False),  # 36 of 121 steps
    ],
)
def test_twelve_held_poses_in_three_tenths_of_the_time_are_a_low_rate(
    times: int, moved_m: float, free: int, is_held: bool
) -> None:
    """Four steps each, of which three are held; and then others."""
    count = 4 * times + free + 1
    own = steps_of(count)
    truth = own.copy()
    for begin in range(0, 4 * times, 4):
        own[begin : begin + 3] = moved_m / 3.0
        truth[begin : begin + 4] = [0.0, 0.0, 0.0, moved_m + own[begin + 3]]
    found = seen_in(truth, own)
    assert list(found) == ["groundtruth_held"] * is_held


@pytest.mark.parametrize(("count", "is_held"), [(150, True), (180, False)])
def test_poses_held_at_rest_are_not_held_by_the_groundtruth(count: int, is_held: bool) -> None:
    """51 held steps while the estimate moves, in intervals of 3 and of 6; and 52 at rest."""
    own = np.full(count, 0.03)
    own[1::2] = 0.02
    truth, row = own.copy(), 0
    for length, is_moving in (
        [(3, True)] * 7 + [(6, True)] * 5 + [(2, True)] * 2 + [(4, False)] * 13
    ):
        if not is_moving:
            own[row : row + length] = truth[row : row + length] = 0.001
        held(truth, row, row + length)
        row += length + 1
    found = seen_in(truth, own)
    assert list(found) == ["groundtruth_held"] * is_held
    for seen in found.values():
        assert dict(seen.values) == pytest.approx({"held_s": 3 * STEP_S, "rate_hz": 1.0 / STEP_S})


def glided(intervals: list[tuple[int, int, float]], count: int = 200) -> dict[str, Detection]:
    """Return what is seen if the groundtruth is linear while the estimate is off in the middle."""
    own = steps_of(count)
    truth = own.copy()
    for begin, end, bent_m in intervals:
        half, total = (end - begin) / 2.0, 4.0
        middle = np.array([0.0, total / 2.0 + bent_m, total])
        along = np.interp(np.arange(end - begin + 1), [0.0, half, 2.0 * half], middle)
        own[begin:end] = np.diff(along)
        truth[begin:end] = total / (end - begin)
    return seen_in(truth, own)


@pytest.mark.parametrize(
    ("rows", "bent_m", "is_bridged"),
    [(7, 0.5, True), (6, 0.5, False), (8, 0.051, True), (8, 0.049, False)],
)
def test_a_dropout_was_filled_where_the_estimate_is_off_a_line_for_long(
    rows: int, bent_m: float, is_bridged: bool
) -> None:
    assert list(glided([(40, 40 + rows, bent_m)])) == ["groundtruth_bridged"] * is_bridged


def test_the_filled_dropout_with_the_largest_deviation_is_stated() -> None:
    found = glided([(10, 30, 0.3), (40, 52, 0.8), (70, 76, 1.0), (100, 140, 0.0)])
    bridged = found["groundtruth_bridged"]
    assert dict(bridged.values) == pytest.approx(
        {
            "bridged_s": 12 * STEP_S,
            "at_s": 40 * STEP_S,
            "after_s": 52 * STEP_S,
            "bent_m": 0.8,
            "stretches": 2.0,
        }
    )


@pytest.mark.parametrize(("gap", "is_known"), [(16, True), (17, False)])
@pytest.mark.parametrize("place", [40, 80])
def test_an_interval_is_judged_only_where_the_estimate_has_poses(
    gap: int, is_known: bool, place: int
) -> None:
    """An interval of 40 steps, and an estimate without poses around its start or its end."""
    own = steps_of(200)
    own[40:60], own[60:80] = 0.03, 0.01
    for cause in ("groundtruth_bridged", "groundtruth_frozen"):
        truth = own.copy()
        if cause == "groundtruth_bridged":
            truth[40:80] = 0.02
        else:
            held(truth, 40, 80)
        estimate = in_units(track(own))
        begin = place - gap // 2
        estimate = estimate[np.r_[0 : begin + 1, begin + gap : 201]]
        found = groundtruth_defects(track(truth), estimate, 0.5)
        assert [item.cause for item in found.seen] == [cause] * is_known


def test_the_units_are_compared_over_the_common_time() -> None:
    """Before and after it, one side moves fast."""
    own = steps_of(200)
    own[:20] = own[-30:] = 1.0
    truth = own.copy()
    held(truth, 60, 100)
    moved_m = float(own[60:100].sum())
    for rows, other_rows in (
        (slice(25, 165), slice(None)),
        (slice(None), slice(25, 165)),
        (slice(25, None), slice(None, 165)),
        (slice(None, 165), slice(25, None)),
    ):
        [seen] = groundtruth_defects(
            track(truth)[rows], in_units(track(own))[other_rows], 0.5
        ).seen
        assert seen.values["moved_m"] == pytest.approx(moved_m)


@pytest.mark.parametrize(
    ("count", "own", "later", "is_examined"),
    [(12, 12, 0.0, True), (11, 12, 0.0, False), (12, 11, 0.0, False), (12, 12, 11.0, False)],
)
def test_twelve_common_poses_are_needed(
    count: int, own: int, later: float, is_examined: bool
) -> None:
    estimate = track(steps_of(own - 1), begin_s=BEGIN_S + later * STEP_S)
    found = groundtruth_defects(track(steps_of(count - 1)), estimate, 0.5)
    assert found.test == "groundtruth defects"
    assert found.why_not == ("" if is_examined else "too few common poses")
    assert bool(found.scores) == is_examined


def test_shares_are_of_steps_of_about_40_ms() -> None:
    """At 128 Hz every fifth pose: of poses held for 7 rows, 2 of 7 steps are constant."""
    steps = np.where(np.arange(1400) % 7 == 6, 0.02 + 0.001 * (np.arange(1400) % 5), 0.0)
    own = track(steps, 1.0 / 128.0)
    found = groundtruth_defects(own, own, 0.5)
    assert found.scores["still_share"] == pytest.approx(2.0 / 7.0, abs=1.0 / 280.0)
    steps = steps_of(100)
    steps[40:45] = 0.02
    held(steps, 70, 78)
    found = groundtruth_defects(track(steps), track(steps_of(100)), 0.5)
    assert found.scores == pytest.approx({"still_share": 0.08, "straight_share": 0.04})


@pytest.mark.parametrize(("times_s", "least_s"), [((0.0625, 0.125), 0.0625), ((0.5, 0.25), 0.25)])
@pytest.mark.parametrize("speed", [1.0, 1000.0])
def test_a_velocity_is_constant_up_to_the_rounding_of_its_positions(
    times_s: tuple[float, float], least_s: float, speed: float
) -> None:
    limit = 1e-6 * speed + 2e-7 / least_s
    for change, is_alike in ((0.98 * limit, True), (1.02 * limit, False)):
        seconds = np.concatenate([[0.0], np.cumsum(times_s)])
        velocities = np.array([speed, 0.0, 0.0]), np.array([speed, change, 0.0])
        moves = [velocity * time for velocity, time in zip(velocities, times_s, strict=True)]
        positions = np.concatenate([np.zeros((1, 3)), np.cumsum(moves, axis=0)])
        still, gliding = _constant(TimedPoses(seconds, positions))
        assert still.tolist() == [False, False]
        assert gliding.tolist() == [False, is_alike]


def test_a_step_without_motion_is_constant_and_not_linear() -> None:
    positions = np.outer([0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 3.0, 3.0], [0.0, 0.0, -1e-9])
    still, gliding = _constant(TimedPoses(np.arange(8.0), positions))
    assert still.tolist() == [True, True, False, False, False, True, True]
    assert gliding.tolist() == [False, False, False, True, True, False, False]


def test_long_constant_and_linear_intervals_are_left_out_but_for_their_ends() -> None:
    steps = steps_of(200)
    held(steps, 20, 50)
    steps[70:100] = 0.05
    held(steps, 120, 136)  # a second, no more
    steps[150:166] = 0.05
    poses = track(steps)
    kept = np.delete(np.arange(201), np.r_[21:50, 71:100])
    assert without_defects(poses).seconds.tolist() == poses.seconds[kept].tolist()


def test_a_linear_interval_may_end_at_the_last_row_but_one() -> None:
    steps = steps_of(200)
    steps[160:199] = 0.05
    poses = track(steps)
    kept = np.delete(np.arange(201), np.arange(161, 199))
    assert without_defects(poses).seconds.tolist() == poses.seconds[kept].tolist()


def test_intervals_of_a_fast_groundtruth_end_at_every_fifth_row() -> None:
    """Of 128 Hz. Rows 402 to 606 are equal."""
    steps = steps_of(1000)
    held(steps, 402, 606)
    poses = track(steps, 1.0 / 128.0)
    kept = np.delete(np.arange(1001), np.arange(406, 605))
    assert without_defects(poses).seconds.tolist() == poses.seconds[kept].tolist()


@pytest.mark.parametrize(("begin", "kept"), [(10, 13), (9, 41)])
def test_a_groundtruth_that_is_constant_for_the_most_part_is_left(begin: int, kept: int) -> None:
    steps = steps_of(40)
    held(steps, begin, 39)
    assert len(without_defects(track(steps))) == kept


def gaps(
    places: list[tuple[int, int, float]], count: int = 400, missing: tuple[int, ...] = ()
) -> TestResult:
    """Return the test of a groundtruth with gaps, in which the estimate is ahead of a line.

    At a third of each gap, by some metres. The estimate has no poses in the missing rows.
    """
    own = steps_of(count)
    kept = np.ones(count + 1, dtype=bool)
    for begin, end, bent_m in places:
        along = np.linspace(0.0, 1.0, end - begin + 1)
        along[(end - begin) // 3] += bent_m
        own[begin:end] = np.diff(np.maximum.accumulate(along))
        kept[begin + 1 : end] = False
    estimate = in_units(track(own))[~np.isin(np.arange(count + 1), missing)]
    return groundtruth_defects(track(own)[kept], estimate, 3.0)


@pytest.mark.parametrize(
    ("rows", "bent_m", "is_seen"),
    [
        (17, 0.3, True),
        (16, 0.3, False),
        (48, 0.3, True),
        (49, 0.3, False),
        (40, 0.151, True),
        (40, 0.149, False),
    ],
)
def test_a_gap_of_more_than_a_second_up_to_the_limit_is_interpolated(
    rows: int, bent_m: float, is_seen: bool
) -> None:
    found = gaps([(100, 100 + rows, bent_m)]).seen
    assert [item.cause for item in found] == ["gap_bridged"] * is_seen


def test_gaps_are_counted_and_the_largest_deviation_in_any_is_stated() -> None:
    """Of a gap without poses of the estimate, nothing is known."""
    places = [(30, 50, 0.2), (70, 110, 0.4), (150, 180, 0.3), (200, 230, 0.6)]
    examined = gaps(places, missing=tuple(range(201, 228)))
    [seen] = examined.seen
    inside = 19 + 39 + 29
    assert dict(seen.values) == pytest.approx(
        {
            "max_gap_s": 3.0,
            "holes": 4.0,
            "longest_s": 40 * STEP_S,
            "bent_m": 0.4,
            "percent": 100.0 * inside / 374,
        }
    )


@pytest.mark.parametrize(("missing", "is_seen"), [(16, True), (17, False)])
@pytest.mark.parametrize("begin", [85, 145])
def test_the_line_across_a_gap_needs_poses_of_the_estimate_at_its_ends(
    missing: int, is_seen: bool, begin: int
) -> None:
    """They are interpolated across a second."""
    found = gaps([(100, 148, 0.4)], missing=tuple(range(begin, begin + missing - 1)))
    assert bool(found.seen) == is_seen


@pytest.mark.parametrize(("rows", "is_seen"), [(3, True), (2, False)])
def test_the_deviation_in_a_gap_is_of_three_poses(rows: int, is_seen: bool) -> None:
    """At both sides of the largest deviation, and of poses near the ends."""
    inside = [105, 114, 123][:rows]
    missing = tuple(set(range(101, 128)) - set(inside))
    assert bool(gaps([(100, 128, 0.9)], missing=missing).seen) == is_seen


@pytest.mark.parametrize(("others", "is_seen"), [(40, True), (39, False)])
def test_a_groundtruth_with_a_low_rate_has_no_gaps(others: int, is_seen: bool) -> None:
    """Ten gaps, and some usual steps."""
    places = [(18 * index, 18 * index + 17, 0.4) for index in range(10)]
    count = places[-1][1] + others - 9
    found = gaps(places, count)
    assert bool(found.seen) == is_seen


def test_gaps_of_all_lengths_are_examined() -> None:
    places = [(40 * index, 40 * index + 18 + index // 5, 0.2) for index in range(25)]
    places[2] = (80, 97, 0.6)  # the shortest one
    [seen] = gaps(places, 40 * 25).seen
    inside = sum(end - begin - 1 for begin, end, _ in places)
    assert seen.values["holes"] == 25.0
    assert seen.values["bent_m"] == pytest.approx(0.6)
    assert seen.values["percent"] == pytest.approx(100.0 * inside / 1001)
