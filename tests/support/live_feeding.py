"""States handed to a live evaluator as they arrive, and its comparison with the offline one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from state_rows import states
from strategies import make_estimate, make_groundtruth

from trajeval_ros import Evaluation, Trajectory
from trajeval_ros.metrics.evaluation import evaluate_pairs
from trajeval_ros.online.evaluator import OnlineEvaluator

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
    begin = min(int(arrival.min()) for arrival in arrivals)
    end = max(int(arrival.max()) for arrival in arrivals)
    ticks = np.arange(begin, end + 2 * round(drain_s * SECOND), round(drain_s * SECOND))
    cuts = [np.searchsorted(np.maximum.accumulate(arrival), ticks) for arrival in arrivals]
    for before, after in zip(range(len(ticks) - 1), range(1, len(ticks)), strict=True):
        g, e = (slice(int(cut[before]), int(cut[after])) for cut in cuts)
        if g.start < g.stop:
            evaluator.add_groundtruth(groundtruth[g])
        if e.start < e.stop:
            evaluator.add_estimate(estimate[e])
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
    for segment, other in zip(live.relative or (), offline.relative or (), strict=True):
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
