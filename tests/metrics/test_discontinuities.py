"""Discontinuities of simulated streams: kind, side, time and size, live as recorded."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros import evaluate, read_trajectory, simulate
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.discontinuities.detector import Discontinuities
from trajeval_ros.metrics.discontinuities.events import SIDES, Event
from trajeval_ros.metrics.discontinuities.handling import (
    without_clock_steps,
    without_groundtruth_outliers,
)
from trajeval_ros.metrics.discontinuities.recorded import discontinuities
from trajeval_ros.metrics.discontinuities.screening import has_repeats, unusual_times
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import Protocol

FIELD_CASES = Path(__file__).parents[3] / "shared/data/field_cases"
AT_S, DURATION_S = 40.0, 80.0
HALF_ROTATION = np.array([1.0, 0.0, 0.0, 0.0])


def sides(seed: int) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth at 100 Hz and a drifting estimate at 20 Hz, in another frame."""
    rng = np.random.default_rng(seed)
    amplitudes, phases = rng.uniform(0.5, 2.0, (6, 3)), rng.uniform(0.0, 6.0, (6, 3))
    rates = rng.uniform(0.1, 0.8, (6, 3))

    def flown(stamps: Stamps) -> tuple[Floats, Floats]:
        seconds = stamps[:, None, None] / NANOSECONDS
        waves = (amplitudes * np.sin(rates * seconds + phases)).sum(axis=2)
        angles = waves[:, 3:] * np.array([0.05, 0.05, 0.4])
        half = np.linalg.norm(angles, axis=1, keepdims=True) / 2.0
        quaternions = np.hstack([angles * np.sinc(half / np.pi) / 2.0, np.cos(half)])
        return waves[:, :3], quaternions

    stamps = np.arange(0, int(DURATION_S * 1e9), 10_000_000)
    positions, quaternions = flown(stamps)
    positions = positions + 0.001 * rng.normal(size=positions.shape)
    groundtruth = Trajectory(stamps, positions, quaternions)
    stamps = np.arange(3_700_000, int(DURATION_S * 1e9) - 50_000_000, 50_000_000)
    positions, quaternions = flown(stamps)
    positions = positions * 1.003 + 0.003 * rng.normal(size=positions.shape)
    positions += np.cumsum(0.003 * rng.normal(size=positions.shape), axis=0) / 10.0
    frame = np.array([0.0, 0.0, np.sin(0.4), np.cos(0.4)])
    quaternions = lie.multiply(np.broadcast_to(frame, quaternions.shape), quaternions)
    positions = lie.rotate(np.broadcast_to(frame, quaternions.shape), positions) + [3.0, -2.0, 0.5]
    return groundtruth, Trajectory(stamps, positions, quaternions)


def changed(
    trajectory: Trajectory, begin_s: float, end_s: float, change: Callable[[Floats], Floats]
) -> Trajectory:
    """Return a trajectory with other positions within a time."""
    rows = inside(trajectory, begin_s, end_s)
    positions = trajectory.positions.copy()
    positions[rows] = change(positions[rows])
    return dataclasses.replace(trajectory, positions=positions)


def inside(trajectory: Trajectory, begin_s: float, end_s: float) -> slice:
    seconds = trajectory.stamps / NANOSECONDS
    return slice(int(np.searchsorted(seconds, begin_s)), int(np.searchsorted(seconds, end_s)))


def only(events: list[Event]) -> Event:
    assert len(events) == 1, events
    return events[0]


@pytest.mark.parametrize("seed", [811, 812])
def test_a_healthy_run_has_no_event(seed: int) -> None:
    assert discontinuities(*sides(seed)) == []


@pytest.mark.parametrize("number", [4000, 4001])  # before and after an estimated pose
def test_one_sample_of_the_groundtruth_has_its_size(number: int) -> None:
    """The groundtruth at the estimate's timestamps has a part of it, by interpolation."""
    groundtruth, estimate = sides(813)
    one = slice(number, number + 1)
    positions, quaternions = groundtruth.positions.copy(), groundtruth.known_quaternions.copy()
    positions[one] += [0.0, 6.0, 0.0]
    outlier = only(
        discontinuities(dataclasses.replace(groundtruth, positions=positions), estimate)
    )
    assert (outlier.kind, outlier.side) == ("outlier", "groundtruth")
    assert outlier.m == pytest.approx(6.0, abs=0.05)
    quaternions[one] = lie.multiply(quaternions[one], HALF_ROTATION[None])
    flip = only(
        discontinuities(dataclasses.replace(groundtruth, quaternions=quaternions), estimate)
    )
    assert (flip.kind, flip.side) == ("flip", "groundtruth")
    assert flip.deg == pytest.approx(180.0, abs=1.0)


@pytest.mark.parametrize("number", [0, 1])  # groundtruth and estimate
@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("is_first", [True, False])
def test_poses_outside_at_an_end_of_the_run_are_an_outlier(
    number: int, count: int, *, is_first: bool
) -> None:
    pair = list(sides(814))
    positions = pair[number].positions.copy()
    until_s = pair[1].stamps[[0, -1][not is_first]] / NANOSECONDS
    near = np.abs(pair[number].stamps / NANOSECONDS - until_s) < 0.05 * count - 0.03
    positions[near] += [0.0, 2.0, 0.0]
    pair[number] = dataclasses.replace(pair[number], positions=positions)
    event = only(discontinuities(*pair))
    assert (event.kind, event.side) == ("outlier", SIDES[number])
    assert event.m == pytest.approx(2.0, abs=0.1)
    assert event.poses == count
    if number == 0:
        kept = without_groundtruth_outliers(pair[0], [event], pair[1].stamps).stamps
        paired = (pair[0].stamps >= event.t_ns) & (pair[0].stamps <= event.end_ns)
        assert np.isin(pair[0].stamps, kept).tolist() == (~(near & paired)).tolist()


def test_an_outlier_with_one_sharp_edge_is_dropped_and_good_poses_are_not() -> None:
    groundtruth, estimate = sides(815)
    positions, rows = groundtruth.positions.copy(), slice(4000, 4010)
    positions[rows, 1] += np.linspace(0.4, 4.0, 10)  # it grows, and ends at once
    moved = dataclasses.replace(groundtruth, positions=positions)
    event = Event("outlier", "groundtruth", *groundtruth.stamps[[3999, 4010]].tolist(), m=4.0)
    kept = without_groundtruth_outliers(moved, [event], estimate.stamps)
    assert np.isin(groundtruth.stamps, kept.stamps, invert=True).nonzero()[0].tolist() == [
        *range(4000, 4010)
    ]


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("deg", [70.0, 90.0, 180.0])
def test_a_flip_that_stays_has_its_time(side: str, deg: float) -> None:
    pair, number = list(sides(833)), SIDES.index(side)
    quaternions = pair[number].known_quaternions.copy()
    rows = inside(pair[number], AT_S, np.inf)
    flip = lie.from_rotation_vector(np.radians(deg) * np.array([[0.0, 0.6, 0.8]]))
    quaternions[rows] = lie.multiply(quaternions[rows], flip)
    pair[number] = dataclasses.replace(pair[number], quaternions=quaternions)
    event = only(discontinuities(*pair))
    assert (event.kind, event.side) == ("flip_stays", side)
    assert event.deg == pytest.approx(deg, abs=1.0)
    assert event.t_ns / NANOSECONDS < AT_S <= event.end_ns / NANOSECONDS < AT_S + 0.11


@pytest.mark.parametrize("seed", [831, 832])
@pytest.mark.parametrize("lasting_s", [8.0, 25.0])
def test_a_flip_of_another_point_of_the_body_returns(seed: int, lasting_s: float) -> None:
    """Its lever arm rotates, too, so that the position seems to step."""
    groundtruth, estimate = sides(seed)
    assert groundtruth.quaternions is not None
    assert estimate.quaternions is not None
    arm = lie.rotate(estimate.quaternions, np.array([0.02, 0.1, -0.05]))
    estimate = dataclasses.replace(estimate, positions=estimate.positions + arm)
    quaternions = groundtruth.quaternions.copy()
    rows = inside(groundtruth, AT_S, AT_S + lasting_s)
    quaternions[rows] = lie.multiply(quaternions[rows], HALF_ROTATION[None])
    flipping = dataclasses.replace(groundtruth, quaternions=quaternions)
    event = only(discontinuities(flipping, estimate))
    assert (event.kind, event.side) == ("flip", "groundtruth")
    assert event.t_ns / NANOSECONDS == pytest.approx(AT_S, abs=0.1)


def test_a_groundtruth_that_is_rare_at_the_start_shows_a_restart() -> None:
    """As a recording of a robot that rests, until it moves."""
    groundtruth, estimate = sides(842)
    rests = groundtruth.stamps < 12 * NANOSECONDS
    groundtruth = groundtruth[~rests | (np.arange(len(groundtruth)) % 200 == 0)]
    first = estimate.positions[0]
    estimate = changed(estimate, AT_S, np.inf, lambda rows: rows - rows[0] + first)
    event = only(discontinuities(groundtruth, estimate))
    assert (event.kind, event.side, event.certainty) == ("restart", "estimate", "sure")


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("step_s", [-10.017, -0.15, 0.417, 3.017])
def test_a_clock_step_is_measured_by_receive_times(side: str, step_s: float) -> None:
    rng = np.random.default_rng(861)
    pair = []
    for name, trajectory in zip(SIDES, sides(861), strict=True):
        delays = rng.exponential(0.003, len(trajectory)) * NANOSECONDS
        received = np.maximum.accumulate(trajectory.stamps + delays.astype(np.int64))
        stamps = trajectory.stamps.copy()
        if name == side:
            stamps[inside(trajectory, AT_S, np.inf)] += round(step_s * NANOSECONDS)
        reading = SourceInfo(receive_times=ReceiveTimes(received))
        pair.append(dataclasses.replace(trajectory, stamps=stamps, reading=reading))
    events = discontinuities(pair[0], pair[1])
    event = only(events)
    assert (event.kind, event.side, event.certainty) == ("clock_step", side, "sure")
    assert event.s == pytest.approx(step_s, abs=0.01)
    corrected = without_clock_steps(pair[SIDES.index(side)], events, side)
    expected = sides(861)[SIDES.index(side)].stamps
    assert np.abs(corrected.stamps - expected).max() < 0.01 * NANOSECONDS


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("step_s", [0.917, 3.017])
def test_a_forward_clock_step_is_measured_by_the_motion(side: str, step_s: float) -> None:
    pair = list(sides(862))
    place = SIDES.index(side)
    stamps = pair[place].stamps.copy()
    stamps[inside(pair[place], AT_S, np.inf)] += round(step_s * NANOSECONDS)
    pair[place] = dataclasses.replace(pair[place], stamps=stamps)
    events = discontinuities(pair[0], pair[1])
    event = only(events)
    assert (event.kind, event.side, event.certainty) == ("clock_step", side, "likely")
    assert event.s == pytest.approx(step_s, abs=0.02)
    corrected = without_clock_steps(pair[place], events, side)
    assert np.abs(corrected.stamps - sides(862)[place].stamps).max() < 0.02 * NANOSECONDS


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("steps_s", [(0.917, 1.417), (-0.917, -1.417), (0.917, -1.417)])
def test_a_second_clock_step_is_corrected(side: str, steps_s: tuple[float, float]) -> None:
    pair = list(sides(863))
    place = SIDES.index(side)
    true = pair[place].stamps
    stamps = true.copy()
    for at_s, step_s in zip((AT_S - 15.0, AT_S), steps_s, strict=True):
        stamps[inside(pair[place], at_s, np.inf)] += round(step_s * NANOSECONDS)
    pair[place] = dataclasses.replace(pair[place], stamps=stamps)
    events = discontinuities(pair[0], pair[1])
    assert [(event.kind, event.side) for event in events] == [("clock_step", side)] * 2
    corrected = without_clock_steps(pair[place], events, side)
    assert np.abs(corrected.stamps - true).max() < 0.05 * NANOSECONDS


@pytest.mark.slow
@pytest.mark.parametrize("batch_s", [0.07, 1.0])
def test_events_do_not_depend_on_the_batches(batch_s: float) -> None:
    groundtruth, estimate = sides(871)
    estimate = changed(estimate, AT_S, np.inf, lambda positions: positions + 1.0)
    groundtruth = changed(groundtruth, 20.0, 20.1, lambda positions: positions + 3.0)
    recorded = discontinuities(groundtruth, estimate)
    search = Discontinuities()
    edges_s = np.append(np.arange(0.0, DURATION_S, batch_s), DURATION_S)
    for begin_s, end_s in itertools.pairwise(edges_s):
        for side, trajectory in zip(SIDES, (groundtruth, estimate), strict=True):
            part = trajectory[inside(trajectory, begin_s, end_s)]
            assert part.quaternions is not None
            search.add(side, part.stamps, np.hstack([part.positions, part.quaternions]))
    assert [event.kind for event in recorded] == ["outlier", "step"]
    for event, same in zip(search.finish(), recorded, strict=True):
        assert (event.kind, event.side, event.t_ns) == (same.kind, same.side, same.t_ns)
        assert (event.end_ns, event.poses) == (same.end_ns, same.poses)
        assert (event.m, event.ratio) == pytest.approx((same.m, same.ratio), rel=1e-9)


@pytest.mark.parametrize(
    ("groundtruth", "estimate", "kind", "side"),
    [
        ("attack/g_one_outlier.txt", "attack/e.txt", "outlier", "groundtruth"),
        ("attack/g.txt", "attack/e_frozen_position.txt", "frozen_position", "estimate"),
        ("bags/step_3.017:/mocap/pose", "bags/step_3.017:/vio/odometry", "clock_step", "estimate"),
        ("bags/step_0.417:/mocap/pose", "bags/step_0.417:/vio/odometry", "clock_step", "estimate"),
        ("bags/flip_one:/mocap/pose", "bags/flip_one:/ekf/odom", "flip", "groundtruth"),
    ],
)
def test_inputs_that_people_report_are_named(
    groundtruth: str, estimate: str, kind: str, side: str
) -> None:
    if not FIELD_CASES.exists():
        pytest.skip("the recordings are absent")
    pair = [read_trajectory(str(FIELD_CASES / name)) for name in (groundtruth, estimate)]
    event = only(discontinuities(pair[0], pair[1]))
    assert (event.kind, event.side) == (kind, side)


def screened(groundtruth: Trajectory, estimate: Trajectory) -> bool:
    evaluation = evaluate(groundtruth, estimate, Protocol(gauge="se3", lengths=()))
    times = unusual_around(evaluation, groundtruth, estimate)
    return times is None or len(times) > 0 or has_repeats(groundtruth) or has_repeats(estimate)


def unusual_around(
    evaluation: Evaluation, groundtruth: Trajectory, estimate: Trajectory
) -> Stamps | None:
    similarity = evaluation.alignment.similarity
    return unusual_times(evaluation.association, similarity, groundtruth, estimate)


@pytest.mark.parametrize("at_s", [[30.0], [110.0], [150.0, 195.0, 390.0]])
def test_far_from_unusual_motions_nothing_is_lost(at_s: list[float]) -> None:
    """Steps of both sides and an outlier, as in a search of the whole run."""
    flight = simulate(seed=3, duration_s=400.0)
    both = [flight.groundtruth, flight.estimate]
    first_s = flight.estimate.stamps[0] / NANOSECONDS
    for number, time_s in zip([1, 0, 1], at_s, strict=False):
        span = first_s + time_s, first_s + time_s + 0.5 if number == 0 else np.inf
        both[number] = changed(both[number], *span, lambda rows: rows + [0.6, 0.8, 0.0])
    evaluation = evaluate(*both, Protocol(gauge="se3", lengths=()))
    times = unusual_around(evaluation, *both)
    assert times is not None
    assert 0 < len(times) < 10 * len(at_s)
    events, near = discontinuities(*both), discontinuities(*both, 0, times)
    assert [(event.kind, event.side, event.end_ns) for event in near] == [
        (event.kind, event.side, event.end_ns) for event in events
    ]
    # The rotation and scale of the frames are learned from nearly the same pairs.
    assert [event.m for event in near] == pytest.approx([event.m for event in events], rel=1e-3)
    assert len(events) == len(at_s)


@pytest.mark.parametrize("seed", range(3))
def test_healthy_runs_need_no_search(seed: int) -> None:
    assert not screened(*sides(seed))
    flight = simulate(seed=seed, duration_s=60.0)
    assert not screened(flight.groundtruth, flight.estimate)


@pytest.mark.parametrize("seed", range(6))
def test_motions_that_differ_smoothly_need_no_search(seed: int) -> None:
    """Neither side changes its velocity suddenly, so that the search exonerates both."""
    groundtruth, estimate = sides(seed)
    flat = estimate.positions * [1.0, 1.0, 0.0]
    wrong = dataclasses.replace(estimate, positions=flat)
    assert not screened(groundtruth, wrong)
    assert not discontinuities(groundtruth, wrong)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("until_s", [AT_S + 0.05, AT_S + 5.0, DURATION_S])
@pytest.mark.parametrize("size_m", [0.2, 2.0])
def test_runs_with_steps_and_outliers_are_searched(
    seed: int, number: int, until_s: float, size_m: float
) -> None:
    both = list(sides(seed))
    both[number] = changed(both[number], AT_S, until_s, lambda rows: rows + [size_m, 0.0, 0.0])
    assert screened(*both)


@pytest.mark.parametrize("number", [0, 1])
def test_runs_with_flips_freezes_and_clock_steps_are_searched(number: int) -> None:
    both = list(sides(1))
    rows = inside(both[number], AT_S, AT_S + 3.0)
    side = both[number]
    quaternions, positions, stamps = (
        array.copy() for array in (side.quaternions, side.positions, side.stamps)
    )
    quaternions[rows] = lie.multiply(quaternions[rows], HALF_ROTATION[None])
    positions[rows] = positions[rows.start]
    stamps[rows.start :] += 1_000_000_000
    for changes in ({"quaternions": quaternions}, {"positions": positions}, {"stamps": stamps}):
        both[number] = dataclasses.replace(side, **changes)
        assert screened(*both)


def test_a_timestamp_centuries_away_adds_no_blocks() -> None:
    groundtruth, estimate = sides(1)
    stamps = estimate.stamps.copy()
    stamps[-1] += 9_000_000_000 * NANOSECONDS
    assert isinstance(
        discontinuities(groundtruth, dataclasses.replace(estimate, stamps=stamps)), list
    )


def test_a_groundtruth_of_two_poses_is_searched() -> None:
    stamps = np.array([0, 400_000_000])
    groundtruth = Trajectory(stamps, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    positions = np.linspace([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 600)
    estimate = Trajectory(np.linspace(0, 4e8, 600).astype(np.int64), positions)
    assert discontinuities(groundtruth, estimate, unusual=stamps[1:]) == []
