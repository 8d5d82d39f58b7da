"""Jumps noticed live: a restart is one, noise and honest motion are none."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import along_line, make_element, make_groundtruth, seeds

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.travelled import StepDifferences
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.jump_detector import Jump, JumpDetector
from trajeval_ros.online.state_rows import Pairs, states
from trajeval_ros.pipeline.pipeline import evaluate


def pairs_of(groundtruth: Trajectory, estimate: Trajectory) -> Pairs:
    return Pairs(
        groundtruth.stamps,
        states(groundtruth.positions, groundtruth.quaternions),
        states(estimate.positions, estimate.quaternions),
    )


def part(pairs: Pairs, begin: int, end: int) -> Pairs:
    return Pairs(*(column[begin:end] for column in pairs))


def detect(pairs: Pairs, cuts: list[int], scale: float = 1.0) -> list[Jump]:
    """Return the jumps among pairs that come in batches."""
    detector = JumpDetector()
    found = []
    bounds = [0, *sorted(cuts), len(pairs.stamps)]
    for begin, end in itertools.pairwise(bounds):
        found += detector.update(part(pairs, begin, end), scale)
    assert detector.count == len(found)
    return found


def restarted(groundtruth: Trajectory, row: int, origin: float) -> Pairs:
    """Return pairs of an estimate that begins anew, elsewhere, at a row."""
    pairs = pairs_of(groundtruth, groundtruth)
    pairs.estimate[row:, :3] += origin
    return pairs


@given(seed=seeds, cuts=st.lists(st.integers(1, 199), max_size=12), row=st.integers(2, 199))
def test_a_restart_is_found_where_it_is_however_pairs_come(
    seed: int, cuts: list[int], row: int
) -> None:
    groundtruth = make_groundtruth(seed, 200)
    [jump] = detect(restarted(groundtruth, row, 60.0), cuts)
    assert jump.stamp == groundtruth.stamps[row]
    assert jump.position_m > 50.0
    assert jump.rotation_deg == pytest.approx(0.0, abs=1e-4)


@given(seed=seeds, cuts=st.lists(st.integers(1, 199), max_size=12))
def test_an_estimate_in_another_frame_does_not_jump(seed: int, cuts: list[int]) -> None:
    groundtruth = make_groundtruth(seed, 200)
    element = make_element(Gauge.SIM3, seed)
    pairs = pairs_of(groundtruth, element.trajectory(groundtruth))
    noise = np.random.default_rng(seed).normal(scale=0.02, size=(200, 3))
    pairs.estimate[:, :3] += element.scale * noise
    assert detect(pairs, cuts, 1.0 / element.scale) == []


def test_a_turn_that_nobody_made_is_a_jump() -> None:
    groundtruth = make_groundtruth(4, 100)
    pairs = pairs_of(groundtruth, groundtruth)
    turned = make_element(Gauge.YAW, 1)
    moved = turned.trajectory(groundtruth)
    assert moved.quaternions is not None
    pairs.estimate[50:, 3:7] = moved.quaternions[50:]
    [jump] = detect(pairs, [])
    assert jump.stamp == groundtruth.stamps[50]
    assert jump.rotation_deg > 30.0


def test_without_rotations_positions_alone_are_looked_at() -> None:
    pairs = restarted(make_groundtruth(4, 100), 30, 20.0)
    pairs.groundtruth[:, 3:7] = np.nan
    [jump] = detect(pairs, [10, 40])
    assert jump.rotation_deg == 0.0


@given(cuts=st.lists(st.integers(1, 199), max_size=12))
def test_an_estimate_in_millimetres_does_not_jump_all_along(cuts: list[int]) -> None:
    groundtruth = along_line(np.linspace(0.0, 40.0, 200), [1.0, 0.0, 0.0])
    pairs = pairs_of(groundtruth, groundtruth)
    pairs.estimate[:, :3] *= 1000.0
    assert [each.stamp for each in detect(pairs, cuts)] == groundtruth.stamps[1:3].tolist()
    pairs.estimate[150:, 0] += 1e5  # 500 times its usual step
    *_, jump = detect(pairs, [100, *cuts])  # what is usual is learned from batch to batch
    assert jump == Jump(int(groundtruth.stamps[150]), pytest.approx(1e5, rel=0.01), 0.0)


def test_a_declared_reset_is_one_jump_however_small() -> None:
    """It is reported with the first pair at or after it, also if that comes later."""
    pairs = pairs_of(*[make_groundtruth(2, 60)] * 2)
    detector = JumpDetector()
    detector.declare([int(pairs.stamps[30])])
    assert detector.update(part(pairs, 0, 30), 1.0) == []
    (jump,) = detector.update(part(pairs, 30, 60), 1.0)
    assert (jump.stamp, jump.declared) == (int(pairs.stamps[30]), True)
    large = restarted(make_groundtruth(2, 60), 40, 1e4)
    detector = JumpDetector()
    detector.declare([int(large.stamps[40])])
    (jump,) = detector.update(large, 1.0)  # one event, not two
    assert jump.declared


def test_pairs_that_come_late_are_passed_over() -> None:
    pairs = pairs_of(*[make_groundtruth(2, 60)] * 2)
    detector = JumpDetector()
    assert detector.update(part(pairs, 20, 60), 1.0) == []
    late = part(pairs, 0, 20)
    late.estimate[:, :3] += 100.0
    assert detector.update(late, 1.0) == []
    assert detector.update(part(pairs, 0, 0), 1.0) == []
    assert detector.count == 0


@pytest.mark.parametrize(
    ("true_m", "typical_m", "typical_deg", "limit_m", "limit_deg"),
    [
        (0.1, 0.0, 0.0, 1.0, 30.0),  # the least that counts
        (0.1, 0.3, 5.0, 3.0, 50.0),  # ten times what is usual
        (7.0, 0.3, 0.0, 7.0, 30.0),  # across a hole, as far as the robot moved
    ],
)
def test_a_jump_is_beyond_the_least_the_usual_and_the_way(
    true_m: float, typical_m: float, typical_deg: float, limit_m: float, limit_deg: float
) -> None:
    factors = np.array([0.99, 1.01, 0.0, 0.0])
    true = np.full(4, true_m)
    steps = StepDifferences(true, true, factors * limit_m, factors[::-1] * limit_deg)
    assert steps.jumps(typical_m, typical_deg).tolist() == [1, 2]


@pytest.mark.parametrize("origin_m", [0.3, 1.5])
def test_an_evaluation_has_an_event_at_a_new_origin(origin_m: float) -> None:
    # The origin moves in the direction of the flight, so that a step is longer by all of it.
    groundtruth = along_line(0.05 * np.arange(200.0), [1.0, 2.0, 2.0], noise_m=0.002)
    positions = groundtruth.positions.copy()
    positions[120:] += origin_m * np.array([1.0, 2.0, 2.0]) / 3.0
    estimate = dataclasses.replace(groundtruth, positions=positions)
    evaluation = evaluate(groundtruth, estimate, Protocol(lengths=()))
    (event,) = evaluation.events
    assert (event.kind, event.side) == ("step", "estimate")
    assert event.end_ns == groundtruth.stamps[120]
    assert event.m == pytest.approx(origin_m)
