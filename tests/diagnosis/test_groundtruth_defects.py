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


def seen_in(truth: Floats, estimated: Floats, max_gap_s: float = 0.5) -> dict[str, Detection]:
    examined = groundtruth_defects(track(truth), in_units(track(estimated)), max_gap_s)
    return {item.cause: item for item in examined.seen}


def frozen_at(intervals: list[tuple[int, int, float]], count: int = 200) -> dict[str, Detection]:
    """Return what is seen if the groundtruth is held while the estimate moves some metres."""
    estimated = steps_of(count)
    for begin, end, moved_m in intervals:
        estimated[begin:end] *= moved_m / estimated[begin:end].sum()
    truth = estimated.copy()
    for begin, end, _ in intervals:
        held(truth, begin, end)
    return seen_in(truth, estimated)


@pytest.mark.parametrize(
    ("rows", "moved_m", "is_frozen"),
    [(40, 1.0, True), (8, 1.0, False), (40, 0.05, False)],
)
def test_a_long_constant_interval_is_frozen_while_the_estimate_moves(
    rows: int, moved_m: float, is_frozen: bool
) -> None:
    result = frozen_at([(40, 40 + rows, moved_m)])
    assert list(result) == ["groundtruth_frozen"] * is_frozen


@pytest.mark.parametrize(
    ("times", "moved_m", "free", "is_held"),
    [
        (24, 0.05, 0, True),
        (5, 0.05, 0, False),
        (24, 0.005, 0, False),
        (24, 0.05, 80, True),
        (24, 0.05, 400, False),
    ],
)
def test_many_held_poses_are_a_low_rate(
    times: int, moved_m: float, free: int, is_held: bool
) -> None:
    """Four steps each, of which three are held; and then others."""
    count = 4 * times + free + 1
    estimated = steps_of(count)
    truth = estimated.copy()
    for begin in range(0, 4 * times, 4):
        estimated[begin : begin + 3] = moved_m / 3.0
        truth[begin : begin + 4] = [0.0, 0.0, 0.0, moved_m + estimated[begin + 3]]
    result = seen_in(truth, estimated)
    assert list(result) == ["groundtruth_held"] * is_held


def glided(intervals: list[tuple[int, int, float]], count: int = 200) -> dict[str, Detection]:
    """Return what is seen if the groundtruth is linear while the estimate is off in the middle."""
    estimated = steps_of(count)
    truth = estimated.copy()
    for begin, end, bent_m in intervals:
        half, total = (end - begin) / 2.0, 4.0
        middle = np.array([0.0, total / 2.0 + bent_m, total])
        along = np.interp(np.arange(end - begin + 1), [0.0, half, 2.0 * half], middle)
        estimated[begin:end] = np.diff(along)
        truth[begin:end] = total / (end - begin)
    return seen_in(truth, estimated)


@pytest.mark.parametrize(
    ("rows", "bent_m", "is_bridged"),
    [(20, 0.5, True), (3, 0.5, False), (20, 0.01, False)],
)
def test_a_dropout_was_filled_where_the_estimate_is_off_a_line_for_long(
    rows: int, bent_m: float, is_bridged: bool
) -> None:
    assert list(glided([(40, 40 + rows, bent_m)])) == ["groundtruth_bridged"] * is_bridged


def test_the_units_are_compared_over_the_common_time() -> None:
    """Before and after it, one side moves fast."""
    estimated = steps_of(200)
    estimated[:20] = estimated[-30:] = 1.0
    truth = estimated.copy()
    held(truth, 60, 100)
    moved_m = float(estimated[60:100].sum())
    for rows, other_rows in (
        (slice(25, 165), slice(None)),
        (slice(None), slice(25, 165)),
        (slice(25, None), slice(None, 165)),
        (slice(None, 165), slice(25, None)),
    ):
        [seen] = groundtruth_defects(
            track(truth)[rows], in_units(track(estimated))[other_rows], 0.5
        ).seen
        assert seen.values["moved_m"] == pytest.approx(moved_m)


def gaps(
    places: list[tuple[int, int, float]], count: int = 400, missing: tuple[int, ...] = ()
) -> TestResult:
    """Return the test of a groundtruth with gaps, in which the estimate is ahead of a line.

    At a third of each gap, by some metres. The estimate has no poses in the missing rows.
    """
    estimated = steps_of(count)
    kept = np.ones(count + 1, dtype=bool)
    for begin, end, bent_m in places:
        along = np.linspace(0.0, 1.0, end - begin + 1)
        along[(end - begin) // 3] += bent_m
        estimated[begin:end] = np.diff(np.maximum.accumulate(along))
        kept[begin + 1 : end] = False
    estimate = in_units(track(estimated))[~np.isin(np.arange(count + 1), missing)]
    return groundtruth_defects(track(estimated)[kept], estimate, 3.0)


@pytest.mark.parametrize(
    ("rows", "bent_m", "is_seen"),
    [(30, 0.3, True), (8, 0.3, False), (80, 0.3, False), (30, 0.05, False)],
)
def test_a_long_gap_up_to_the_limit_is_interpolated(
    rows: int, bent_m: float, is_seen: bool
) -> None:
    result = gaps([(100, 100 + rows, bent_m)]).seen
    assert [item.cause for item in result] == ["gap_bridged"] * is_seen


@pytest.mark.parametrize(("others", "is_seen"), [(200, True), (15, False)])
def test_a_groundtruth_with_a_low_rate_has_no_gaps(others: int, is_seen: bool) -> None:
    """Ten gaps, and some usual steps."""
    places = [(18 * index, 18 * index + 17, 0.4) for index in range(10)]
    count = places[-1][1] + others - 9
    result = gaps(places, count)
    assert bool(result.seen) == is_seen
