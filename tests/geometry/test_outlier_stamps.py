"""Stamps that stand alone: dropped, live as in a bag; time that jumps is not."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_runs import COUNT, ESTIMATE, GROUNDTRUTH, Live
from ros_bags import ODOM, POSE, Message, messages_of, write_messages
from ros_processes import assert_same, offline
from strategies import make_pair, seeds

from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.outlier_stamps import OutlierStamps, trusted_states
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory

SECOND = 10**9
STEPS = SECOND // 10 * np.arange(100)


def kept(stamps: Sequence[int]) -> list[int]:
    """Return the stamps that are trusted, seconds for nanoseconds."""
    in_ns = np.round(np.array(stamps) * SECOND).astype(np.int64)
    rows, trust = trusted_states(in_ns)
    assert trust.isolated == len(stamps) - len(rows)
    return [stamps[row] for row in rows]


@pytest.mark.parametrize(
    ("stamps", "isolated"),
    [
        ([0.0, 0.5, 3600.0, 1.0, 1.5], [3600.0]),
        ([0.0, 0.5, -3600.0, 1.0, 1.5], [-3600.0]),
        ([3600.0, 0.0, 0.5, 1.0], [3600.0]),
        ([0.0, 0.5, 1.0, 3600.0], [3600.0]),
        ([0.0, 0.5, 1.0, 30.0], []),  # the last one of a stream, after a gap
        ([0.0, 0.5, 100.0, 3600.0, 1.0], [100.0, 3600.0]),
        ([0.0, 0.5, 3600.0, 100.0, 1.0], [100.0, 3600.0]),
        ([0.0, 0.5, 3600.0, 3600.0, 1.0], [3600.0, 3600.0]),  # one and the same
        ([0.0, 0.5, -30.0, 1.0, -29.5, 1.5], [-30.0, -29.5]),  # poses of long ago in between
        ([0.0, 0.5, 3600.0, 3600.5, 3601.0], []),  # time has jumped
        ([100.0, 100.5, 0.0, 0.5, 1.0], []),  # and begun anew
        ([0.0, 5.0, 10.0, 15.0, 20.0], []),  # a slow stream
        ([7.0], []),
        ([0.0, 100.0], []),
        ([0.0, 0.2, 0.1, 0.3], []),  # overtaken
    ],
)
def test_what_stands_alone_is_dropped(stamps: list[float], isolated: list[float]) -> None:
    assert kept(stamps) == [stamp for stamp in stamps if stamp not in isolated]


@given(
    stamps=st.lists(st.one_of(st.integers(0, 40), st.integers(-(10**5), 10**5)), max_size=40),
    cuts=st.lists(st.integers(0, 40), max_size=8),
)
def test_batches_don_t_matter(stamps: list[int], cuts: list[int]) -> None:
    in_ns = np.array(stamps, dtype=np.int64) * (SECOND // 4)
    expected, whole = trusted_states(in_ns)
    trust = OutlierStamps()
    parts = np.split(np.arange(len(in_ns)), sorted(cuts))
    result = [trust.take(in_ns[part], part)[1] for part in parts]
    result.append(trust.take(in_ns[:0], np.arange(0), at_end=True)[1])
    np.testing.assert_array_equal(np.concatenate(result), expected)
    assert (trust.isolated, trust.message) == (whole.isolated, whole.message)


@pytest.mark.slow
def test_nothing_waits_for_ever() -> None:
    trust = OutlierStamps()
    stuck = np.full(10_000, 5 * SECOND)
    passed = sum(len(trust.take(word)[0]) for word in np.split(stuck, 100))
    assert passed >= 9_000


def spoiled(side: Trajectory, faults: dict[int, float]) -> Trajectory:
    """Return a trajectory with stamps wrong by so many seconds, by row."""
    stamps = side.stamps.copy()
    for row, wrong_s in faults.items():
        stamps[row] += round(wrong_s * SECOND)
    return dataclasses.replace(side, stamps=stamps)


wrong = st.dictionaries(
    st.integers(0, COUNT // 2),
    st.one_of(st.floats(-1e5, -2e2), st.floats(2e2, 1e8)),
    max_size=4,
)


@pytest.mark.slow
@settings(max_examples=8)
@given(seed=seeds, groundtruth_faults=wrong, faults=wrong, batch=st.integers(1, 50))
def test_live_is_offline_whatever_stamps_are_wrong(
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    groundtruth_faults: dict[int, float],
    faults: dict[int, float],
    batch: int,
) -> None:
    folder = tmp_path_factory.mktemp("run")
    feed = faulty_messages(seed, groundtruth_faults, faults)
    write_messages(folder / "bag", feed)
    live = Live(folder / "live", ODOM)
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    live.end()
    expected = offline(
        folder / "bag", folder, GROUNDTRUTH, [ESTIMATE], "--gauge", "yaw", "--lengths", "2,4"
    )
    assert_same(live.result, expected)


def faulty_messages(
    seed: int, groundtruth_faults: dict[int, float], faults: dict[int, float]
) -> list[Message]:
    """Return both topics' messages in order of their true stamps, some with wrong ones."""
    pair = make_pair(seed, COUNT, smooth=True)
    result = []
    for side, topic, kind, wrong_s in (
        (pair.groundtruth, GROUNDTRUTH, POSE, groundtruth_faults),
        (pair.estimate, ESTIMATE, ODOM, faults),
    ):
        wrong_s = {row % len(side): item for row, item in wrong_s.items()}
        written = messages_of(spoiled(side, wrong_s), topic, kind)
        for (name, of, _, payload), logged in zip(written, side.stamps.tolist(), strict=True):
            result.append((name, of, logged, payload))
    return sorted(result, key=lambda item: item[2])


@pytest.mark.slow
def test_one_stamp_of_the_future_costs_one_pair_and_is_told(tmp_path: Path) -> None:
    clean, faulty = faulty_messages(3, {}, {}), faulty_messages(3, {40: 3600.0}, {30: 7200.0})
    counts = []
    for name, feed in (("clean", clean), ("faulty", faulty)):
        live = Live(tmp_path / name, ODOM)
        for message in feed:
            live.feed([message])
        live.end()
        [run] = live.result["runs"]
        counts.append(run["association"]["pairs"])
    assert counts[0] - 3 <= counts[1] < counts[0]  # and those beside the groundtruth that is gone
    assert run["association"]["dropped"]["lone_stamp"] == 1
    [told] = [item.text for item in live.estimate.stream.news]
    assert told.startswith("/vio: 1 pose dropped: its timestamp differs by 7200 s")
    assert live.estimate.stream.status.duration_s < 3600.0
    write_messages(tmp_path / "bag", faulty)
    read = read_trajectory(f"{tmp_path / 'bag'}:{ESTIMATE}")
    assert read.reading.dropped["lone_stamp"] == 1
    assert any(
        "1 pose dropped: its timestamp differs by 7200 s" in sentence
        for sentence in read.reading.messages(Level.NOTE)
    )
