"""Columns with other contents than poses: numbers of rows, degrees, constants, increments."""

from __future__ import annotations

import numpy as np
import pytest

from trajeval_ros import AssociationRule, Protocol, Trajectory
from trajeval_ros.diagnosis import column_tests
from trajeval_ros.diagnosis.findings import TestResult
from trajeval_ros.diagnosis.input_pair import InputPair, TimedPoses
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge

SECOND = 1_000_000_000


def seen_by(
    test: str,
    groundtruth: TimedPoses,
    estimate: TimedPoses,
    gauge: Gauge = Gauge.YAW,
    *,
    by_time: bool = True,
) -> TestResult:
    rule = AssociationRule("linear" if by_time else "index")
    sides = (
        Trajectory(
            np.rint(poses.seconds * SECOND).astype(np.int64), poses.positions, poses.quaternions
        )
        for poses in (groundtruth, estimate)
    )
    inputs = InputPair(*sides, Protocol(gauge=gauge, association=rule), 0.0)
    result: TestResult = getattr(column_tests, test.replace(" ", "_"))(inputs)
    return result


def timed(seconds: Floats) -> TimedPoses:
    return TimedPoses(seconds, np.outer(np.sin(seconds), np.ones(3)))


@pytest.mark.parametrize(
    ("counted_from", "other_begin", "other_span", "is_seen"),
    [
        (0.0, 5.0, 30.0, False),  # 40 rows are 39 s
        (0.0, 5.0, 4.0, True),
        (0.0, 5.0, 200.0, True),
        (0.0, 100.0, 39.0, True),  # no common time
        (5000.0, 5.0, 200.0, True),
        (1.7e9, 5.0, 200.0, False),
    ],
)
def test_row_numbers_are_small_and_of_another_time(
    counted_from: float, other_begin: float, other_span: float, *, is_seen: bool
) -> None:
    estimated = timed(counted_from + np.arange(40.0))
    true = timed(other_begin + np.linspace(0.0, other_span, 60))
    actual = seen_by("row numbers", true, estimated)
    assert [item.cause for item in actual.seen] == ["row_numbers"] * is_seen
    assert actual.scores == pytest.approx({"span_ratio": 39.0 / other_span})
    assert not seen_by("row numbers", true, estimated, by_time=False).seen
    off = estimated.seconds.copy()
    off[7:] += 1e-3
    assert not seen_by("row numbers", true, timed(off)).seen


def spread(*sizes: float, count: int = 30) -> TimedPoses:
    """Return positions with these extents."""
    column = np.linspace(0.0, 1.0, count)
    return TimedPoses(np.arange(count) * 0.1, np.outer(column, sizes))


@pytest.mark.parametrize("side", ["estimate", "groundtruth"])
@pytest.mark.parametrize(
    ("extent", "ratio", "is_seen"),
    [
        (0.01, 1.0, True),
        (0.01, 2.0, True),
        (0.01, 10.0, False),
        (0.01, 0.1, False),
        (0.5, 1.0, False),
        (1e-9, 1.0, False),
    ],
)
def test_degrees_have_the_extent_of_the_other_side_on_the_earth(
    side: str, extent: float, ratio: float, *, is_seen: bool
) -> None:
    """A minute of arc of latitude is a nautical mile, 1852 m to 0.2 %; heights are larger."""
    moved = ratio * extent * 111_320.0
    assert pytest.approx(1852.0, rel=3e-3) == 111_320.0 / 60.0
    degrees = spread(0.6 * extent, 300.0, -0.8 * extent)
    metres = spread(moved / 3.0, -2.0 * moved / 3.0, 2.0 * moved / 3.0)
    other = "groundtruth" if side == "estimate" else "estimate"
    sides = {side: degrees, other: metres}
    actual = seen_by("degrees", **sides)
    if not is_seen:
        assert actual == TestResult("degrees")
        return
    [seen] = actual.seen
    assert seen.cause == "degrees"
    assert actual.scores == pytest.approx({"ratio": ratio})
    assert seen.values.items() >= {"side": side, "other": other}.items()
    assert seen.values["path_m"] == pytest.approx(moved)
    assert seen.values["extent"] == pytest.approx(extent)


@pytest.mark.parametrize("side", ["estimate", "groundtruth"])
@pytest.mark.parametrize(
    ("axis", "constant", "other", "height", "is_seen"),
    [
        ("z", "z", "", 0.2, True),
        ("x", "x", "", 0.2, True),
        ("y", "y", "", 0.2, True),
        ("", "z", "", 0.01, False),
        ("", "", "", 1.0, False),
        ("", "xz", "", 1.0, False),
        ("", "z", "x", 1.0, False),
    ],
)
def test_a_flat_side_has_one_constant_column_while_the_other_has_heights(
    side: str, axis: str, constant: str, other: str, height: float, *, is_seen: bool
) -> None:
    """`height` is the rms height as a part of the extent of the other side."""
    columns = np.random.default_rng(2).normal(size=(40, 3))
    columns -= columns.mean(axis=0)
    columns /= columns.std(axis=0)
    flat, full = columns.copy(), columns * [3.0, 4.0, 5.0 * height / np.sqrt(1.0 - height**2)] \
        if height < 1.0 else columns * [3.0, 4.0, 50.0]  # fmt: skip
    for name, changed in ((constant, flat), (other, full)):
        for item in name:
            changed[:, "xyz".index(item)] = 7.0
    if len(constant) == 0:
        flat[:, 2] *= 1e-6  # not constant
    another = "groundtruth" if side == "estimate" else "estimate"
    poses = {
        side: TimedPoses(np.arange(40.0), flat),
        another: TimedPoses(np.arange(40.0), full),
    }
    actual = seen_by("flat", **poses)
    assert not seen_by("flat", **poses, gauge=Gauge.PLANAR).seen
    if not is_seen:
        assert actual == TestResult("flat")
        return
    [seen] = actual.seen
    height_m = float(full[:, 2].std())
    assert seen.cause == "flat"
    assert seen.values == {"side": side, "other": another, "axis": axis, "height_m": height_m}
    assert actual.scores == {"height_m": height_m}


def walk(count: int, size: float = 1.0) -> tuple[TimedPoses, Floats]:
    """Return a groundtruth, and the steps that led to every pose."""
    steps = np.random.default_rng(8).normal(size=(count, 3)) * size
    steps *= (1.0 + np.arange(count) // 10 % 3)[:, None]
    steps[:, 0] = np.abs(steps[:, 0])  # far away
    return TimedPoses(0.1 * np.arange(count), np.cumsum(steps, axis=0)), steps


@pytest.mark.parametrize(
    ("factor", "is_seen"), [(1.0, True), (1.5, True), (4.0, False), (0.2, False)]
)
def test_increments_have_the_lengths_of_the_steps(factor: float, *, is_seen: bool) -> None:
    """Of sums over ten steps."""
    true, steps = walk(601)
    estimated = TimedPoses(true.seconds, factor * steps)
    actual = seen_by("increments", true, estimated)
    sums = [
        np.linalg.norm(item[1:], axis=1).reshape(60, 10).sum(axis=1)
        for item in (steps, estimated.positions)
    ]
    ratio = np.median(sums[1]) / np.median(sums[0])
    assert actual.scores == pytest.approx({"peak": 1.0, "ratio": ratio})
    assert ratio == pytest.approx(factor)
    assert [item.cause for item in actual.seen] == ["increments"] * is_seen
    for seen in actual.seen:
        assert seen.values == {"peak": actual.scores["peak"]}
