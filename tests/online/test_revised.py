"""Paths that are published anew: which poses are new, and the error of the newest version."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from state_rows import states, trajectory
from strategies import make_pair, seeds

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.whole_run import RevisedPath, evaluation_of
from trajeval_ros.pipeline.pipeline import evaluate


def rmse_m(path: RevisedPath, gauge: Gauge) -> float | None:
    protocol = Protocol(gauge=gauge, lengths=())
    evaluation = evaluation_of(path.pairs(), protocol)
    position = None if evaluation is None else evaluation.ate["position_m"]
    return None if position is None else position.rmse


@given(
    versions=st.lists(
        st.lists(st.integers(0, 40), unique=True).map(sorted), min_size=1, max_size=8
    )
)
def test_a_pose_is_new_once(versions: list[list[int]]) -> None:
    path, seen = RevisedPath(Gauge.SE3), set[int]()
    assert len(versions) > 0
    for version in versions:
        stamps = np.array(version, dtype=np.int64)
        poses = states(np.zeros((len(stamps), 3)), np.ones((len(stamps), 4)))
        rows = path.renew(trajectory(stamps, poses))
        assert stamps[rows].tolist() == [item for item in version if item not in seen]
        seen.update(version)


@pytest.mark.slow
@given(seed=seeds, gauge=st.sampled_from([Gauge.YAW, Gauge.SE3, Gauge.SIM3, Gauge.PLANAR]))
def test_the_newest_version_is_judged(seed: int, gauge: Gauge) -> None:
    pair = make_pair(seed, 120, smooth=True)
    protocol = Protocol(gauge=gauge, lengths=())
    evaluation = evaluate(pair.groundtruth, pair.estimate, protocol)
    evaluator = OnlineEvaluator(OnlineSettings(protocol))
    rows = states(pair.groundtruth.positions, pair.groundtruth.quaternions)
    evaluator.add_groundtruth(trajectory(pair.groundtruth.stamps, rows))
    path = RevisedPath(gauge)
    stamps = pair.estimate.stamps
    final = states(pair.estimate.positions, pair.estimate.quaternions)
    for end in range(10, len(stamps) + 10, 10):
        earlier = final[:end].copy()
        earlier[:, :3] += 0.3 * (end < len(stamps))  # the last version corrects the others
        new = path.renew(trajectory(stamps[:end], earlier))
        evaluator.add_estimate(trajectory(stamps[:end][new], earlier[new]))
    pairs = evaluator.made(at_end=True)
    assert pairs is not None
    path.record(pairs)
    expected = evaluation.ate["position_m"]
    assert expected is not None
    assert rmse_m(path, gauge) == pytest.approx(expected.rmse, rel=1e-9)


def test_poses_that_the_newest_version_lacks_are_left_out() -> None:
    pair = make_pair(1, 120, smooth=True)
    result = associate(pair.groundtruth, pair.estimate, Protocol().association)
    path = RevisedPath(Gauge.SE3)
    path.renew(pair.estimate)
    path.record(PairedStates(result.groundtruth, result.estimate))
    whole = rmse_m(path, Gauge.SE3)
    assert not len(path.renew(pair.estimate[np.delete(np.arange(len(pair.estimate)), [3, 5])]))
    assert len(path.path) == len(pair.estimate) - 2
    assert rmse_m(path, Gauge.SE3) == pytest.approx(whole, rel=0.1)


def test_without_groundtruth_or_motion_there_is_no_number() -> None:
    path = RevisedPath(Gauge.SE3)
    stamps = np.arange(2, dtype=np.int64)
    still = trajectory(stamps, states(np.zeros((2, 3)), np.ones((2, 4))))
    path.renew(still)
    assert rmse_m(path, Gauge.SE3) is None
    path.record(PairedStates(still, still))
    assert rmse_m(path, Gauge.SE3) is None
