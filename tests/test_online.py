"""The live evaluator: equal to the offline one, in bounded memory, in any order of arrival."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from strategies import gauges, make_estimate, make_groundtruth, seeds

from trajeval_ros import Evaluation, Gauge, Protocol, Trajectory, evaluate
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.absolute_errors import absolute_errors
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.evaluation import evaluate_pairs
from trajeval_ros.metrics.named_protocols import PROTOCOLS
from trajeval_ros.metrics.sub_trajectories import Selection
from trajeval_ros.metrics.sub_trajectory_length import Length
from trajeval_ros.online.dense_pairing import DensePairing
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.intake import Limits
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.state_rows import Pairs, states, trajectory
from trajeval_ros.online.window import Window

SECOND = 10**9


def make_pair(seed: int, count: int) -> tuple[Trajectory, Trajectory]:
    """Return a groundtruth and an estimate without biases, which no message has."""
    groundtruth = make_groundtruth(seed, count)
    none = {"gyroscope_biases": None, "accelerometer_biases": None}
    estimate = dataclasses.replace(make_estimate(groundtruth, seed + 1), **none)
    return dataclasses.replace(groundtruth, **none), estimate


def rows_of(source: Trajectory) -> NDArray[np.float64]:
    return states(source.positions, source.quaternions, source.velocities)


def feed(
    evaluator: OnlineEvaluator,
    groundtruth: Trajectory,
    estimate: Trajectory,
    *,
    delay_s: float = 0.0,
    drain_s: float = 0.02,
) -> None:
    """Play both streams in order of their stamps, in batches, the estimate later by a delay."""
    arrivals = (groundtruth.stamps, estimate.stamps + round(delay_s * SECOND))
    truth_rows, estimate_rows = rows_of(groundtruth), rows_of(estimate)
    begin = min(int(each.min()) for each in arrivals)
    end = max(int(each.max()) for each in arrivals)
    ticks = np.arange(begin, end + 2 * round(drain_s * SECOND), round(drain_s * SECOND))
    cuts = [np.searchsorted(np.maximum.accumulate(each), ticks) for each in arrivals]
    for before, after in zip(range(len(ticks) - 1), range(1, len(ticks)), strict=True):
        g, e = (slice(int(cut[before]), int(cut[after])) for cut in cuts)
        if g.start < g.stop:
            evaluator.add_groundtruth(groundtruth.stamps[g], truth_rows[g])
        if e.start < e.stop:
            evaluator.add_estimate(estimate.stamps[e], estimate_rows[e])
        evaluator.update()
    evaluator.update(at_end=True)


def assert_live_is_offline(
    evaluator: OnlineEvaluator, offline: Evaluation, relative: float = 1e-9
) -> None:
    live = evaluate_pairs(
        evaluator.association(), offline.groundtruth, offline.estimate, offline.protocol
    )
    assert len(live.association) == len(offline.association)
    assert live.association.dropped == offline.association.dropped
    assert live.association.estimate_coverage == offline.association.estimate_coverage
    assert live.association.groundtruth_coverage == pytest.approx(
        offline.association.groundtruth_coverage, rel=relative
    )
    for metric, statistics in offline.ate.items():
        mine = live.ate[metric]
        assert (mine is None) == (statistics is None), metric
        if mine is not None and statistics is not None:
            assert dataclasses.astuple(mine) == pytest.approx(
                dataclasses.astuple(statistics), rel=relative, abs=1e-12
            )
    for segment, other in zip(live.segments or (), offline.segments or (), strict=True):
        np.testing.assert_array_equal(segment.errors.starts, other.errors.starts)
        np.testing.assert_array_equal(segment.errors.ends, other.errors.ends)
        np.testing.assert_allclose(
            segment.errors.position_m, other.errors.position_m, rtol=relative, atol=1e-12
        )
    # The running numbers are those of the pairs, too.
    snapshot = evaluator.snapshot()
    position = offline.ate["position_m"]
    assert position is not None
    assert snapshot.position_rmse_m == pytest.approx(position.rmse, rel=relative)
    for metric, statistics in offline.ate.items():
        assert (snapshot.ate[metric] is None) == (statistics is None), metric


RECORDINGS = [
    ("euroc/groundtruth/MH_01.txt", "euroc/vio_mono/MH_01.txt", Gauge.YAW, "z"),
    ("euroc/groundtruth/V1_02_asl.csv", "euroc/V1_02_estimate.txt", Gauge.SE3, "z"),
    ("tum/fr2_desk_groundtruth.txt", "tum/fr2_desk_ORB.txt", Gauge.SIM3, "z"),
    ("bags/ROS_example.bag:groundtruth", "bags/ROS_example.bag:ORB-SLAM", Gauge.SE3, "-y"),
]


@pytest.mark.parametrize(("truth", "estimate", "gauge", "axis"), RECORDINGS)
@pytest.mark.parametrize("delay_s", [0.0, 0.3])
def test_live_is_offline_on_recordings(
    recording: Callable[[str], Trajectory],
    truth: str,
    estimate: str,
    gauge: Gauge,
    axis: str,
    delay_s: float,
) -> None:
    protocol = Protocol(gauge=gauge)
    evaluator = OnlineEvaluator(OnlineSettings(protocol, up=(axis, axis)))
    sides = [dataclasses.replace(recording(each), up=UpAxis(axis)) for each in (truth, estimate)]
    feed(evaluator, *sides, delay_s=delay_s, drain_s=0.25)
    offline = evaluate(*sides, protocol)
    assert_live_is_offline(evaluator, offline)
    # All sub-trajectories but those whose ends only the end of the run decides are seen live.
    for segment in offline.segments or ():
        live = evaluator.snapshot().relative[str(segment.length)]
        tail = np.count_nonzero(segment.errors.ends == len(offline.association) - 1)
        assert len(segment.errors.ends) - tail <= live.count <= len(segment.errors.ends)
        if live.count == len(segment.errors.ends) and not gauge.has_scale:
            mean = segment.statistics["position_m"]
            assert mean is not None
            assert live.position_m == pytest.approx(mean.mean, rel=1e-9)


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
    truth_rows, estimate_rows = rows_of(groundtruth), rows_of(estimate)
    for begin in range(0, len(order), size):
        batch = order[begin : begin + size]
        g, e = batch[batch < len(groundtruth)], batch[batch >= len(groundtruth)] - len(groundtruth)
        evaluator.add_groundtruth(groundtruth.stamps[g], truth_rows[g])
        evaluator.add_estimate(estimate.stamps[e], estimate_rows[e])
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


@settings(max_examples=10)
@given(seed=seeds, frames=st.integers(1, 40))
def test_frames_are_counted_live_as_offline(seed: int, frames: int) -> None:
    groundtruth, estimate = make_pair(seed, 200)
    protocol = Protocol(lengths=(Length(frames, "f"),))
    evaluator = OnlineEvaluator(OnlineSettings(protocol))
    feed(evaluator, groundtruth, estimate, drain_s=0.37)
    live = evaluator.snapshot().relative[f"{frames}f"]
    (segment,) = evaluate(groundtruth, estimate, protocol).segments or ()
    assert live.count == len(segment.errors.ends) > 0
    position, rotation = (segment.statistics[each] for each in ("position_m", "rotation_deg"))
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


@settings(max_examples=10)
@given(seed=seeds)
@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.SE3])
@pytest.mark.parametrize("window", ["0", "5s", "4m", "37"])
def test_batches_of_any_size_give_the_same_snapshot(seed: int, gauge: Gauge, window: str) -> None:
    groundtruth, estimate = make_pair(seed, 300)
    protocol = Protocol(gauge=gauge, lengths=(Length(3, "m"), Length(8, "m"), Length(2, "s")))
    said = []
    for size in (1, 24, 10_000):
        evaluator = OnlineEvaluator(OnlineSettings(protocol, Window.parse(window)))
        feed_in_batches(evaluator, groundtruth, estimate, size)
        said.append(list(numbers_of(evaluator.snapshot())))
    for others in said[1:]:
        for mine, other in zip(said[0], others, strict=True):
            if isinstance(mine, float):
                assert other == pytest.approx(mine, rel=1e-9, abs=1e-11)
            else:
                assert other == mine


@given(seed=seeds)
def test_order_of_arrival_within_the_buffer_changes_no_pair(seed: int) -> None:
    random = np.random.default_rng(seed)
    groundtruth, estimate = make_pair(seed, 200)
    evaluator = OnlineEvaluator(OnlineSettings(limits=Limits(past_s=1e3)))
    for source, add in (
        (groundtruth, evaluator.add_groundtruth),
        (estimate, evaluator.add_estimate),
    ):
        # All of it, in shuffled pieces, some of them twice.
        order = random.permutation(len(source))
        rows = rows_of(source)
        for piece in np.array_split(np.concatenate([order, order[:20]]), 7):
            add(source.stamps[piece], rows[piece])
    evaluator.update(at_end=True)
    expected = evaluate(groundtruth, estimate, PROTOCOLS["default"]).association
    pairs = evaluator.association()
    np.testing.assert_array_equal(pairs.estimate.stamps, expected.estimate.stamps)
    np.testing.assert_allclose(pairs.groundtruth.positions, expected.groundtruth.positions)
    assert pairs.dropped.pop("duplicate_stamp") == 20
    assert pairs.dropped == expected.dropped


@pytest.mark.parametrize("window", ["5s", "4m", "37"])
@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.SIM3])
def test_a_window_has_the_errors_of_its_pairs(window: str, gauge: Gauge) -> None:
    groundtruth, estimate = make_pair(5, 600)
    record: list[Pairs] = []
    evaluator = OnlineEvaluator(
        OnlineSettings(Protocol(gauge=gauge), Window.parse(window)),
        record.append,
    )
    feed(evaluator, groundtruth, estimate)
    snapshot = evaluator.snapshot()
    all_pairs = Pairs(*(np.concatenate(column) for column in zip(*record, strict=True)))
    stamps = all_pairs.stamps
    along = trajectory(stamps, all_pairs.groundtruth).travelled
    inside = {
        "5s": stamps >= stamps[-1] - 5 * SECOND,
        "4m": along >= along[-1] - 4.0,
        "37": np.arange(len(stamps)) >= len(stamps) - 37,
    }[window]
    assert snapshot.window_pairs == np.count_nonzero(inside)
    assert isinstance(snapshot.alignment, Alignment)
    aligned = snapshot.alignment.similarity.trajectory(
        trajectory(stamps[inside], all_pairs.estimate[inside])
    )
    errors = absolute_errors(trajectory(stamps[inside], all_pairs.groundtruth[inside]), aligned)
    rmse = float(np.sqrt(np.mean(errors.position_m**2)))
    assert snapshot.window_position_rmse_m == pytest.approx(rmse, rel=1e-9)
    rotation = snapshot.ate["rotation_deg"]
    assert rotation is not None
    assert errors.rotation_deg is not None
    assert rotation.mean == pytest.approx(errors.rotation_deg.mean(), rel=1e-9)


def test_groundtruth_coverage_is_of_the_whole_run_whatever_the_window() -> None:
    groundtruth, estimate = make_pair(5, 600)
    recorded = evaluate(groundtruth, estimate, PROTOCOLS["default"]).association
    for text in ("0", "2s", "3"):
        live = OnlineEvaluator(OnlineSettings(window=Window.parse(text)))
        assert live.snapshot().coverage is None
        feed(live, groundtruth, estimate)
        assert live.snapshot().coverage == recorded.coverage


def test_memory_does_not_grow_with_the_run() -> None:
    evaluator = OnlineEvaluator(OnlineSettings(window=Window.parse("10s")))
    sizes = []
    for minute in range(20):
        stamps = (np.arange(1200) * 50_000_000 + minute * 60 * SECOND).astype(np.int64)
        t = stamps / SECOND
        path = np.column_stack([3 * np.cos(t / 3), 3 * np.sin(t / 3), 0.1 * np.sin(t)])
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
        evaluator.add_groundtruth(stamps, states(path, quaternions))
        evaluator.add_estimate(stamps, states(path + 0.01 * np.sin(t)[:, None], quaternions))
        evaluator.update()
        sizes.append(len(evaluator.store))
    assert max(sizes[3:]) <= max(sizes[:3]) + 50
    assert len(evaluator.store) < 2000


def numbers_held(thing: object, seen: set[int]) -> int:
    """Return how many numbers and objects something keeps alive, arrays with all their room."""
    if id(thing) in seen:
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return thing.size if thing.base is None else numbers_held(thing.base, seen)
    inside: list[object] = []
    if isinstance(thing, dict):
        inside = [*thing.keys(), *thing.values()]
    elif isinstance(thing, list | tuple | set):
        inside = list(thing)
    elif type(thing).__module__.startswith("trajeval_ros"):
        inside = list(vars(thing).values())
    return 1 + sum(numbers_held(each, seen) for each in inside)


@pytest.mark.parametrize("speed", [0.0, 3.0], ids=["at rest", "moving"])
def test_nothing_held_grows_with_the_run(speed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trajeval_ros.online.live_relative_errors.MOST_OPEN_STARTS", 1000)
    evaluator = OnlineEvaluator(
        OnlineSettings(
            Protocol(lengths=(Length(2, "m"), Length(1, "s"))),
            Window.parse("2s"),
            limits=Limits(past_s=1.0),
        )
    )

    def poses(stamps: NDArray[np.int64]) -> NDArray[np.float64]:
        angle = speed / 2.0 * stamps / SECOND
        flat = np.zeros(len(stamps))
        positions = np.column_stack([2.0 * np.cos(angle), 2.0 * np.sin(angle), flat])
        return states(
            positions, np.column_stack([flat, flat, np.sin(angle / 2.0), np.cos(angle / 2.0)])
        )

    held = []
    for drain in range(2000):  # 1 kHz and 200 Hz, drained at 50 Hz
        truth = (drain * 20 + np.arange(20, dtype=np.int64)) * 1_000_000
        stamps = (drain * 4 + np.arange(4, dtype=np.int64)) * 5_000_000 + 300_000
        evaluator.add_groundtruth(truth, poses(truth))
        evaluator.add_estimate(stamps, poses(stamps))
        evaluator.update()
        held.append(numbers_held(evaluator, set()) if drain % 20 == 0 else 0)
    assert max(held[1000:]) <= max(held[:1000])
    running = evaluator.snapshot().relative["2m"]
    assert (running.count == 0) == (speed == 0.0)
    assert (running.given_up > 0) == (speed == 0.0)


@pytest.mark.slow
def test_running_sums_hold_over_two_million_pairs_at_utm_coordinates() -> None:
    random = np.random.default_rng(0)
    count = 2_000_000
    t = np.arange(count) * 0.05
    path = np.column_stack([800 * np.cos(t / 500), 600 * np.sin(t / 300), 5 * np.sin(t / 40)])
    path += [500_000.0, 5_000_000.0, 400.0]
    drift = np.cumsum(random.normal(scale=2e-5, size=(count, 3)), axis=0)
    stamps = (np.arange(count) * 50_000_000).astype(np.int64)
    protocol = Protocol(gauge=Gauge.SE3, lengths=())
    evaluator = OnlineEvaluator(OnlineSettings(protocol, Window.parse("60s")))
    evaluator_rows = states(path), states(path - [499_000.0, 4_999_000.0, 0.0] + drift)
    for begin in range(0, count, 400):
        part = slice(begin, begin + 400)
        evaluator.add_groundtruth(stamps[part], evaluator_rows[0][part])
        evaluator.add_estimate(stamps[part], evaluator_rows[1][part])
        evaluator.update()
    truth = Trajectory(stamps, evaluator_rows[0][:, :3])
    estimate = Trajectory(stamps, evaluator_rows[1][:, :3])
    offline = evaluate(truth, estimate, protocol).ate["position_m"]
    assert offline is not None
    assert evaluator.snapshot().position_rmse_m == pytest.approx(offline.rmse, rel=1e-9)


def test_groundtruth_that_starts_late_ends_early_or_pauses_is_never_made_up() -> None:
    stamps = (np.arange(400) * SECOND // 20).astype(np.int64)
    path = np.column_stack([np.cos(stamps / SECOND), np.sin(stamps / SECOND), np.zeros(400)])
    keep = ((stamps > 3 * SECOND) & (stamps < 8 * SECOND)) | (
        (stamps > 10 * SECOND) & (stamps < 15 * SECOND)
    )
    linear = Protocol(gauge=Gauge.YAW, association="linear")
    evaluator = OnlineEvaluator(OnlineSettings(linear))
    evaluator.add_estimate(stamps + 1, states(path))
    evaluator.update()
    evaluator.add_groundtruth(stamps[keep], states(path[keep]))
    evaluator.update(at_end=True)
    truth, estimate = Trajectory(stamps[keep], path[keep]), Trajectory(stamps + 1, path)
    expected = evaluate(truth, estimate, linear).association
    assert evaluator.association().dropped == expected.dropped
    assert set(expected.dropped) == {
        "before_groundtruth", "after_groundtruth", "in_groundtruth_gap",
    }  # fmt: skip


def test_what_waits_is_bounded_and_counted() -> None:
    limits = Limits(waiting_states=100)
    evaluator = OnlineEvaluator(OnlineSettings(limits=limits))
    stamps = (np.arange(1000) * SECOND // 20).astype(np.int64)
    for part in np.array_split(np.arange(1000), 50):
        evaluator.add_estimate(stamps[part], states(np.zeros((len(part), 3))))
        evaluator.update()
    snapshot = evaluator.snapshot()
    assert snapshot.waiting == 100
    assert snapshot.dropped == {"waited_too_long": 900}
    assert snapshot.alignment is None
    assert snapshot.warming_up == "no pairs yet"


def test_a_bag_that_is_played_twice_has_the_groundtruth_of_one() -> None:
    buffer = DensePairing()
    stamps = (np.arange(3000) * SECOND // 50).astype(np.int64)
    rows = states(np.column_stack([0.02 * np.arange(3000), np.zeros((3000, 2))]))
    told = []
    for _ in range(2):
        for part in np.array_split(np.arange(3000), 600):
            buffer.add_groundtruth(stamps[part], rows[part])
            buffer.add_estimate(stamps[part], rows[part])
            buffer.take()
        told.append((buffer.groundtruth_path_m, buffer.groundtruth_time, buffer.groundtruth_count))
    assert told[0] == (pytest.approx(59.98), int(stamps[-1]), 3000)
    assert told[1] == told[0]
    again = buffer.groundtruth_intake.dropped
    assert again["too_late"] + again["duplicate_stamp"] == 3000
    assert sum(buffer.dropped.values()) == 3000


def test_a_late_groundtruth_state_adds_no_path() -> None:
    buffer = DensePairing(limits=Limits(past_s=1.0))
    stamps = (np.arange(500) * SECOND // 50).astype(np.int64)
    rows = states(np.column_stack([0.02 * np.arange(500), np.zeros((500, 2))]))
    buffer.add_groundtruth(stamps, rows)
    buffer.take()
    buffer.add_groundtruth(stamps[:400] + 1, rows[:400])
    buffer.take()
    assert buffer.groundtruth_path_m == pytest.approx(0.02 * 499)
    assert buffer.groundtruth_time == stamps[-1]
    assert buffer.groundtruth_intake.dropped == {"too_late": 400}


@pytest.mark.parametrize("window", ["0", "5s", "4m", "37"])
def test_a_snapshot_before_the_first_pair_has_no_errors(window: str) -> None:
    snapshot = OnlineEvaluator(OnlineSettings(window=Window.parse(window))).snapshot()
    assert (snapshot.pairs, snapshot.window_pairs, snapshot.ate) == (0, 0, {})
    assert snapshot.position_rmse_m is snapshot.window_position_rmse_m is None


def test_states_that_are_no_poses_are_counted_by_reason() -> None:
    evaluator = OnlineEvaluator()
    stamps = np.arange(4, dtype=np.int64) * SECOND // 10
    positions = np.zeros((4, 3))
    positions[1, 0] = np.nan
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (4, 1))
    quaternions[2] = 0.0
    evaluator.add_groundtruth(stamps, states(np.zeros((4, 3)), quaternions[[0, 0, 0, 0]]))
    evaluator.add_estimate(stamps, states(positions, quaternions))
    evaluator.update(at_end=True)
    assert evaluator.snapshot().pairs == 2
    assert evaluator.snapshot().dropped == {"not_finite": 1, "zero_quaternion": 1}


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
    evaluator.add_groundtruth(stamps, states(np.zeros((100, 3))))
    evaluator.add_estimate(stamps, states(still))
    evaluator.update()
    assert "do not determine" in evaluator.snapshot().warming_up


@pytest.mark.parametrize("first", [1, 40])
def test_alignment_by_the_first_states_is_that_of_offline(first: int) -> None:
    groundtruth, estimate = make_pair(21, 400)
    protocol = Protocol(gauge=Gauge.YAW, align_states=first, lengths=())
    evaluator = OnlineEvaluator(OnlineSettings(protocol))
    feed(evaluator, groundtruth, estimate)
    assert_live_is_offline(evaluator, evaluate(groundtruth, estimate, protocol))


@settings(max_examples=10)
@given(seed=seeds)
def test_a_window_of_the_whole_run_is_the_whole_run(seed: int) -> None:
    groundtruth, estimate = make_pair(seed, 200)
    evaluator = OnlineEvaluator()
    feed(evaluator, groundtruth, estimate)
    snapshot = evaluator.snapshot()
    assert snapshot.window_position_rmse_m == snapshot.position_rmse_m
    position = snapshot.ate["position_m"]
    assert position is not None
    assert position.rmse == pytest.approx(snapshot.position_rmse_m, rel=1e-9)


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


@pytest.mark.parametrize("text", ["99999999999s", "1000000001m", "9" * 20, "9" * 400])
def test_a_window_longer_than_any_run_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="above the limit of 1e\\+09"):
        Window.parse(text)


@pytest.mark.parametrize("unit", ["s", "m", ""])
def test_the_longest_window_is_the_whole_run(unit: str) -> None:
    evaluator = OnlineEvaluator(OnlineSettings(window=Window.parse(f"1000000000{unit}")))
    groundtruth, estimate = make_pair(1, 200)
    evaluator.add_groundtruth(groundtruth.stamps, rows_of(groundtruth))
    evaluator.add_estimate(estimate.stamps, rows_of(estimate))
    evaluator.update(at_end=True)
    assert evaluator.snapshot().window_pairs == evaluator.pairs > 90


@pytest.mark.parametrize("text", ["0", "30s", "50m", "500", "2.5m"])
def test_windows_are_written_as_they_are_read(text: str) -> None:
    assert str(Window.parse(text)) == text


def test_lengths_and_window_change_while_it_runs() -> None:
    groundtruth, estimate = make_pair(3, 400)
    short, long = Length(1.0, "m"), Length(2.0, "m")
    metres = OnlineSettings(protocol=Protocol(lengths=(short,)), window=Window(20, "pairs"))
    changing, steady = OnlineEvaluator(metres), OnlineEvaluator(metres)
    half = groundtruth.stamps[200]
    for evaluator in (changing, steady):
        feed(
            evaluator,
            groundtruth[groundtruth.stamps <= half],
            estimate[estimate.stamps <= half],
        )
    both = dataclasses.replace(metres.protocol, lengths=(long, short))
    changing.change(dataclasses.replace(metres, protocol=both, window=Window()))
    at_change = changing.pairs
    for evaluator in (changing, steady):
        feed(evaluator, groundtruth[groundtruth.stamps > half], estimate[estimate.stamps > half])
    now, before = changing.snapshot(), steady.snapshot()
    # Short and long batches multiply quaternions in sums of another order (`lie.multiply`). Four
    # products of unit quaternions, each known to 4 u in each of four components, make an angle
    # that is known to 64 u, and a step of one metre that is known to as much; two of them differ
    # by twice that, their means by N u more.
    one, other = now.relative["1m"], before.relative["1m"]
    assert (one.count, one.given_up) == (other.count, other.given_up)
    rounding = (128 + one.count) * np.finfo(np.float64).eps / 2.0
    assert one.position_m == pytest.approx(other.position_m, rel=0, abs=rounding)
    assert one.rotation_deg == pytest.approx(other.rotation_deg, rel=0, abs=np.degrees(rounding))
    assert now.relative["2m"].count > 0
    # The wider window began with what the narrow one had left, and has forgotten nothing since.
    assert now.window_pairs > changing.pairs - at_change
    assert now.window_position_rmse_m is not None


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_a_velocity_that_is_none_leaves_the_pose(value: float) -> None:
    groundtruth, estimate = make_pair(3, 60)
    assert estimate.velocities is not None
    velocities = estimate.velocities.copy()
    velocities[20, 1] = value
    evaluator = OnlineEvaluator()
    wild = Trajectory(estimate.stamps, estimate.positions, estimate.quaternions, velocities)
    feed(evaluator, groundtruth, wild)
    ate = evaluator.snapshot().ate
    assert ate["velocity_mps"] is None
    expected = evaluate(groundtruth, dataclasses.replace(estimate, velocities=None))
    assert ate["position_m"] is not None
    assert expected.ate["position_m"] is not None
    assert ate["position_m"].count == expected.ate["position_m"].count
    assert ate["position_m"].rmse == pytest.approx(expected.ate["position_m"].rmse)


@given(size=st.integers(0, 10**9), unit=st.sampled_from(["", "s", "m"]))
def test_windows_are_read_as_they_are_written(size: int, unit: str) -> None:
    window = Window.parse(f"{size}{unit}")
    assert Window.parse(str(window)) == window


@pytest.mark.parametrize(("max_delay_s", "pairs"), [(20.0, True), (0.0, True), (5.0, False)])
def test_a_late_estimate_is_paired_within_the_delay_or_told(
    max_delay_s: float, pairs: bool
) -> None:
    groundtruth, estimate = make_pair(3, 400)
    span_s = (groundtruth.stamps[-1] - groundtruth.stamps[0]) / SECOND
    stretch = int(np.ceil(40.0 / span_s))  # 40 s and more
    sides = [
        dataclasses.replace(each, stamps=each.stamps[0] + stretch * (each.stamps - each.stamps[0]))
        for each in (groundtruth, estimate)
    ]
    limits = Limits(past_s=max_delay_s or np.inf)
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge="yaw"), limits=limits))
    feed(evaluator, *sides, delay_s=12.0, drain_s=0.25)
    said = evaluator.buffer.why_forgotten
    if pairs:
        assert said == ""
        assert_live_is_offline(evaluator, evaluate(*sides, Protocol(gauge="yaw")))
    else:
        late = evaluator.buffer.dropped["too_late"]
        assert said.startswith(f"{counted(late, 'pose')} dropped: later than")
        assert "5 s (max_delay)" in said


def test_a_memory_that_is_full_is_told() -> None:
    buffer = DensePairing(limits=Limits(np.inf, past_states=100, waiting_states=5))
    stamps = np.arange(1000, dtype=np.int64) * SECOND // 10
    buffer.add_groundtruth(stamps, np.zeros((1000, 10)))
    buffer.take()
    buffer.add_estimate(stamps[:3] + 1, np.zeros((3, 10)))
    buffer.take()
    assert buffer.why_forgotten == (
        "3 poses dropped: later than the groundtruth buffer of the newest 100 states"
    )
    buffer.add_estimate(stamps[-1] + stamps[1:9], np.zeros((8, 10)))
    assert buffer.why_forgotten.endswith(
        "3 poses dropped: more than 5 were waiting for groundtruth"
    )
