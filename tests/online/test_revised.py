"""Paths that are published anew: which poses are new, and the error of the newest version."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import make_pair, seeds

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.up_axis import Z_UP
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.state_rows import Pairs, states, trajectory
from trajeval_ros.online.whole_run import RevisedPath, evaluate_rows
from trajeval_ros.pipeline.pipeline import evaluate


def rmse_m(path: RevisedPath, gauge: Gauge) -> float | None:
    protocol = Protocol(gauge=gauge, lengths=())
    evaluation = evaluate_rows(path.pairs(), protocol, (Z_UP, Z_UP))
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
        rows = path.renew(stamps, states(np.zeros((len(stamps), 3)), np.ones((len(stamps), 4))))
        assert stamps[rows].tolist() == [each for each in version if each not in seen]
        seen.update(version)


@given(seed=seeds, gauge=st.sampled_from([Gauge.YAW, Gauge.SE3, Gauge.SIM3, Gauge.PLANAR]))
def test_the_newest_version_is_judged(seed: int, gauge: Gauge) -> None:
    pair = make_pair(seed, 120, smooth=True)
    protocol = Protocol(gauge=gauge, lengths=())
    evaluation = evaluate(pair.groundtruth, pair.estimate, protocol)
    record: list[PairedStates] = []
    evaluator = OnlineEvaluator(OnlineSettings(protocol), record=record.append)
    rows = states(pair.groundtruth.positions, pair.groundtruth.quaternions)
    evaluator.add_groundtruth(trajectory(pair.groundtruth.stamps, rows))
    path = RevisedPath(gauge)
    stamps = pair.estimate.stamps
    final = states(pair.estimate.positions, pair.estimate.quaternions)
    for end in range(10, len(stamps) + 10, 10):
        earlier = final[:end].copy()
        earlier[:, :3] += 0.3 * (end < len(stamps))  # the last version corrects the others
        new = path.renew(stamps[:end], earlier)
        evaluator.add_estimate(trajectory(stamps[:end][new], earlier[new]))
    evaluator.update(at_end=True)
    for pairs in record:
        path.record(pairs.rows)
    expected = evaluation.ate["position_m"]
    assert expected is not None
    assert rmse_m(path, gauge) == pytest.approx(expected.rmse, rel=1e-9)


def test_poses_of_the_newest_version_that_are_none_are_left_out() -> None:
    pair = make_pair(1, 120, smooth=True)
    groundtruth = associate(pair.groundtruth, pair.estimate, Protocol().association).groundtruth
    path = RevisedPath(Gauge.SE3)
    rows = states(pair.estimate.positions, pair.estimate.quaternions)
    path.renew(pair.estimate.stamps, rows)
    path.record(
        Pairs(groundtruth.stamps, states(groundtruth.positions), states(groundtruth.positions))
    )
    whole = rmse_m(path, Gauge.SE3)
    broken = rows.copy()
    broken[3, 0], broken[5, 3:7] = np.nan, np.inf
    assert not len(path.renew(pair.estimate.stamps, broken))
    assert len(path.stamps) == len(rows) - 2
    assert np.isfinite(path.states[:, :7]).all()
    assert rmse_m(path, Gauge.SE3) == pytest.approx(whole, rel=0.1)


def test_without_groundtruth_or_motion_there_is_no_number() -> None:
    path = RevisedPath(Gauge.SE3)
    stamps = np.arange(2, dtype=np.int64)
    rows = states(np.zeros((2, 3)), np.ones((2, 4)))
    path.renew(stamps, rows)
    assert rmse_m(path, Gauge.SE3) is None
    path.record(Pairs(stamps, rows, rows))
    assert rmse_m(path, Gauge.SE3) is None
