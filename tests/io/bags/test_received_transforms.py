"""Transforms as a receiver knows them, against a receiver that takes them one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from strategies import seeds

from trajeval_ros.geometry.source_info import ReceiveTimes
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.received_transforms import (
    ReceivedChain,
    Transforms,
    compose_received,
    transforms_of,
)
from trajeval_ros.io.bags.transform_tree import Edge, find_chain
from trajeval_ros.metrics.stream_health import UNKNOWN

Array = NDArray[Any]
STEP = 10**7
NOTHING = np.empty((0, 7))
MOVING = Edge.from_columns(np.empty(0, np.int64), NOTHING, is_static=False)
MAP, ODOM, ARM, FIXED = ("map", "odom"), ("odom", "base"), ("tip", "base"), ("tip", "tool")


def columns_of(poses: Trajectory) -> dict[str, Array]:
    receive_times = poses.reading.receive_times
    assert receive_times is not None
    assert receive_times.corrected is not None
    assert poses.quaternions is not None
    return {
        "stamps": poses.stamps,
        "positions": poses.positions,
        "quaternions": poses.quaternions,
        "times": receive_times.times,
        "corrected": receive_times.corrected,
    }


def as_matrix(numbers: Array) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3]
    return matrix


@settings(max_examples=12)
@given(seed=seeds, delay=st.integers(1, 8), ahead=st.integers(-20, 20))
def test_a_pose_is_of_the_newest_transforms_that_were_received(
    seed: int, delay: int, ahead: int
) -> None:
    """Corrections may be dated ahead; of the leading edge, late transforms are never in use."""
    rng = np.random.default_rng(seed)
    received, edges = {}, {}
    for key, count, shift in ((MAP, 6, ahead), (ODOM, 40, 0), (ARM, 12, 0)):
        stamps = 1000 * STEP + np.sort(rng.choice(60, size=count, replace=False)) * STEP
        stamps[[0, -1]] = [1000 * STEP, 1060 * STEP]
        times = stamps + rng.integers(0, delay * 2, size=count) * STEP // 2 + STEP // 2
        numbers = rng.normal(size=(count, 7))
        numbers[:, 3:] /= np.linalg.norm(numbers[:, 3:], axis=1)[:, None]
        dated = stamps + shift * STEP
        order = np.argsort(times, kind="stable")
        received[key] = transforms_of(dated[order], numbers[order], times[order])
        edges[key] = Edge.from_columns(dated, numbers, is_static=False)
    fixed = rng.normal(size=(1, 7))
    edges[FIXED] = Edge.from_columns(np.zeros(1, dtype=np.int64), fixed, is_static=True)
    by = {key: (item, ReceiveTimes(item["time"])) for key, item in received.items()}
    way, leading, _ = find_chain(edges, "map", "tool", "t")
    assert leading == ODOM
    result = compose_received(ReceivedChain(edges, way, leading), by)
    receive_times = result.reading.receive_times
    assert receive_times is not None
    assert receive_times.corrected is not None
    assert result.quaternions is not None
    odometry = received[ODOM]  # it has the most transforms
    is_newer = np.diff(np.maximum.accumulate(odometry["stamp"]), prepend=0) > 0
    used = [received[MAP]["time"], received[ARM]["time"], odometry["time"][is_newer]]
    events = sorted({int(at) for times in used for at in times})
    first = max(int(item["time"].min()) for item in received.values())
    events = [event for event in events if event >= first]
    assert receive_times.times.tolist() == events
    for row, now in enumerate(events):
        product, corrected = np.eye(4), 0
        for key, power in ((MAP, 1), (ODOM, 1), (ARM, -1), (FIXED, 1)):
            if key == FIXED:
                numbers = np.hstack([edges[FIXED].translations, edges[FIXED].quaternions])[0]
                product = product @ as_matrix(numbers)
                continue
            item = received[key]
            known = np.flatnonzero(item["time"] <= now)
            newest = known[-1]
            if key == ODOM:
                newest = known[int(item["stamp"][known].argmax())]
                assert result.stamps[row] == item["stamp"][newest]
            else:
                corrected = max(corrected, int(item["time"][newest]))
            product = product @ np.linalg.matrix_power(as_matrix(item["numbers"][newest]), power)
        assert receive_times.corrected[row] == corrected
        np.testing.assert_allclose(result.positions[row], product[:3, 3], atol=1e-12)
        rotated = Rotation.from_quat(result.quaternions[row]).as_matrix()
        np.testing.assert_allclose(rotated, product[:3, :3], atol=1e-12)


@pytest.mark.slow
@settings(max_examples=12)
@given(seed=seeds, parts=st.integers(1, 200), seconds=st.sampled_from([40, 4000]))
def test_poses_do_not_depend_on_the_batches_of_transforms(
    seed: int, parts: int, seconds: int
) -> None:
    """Corrections come seldom; the leading edge has isolated timestamps, or is slow."""
    rng = np.random.default_rng(seed)
    received: dict[tuple[str, str], Transforms] = {}
    for key, count in ((MAP, 8 if seconds == 40 else 200), (ODOM, 400)):
        times = 10**15 + np.sort(rng.integers(0, seconds * 10**9, size=count))
        stamps = times - rng.integers(0, 10**8, size=count)
        if key == ODOM:
            isolated = 20 * rng.integers(0, 20, size=12 if seconds == 40 else 0) + 5
            stamps[isolated] += rng.choice([-1, 1]) * 10**16
        else:
            stamps += rng.integers(-60 * 10**9, 60 * 10**9, size=count)
        numbers = rng.normal(size=(count, 7))
        numbers[rng.choice(count, size=count // 8), 3:] = 0.0
        received[key] = transforms_of(stamps, numbers, times)
    way = [(MAP, True), (ODOM, True)]
    expected = ReceivedChain({MAP: MOVING, ODOM: MOVING}, way, ODOM).poses(received, at_end=True)
    assert len(expected) > 50
    chain, result = ReceivedChain({MAP: MOVING, ODOM: MOVING}, way, ODOM), []
    edges = 10**15 + np.sort(rng.integers(0, seconds * 10**9, size=parts))
    for begin, end in zip([0, *edges], [*edges, 10**16], strict=True):
        new = {
            key: item[(item["time"] >= begin) & (item["time"] < end)]
            for key, item in received.items()
        }
        result.append(chain.poses(new, at_end=end == 10**16))
    for name, column in columns_of(expected).items():
        joined = np.concatenate([columns_of(item)[name] for item in result])
        np.testing.assert_allclose(joined, column, atol=1e-14, err_msg=name)


def test_a_transform_received_with_the_newest_pose_holds_just_after_it() -> None:
    """Simulated time stands still now and then, and messages of a topic can overtake others."""
    chain = ReceivedChain({MAP: MOVING, ODOM: MOVING}, [(MAP, True), (ODOM, True)], ODOM)
    rotation = [0.0, 0.0, 0.0, 1.0]

    def at(stamp: int, time: int, x: float) -> Transforms:
        return transforms_of(
            np.array([stamp]), np.array([[x, 0.0, 0.0, *rotation]]), np.array([time])
        )

    odometry = at(STEP, 9, 2.0)
    assert len(chain.poses({MAP: at(5, 9, 1.0), ODOM: odometry})) == 0  # the first waits
    first = columns_of(chain.poses({ODOM: at(STEP + 1, 10, 2.0)}))
    assert (first["times"].tolist(), first["positions"][:, 0].tolist()) == ([9, 10], [3.0, 3.0])
    for new, time, x in ((10, 11, 7.0), (4, 12, 9.0)):
        result = columns_of(chain.poses({MAP: at(6, new, x)}))
        assert (result["times"].tolist(), result["positions"][:, 0].tolist()) == (
            [time],
            [x + 2.0],
        )
        assert result["corrected"].tolist() == [time]
    unusable = [at(0, 20, 1.0), at(7, UNKNOWN, 1.0)]
    assert len(chain.poses({MAP: np.concatenate(unusable)})) == 0
