"""The live search for discontinuities: batches, borders of runs, and replays."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from trajeval_ros import OnlineEvaluator, Protocol, Request, run, simulate
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.metrics.discontinuities.events import Event
from trajeval_ros.metrics.discontinuities.recorded import discontinuities
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.live_discontinuities import LiveDiscontinuities

FLIGHT = simulate(6, 40.0)
TRUTH, ESTIMATE = FLIGHT.groundtruth[::5], FLIGHT.estimate
STEP_S = 20.0


def stepped(by_m: float = 0.5) -> Trajectory:
    positions = ESTIMATE.positions.copy()
    positions[ESTIMATE.seconds > STEP_S] += [by_m, 0.0, 0.0]
    return dataclasses.replace(ESTIMATE, positions=positions)


def feed(
    search: LiveDiscontinuities,
    estimate: Trajectory,
    every_s: float,
    rate: float = 1.0,
    until_s: float = np.inf,
) -> list[list[Event]]:
    """Let states arrive, and examine them every few seconds; return the new events of each."""
    result, sides = [], (("groundtruth", TRUTH), ("estimate", estimate))
    first = int(min(side.stamps[0] for _, side in sides))
    for begin_s in np.arange(0.0, min(41.0, until_s), every_s):
        bounds = first + np.round(NANOSECONDS * np.array([begin_s, begin_s + every_s]))
        for name, side in sides:
            rows = slice(*np.searchsorted(side.stamps, bounds))
            arrived = first + ((side.stamps[rows] - first) / rate).astype(np.int64)
            search.add(name, StampedPoses.of(side, rows), arrived)
        result.append(search.examine())
    return result


@pytest.mark.parametrize("every_s", [0.04, 0.4, 7.0])
def test_events_are_those_of_the_recording(every_s: float) -> None:
    search, estimate = LiveDiscontinuities(), stepped()
    feed(search, estimate, every_s)
    search.examine(at_end=True)
    [live], [recorded] = search.events, discontinuities(TRUTH, estimate)
    assert live.m == pytest.approx(recorded.m, rel=1e-9)
    assert (live.kind, live.side, live.t_ns, live.end_ns) == (
        "step",
        "estimate",
        recorded.t_ns,
        recorded.end_ns,
    )


@pytest.mark.parametrize("mps2", [0.1, 1.0])
def test_divergences_of_the_result_are_those_of_the_level(mps2: float) -> None:
    """Also a small one, which is no finding."""
    since_s = np.maximum(ESTIMATE.seconds - STEP_S, 0.0)
    positions = ESTIMATE.positions + np.outer(0.5 * mps2 * since_s**2, [0.6, 0.8, 0.0])
    diverging = dataclasses.replace(ESTIMATE, positions=positions, velocities=None)
    live, ends = OnlineEvaluator(), np.random.default_rng(3).integers(1, 40, 30)
    for begin_s, end_s in itertools.pairwise([0, *sorted(ends), 50]):
        for side, add in ((TRUTH, live.add_groundtruth), (diverging, live.add_estimate)):
            add(side[(side.seconds >= begin_s) & (side.seconds < end_s)])
        live.update(at_end=end_s == 50)
    result = run(TRUTH, [diverging], Request(Protocol(lengths=()))).runs[0]
    [event], [level] = result.evaluation.events, live.losses.events
    assert dataclasses.asdict(event) == dataclasses.asdict(level) | {
        name: pytest.approx(getattr(level, name), rel=1e-9) for name in ("m", "moved_m")
    }
    told = [remark.text for remark in result.evaluation.remarks]
    assert sum("the estimate diverges from " in text for text in told) == 1
    is_headline = result.diagnosis.named("diverged") is not None
    assert is_headline == (mps2 == 1.0)


def test_no_event_begins_in_what_is_settled() -> None:
    search, settled = LiveDiscontinuities(), []
    for begin_s in np.arange(0.0, 40.0, 0.4):
        inside = [
            side[(side.seconds >= begin_s) & (side.seconds < begin_s + 0.4)]
            for side in (TRUTH, stepped())
        ]
        for name, side in zip(("groundtruth", "estimate"), inside, strict=True):
            search.add(name, StampedPoses.of(side), None)
        new, newest = search.examine(), int(inside[0].stamps[-1])
        if new:
            break
        settled.append((search.settled_until(newest), newest))
    [event] = new
    assert max(stamp for stamp, _ in settled) < event.end_ns
    assert max(newest for _, newest in settled) > event.end_ns  # pairs after it were held
    assert all(newest - stamp <= 12 * NANOSECONDS for stamp, newest in settled)


@pytest.mark.parametrize("rate", [0.3, 1.0, 5.0, 15.0])
def test_a_gap_is_no_clock_step_at_any_rate_of_a_replay(rate: float) -> None:
    kept = (ESTIMATE.seconds < 18.0) | (ESTIMATE.seconds > 21.0)
    search = LiveDiscontinuities()
    feed(search, ESTIMATE[kept], 0.4, rate)
    search.examine(at_end=True)
    assert search.events == []


@pytest.mark.parametrize("rate", [0.3, 1.0, 5.0])
def test_a_clock_step_is_measured_at_any_rate_of_a_replay(rate: float) -> None:
    search, stamps = LiveDiscontinuities(), ESTIMATE.stamps.copy()
    first = int(TRUTH.stamps[0])
    stamps[ESTIMATE.seconds > STEP_S] += NANOSECONDS
    arrived = first + ((ESTIMATE.stamps - first) / rate).astype(np.int64)
    of_truth = first + ((TRUTH.stamps - first) / rate).astype(np.int64)
    search.add("groundtruth", StampedPoses.of(TRUTH), of_truth)
    search.add("estimate", StampedPoses(stamps, StampedPoses.of(ESTIMATE).poses), arrived)
    search.examine(at_end=True)
    step = search.clock_step()
    assert step is not None
    assert (step.side, step.s) == ("estimate", pytest.approx(1.0, abs=0.05))


def test_unknown_times_of_reception_are_none() -> None:
    search, estimate = LiveDiscontinuities(), stepped()
    for name, side in (("groundtruth", TRUTH), ("estimate", estimate)):
        search.add(name, StampedPoses.of(side), np.full(len(side), UNKNOWN))
    assert [event.kind for event in search.examine(at_end=True)] == ["step"]
    assert search.examine() == []
