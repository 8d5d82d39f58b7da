"""Constant and linear intervals and gaps of a groundtruth, on paths along one line.

On a line, forwards, the length of a path is the distance of its ends, whatever is sampled. So the
ratio of the units of both sides and every distance of a finding are known exactly.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from trajeval_ros.diagnosis.dropout_tests import groundtruth_defects
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


@pytest.mark.parametrize(("others", "is_seen"), [(40, True), (39, False)])
def test_a_groundtruth_with_a_low_rate_has_no_gaps(others: int, is_seen: bool) -> None:
    """Ten gaps, and some usual steps."""
    places = [(18 * index, 18 * index + 17, 0.4) for index in range(10)]
    count = places[-1][1] + others - 9
    found = gaps(places, count)
    assert bool(found.seen) == is_seen
