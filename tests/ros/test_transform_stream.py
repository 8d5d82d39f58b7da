"""Live transforms without a network: the chain of offline, whatever arrives when, in bounds."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from composed import compose_transforms
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from ros_bags import Transform, transforms_message
from strategies import START, seeds

from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.transform_tree import Edge, EdgeKey
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.online.state_buffer import NO_STATES
from trajeval_ros.ros.poses import StreamStatus
from trajeval_ros.ros.transform_stream import TransformStream

SECOND = 10**9
SOURCE = "/tf:map.camera"
MAP, ODOM, CAMERA, OTHER = ("map", "odom"), ("odom", "base"), ("camera", "base"), ("world", "x")


class Arriving(NamedTuple):
    """A message with one transform."""

    arrives: int
    is_static: bool
    transform: Transform


def a_run(
    random: np.random.Generator,
    seconds: float,
    lags_s: dict[EdgeKey, float],
    map_rate: float = 8.0,
) -> list[Arriving]:
    """Return two edges that move, one that does not, and one of another tree, as they arrive.

    Some transforms have no time, some are no poses, some come twice.
    """
    result = []
    for key, rate in ((MAP, map_rate), (ODOM, 20.0), (CAMERA, 0.0), (OTHER, 5.0)):
        count = max(1, round(rate * seconds))
        offsets = np.cumsum(random.uniform(0.5, 1.5, count)) / (rate or 1.0) * SECOND
        stamps = START + offsets.astype(np.int64)
        numbers = random.normal(size=(count, 7))
        if rate:
            odd = random.integers(count // 2, count, 6)
            stamps[odd[:2]] = 0
            numbers[odd[2]] = np.nan
            numbers[odd[3], 3:] = 0.0
            stamps[odd[4:]], numbers[odd[4:]] = stamps[odd[4:] - 1], numbers[odd[4:] - 1]
        lag = round(lags_s.get(key, 0.0) * SECOND)
        arrivals = np.maximum.accumulate(stamps) + lag
        result += [
            Arriving(arrival, not rate, (*key, stamp, numbers_[:3], numbers_[3:]))
            for arrival, stamp, numbers_ in zip(
                arrivals.tolist(), stamps.tolist(), numbers.tolist(), strict=True
            )
        ]
    return sorted(result, key=lambda item: item.arrives)


def feed(stream: TransformStream, batches: Iterable[Sequence[Arriving]]) -> list[Trajectory]:
    """Let batches arrive as the node hands them over: what is static before what moves."""
    result = []
    for batch in batches:
        stream.hold([transforms_message(item.transform) for item in batch if item.is_static])
        payloads = [transforms_message(item.transform) for item in batch if not item.is_static]
        if payloads:
            arrived = np.array([item.arrives for item in batch if not item.is_static])
            states, rows = stream.poses("", payloads, arrived)
            result.append(states)
            assert (rows == len(payloads) - 1).all()
    return result


def offline(run: Iterable[Arriving]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return stamps and states of the chain of all transforms."""
    by_key: dict[EdgeKey, list[Arriving]] = {}
    for item in run:
        by_key.setdefault(item.transform[:2], []).append(item)
    edges = {
        key: Edge.from_columns(
            np.array([item.transform[2] for item in several]),
            np.array([[*item.transform[3], *item.transform[4]] for item in several]),
            several[0].is_static,
        )
        for key, several in by_key.items()
    }
    stamps, positions, quaternions = compose_transforms(edges, "map", "camera", "t")
    return stamps, np.hstack([positions, quaternions])


def cut(run: Sequence[Arriving], cuts: Sequence[float]) -> list[list[Arriving]]:
    """Return a run in batches, cut at shares of it."""
    places = sorted(round(share * len(run)) for share in cuts)
    return [[run[row] for row in part] for part in np.split(np.arange(len(run)), places)]


lags = st.floats(0.0, 8.0)


@pytest.mark.slow
@settings(max_examples=20)
@given(
    seed=seeds,
    cuts=st.lists(st.floats(0.0, 1.0), max_size=40),
    lags_s=st.fixed_dictionaries({MAP: lags, ODOM: lags, CAMERA: lags}),
)
def test_any_batches_give_the_offline_chain(
    seed: int, cuts: list[float], lags_s: dict[EdgeKey, float]
) -> None:
    run = a_run(np.random.default_rng(seed), 12.0, lags_s)
    stream = TransformStream(SOURCE, "map", "camera")
    result = feed(stream, cut(run, cuts))
    stamps, expected = offline(run)
    assert len(stamps) > 100
    np.testing.assert_array_equal(np.concatenate([item.stamps for item in result]), stamps)
    live = np.concatenate([StampedPoses.of(item).poses for item in result])
    np.testing.assert_allclose(live, expected, rtol=1e-12, atol=1e-12)
    assert stream.trouble is None
    assert stream.status.poses == len(stamps)
    assert (stream.status.first, stream.status.last) == (stamps[0], stamps[-1])


@pytest.mark.slow
@settings(max_examples=20)
@given(
    seed=seeds,
    cuts=st.lists(st.floats(0.0, 1.0), max_size=80),
    lags_s=st.fixed_dictionaries({MAP: st.floats(0.0, 1.0), ODOM: st.floats(0.0, 1.0)}),
    map_rate=st.sampled_from([0.6, 8.0]),
)
def test_after_a_restart_of_time_the_chain_is_that_of_the_new_messages_alone(
    seed: int, cuts: list[float], lags_s: dict[EdgeKey, float], map_rate: float
) -> None:
    """However the messages around the step are divided, and at rare corrections, too."""
    run = a_run(np.random.default_rng(seed), 12.0, lags_s, map_rate)
    pause = 100 * SECOND
    again = [item._replace(arrives=item.arrives + pause) for item in run if not item.is_static]
    restarted, alone = (TransformStream(SOURCE, "map", "camera") for _ in range(2))
    results = []
    for stream, batches in ((restarted, cut([*run, *again], cuts)), (alone, [[*run, *again]])):
        stream.starts_new_run = stream.is_receiver = True
        if stream is alone:
            stream.hold([transforms_message(item.transform) for item in run if item.is_static])
            batches = [again]
        states, received = [], []
        for batch in batches:
            states += feed(stream, [batch])
            received.append(stream.as_received(NO_STATES))
        received.append(stream.as_received(stream.last_poses()))
        stamps = np.concatenate([item.stamps for item in states])
        back = np.flatnonzero(np.diff(stamps) < -SECOND)
        rows = slice(back[-1] + 1 if len(back) else 0, None)
        received = [item for item in received if item.reading.receive_times is not None]
        poses = np.concatenate([StampedPoses.of(item).poses for item in received])
        times = np.concatenate([item.reading.receive_times.times for item in received])
        results.append(
            (stamps[rows], times[times >= START + pause], poses[times >= START + pause])
        )
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
    assert (stream.status.frame, stream.status.child_frame) == ("map", "camera")
    assert stream.status.remarks == [Remark(Level.NOTE, "format", "format: TF")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parent", "child"),
    [("tf_example", "odom", "base_link"), ("nav2_turtlebot.mcap", "map", "base_link")],
)
def test_recorded_transforms_give_the_offline_chain(
    shared_data: Path, name: str, parent: str, child: str
) -> None:
    path = shared_data / "bags" / name
    expected = read_trajectory(f"{path}:/tf:{parent}.{child}")
    stream = TransformStream(f"/tf:{parent}.{child}", parent, child)
    with Bag(path) as bag:
        [tf], [static] = bag.find("/tf"), bag.find("/tf_static")
        stream.hold([bytes(payload) for _, _, payload in bag.messages([static])])
        messages = [(logged, bytes(payload)) for _, logged, payload in bag.messages([tf])]
    result = []
    for begin in range(0, len(messages), 10):
        arrived, payloads = zip(*messages[begin : begin + 10], strict=True)
        result.append(stream.poses("", payloads, np.array(arrived))[0])
    np.testing.assert_array_equal(
        np.concatenate([item.stamps for item in result]), expected.stamps
    )
    live = np.concatenate([StampedPoses.of(item).poses for item in result])
    assert expected.quaternions is not None
    np.testing.assert_allclose(live[:, :3], expected.positions, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(live[:, 3:], expected.quaternions, rtol=1e-9, atol=1e-9)


def moving(key: EdgeKey, stamp: int) -> Arriving:
    return Arriving(stamp, False, (*key, stamp, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)))


STATIC = Arriving(START, True, (*CAMERA, 0, (0.1, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))


def seconds_of(keys: Sequence[EdgeKey], first: int, last: int) -> list[list[Arriving]]:
    """Return a batch a second, of ten transforms of each edge."""
    return [
        [
            moving(key, START + second * SECOND + step * SECOND // 10)
            for step in range(10)
            for key in keys
        ]
        for second in range(first, last)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("keys", [(MAP, ODOM, OTHER), (OTHER,)])
def test_memory_stops_to_grow(keys: tuple[EdgeKey, ...]) -> None:
    stream = TransformStream(SOURCE, "map", "camera")
    feed(stream, [[STATIC], *seconds_of(keys, 0, 320)])
    stream.begin_run(StreamStatus())  # delays of a run are stored up to a limit
    before = len(pickle.dumps(stream))
    feed(stream, seconds_of(keys, 320, 500))
    stream.begin_run(StreamStatus())
    assert len(pickle.dumps(stream)) < 1.02 * before


def test_an_edge_waits_for_the_others_as_far_back_as_it_may(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("trajeval_ros.ros.transform_stream._MOST_TRANSFORMS", 100)
    stream = TransformStream(SOURCE, "map", "camera")
    feed(stream, [[STATIC], *seconds_of((MAP, ODOM), 0, 5)])
    assert stream.status.poses == 50
    assert not any(len(item.stamps) for item in feed(stream, seconds_of((MAP,), 5, 60)))
    after = [START + 60 * SECOND, START + 60 * SECOND + SECOND // 10]
    [result] = feed(stream, [[moving(ODOM, item) for item in after]])
    # Of 55 s without its fellow, what is held has a pose; never anything beyond the newest.
    newest = START + 60 * SECOND - SECOND // 10
    assert result.stamps.tolist() == [newest - row * SECOND // 10 for row in range(99, -1, -1)]


def test_other_trees_are_held_in_bounds_until_ours_is_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("trajeval_ros.ros.transform_stream._MOST_EDGES", 3)
    stream = TransformStream(SOURCE, "map", "camera")
    for stamp in (START, START + SECOND // 10):
        feed(stream, [[moving((f"a{row}", f"b{row}"), stamp) for row in range(10)]])
    assert "use one of a2, a1, a0, b2, b1, b0" in stream.trouble.text


def test_what_has_no_poses_yet_says_why() -> None:
    stream = TransformStream(SOURCE, "map", "camera")
    feed(stream, seconds_of((ODOM,), 0, 1))
    assert stream.trouble.text == "/tf:map.camera: unknown frame map; use one of odom, base"
    feed(stream, seconds_of((ODOM, MAP), 1, 2))
    assert (
        stream.trouble.text == "/tf:map.camera: unknown frame camera; use one of map, base, odom"
    )
    feed(stream, seconds_of((ODOM, MAP, ("elsewhere", "camera")), 2, 3))
    assert "camera is not connected to map; use one of" in stream.trouble.text
    feed(stream, [[STATIC], *seconds_of((ODOM, MAP), 3, 4)])
    assert stream.trouble is None
    assert stream.status.poses == 30


def test_poses_begin_when_the_leading_edge_is_known() -> None:
    stream = TransformStream(SOURCE, "map", "camera")
    feed(stream, [[STATIC], *seconds_of((MAP, ODOM), 0, 2)])
    assert "output starts 2 s after all its transforms are received" in stream.trouble.text
    assert stream.heard_at is None
    feed(stream, seconds_of((MAP, ODOM), 2, 3))
    assert stream.trouble is None
    assert stream.status.poses == 30
    assert stream.heard_at is not None


def test_frames_that_never_move_are_named() -> None:
    stream = TransformStream("/tf:base.camera", "base", "camera")
    feed(stream, [[STATIC], *seconds_of((ODOM,), 0, 1)])
    assert "all transforms between base and camera are static so far" in stream.trouble.text
    # What moves is no static frame, whichever comes first.
    feed(stream, [*seconds_of((CAMERA,), 1, 4), [STATIC]])
    assert stream.status.poses == 30


def test_a_user_is_warned_once_of_what_does_not_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trajeval_ros.ros.transform_stream._WARN_AFTER_S", -1.0)
    stream = TransformStream("/tf:map.camra", "map", "camra")
    feed(stream, [[STATIC], *seconds_of((MAP, ODOM), 0, 5)])
    for _ in range(3):
        stream.tell_trouble()
    [text] = stream.news
    assert text.text == "/tf:map.camra: unknown frame camra; use one of camera, map, odom, base"


def test_time_that_begins_anew_is_told() -> None:
    stream = TransformStream(SOURCE, "map", "camera")
    feed(stream, [[STATIC], *seconds_of((MAP, ODOM), 10, 20)])
    feed(stream, seconds_of((MAP, ODOM), 0, 3))
    [text] = stream.news
    assert "/tf:map.camera: timestamps step back by " in text.text
    assert stream.status.poses == 100


def test_damaged_messages_are_counted() -> None:
    stream = TransformStream(SOURCE, "map", "camera")
    stream.hold([b"\0\1\0\0", transforms_message(STATIC.transform)])
    stream.poses("", [transforms_message(STATIC.transform)[:40]], np.array([START]))
    assert stream.status.dropped == {"undecodable": 2}
