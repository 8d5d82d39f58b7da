"""Transforms as a receiver knows them, against a receiver that takes them one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from strategies import seeds

from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.io.bags.received_transforms import ReceivedEdge, compose_received
from trajeval_ros.io.bags.transform_tree import Edge

Array = NDArray[Any]
STEP = 10**7
MAP, ODOM, ARM, FIXED = ("map", "odom"), ("odom", "base"), ("tip", "base"), ("tip", "tool")


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
        received[key] = ReceivedEdge(dated[order], numbers[order], Receptions(times[order]))
        edges[key] = Edge.from_columns(dated, numbers, is_static=False)
    fixed = rng.normal(size=(1, 7))
    edges[FIXED] = Edge.from_columns(np.zeros(1, dtype=np.int64), fixed, is_static=True)
    found = compose_received(edges, received, "map", "tool")
    receptions = found.reading.receptions
    assert receptions is not None
    assert receptions.corrected is not None
    assert found.quaternions is not None
    events = sorted({int(at) for each in received.values() for at in each.receptions.times})
    first = max(int(each.receptions.times.min()) for each in received.values())
    events = [each for each in events if each >= first]
    assert receptions.times.tolist() == events
    for row, now in enumerate(events):
        product, corrected = np.eye(4), 0
        for key, power in ((MAP, 1), (ODOM, 1), (ARM, -1), (FIXED, 1)):
            if key == FIXED:
                numbers = np.hstack([edges[FIXED].translations, edges[FIXED].quaternions])[0]
                product = product @ as_matrix(numbers)
                continue
            each = received[key]
            known = np.flatnonzero(each.receptions.times <= now)
            newest = known[-1]
            if key == ODOM:  # it has the most transforms
                newest = known[int(each.stamps[known].argmax())]
                assert found.stamps[row] == each.stamps[newest]
            else:
                corrected = max(corrected, int(each.receptions.times[newest]))
            product = product @ np.linalg.matrix_power(as_matrix(each.numbers[newest]), power)
        assert receptions.corrected[row] == corrected
        np.testing.assert_allclose(found.positions[row], product[:3, 3], atol=1e-12)
        turned = Rotation.from_quat(found.quaternions[row]).as_matrix()
        np.testing.assert_allclose(turned, product[:3, :3], atol=1e-12)
