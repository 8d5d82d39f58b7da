"""Discontinuities of one stream alone: kind, time and size, equal for batches of any size."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros import read_trajectory, simulate
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.discontinuities.events import SIDES, Event
from trajeval_ros.metrics.discontinuities.one_stream import KnownEvent, OneStream
from trajeval_ros.metrics.discontinuities.recorded import stream_discontinuities

DATA = Path(__file__).parents[3] / "shared/data"
AT_S, END_S = 40.0, np.inf
HALF_ROTATION = np.array([1.0, 0.0, 0.0, 0.0])


@cache
def flights(seed: int) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth and estimate of a healthy simulated flight, without a gap."""
    flight = simulate(seed=seed, duration_s=80.0)
    return flight.groundtruth, flight.estimate


def inside(trajectory: Trajectory, begin_s: float, end_s: float) -> slice:
    seconds = trajectory.seconds
    return slice(int(np.searchsorted(seconds, begin_s)), int(np.searchsorted(seconds, end_s)))


def moved(
    trajectory: Trajectory, begin_s: float, end_s: float, change: Callable[[Floats], Floats]
) -> Trajectory:
    """Return a trajectory with other positions within a time."""
    rows, positions = inside(trajectory, begin_s, end_s), trajectory.positions.copy()
    positions[rows] = change(positions[rows])
    return dataclasses.replace(trajectory, positions=positions)


def flipped(trajectory: Trajectory, begin_s: float, end_s: float) -> Trajectory:
    """Return a trajectory whose body is rotated by 180 deg within a time."""
    rows, quaternions = inside(trajectory, begin_s, end_s), trajectory.known_quaternions.copy()
    quaternions[rows] = lie.multiply(quaternions[rows], HALF_ROTATION[None])
    return dataclasses.replace(trajectory, quaternions=quaternions)


def events_of(trajectory: Trajectory, side: str = "estimate") -> list[Event]:
    """Return the events without gaps, of which a simulated flight has one."""
    return [event for event in stream_discontinuities(trajectory, side) if event.kind != "gap"]


def only(events: list[Event]) -> Event:
    assert len(events) == 1, events
    return events[0]


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("seed", [911, 912, 913])
def test_a_healthy_flight_has_only_its_gap(seed: int, number: int) -> None:
    trajectory = flights(seed)[number]
    assert events_of(trajectory, SIDES[number]) == []
    gaps = stream_discontinuities(trajectory, SIDES[number])
    longest_s = float(np.diff(trajectory.seconds).max())
    assert [event.s for event in gaps] == [pytest.approx(longest_s)] * number


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize(
    ("size_m", "until_s", "kind"),
    [(0.3, END_S, "step"), (0.5, AT_S + 0.2, "outlier"), (3.0, AT_S + 9.0, "outlier")],
)
def test_steps_stay_and_outliers_return(
    number: int, size_m: float, until_s: float, kind: str
) -> None:
    trajectory = flights(911)[number]
    rows = inside(trajectory, AT_S, until_s)
    jumped = moved(trajectory, AT_S, until_s, lambda item: item + size_m * np.array([0.6, 0.8, 0]))
    event = only(events_of(jumped, SIDES[number]))
    assert (event.kind, event.side) == (kind, SIDES[number])
    assert event.m == pytest.approx(size_m, abs=0.1)
    assert event.t_ns == trajectory.stamps[rows.start - 1]
    if kind == "step":
        assert event.end_ns == trajectory.stamps[rows.start]
    else:
        assert event.end_ns == trajectory.stamps[rows.stop]
        outside = trajectory.stamps[rows]
        assert event.s == pytest.approx((outside[-1] - outside[0]) / NANOSECONDS)


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("poses", [1, 2, 40])
def test_a_flip_returns(number: int, poses: int) -> None:
    """One pose alone rotates out and back like a constant rate of 180 deg per period."""
    trajectory = flights(912)[number]
    begin_s, *_, end_s = trajectory.seconds[inside(trajectory, AT_S, END_S)][: poses + 1]
    event = only(events_of(flipped(trajectory, begin_s, end_s), SIDES[number]))
    assert (event.kind, event.m) == ("flip", 0.0)
    assert event.deg == pytest.approx(180.0, abs=5.0)
    stays = only(events_of(flipped(trajectory, AT_S, END_S), SIDES[number]))
    assert stays.kind == "flip_stays"


def test_only_an_estimate_restarts() -> None:
    estimate = flights(913)[1]
    again = moved(estimate, AT_S, END_S, lambda item: item - item[0] + estimate.positions[0])
    assert only(events_of(again)).kind == "restart"
    assert only(events_of(again, "groundtruth")).kind == "step"


@pytest.mark.parametrize("kind", ["frozen_position", "frozen_rotation"])
def test_a_part_that_repeats_after_an_abrupt_stop_is_frozen(kind: str) -> None:
    estimate = flights(911)[1]
    rows = inside(estimate, AT_S, AT_S + 5.0)
    positions, quaternions = estimate.positions.copy(), estimate.known_quaternions.copy()
    values = positions if kind == "frozen_position" else quaternions
    values[rows] = values[rows.start]
    held = dataclasses.replace(estimate, positions=positions, quaternions=quaternions)
    event = next(item for item in events_of(held) if item.kind.startswith("frozen"))
    assert event.kind == kind
    assert event.t_ns == estimate.stamps[rows.start]
    assert event.s == pytest.approx(5.0, abs=0.1)


def test_a_robot_that_brakes_and_rests_is_not_frozen() -> None:
    stamps = np.arange(0, 60 * NANOSECONDS, NANOSECONDS // 20)
    seconds = stamps / NANOSECONDS
    speed = np.clip(0.5 * np.minimum(seconds % 20.0, 12.0 - seconds % 20.0), 0.0, 1.0)
    positions = np.cumsum(speed)[:, None] / 20.0 * [1.0, 0.0, 0.0]
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
    assert stream_discontinuities(Trajectory(stamps, positions, upright), "estimate") == []


def test_a_quantised_encoder_in_stop_and_go_has_no_event() -> None:
    """A step below the resolution of the poses repeats the pose before."""
    stamps = np.arange(0, 300 * NANOSECONDS, NANOSECONDS // 50)
    seconds = stamps / NANOSECONDS
    speed = np.clip(np.minimum(seconds % 15.0, 9.0 - seconds % 15.0), 0.0, 0.4)
    path = np.floor(np.cumsum(speed) / 50.0 / 0.002) * 0.002
    yaw = np.floor(0.6 * np.sin(seconds / 9.0) / 0.004) * 0.004
    along = np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1)
    positions = np.cumsum(np.diff(path, prepend=0.0)[:, None] * along, axis=0)
    quaternions = lie.from_rotation_vector(np.outer(yaw, [0.0, 0.0, 1.0]))
    assert stream_discontinuities(Trajectory(stamps, positions, quaternions), "estimate") == []


def stop_and_go(seed: int, resolution: float) -> Trajectory:
    """Return poses of a robot that drives and rests by turns, as multiples of a resolution (m)."""
    random, stamps = np.random.default_rng(seed), np.arange(0, 300 * NANOSECONDS, 20_000_000)
    speed, rate = np.zeros((2, len(stamps)))
    begin = 0
    while begin < len(stamps):
        drives = int(50.0 * random.uniform(3.0, 25.0))
        row = np.arange(begin, min(begin + drives, len(stamps)))
        ramp = np.minimum(np.minimum(row - begin, begin + drives - row) / 50.0, 1.0)
        speed[row], rate[row] = random.uniform([0.05, -0.4], [0.6, 0.4])[:, None] * ramp
        begin += drives + int(50.0 * random.uniform(1.0, 15.0))
    heading = np.cumsum(rate) / 50.0
    along = np.stack([np.cos(heading), np.sin(heading), 0.0 * heading], axis=1)
    positions = np.cumsum(speed[:, None] * along, axis=0) / 50.0
    heading = np.round(heading / 0.002) * 0.002
    quaternions = lie.from_rotation_vector(np.outer(heading, [0.0, 0.0, 1.0]))
    return Trajectory(stamps, np.round(positions / resolution) * resolution, quaternions)


@pytest.mark.parametrize("resolution", [0.001, 0.005, 0.01])
@pytest.mark.parametrize("seed", range(3))
def test_rests_of_coarse_positions_are_not_frozen(seed: int, resolution: float) -> None:
    coarse = stop_and_go(seed, resolution)
    assert stream_discontinuities(coarse, "estimate") == []
    speed = np.linalg.norm(coarse.positions[50:] - coarse.positions[:-50], axis=1)
    begin = 2000 + int(np.argmin(np.abs(speed[2000:-100] - 0.35)))
    rows = np.arange(begin + 25, begin + 125)
    positions = coarse.positions.copy()
    positions[rows] = positions[rows[0]]
    held = stream_discontinuities(dataclasses.replace(coarse, positions=positions), "estimate")
    assert "frozen_position" in [event.kind for event in held]


@pytest.mark.parametrize("step_s", [-10.017, -0.15, 0.417, 3.017])
def test_a_clock_step_is_measured_by_receive_times(step_s: float) -> None:
    groundtruth, rng = flights(914)[0][::5], np.random.default_rng(914)
    delays = rng.exponential(0.003, len(groundtruth)) * NANOSECONDS
    received = np.maximum.accumulate(groundtruth.stamps + delays.astype(np.int64))
    stamps = groundtruth.stamps.copy()
    stamps[inside(groundtruth, AT_S, END_S)] += round(step_s * NANOSECONDS)
    reading = SourceInfo(receive_times=ReceiveTimes(received))
    stepped = dataclasses.replace(groundtruth, stamps=stamps, reading=reading)
    event = only(stream_discontinuities(stepped, "groundtruth"))
    assert (event.kind, event.certainty) == ("clock_step", "sure")
    assert event.s == pytest.approx(step_s, abs=0.01)


@cache
def faulty() -> Trajectory:
    """Return an estimate with a step, an outlier, a long excursion, a flip and a freeze."""
    estimate = flights(915)[1]
    for begin_s, end_s in ((20.0, END_S), (30.0, 30.1), (35.0, 45.0)):
        estimate = moved(estimate, begin_s, end_s, lambda item: item + [0.4, 0.0, 1.0])
    estimate = flipped(estimate, 50.0, 50.2)
    return moved(estimate, 60.0, 64.0, lambda item: 0.0 * item + item[0])


def fed(trajectory: Trajectory, ends: list[int]) -> tuple[list[Event], list[KnownEvent]]:
    stream, known, begin = OneStream(), [], 0
    poses = np.hstack([trajectory.positions, trajectory.known_quaternions])
    for end in [*ends, len(trajectory)]:
        known += stream.add(trajectory.stamps[begin:end], poses[begin:end])
        begin = end
    return stream.finish(), known


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(1, 1500), max_size=40, unique=True).map(sorted))
def test_events_do_not_depend_on_the_batches(ends: list[int]) -> None:
    whole, known = fed(faulty(), [])
    kinds = {event.kind for event in whole}
    assert kinds >= {"step", "outlier", "flip", "frozen_position", "gap"}
    events, at = fed(faulty(), ends)
    # Events that a later return removes were known before it.
    assert {item.known_ns for item in known} <= {item.known_ns for item in at}
    assert len(events) == len(whole)
    for event, same in zip(events, whole, strict=True):
        assert (event.kind, event.t_ns, event.end_ns) == (same.kind, same.t_ns, same.end_ns)
        for name in ("m", "deg", "s", "ratio"):
            assert getattr(event, name) == pytest.approx(getattr(same, name), rel=1e-6, abs=1e-9)


def test_a_step_is_known_with_the_next_pose() -> None:
    estimate = flights(911)[1]
    jumped = moved(estimate, AT_S, END_S, lambda item: item + 1.0)
    row = inside(jumped, AT_S, END_S).start
    _, known = fed(jumped, list(range(row - 20, row + 20)))
    at = [item.known_ns for item in known if item.event.kind == "step"]
    assert at == [estimate.stamps[row + 1]]


@pytest.mark.slow
def test_the_memory_is_that_of_a_minute() -> None:
    groundtruth = simulate(seed=3, duration_s=400.0).groundtruth
    stream = OneStream("groundtruth")
    poses = np.hstack([groundtruth.positions, groundtruth.known_quaternions])
    for begin in range(0, len(groundtruth), 500):
        stream.add(groundtruth.stamps[begin : begin + 500], poses[begin : begin + 500])
        assert len(pickle.dumps(stream)) < 2_000_000  # half of the recording


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("field_cases/attack/g_one_outlier.txt", [("outlier", 59.95, 30.0)]),
        ("field_cases/attack/e_frozen_position.txt", [("frozen_position", 80.0, 0.0)]),
        ("field_cases/bags/flip_one:/mocap/pose", [("flip", 14.99, 0.0)]),
        ("field_cases/bags/gt_swap:/ft_gt_swap/mocap/pose", [("flip_stays", 14.99, 0.0)]),
        ("field_cases/bags/restart_gap_0.4s.txt", [("restart", 74.55, 6.08)]),
        ("euroc/groundtruth/MH_05.txt", [("step", 79.35, 0.053)]),
        # A car whose speed changes by 2 m/s within one period, where interpolation ends.
        ("kitti/KITTI_00_gt.txt", [("step", 308.91, 0.219)]),
        # 10 m from the path for 0.3 s and for one pose.
        ("hilti_2021/uzh_run2_mocap.txt", [("outlier", 23.51, 10.08), ("outlier", 24.97, 10.42)]),
        ("euroc/groundtruth/MH_01.txt", []),
        ("euroc/groundtruth/V2_03.txt", []),
        ("tum/fr2_desk_groundtruth.txt", []),
        ("gnss/husky_outdoor.bag", []),
        ("hilti_2021/Campus_2_prism.txt", []),
        ("groundtruth_doctor/V1_01_corrected/groundtruth.txt.gz", []),
        ("groundtruth_doctor/V1_01_original/groundtruth.txt.gz", []),
        ("groundtruth_doctor/mocap2gt/groundtruth.txt.gz", []),
        ("field_cases/slow_groundtruth/rtk.txt", []),
    ],
)
def test_recordings_have_the_events_that_their_columns_show(
    source: str, expected: list[tuple[str, float, float]]
) -> None:
    if not DATA.exists():
        pytest.skip("the recordings are absent")
    trajectory = read_trajectory(str(DATA / source))
    events = events_of(trajectory)
    first = int(trajectory.stamps.min())
    assert [event.kind for event in events] == [kind for kind, _, _ in expected]
    for event, (_, begin_s, m) in zip(events, expected, strict=True):
        assert (event.t_ns - first) / NANOSECONDS == pytest.approx(begin_s, abs=0.01)
        assert event.m == pytest.approx(m, rel=0.02)
