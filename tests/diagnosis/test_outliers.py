"""Outliers of an estimate, which are no restart, and the parts of that test."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.diagnosis.dropout_tests import _gain, _Jump, _moved, _turned
from trajeval_ros.diagnosis.input_pair import TimedPoses
from trajeval_ros.geometry.arrays import Floats


def excursion(rate_hz: float, number: int, size: float, ahead: float = 0.0) -> tuple[Any, ...]:
    """Return a body at rest, and an estimate with outliers from row 50 on, and the two jumps.

    The poses after the outliers are off by a part of the size.
    """
    seconds = np.arange(100) / rate_hz
    true = TimedPoses(seconds, np.zeros((100, 3)))
    positions = np.zeros((100, 3))
    positions[50 : 50 + number, 0] = size
    positions[50 + number :, 1] = ahead * size
    begin, end = (_Jump(each - 1, each, size, 0.0) for each in (50, 50 + number))
    return true, TimedPoses(seconds, positions), begin, end


@pytest.mark.parametrize(
    ("rate_hz", "number", "stays"),
    [(10.0, 20, False), (10.0, 21, True), (1.0, 5, False), (1.0, 6, True)],
)
def test_outliers_last_for_up_to_two_seconds_or_five_poses(
    rate_hz: float, number: int, *, stays: bool
) -> None:
    true, estimate, begin, end = excursion(rate_hz, number, 4.0)
    assert begin.stays(true, estimate, 1.0) == stays
    assert end.stays(true, estimate, 1.0) == stays


@pytest.mark.parametrize(("ahead", "stays"), [(0.249, False), (0.251, True)])
def test_poses_after_outliers_are_right_to_a_quarter_of_their_size(
    ahead: float, *, stays: bool
) -> None:
    true, estimate, begin, end = excursion(10.0, 3, 4.0, ahead)
    assert begin.stays(true, estimate, 1.0) == stays
    assert end.stays(true, estimate, 1.0) == stays
    # In another unit, in which the size of the jump is 2 m.
    jumps = [dataclasses.replace(each, metres=8.0) for each in (begin, end)]
    assert [each.stays(true, estimate, 2.0) for each in jumps] == [stays, stays]


@pytest.mark.parametrize(("ahead", "stays"), [(0.249, False), (0.251, True)])
def test_outliers_are_short_beside_the_motion(ahead: float, *, stays: bool) -> None:
    """Both sides move while there are outliers."""
    true, estimate, begin, end = excursion(10.0, 3, 4.0, ahead)
    true.positions[53:] = estimate.positions[53:]
    assert begin.stays(true, estimate, 1.0) == stays
    assert end.stays(true, estimate, 1.0) == stays


def test_the_nearest_pose_after_an_outlier_decides_of_a_fast_body() -> None:
    """It moves by a tenth of the jump per step, so two steps are short and three are not."""
    true, estimate, begin, end = excursion(10.0, 1, 4.0)
    motion = np.outer(np.arange(100.0), [0.0, 0.0, 0.4])
    moving = (
        dataclasses.replace(each, positions=each.positions + motion) for each in (true, estimate)
    )
    sides = tuple(moving)
    assert not begin.stays(*sides, 1.0)
    assert not end.stays(*sides, 1.0)
    assert dataclasses.replace(begin, metres=3.1).stays(*sides, 1.0)


def test_one_pose_before_or_after_outliers_is_enough() -> None:
    true, estimate, begin, end = excursion(10.0, 3, 4.0)
    assert not begin.stays(true[:54], estimate[:54], 1.0)
    assert begin.stays(true[:53], estimate[:53], 1.0)
    for first, stays in ((49, False), (50, True)):
        late = dataclasses.replace(end, before=end.before - first, after=end.after - first)
        assert late.stays(true, estimate[first:], 1.0) == stays


@pytest.mark.parametrize(("missing", "stays"), [(9, False), (10, True)])
def test_motions_over_outliers_need_groundtruth(missing: int, *, stays: bool) -> None:
    """Its gaps are at most a second, at the only good poses before or after."""
    true, estimate, begin, end = excursion(10.0, 20, 4.0)
    for first in (71 - missing, 50 - missing):
        kept = np.delete(np.arange(100), np.arange(first, first + missing))
        around = [begin.stays(true[kept], estimate, 1.0), end.stays(true[kept], estimate, 1.0)]
        assert stays in around


@pytest.mark.parametrize(("degrees", "stays"), [(9.9, False), (10.1, True)])
def test_outliers_of_the_heading_have_angles(degrees: float, *, stays: bool) -> None:
    angles = np.zeros(100)
    angles[50:53], angles[53:] = 40.0, degrees
    turned = Rotation.from_rotvec(np.radians(np.outer(angles, [0.0, 1.0, 0.0]))).as_quat()
    seconds, still = np.arange(100) / 10.0, Rotation.identity(100).as_quat()
    true = TimedPoses(seconds, np.zeros((100, 3)), still)
    estimate = TimedPoses(seconds, np.zeros((100, 3)), turned)
    for row in (50, 53):
        assert _Jump(row - 1, row, 0.0, 40.0).stays(true, estimate, 3.0) == stays


def test_motions_are_lengths_or_angles() -> None:
    generator = np.random.default_rng(3)
    positions, turned = generator.normal(size=(2, 9, 3)), Rotation.random(18, random_state=4)
    start, end = (
        TimedPoses(np.arange(9.0), each, turned[rows].as_quat())
        for each, rows in zip(positions, (slice(0, 9), slice(9, 18)), strict=True)
    )
    away = np.linalg.norm(positions[1] - positions[0], axis=1)
    angles = np.degrees((turned[:9].inv() * turned[9:]).magnitude())
    np.testing.assert_allclose(_moved(start, end, by_angle=False), away, rtol=1e-12)
    np.testing.assert_allclose(_moved(start, end, by_angle=True), angles, rtol=1e-9)
    for without in ((start, dataclasses.replace(end, quaternions=None)),
                    (dataclasses.replace(start, quaternions=None), end)):  # fmt: skip
        np.testing.assert_allclose(_moved(*without, by_angle=True), away, rtol=1e-12)
    steps = [
        np.degrees((each[:-1].inv() * each[1:]).magnitude()) for each in (turned[:9], turned[9:])
    ]
    true = end.at(end.seconds)
    np.testing.assert_allclose(_turned(start, true), np.abs(steps[0] - steps[1]), rtol=1e-9)
    for sides in ((start, true._replace(quaternions=None)),
                  (dataclasses.replace(start, quaternions=None), true)):  # fmt: skip
        assert _turned(*sides).tolist() == [0.0] * 8


def test_the_gain_is_of_the_squared_errors_after_rigid_alignments() -> None:
    """As of scipy, and parts with less than five positions fit."""
    ours, true = np.random.default_rng(5).normal(size=(2, 40, 3))
    known = np.ones(40, dtype=bool)
    known[[3, 17, 30]] = False
    rows = np.flatnonzero(known)

    def misfit(part: Floats) -> float:
        a, b = (each[part] - each[part].mean(axis=0) for each in (ours, true))
        return float(Rotation.align_vectors(b, a)[1]) ** 2

    for cuts, parts in (
        ([20], [rows[rows < 20], rows[rows >= 20]]),
        ([5, 18, 40], [rows[(rows >= 5) & (rows < 18)], rows[rows >= 18]]),  # 4 before
        ([6], [rows[rows < 6], rows[rows >= 6]]),  # 5 before
    ):
        gain = 1.0 - sum(misfit(each) for each in parts) / misfit(rows)
        assert _gain(ours, true, known, np.array(cuts)) == pytest.approx(gain, rel=1e-9)
