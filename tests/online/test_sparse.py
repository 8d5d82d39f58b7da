"""Live pairs at the stamps of fixes and points: the same as recorded ones, however they arrive."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from state_rows import states, trajectory

from trajeval_ros import OnlineEvaluator, OnlineSettings, Protocol, evaluate, simulate
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.evaluation import Evaluation, evaluate_pairs

FLIGHT = simulate(seed=5, duration_s=30.0)
LEVER = (0.3, -0.1, 0.5)


def points(lever: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Trajectory:
    """Return the antenna of the flight 2.5 times a second, some of it beyond the estimate."""
    groundtruth = FLIGHT.groundtruth[::80]
    assert groundtruth.rotations is not None
    return Trajectory(
        groundtruth.stamps, groundtruth.positions + groundtruth.rotations.apply(lever)
    )


def live(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol, chunk: int, late_s: float
) -> OnlineEvaluator:
    """Feed both sides as they arrive, the groundtruth later by a constant."""
    evaluator = OnlineEvaluator(OnlineSettings(protocol))
    late = round(late_s * 1e9)
    events = [(int(stamp) + late, 0, row) for row, stamp in enumerate(groundtruth.stamps)]
    events += [(int(stamp), 1, row) for row, stamp in enumerate(estimate.stamps)]
    events.sort()
    rows = states(groundtruth.positions), states(estimate.positions, estimate.quaternions)
    stamps = groundtruth.stamps, estimate.stamps
    for begin in range(0, len(events), chunk):
        for side in (0, 1):
            own = [row for _, of, row in events[begin : begin + chunk] if of == side]
            add = (evaluator.add_groundtruth, evaluator.add_estimate)[side]
            if own:
                add(trajectory(stamps[side][own], rows[side][own]))
        evaluator.update()
    evaluator.update(at_end=True)
    return evaluator


def assert_same(evaluator: OnlineEvaluator, offline: Evaluation) -> None:
    pairs, snapshot = evaluator.association(), evaluator.snapshot()
    np.testing.assert_array_equal(pairs.groundtruth.stamps, offline.association.groundtruth.stamps)
    assert pairs.rule.method == offline.association.rule.method == "groundtruth-stamps"
    assert pairs.dropped == offline.association.dropped
    assert pairs.coverage == offline.association.coverage
    assert pairs.estimate_coverage is None
    ate = offline.ate["position_m"]
    assert ate is not None
    assert snapshot.position_rmse_m == pytest.approx(ate.rmse, rel=1e-9)
    for name in ("position_m", "horizontal_m", "vertical_m"):
        mine, yours = snapshot.ate[name], offline.ate[name]
        if yours is None:  # a plane has no vertical errors
            continue
        assert mine is not None
        assert dataclasses.astuple(mine) == pytest.approx(dataclasses.astuple(yours), rel=1e-9)
    at_end = evaluate_pairs(pairs, pairs.groundtruth, pairs.estimate, offline.protocol)
    for mine, yours in zip(at_end.relative or (), offline.relative or (), strict=True):
        np.testing.assert_allclose(mine.errors.position_m, yours.errors.position_m, atol=1e-9)


@pytest.mark.parametrize("gauge", ["yaw", "planar", "se3", "none"])
@settings(max_examples=5)
@given(
    chunk=st.sampled_from([7, 60, 1000]),
    late_s=st.sampled_from([-0.2, 0.0, 3.0]),
    arm=st.booleans(),
    offset_s=st.sampled_from([0.0, 0.013]),
)
def test_live_is_offline(
    gauge: str, chunk: int, late_s: float, arm: bool, offset_s: float
) -> None:
    lever = LEVER if arm else None
    protocol = Protocol(
        gauge=gauge, lever_m=lever, association=AssociationRule(time_offset_s=offset_s)
    )
    # The estimate begins late and ends early, and has a gap.
    estimate = FLIGHT.estimate[40:-60]
    groundtruth = points(LEVER)
    assert_same(
        live(groundtruth, estimate, protocol, chunk, late_s),
        evaluate(groundtruth, estimate, protocol),
    )


def test_poses_are_paired_at_the_estimate_s_stamps_as_before() -> None:
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge="yaw")))
    groundtruth = FLIGHT.groundtruth
    evaluator.add_groundtruth(
        trajectory(groundtruth.stamps, states(groundtruth.positions, groundtruth.quaternions))
    )
    estimate = FLIGHT.estimate
    evaluator.add_estimate(
        trajectory(estimate.stamps, states(estimate.positions, estimate.quaternions))
    )
    evaluator.update(at_end=True)
    assert evaluator.association().rule.method == "linear"


def test_estimates_that_came_before_any_fix_are_kept() -> None:
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge="yaw")))
    estimate, groundtruth = FLIGHT.estimate, points()
    rows = states(estimate.positions, estimate.quaternions)
    evaluator.add_estimate(trajectory(estimate.stamps, rows))
    evaluator.add_estimate(trajectory(estimate.stamps[-3:], rows[-3:]))  # again
    evaluator.update()
    evaluator.add_groundtruth(trajectory(groundtruth.stamps, states(groundtruth.positions)))
    evaluator.update(at_end=True)
    offline = evaluate(groundtruth, estimate, Protocol(gauge="yaw"))
    assert evaluator.pairs == len(offline.association)
    assert evaluator.snapshot().dropped["duplicate_stamp"] == 3


def test_a_fix_that_comes_when_the_estimate_is_forgotten_is_too_late() -> None:
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge="yaw")))
    estimate, groundtruth = FLIGHT.estimate, points()
    evaluator.add_groundtruth(
        trajectory(groundtruth.stamps[-1:], states(groundtruth.positions[-1:]))
    )
    rows = states(estimate.positions, estimate.quaternions)
    evaluator.add_estimate(trajectory(estimate.stamps, rows))
    evaluator.update()
    evaluator.add_groundtruth(
        trajectory(groundtruth.stamps[5:10], states(groundtruth.positions[5:10]))
    )
    evaluator.update(at_end=True)
    assert evaluator.snapshot().dropped["too_late"] == 5
    assert (
        "5 fixes or points dropped: later than the estimate buffer of 10 s"
        in evaluator.buffer.why_forgotten
    )


def test_a_lever_arm_wants_orientations() -> None:
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge="yaw", lever_m=LEVER)))
    groundtruth = points()
    evaluator.add_groundtruth(trajectory(groundtruth.stamps, states(groundtruth.positions)))
    with pytest.raises(InputError, match="no orientations"):
        evaluator.add_estimate(
            trajectory(FLIGHT.estimate.stamps, states(FLIGHT.estimate.positions))
        )


def test_weights_need_the_whole_recording() -> None:
    with pytest.raises(SettingsError, match="weights of the alignment are not supported live"):
        OnlineSettings(Protocol(gauge="yaw", align_weights="groundtruth-covariance"))
