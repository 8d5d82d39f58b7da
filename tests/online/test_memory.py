"""Memory of the live evaluator: bounded, and what is forgotten or late is told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from live_feeding import SECOND, assert_live_is_offline, feed, make_pair
from numpy.typing import NDArray
from state_rows import states, trajectory

from trajeval_ros import Gauge, Protocol, Trajectory, evaluate
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.online.window import Window


def test_memory_does_not_grow_with_the_run() -> None:
    evaluator = OnlineEvaluator(OnlineSettings(window=Window.parse("10s")))
    sizes = []
    for minute in range(20):
        stamps = (np.arange(1200) * 50_000_000 + minute * 60 * SECOND).astype(np.int64)
        t = stamps / SECOND
        path = np.column_stack([3 * np.cos(t / 3), 3 * np.sin(t / 3), 0.1 * np.sin(t)])
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
        evaluator.add_groundtruth(trajectory(stamps, states(path, quaternions)))
        evaluator.add_estimate(
            trajectory(stamps, states(path + 0.01 * np.sin(t)[:, None], quaternions))
        )
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
    return 1 + sum(numbers_held(item, seen) for item in inside)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.0, 3.0], ids=["at rest", "moving"])
def test_nothing_held_grows_with_the_run(speed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trajeval_ros.online.live_relative_errors.MOST_OPEN_STARTS", 1000)
    evaluator = OnlineEvaluator(
        OnlineSettings(
            Protocol(lengths=(Length(2, "m"), Length(1, "s"))),
            Window.parse("2s"),
            limits=BufferLimits(past_s=1.0),
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
        groundtruth = (drain * 20 + np.arange(20, dtype=np.int64)) * 1_000_000
        stamps = (drain * 4 + np.arange(4, dtype=np.int64)) * 5_000_000 + 300_000
        evaluator.add_groundtruth(trajectory(groundtruth, poses(groundtruth)))
        evaluator.add_estimate(trajectory(stamps, poses(stamps)))
        evaluator.update()
        held.append(numbers_held(evaluator, set()) if drain % 20 == 0 else 0)
    assert max(held[1000:]) <= max(held[:1000])
    running = evaluator.snapshot().relative["2m"]
    assert (running.count == 0) == (speed == 0.0)
    assert (running.given_up > 0) == (speed == 0.0)


@pytest.mark.slow
def test_running_sums_hold_over_half_a_million_pairs_at_utm_coordinates() -> None:
    random = np.random.default_rng(0)
    count = 500_000
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
        evaluator.add_groundtruth(trajectory(stamps[part], evaluator_rows[0][part]))
        evaluator.add_estimate(trajectory(stamps[part], evaluator_rows[1][part]))
        evaluator.update()
    groundtruth = Trajectory(stamps, evaluator_rows[0][:, :3])
    estimate = Trajectory(stamps, evaluator_rows[1][:, :3])
    offline = evaluate(groundtruth, estimate, protocol).ate["position_m"]
    assert offline is not None
    assert evaluator.snapshot().position_rmse_m == pytest.approx(offline.rmse, rel=1e-9)


def test_what_waits_is_bounded_and_counted() -> None:
    limits = BufferLimits(waiting_states=100)
    evaluator = OnlineEvaluator(OnlineSettings(limits=limits))
    stamps = (np.arange(1000) * SECOND // 20).astype(np.int64)
    for part in np.array_split(np.arange(1000), 50):
        evaluator.add_estimate(trajectory(stamps[part], states(np.zeros((len(part), 3)))))
        evaluator.update()
    snapshot = evaluator.snapshot()
    assert snapshot.waiting == 100
    assert snapshot.dropped == {"waited_too_long": 900}
    assert snapshot.alignment is None
    assert snapshot.warming_up == "no pairs yet"


@pytest.mark.slow
@pytest.mark.parametrize(("max_delay_s", "pairs"), [(20.0, True), (0.0, True), (5.0, False)])
def test_a_late_estimate_is_paired_within_the_delay_or_told(
    max_delay_s: float, pairs: bool
) -> None:
    groundtruth, estimate = make_pair(3, 400)
    span_s = (groundtruth.stamps[-1] - groundtruth.stamps[0]) / SECOND
    stretch = int(np.ceil(40.0 / span_s))  # 40 s and more
    sides = [
        dataclasses.replace(item, stamps=item.stamps[0] + stretch * (item.stamps - item.stamps[0]))
        for item in (groundtruth, estimate)
    ]
    limits = BufferLimits(past_s=max_delay_s or np.inf)
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge="yaw"), limits=limits))
    feed(evaluator, *sides, delay_s=12.0, drain_s=0.25)
    text = evaluator.buffer.why_forgotten
    if pairs:
        assert text == ""
        assert_live_is_offline(evaluator, evaluate(*sides, Protocol(gauge="yaw")))
    else:
        late = evaluator.buffer.dropped["too_late"]
        assert text.startswith(f"{counted(late, 'pose')} dropped: later than")
        assert "5 s (max_delay)" in text


@pytest.mark.parametrize("silent", ["groundtruth", "estimate"])
@pytest.mark.parametrize("method", ["linear", "groundtruth-stamps"])
def test_states_are_forgotten_while_the_other_side_is_silent(method: str, silent: str) -> None:
    """Except for those that wait for it, up to their limit."""
    protocol = Protocol(association=AssociationRule(method))
    limits = BufferLimits(past_s=1.0, waiting_states=300)
    evaluator = OnlineEvaluator(OnlineSettings(protocol, limits=limits))
    add = evaluator.add_estimate if silent == "groundtruth" else evaluator.add_groundtruth
    stamps = np.arange(2000, dtype=np.int64) * SECOND // 100
    for part in np.array_split(stamps, 500):
        add(Trajectory(part, np.zeros((len(part), 3))))
        evaluator.update()
    buffer = evaluator.buffer
    waits = (buffer.estimate if silent == "groundtruth" else buffer.groundtruth) is (
        buffer.groundtruth if buffer.at_groundtruth else buffer.estimate
    )
    held = max(len(buffer.groundtruth), len(buffer.estimate))
    assert (held, buffer.waiting) == (300, 300) if waits else 100 <= held <= 145


def test_a_memory_that_is_full_is_told() -> None:
    buffer = Pairing(limits=BufferLimits(np.inf, past_states=100, waiting_states=5))
    stamps = np.arange(1000, dtype=np.int64) * SECOND // 10
    buffer.add_groundtruth(Trajectory(stamps, np.zeros((1000, 3))))
    buffer.made()
    buffer.forget()
    buffer.add_estimate(Trajectory(stamps[:3] + 1, np.zeros((3, 3))))
    buffer.made()
    buffer.forget()
    assert buffer.why_forgotten == (
        "3 poses dropped: later than the groundtruth buffer of the newest 100 states"
    )
    buffer.add_estimate(Trajectory(stamps[-1] + stamps[1:9], np.zeros((8, 3))))
    assert buffer.why_forgotten.endswith(
        "3 poses dropped: more than 5 were waiting for groundtruth"
    )
