"""The live evaluator: equal to the offline one, in any order of arrival."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_feeding import SECOND, assert_live_is_offline, feed, make_pair, rows_of
from state_rows import states, trajectory
from strategies import gauges, make_groundtruth, seeds

from trajeval_ros import Gauge, Protocol, Trajectory, evaluate
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.protocol import PROTOCOLS
from trajeval_ros.metrics.sub_trajectories import Length, Selection
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.online.window import Window

# Recordings with and without a delay of the estimate.
RECORDINGS = [
    ("euroc/groundtruth/MH_01.txt", "euroc/vio_mono/MH_01.txt", Gauge.YAW, "z", 0.3),
    ("euroc/groundtruth/V1_02_asl.csv", "euroc/V1_02_estimate.txt", Gauge.SE3, "z", 0.0),
    ("tum/fr2_desk_groundtruth.txt", "tum/fr2_desk_ORB.txt", Gauge.SIM3, "z", 0.3),
    ("bags/ROS_example.bag:groundtruth", "bags/ROS_example.bag:ORB-SLAM", Gauge.SE3, "-y", 0.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("groundtruth", "estimate", "gauge", "axis", "delay_s"), RECORDINGS)
def test_live_is_offline_on_recordings(
    recording: Callable[[str], Trajectory],
    groundtruth: str,
    estimate: str,
    gauge: Gauge,
    axis: str,
    delay_s: float,
) -> None:
    protocol = Protocol(gauge=gauge)
    evaluator = OnlineEvaluator(OnlineSettings(protocol, up=(axis, axis)))
    sides = [
        dataclasses.replace(recording(item), up=UpAxis(axis)) for item in (groundtruth, estimate)
    ]
    feed(evaluator, *sides, delay_s=delay_s, drain_s=0.25)
    offline = evaluate(*sides, protocol)
    assert_live_is_offline(evaluator, offline)
    assert offline.relative
    for segment in offline.relative:
        live = evaluator.snapshot().relative[str(segment.length)]
        assert live.count == len(segment.errors.ends)
        if live.count and not gauge.has_scale:
            mean = segment.statistics["position_m"]
            assert mean is not None
            assert live.position_m == pytest.approx(mean.mean, rel=1e-9)


@pytest.mark.slow
@settings(max_examples=10)
@given(seed=seeds, gauge=gauges)
def test_live_is_offline(seed: int, gauge: Gauge) -> None:
    groundtruth, estimate = make_pair(seed, 300)
    protocol = Protocol(gauge=gauge, lengths=("3m", "2s", "7f"), align_states=None)
    evaluator = OnlineEvaluator(OnlineSettings(protocol))
    feed(evaluator, groundtruth, estimate, drain_s=0.37)
    assert_live_is_offline(evaluator, evaluate(groundtruth, estimate, protocol), 1e-8)


def feed_in_batches(
    evaluator: OnlineEvaluator, groundtruth: Trajectory, estimate: Trajectory, size: int
) -> None:
    """Feed both streams in order of their stamps, so many messages between two updates."""
    stamps = np.concatenate([groundtruth.stamps, estimate.stamps])
    order = np.argsort(stamps, kind="stable")
    groundtruth_rows, estimate_rows = rows_of(groundtruth), rows_of(estimate)
    for begin in range(0, len(order), size):
        batch = order[begin : begin + size]
        g, e = batch[batch < len(groundtruth)], batch[batch >= len(groundtruth)] - len(groundtruth)
        evaluator.add_groundtruth(trajectory(groundtruth.stamps[g], groundtruth_rows[g]))
        evaluator.add_estimate(trajectory(estimate.stamps[e], estimate_rows[e]))
        evaluator.update()
    evaluator.update(at_end=True)


def numbers_of(thing: object) -> Iterator[float | str | None]:
    """Yield all that a snapshot says, number by number, names before what they name."""
    if dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        thing = {field.name: getattr(thing, field.name) for field in dataclasses.fields(thing)}
    if isinstance(thing, dict):
        for name in sorted(thing):
            yield name
            yield from numbers_of(thing[name])
    elif isinstance(thing, np.ndarray):
        yield from thing.ravel().tolist()
    else:
        assert thing is None or isinstance(thing, int | float | str)
        yield thing


@pytest.mark.slow
@settings(max_examples=10)
@given(seed=seeds, frames=st.integers(1, 40))
def test_frames_are_counted_live_as_offline(seed: int, frames: int) -> None:
    groundtruth, estimate = make_pair(seed, 200)
    protocol = Protocol(lengths=(Length(frames, "f"),))
    evaluator = OnlineEvaluator(OnlineSettings(protocol))
    feed(evaluator, groundtruth, estimate, drain_s=0.37)
    live = evaluator.snapshot().relative[f"{frames}f"]
    (segment,) = evaluate(groundtruth, estimate, protocol).relative or ()
    assert live.count == len(segment.errors.ends) > 0
    position, rotation = (segment.statistics[name] for name in ("position_m", "rotation_deg"))
    assert position is not None
    assert rotation is not None
    assert live.position_m == pytest.approx(position.mean, rel=1e-9)
    assert live.rotation_deg == pytest.approx(rotation.mean, rel=1e-9)


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"lengths": "5deg"}, "degrees"),
        ({"lengths": "0.1rad"}, "degrees"),
        ({"selection": Selection(pairs="consecutive")}, "consecutive"),
        ({"selection": "first-past"}, "selection first-past, every 1 is not supported live"),
        ({"selection": Selection(every=10)}, "selection nearest, every 10 is not supported live"),
        ({"selection": Selection(path="estimate")}, "along the estimate is not supported live"),
        ({"gauge": "sim3", "apply": "scale"}, "scale"),
    ],
)
def test_what_only_a_recording_shows_is_refused(settings: dict[str, Any], what: str) -> None:
    with pytest.raises(SettingsError, match=what):
        OnlineSettings(Protocol(**settings))


@pytest.mark.slow
@settings(max_examples=4)
@given(seed=seeds)
@pytest.mark.parametrize(
    ("gauge", "window"),
    [(Gauge.YAW, "0"), (Gauge.SE3, "5s"), (Gauge.YAW, "4m"), (Gauge.SE3, "37")],
)
def test_batches_of_any_size_give_the_same_snapshot(seed: int, gauge: Gauge, window: str) -> None:
    groundtruth, estimate = make_pair(seed, 300)
    protocol = Protocol(gauge=gauge, lengths=(Length(3, "m"), Length(8, "m"), Length(2, "s")))
    message = []
    for size in (1, 24, 10_000):
        evaluator = OnlineEvaluator(OnlineSettings(protocol, Window.parse(window)))
        feed_in_batches(evaluator, groundtruth, estimate, size)
        message.append(list(numbers_of(evaluator.snapshot())))
    assert len(message[1:]) > 0
    for others in message[1:]:
        for mine, other in zip(message[0], others, strict=True):
            if isinstance(mine, float):
                assert other == pytest.approx(mine, rel=1e-9, abs=1e-11)
            else:
                assert other == mine


def in_order_of_arrival(
    evaluator: OnlineEvaluator, sides: tuple[Trajectory, Trajectory], arrivals: list[Any]
) -> None:
    """Play both sides by their times of arrival, seconds, with ticks of 40 ms."""
    orders = [np.argsort(times, kind="stable") for times in arrivals]
    ticks = np.arange(0.0, max(float(times.max()) for times in arrivals) + 0.08, 0.04)
    cuts = [np.searchsorted(np.sort(times), ticks) for times in arrivals]
    for tick in range(1, len(ticks)):
        for side, add, order, cut in zip(
            sides, (evaluator.add_groundtruth, evaluator.add_estimate), orders, cuts, strict=True
        ):
            rows = order[cut[tick - 1] : cut[tick]]
            if len(rows):
                add(side[rows])
        evaluator.update()
        if tick % 10 == 0:
            evaluator.snapshot()
    evaluator.update(at_end=True)


@pytest.mark.slow
@settings(max_examples=10)
@given(
    seed=seeds,
    gauge=st.sampled_from([Gauge.YAW, Gauge.SE3]),
    late_s=st.sampled_from([0.0, 0.15, 2.0]),
    jitter_s=st.sampled_from([0.0, 0.15, 0.6]),
    burst_s=st.sampled_from([0.0, 1.0]),
)
def test_late_disordered_and_bursty_estimates_give_the_errors_of_the_recording(
    seed: int, gauge: Gauge, late_s: float, jitter_s: float, burst_s: float
) -> None:
    groundtruth, estimate = make_pair(seed, 300)
    protocol = Protocol(gauge=gauge, lengths=("3m", "2s"))
    evaluator = OnlineEvaluator(OnlineSettings(protocol, Window.parse("5s")))
    begin = min(groundtruth.stamps[0], estimate.stamps[0])
    known, sent = ((side.stamps - begin) / SECOND for side in (groundtruth, estimate))
    sent = sent + late_s + jitter_s * np.random.default_rng(seed).random(len(sent))
    arrivals = [
        np.ceil(times / burst_s) * burst_s if burst_s else times for times in (known, sent)
    ]
    in_order_of_arrival(evaluator, (groundtruth, estimate), arrivals)
    offline, live = evaluate(groundtruth, estimate, protocol), evaluator.snapshot()
    assert live.pairs == len(offline.association)
    assert live.dropped == offline.association.dropped
    position = offline.ate["position_m"]
    assert position is not None
    assert live.position_rmse_m == pytest.approx(position.rmse, rel=1e-12)
    if jitter_s:
        return  # coverage and relative errors so far leave out what is late
    assert live.coverage == offline.association.coverage
    for segment in offline.relative or ():
        running, mean = live.relative[str(segment.length)], segment.statistics["position_m"]
        assert running.count == segment.count
        if mean is not None:
            assert running.position_m == pytest.approx(mean.mean, rel=1e-12)


def test_a_part_of_a_trajectory_does_not_count_what_the_whole_dropped() -> None:
    groundtruth, estimate = make_pair(3, 60)
    positions = estimate.positions.copy()
    positions[7] = np.nan
    read = Trajectory.from_columns(estimate.stamps, positions, estimate.quaternions)
    evaluator = OnlineEvaluator()
    evaluator.add_groundtruth(groundtruth)
    for begin in range(0, len(read), 10):
        evaluator.add_estimate(read[begin : begin + 10])
    evaluator.update(at_end=True)
    assert "not_finite" not in evaluator.snapshot().dropped


@pytest.mark.slow
@settings(max_examples=10)
@given(seed=seeds)
def test_order_of_arrival_within_the_buffer_changes_no_pair(seed: int) -> None:
    random = np.random.default_rng(seed)
    groundtruth, estimate = make_pair(seed, 200)
    evaluator = OnlineEvaluator(OnlineSettings(limits=BufferLimits(past_s=1e3)))
    for source, add in (
        (groundtruth, evaluator.add_groundtruth),
        (estimate, evaluator.add_estimate),
    ):
        # All of it, in shuffled pieces, some of them twice.
        order = random.permutation(len(source))
        rows = rows_of(source)
        for piece in np.array_split(np.concatenate([order, order[:20]]), 7):
            add(trajectory(source.stamps[piece], rows[piece]))
    evaluator.update(at_end=True)
    expected = evaluate(groundtruth, estimate, PROTOCOLS["default"]).association
    pairs = evaluator.association()
    np.testing.assert_array_equal(pairs.estimate.stamps, expected.estimate.stamps)
    np.testing.assert_allclose(pairs.groundtruth.positions, expected.groundtruth.positions)
    assert pairs.dropped.pop("duplicate_stamp") == 20
    assert pairs.dropped == expected.dropped


def test_groundtruth_that_starts_late_ends_early_or_pauses_is_never_made_up() -> None:
    stamps = (np.arange(400) * SECOND // 20).astype(np.int64)
    path = np.column_stack([np.cos(stamps / SECOND), np.sin(stamps / SECOND), np.zeros(400)])
    keep = ((stamps > 3 * SECOND) & (stamps < 8 * SECOND)) | (
        (stamps > 10 * SECOND) & (stamps < 15 * SECOND)
    )
    linear = Protocol(gauge=Gauge.YAW, association="linear")
    evaluator = OnlineEvaluator(OnlineSettings(linear))
    evaluator.add_estimate(trajectory(stamps + 1, states(path)))
    evaluator.update()
    evaluator.add_groundtruth(trajectory(stamps[keep], states(path[keep])))
    evaluator.update(at_end=True)
    groundtruth, estimate = Trajectory(stamps[keep], path[keep]), Trajectory(stamps + 1, path)
    expected = evaluate(groundtruth, estimate, linear).association
    assert evaluator.association().dropped == expected.dropped
    assert set(expected.dropped) == {
        "before_groundtruth", "after_groundtruth", "in_groundtruth_gap",
    }  # fmt: skip


@pytest.mark.slow
def test_a_bag_that_is_played_twice_has_the_groundtruth_of_one() -> None:
    buffer = Pairing()
    stamps = (np.arange(3000) * SECOND // 50).astype(np.int64)
    rows = states(np.column_stack([0.02 * np.arange(3000), np.zeros((3000, 2))]))
    told = []
    for _ in range(2):
        for part in np.array_split(np.arange(3000), 600):
            buffer.add_groundtruth(trajectory(stamps[part], rows[part]))
            buffer.add_estimate(trajectory(stamps[part], rows[part]))
            buffer.made()
            buffer.forget()
        told.append((buffer.groundtruth_path_m, buffer.groundtruth_time, buffer.groundtruth_count))
    assert told[0] == (pytest.approx(59.98), int(stamps[-1]), 3000)
    assert told[1] == told[0]
    again = buffer.groundtruth_counts.dropped
    assert again["too_late"] + again["duplicate_stamp"] == 3000
    assert sum(buffer.dropped.values()) == 3000


def test_a_late_groundtruth_state_adds_no_path() -> None:
    buffer = Pairing(limits=BufferLimits(past_s=1.0))
    stamps = (np.arange(500) * SECOND // 50).astype(np.int64)
    rows = states(np.column_stack([0.02 * np.arange(500), np.zeros((500, 2))]))
    buffer.add_groundtruth(trajectory(stamps, rows))
    buffer.made()
    buffer.forget()
    buffer.add_groundtruth(trajectory(stamps[:400] + 1, rows[:400]))
    buffer.made()
    buffer.forget()
    assert buffer.groundtruth_path_m == pytest.approx(0.02 * 499)
    assert buffer.groundtruth_time == stamps[-1]
    assert buffer.groundtruth_counts.dropped == {"too_late": 400}


def test_a_groundtruth_state_that_comes_after_its_use_is_counted_and_kept() -> None:
    buffer = Pairing(AssociationRule(max_gap_s=5.0))
    for groundtruth_s in ([0.0, 1.0, 3.0, 4.0], [2.0], [2.5], [3.5]):
        stamps = (SECOND * np.array(groundtruth_s)).astype(np.int64)
        buffer.add_groundtruth(trajectory(stamps, states(np.zeros((len(stamps), 3)))))
        buffer.add_estimate(trajectory(np.array([5 * SECOND // 2]), states(np.zeros((1, 3)))))
        buffer.made()
    assert buffer.groundtruth_counts.dropped == {"after_use": 2}
    assert buffer.groundtruth_count == 7
    assert buffer.dropped == {"duplicate_stamp": 3}


@pytest.mark.slow
def test_a_frozen_alignment_waits_until_it_is_determined_and_then_stays() -> None:
    groundtruth = make_groundtruth(9, 800)
    drift = np.cumsum(np.random.default_rng(0).normal(scale=1e-3, size=(800, 3)), axis=0)
    estimate = dataclasses.replace(groundtruth, positions=groundtruth.positions + drift)
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge=Gauge.YAW), freeze=True))
    half = len(estimate) // 2
    feed(evaluator, groundtruth, estimate[:half])
    frozen = evaluator.snapshot()
    assert frozen.alignment is not None
    assert frozen.warming_up == ""
    assert frozen.alignment.states_used < half
    later = OnlineEvaluator(OnlineSettings(Protocol(gauge=Gauge.YAW), freeze=True))
    feed(later, groundtruth, estimate)
    np.testing.assert_array_equal(
        later.snapshot().alignment.similarity.rotation,  # type: ignore[union-attr]
        frozen.alignment.similarity.rotation,
    )


def test_standing_still_is_warming_up() -> None:
    stamps = (np.arange(100) * SECOND // 20).astype(np.int64)
    still = np.random.default_rng(0).normal(scale=1e-3, size=(100, 3))
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge=Gauge.SE3), freeze=True))
    evaluator.add_groundtruth(trajectory(stamps, states(np.zeros((100, 3)))))
    evaluator.add_estimate(trajectory(stamps, states(still)))
    evaluator.update()
    assert "do not determine" in evaluator.snapshot().warming_up


@pytest.mark.parametrize("first", [1, 40])
def test_alignment_by_the_first_states_is_that_of_offline(first: int) -> None:
    groundtruth, estimate = make_pair(21, 400)
    protocol = Protocol(gauge=Gauge.YAW, align_states=first, lengths=())
    evaluator = OnlineEvaluator(OnlineSettings(protocol))
    feed(evaluator, groundtruth, estimate)
    assert_live_is_offline(evaluator, evaluate(groundtruth, estimate, protocol))


def test_what_cannot_be_live_is_refused_with_the_reason() -> None:
    with pytest.raises(SettingsError, match="linear"):
        OnlineSettings(PROTOCOLS["evo"])
    with pytest.raises(SettingsError, match="frozen"):
        OnlineSettings(Protocol(align_states=5), freeze=True)
    with pytest.raises(SettingsError, match="whole run"):
        OnlineEvaluator(OnlineSettings(window=Window.parse("5s"))).association()
    for text in ("", "-5s", "5 km", "5s5"):
        with pytest.raises(SettingsError, match="is not valid"):
            Window.parse(text)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_a_velocity_that_is_none_leaves_the_pose(value: float) -> None:
    groundtruth, estimate = make_pair(3, 60)
    assert estimate.velocities is not None
    velocities = estimate.velocities.copy()
    velocities[20, 1] = value
    evaluator = OnlineEvaluator()
    columns = estimate.stamps, estimate.positions, estimate.quaternions
    wild = Trajectory.from_columns(*columns, velocities=velocities)
    feed(evaluator, groundtruth, wild)
    ate = evaluator.snapshot().ate
    assert ate["velocity_mps"] is None
    expected = evaluate(groundtruth, dataclasses.replace(estimate, velocities=None))
    assert ate["position_m"] is not None
    assert expected.ate["position_m"] is not None
    assert ate["position_m"].count == expected.ate["position_m"].count
    assert ate["position_m"].rmse == pytest.approx(expected.ate["position_m"].rmse)


@pytest.mark.parametrize("column", ["positions", "velocities"])
def test_blocks_with_numbers_that_are_not_finite_are_refused(column: str) -> None:
    groundtruth, _ = make_pair(3, 60)
    numbers = getattr(groundtruth, column).copy()
    numbers[20, 1] = np.nan
    wild = dataclasses.replace(groundtruth, **{column: numbers})
    for add in (OnlineEvaluator().add_groundtruth, OnlineEvaluator().add_estimate):
        with pytest.raises(InputError, match=f"{column} that are not finite.*from_columns"):
            add(wild)


def test_live_lengths_in_seconds_end_where_offline_ones_do() -> None:
    """Two states can be equally far from the end; rounding of the seconds decided before."""
    random = np.random.default_rng(5)
    stamps = 50_000_000 * np.cumsum(random.choice([6, 8, 10, 14], size=300)).astype(np.int64)
    truth = dataclasses.replace(make_pair(5, 300)[0], stamps=stamps)
    protocol = Protocol(gauge=Gauge.NONE, lengths=("2.5s",))
    evaluator = OnlineEvaluator(OnlineSettings(protocol))
    moved = dataclasses.replace(truth, positions=truth.positions + random.normal(size=(300, 3)))
    feed(evaluator, truth, moved, drain_s=1.7)
    (segment,) = evaluate(truth, moved, protocol).relative or ()
    live = evaluator.snapshot().relative["2.5s"]
    mean = segment.statistics["position_m"]
    assert mean is not None
    assert live.count == mean.count > 50
    assert live.position_m == pytest.approx(mean.mean, rel=1e-9)


def test_the_last_pair_ends_sub_trajectories_if_no_other_follows() -> None:
    """Straight along x, 1 m per pair; the last pair is at 4.9 m, as near to 5 m as any."""
    truth, _ = make_pair(5, 6)
    places = np.outer([0.0, 1.0, 2.0, 3.0, 4.0, 4.9], [1.0, 0.0, 0.0])
    truth = dataclasses.replace(truth, positions=places)
    protocol = Protocol(gauge=Gauge.NONE, lengths=("5m", "2m"))
    evaluator = OnlineEvaluator(OnlineSettings(protocol))
    evaluator.add_groundtruth(trajectory(truth.stamps, rows_of(truth)))
    evaluator.add_estimate(trajectory(truth.stamps, rows_of(truth)))
    evaluator.update()
    counts = {key: item.count for key, item in evaluator.snapshot().relative.items()}
    evaluator.update(at_end=True)
    at_end = {key: item.count for key, item in evaluator.snapshot().relative.items()}
    offline = evaluate(truth, truth, protocol).relative or ()
    assert at_end == {str(item.length): len(item.errors.ends) for item in offline}
    assert (counts, at_end) == ({"5m": 0, "2m": 3}, {"5m": 1, "2m": 4})
