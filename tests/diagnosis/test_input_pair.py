"""Poses over seconds, and both sides of a comparison until the estimate was lost."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from trajeval_ros import AssociationRule, Protocol, Trajectory
from trajeval_ros.diagnosis.input_pair import InputPair, TimedPoses
from trajeval_ros.geometry.arrays import lengths
from trajeval_ros.metrics.discontinuities.events import DIVERGED, ESTIMATE, FROZEN, Loss

SECOND = 1_000_000_000


def test_poses_are_sorted_and_the_first_of_equal_times_is_kept() -> None:
    seconds = np.array([1.0, 3.0, 2.0, 3.0, 1.0, 5.0])
    positions, quaternions, velocities = (np.outer(np.arange(6.0), np.ones(n)) for n in (3, 4, 3))
    result = TimedPoses(seconds, positions, quaternions, velocities).in_order()
    assert result.seconds.tolist() == [1.0, 2.0, 3.0, 5.0]
    rows = [0.0, 2.0, 1.0, 5.0]
    assert result.quaternions is not None
    assert result.velocities is not None
    for item in (result.positions, result.quaternions, result.velocities):
        assert item[:, 0].tolist() == rows
    assert result.in_order() is result
    assert result.span_s == 4.0
    assert result.usual_step_s == 1.0
    deviation = np.linalg.norm(np.std(result.positions, axis=0))
    assert result.extent == pytest.approx(deviation)
    nothing = result[:0]
    assert (nothing.span_s, nothing.extent, nothing.usual_step_s) == (0.0, 0.0, 1.0)
    assert result[:1].usual_step_s == 1.0
    np.testing.assert_allclose(lengths(positions), np.linalg.norm(positions, axis=1))


def test_a_clock_is_corrected_by_an_offset_and_a_rate_from_its_start() -> None:
    poses = TimedPoses(np.array([10.0, 12.0, 20.0]), np.zeros((3, 3)))
    assert poses.shifted(0.0) is poses
    assert poses.shifted(3.0).seconds.tolist() == [13.0, 15.0, 23.0]
    assert poses.shifted(-1.0, 0.5).seconds.tolist() == [9.0, 12.0, 24.0]
    assert poses.shifted(0.0, 0.5).seconds.tolist() == [10.0, 13.0, 25.0]


def test_poses_between_neighbours_are_interpolated() -> None:
    """Beyond the ends, the poses are those of the ends, and not known."""
    seconds = np.array([0.0, 1.0, 3.0, 4.0])
    rotated = Rotation.random(4, random_state=3)
    positions = np.random.default_rng(3).normal(size=(4, 3))
    poses = TimedPoses(seconds, positions, rotated.as_quat())
    times = np.array([-0.1, 0.0, 0.4, 1.0, 2.5, 3.0, 4.0, 4.1])
    inside = np.clip(times, 0.0, 4.0)
    for max_gap_s, gap_is_known in ((2.0, True), (1.9, False), (np.inf, True)):
        result = poses.at(times, max_gap_s)
        assert not result.known[[0, 7]].any()
        assert result.known[[1, 2, 6]].all()
        assert result.known[4] == gap_is_known
        for axis in range(3):
            expected = np.interp(inside, seconds, positions[:, axis])
            np.testing.assert_allclose(result.positions[:, axis], expected, atol=1e-12)
        assert result.quaternions is not None
        apart = Slerp(seconds, rotated)(inside).inv() * Rotation.from_quat(result.quaternions)
        assert apart.magnitude().max() < 1e-9
    assert TimedPoses(seconds, positions).at(times).quaternions is None


def pair_of(**rule: Any) -> InputPair:
    """Return a groundtruth of 20 s from 100 s on, and an estimate that begins a second later."""
    sides = [
        Trajectory.from_columns(
            np.arange(begin, 121) * SECOND, np.outer(np.arange(begin, 121.0), np.ones(3))
        )
        for begin in (100, 101)
    ]
    protocol = Protocol(association=AssociationRule(**rule), lengths=())
    return InputPair(*sides, protocol, protocol.association.time_offset_s)


def test_both_sides_share_an_epoch_and_the_offset_is_the_estimate_s() -> None:
    pair = pair_of(method="linear", max_gap_s=0.7, time_offset_s=0.25)
    assert pair.poses["groundtruth"].seconds.tolist() == np.arange(21.0).tolist()
    assert pair.poses["estimate"].seconds.tolist() == (np.arange(1.0, 21.0) + 0.25).tolist()
    assert pair.by_time
    assert pair.protocol.association.longest_step_s == 0.7
    nearest = AssociationRule("nearest", max_gap_s=0.7, max_time_difference_s=0.05)
    assert nearest.longest_step_s == 0.1
    assert not pair_of(method="index").by_time
    applied = dataclasses.replace(pair, offset_s=0.0)
    assert applied.poses["estimate"].seconds[0] == 1.0


@pytest.mark.parametrize(
    ("cause", "is_over", "kept", "true_kept"),
    [
        (FROZEN, True, [*range(1, 6), *range(10, 21)], [*range(21)]),
        (FROZEN, False, [*range(1, 6)], [*range(6)]),
        (DIVERGED, True, [*range(1, 6)], [*range(6)]),
        (DIVERGED, False, [*range(1, 6)], [*range(6)]),
    ],
)
def test_frozen_poses_and_what_follows_a_divergence_are_left_out(
    cause: str, kept: list[int], true_kept: list[int], *, is_over: bool
) -> None:
    """A loss from the last good pair at 5 s to its last pair at 9 s."""
    begin, end = (int(item * SECOND) for item in (105, 109))
    loss = Loss(cause, ESTIMATE, begin, end, m=4.0, moved_m=9.0, is_over=is_over)
    pair = pair_of()
    result = pair.tracked([loss])
    assert result.poses["estimate"].seconds.tolist() == kept
    assert result.poses["groundtruth"].seconds.tolist() == true_kept
    assert ((result.estimate.stamps - 100 * SECOND) // SECOND).tolist() == kept
    assert ((result.groundtruth.stamps - 100 * SECOND) // SECOND).tolist() == true_kept
    assert pair.tracked([]).poses["estimate"].seconds.tolist() == [*range(1, 21)]
    ordered = result.in_order
    assert [len(item) for item in ordered] == [len(true_kept), len(kept)]
