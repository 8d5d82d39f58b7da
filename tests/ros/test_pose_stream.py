"""Messages of a topic become the same states in whatever batches they arrive."""

from __future__ import annotations

import dataclasses
from functools import reduce

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from ros_bags import ODOM, POSE, messages_of
from strategies import make_groundtruth, seeds

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.online.state_buffer import joined
from trajeval_ros.ros.poses import PoseStream, arrivals_of

COUNT = 30
FAR_NS = 10**15  # of a clock that was not set


def source(seed: int, isolated: int) -> Trajectory:
    """Return states at 20 Hz with covariances; the timestamp of one is far from all others."""
    states = make_groundtruth(seed, COUNT)
    halves = np.random.default_rng(seed).normal(size=(COUNT, 6, 6))
    stamps = 10**18 + 50_000_000 * np.arange(COUNT)
    stamps[isolated] += FAR_NS
    covariances = halves @ halves.swapaxes(1, 2)
    return dataclasses.replace(states, stamps=stamps, covariances=covariances)


@settings(max_examples=30, deadline=None)
@given(
    seed=seeds,
    isolated=st.integers(0, COUNT - 1),
    cuts=st.lists(st.integers(1, COUNT - 1), max_size=6, unique=True).map(sorted),
    kind=st.sampled_from([ODOM, POSE]),
)
def test_batches_do_not_matter(seed: int, isolated: int, cuts: list[int], kind: str) -> None:
    states = source(seed, isolated)
    payloads = [payload for *_, payload in messages_of(states, "/vio", kind)]
    arrived = 10**18 + 50_000_000 * np.arange(COUNT) + 7
    stream, result, rows = PoseStream("/vio", covariances=True), [], []
    for part in np.split(np.arange(COUNT), cuts):
        block, of = stream.poses(kind, [payloads[row] for row in part], arrived[part])
        result.append(block)
        rows += (part[of] if len(part) else of).tolist()
    result.append(stream.last_poses())
    live = reduce(joined, [block for block in result if len(block)])
    kept = np.delete(np.arange(COUNT), isolated)
    np.testing.assert_array_equal(live.stamps, states.stamps[kept])
    np.testing.assert_array_equal(live.positions, states.positions[kept])
    np.testing.assert_array_equal(arrivals_of(live), arrived[kept])
    assert live.quaternions is not None
    np.testing.assert_allclose(live.quaternions, states.known_quaternions[kept], atol=1e-15)
    if kind == ODOM:
        assert live.covariances is not None
        assert states.covariances is not None
        np.testing.assert_array_equal(live.covariances, states.covariances[kept])
    else:
        assert live.covariances is None
    assert stream.status.dropped == {"lone_stamp": 1}
    assert stream.status.poses == COUNT - 1
    # A state that waited has the row of the first message of its batch.
    assert all(row >= message for row, message in zip(rows, kept.tolist(), strict=False))
