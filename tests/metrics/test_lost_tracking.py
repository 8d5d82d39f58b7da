"""Frozen and diverging estimates are detected soon, at the right time, and nowhere else."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from state_rows import states
from strategies import make_element

from benchmarks.diagnosis_runs import DRIFTS, KINDS, simulated
from trajeval_ros.diagnosis.lost_tracking_tests import losses_in
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.discontinuities.events import Loss
from trajeval_ros.metrics.discontinuities.lost_tracking import TrackingLosses

PAIRS = {
    kind: associate(pair.truth, pair.estimate, pair.protocol.association)
    for kind in ("drone", "handheld")
    for pair in [simulated(31, kind, "walk", 60.0)]
}


def rows(trajectory: Trajectory) -> Floats:
    return states(trajectory.positions, trajectory.quaternions)


def frozen(trajectory: Trajectory, begin: int, end: int) -> Floats:
    poses = rows(trajectory)
    poses[begin:end] = poses[begin]
    return poses


def diverging(trajectory: Trajectory, begin: int, mps2: float) -> Floats:
    poses = rows(trajectory)
    since = np.clip(trajectory.seconds - trajectory.seconds[begin], 0.0, None)
    poses[:, :3] += np.outer(0.5 * mps2 * since**2, [0.0, 0.6, 0.8])
    return poses


def batches(
    stamps: Stamps, groundtruth: Floats, estimate: Floats, cuts: list[int]
) -> TrackingLosses:
    tracking = TrackingLosses(AssociationRule())
    for begin, end in itertools.pairwise([0, *sorted(cuts), len(stamps)]):
        tracking.add(stamps[begin:end], groundtruth[begin:end], estimate[begin:end])
    return tracking


def bumped(trajectory: Trajectory, begin: int, count: int) -> Floats:
    """Return poses that leave the path twice and come back, with an outlier after each."""
    poses = rows(trajectory)
    for first in (begin - 250, begin):
        poses[first : first + count, 0] += 0.05 * np.arange(len(poses[first : first + count]))
        poses[first + count + 20 : first + count + 21, 1] += 30.0
    return poses


@given(
    kind=st.sampled_from(sorted(PAIRS)),
    begin=st.integers(300, 900),
    count=st.integers(2, 400),
    cuts=st.lists(st.integers(1, 1100), max_size=20),
    fault=st.sampled_from(["diverging", "frozen", "bumped"]),
)
def test_losses_do_not_depend_on_batches(
    kind: str, begin: int, count: int, cuts: list[int], fault: str
) -> None:
    pairs = PAIRS[kind]
    poses = {
        "diverging": diverging(pairs.estimate, begin, 1.0),
        "frozen": frozen(pairs.estimate, begin, begin + count),
        "bumped": bumped(pairs.estimate, begin, count),
    }[fault]
    stamps, truth = pairs.estimate.stamps, rows(pairs.groundtruth)
    apart, whole = (batches(stamps, truth, poses, item).events for item in (cuts, []))
    assert whole or fault != "diverging"
    for one, other in zip(apart, whole, strict=True):
        # Products of small and of large batches round differently: some units in the last place.
        motions = {
            name: pytest.approx(getattr(other, name), rel=1e-12)
            for name in ("m", "deg", "moved_m")
        }
        assert dataclasses.asdict(one) == dataclasses.asdict(other) | motions


def delays(pairs_of: str, poses: Floats, begin: int) -> tuple[Loss, float, float]:
    """Return the loss, and the times of its warning and of its error after the onset, seconds."""
    pairs, tracking, result = (
        PAIRS[pairs_of],
        TrackingLosses(AssociationRule()),
        dict[bool, float](),
    )
    stamps, truth = pairs.estimate.stamps, rows(pairs.groundtruth)
    assert tracking.is_clear
    clear = 0
    for row in range(len(stamps)):
        tracking.add(*(column[row : row + 1] for column in (stamps, truth, poses)))
        loss = tracking.present
        clear = row if tracking.is_clear else clear
        if loss is not None:
            after_s = float(stamps[row] - stamps[begin]) / NANOSECONDS
            assert after_s > 0.0
            for level in (False, loss.s >= 3.0):
                result.setdefault(level, after_s)
    loss = tracking.present
    assert loss is not None
    assert begin - 1 <= clear < begin + 20
    assert loss.t_ns >= stamps[clear] - NANOSECONDS // 2
    return loss, result[False], result[True]


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(PAIRS))
@pytest.mark.parametrize("begin", [400, 550, 700])
def test_a_frozen_estimate_is_a_warning_in_2_s_and_an_error_in_5_s(kind: str, begin: int) -> None:
    poses = frozen(PAIRS[kind].estimate, begin, 10_000)
    loss, warned_s, error_s = delays(kind, poses, begin)
    assert loss.kind == "frozen"
    onset_s = (loss.t_ns - PAIRS[kind].estimate.stamps[begin]) / NANOSECONDS
    assert 0.0 <= onset_s < 1.0
    assert warned_s < 2.0
    assert error_s < 5.0


@pytest.mark.parametrize("kind", sorted(PAIRS))
@pytest.mark.parametrize("begin", [400, 550, 700])
def test_a_divergence_of_3_mps2_is_an_error_in_5_s(kind: str, begin: int) -> None:
    poses = diverging(PAIRS[kind].estimate, begin, 3.0)
    loss, _, error_s = delays(kind, poses, begin)
    assert loss.kind == "diverged"
    onset_s = (loss.t_ns - PAIRS[kind].estimate.stamps[begin]) / NANOSECONDS
    assert -1.0 < onset_s < 2.0
    assert error_s < 5.0


@pytest.mark.parametrize("drift", DRIFTS)
@pytest.mark.parametrize("kind", KINDS)
def test_drift_is_no_loss(kind: str, drift: str) -> None:
    pair = simulated(99_000, kind, drift, 120.0)
    pairs = associate(pair.truth, pair.estimate, pair.protocol.association)
    assert losses_in(pairs) == []


@given(seed=st.integers(0, 100), row=st.integers(50, 1000), metres=st.floats(0.0, 100.0))
def test_neither_another_frame_nor_a_jump_is_a_loss(seed: int, row: int, metres: float) -> None:
    pairs = PAIRS["drone"]
    estimate = make_element(Gauge.SIM3, seed).trajectory(pairs.estimate)
    poses = rows(estimate)
    restarted = make_element(Gauge.SE3, seed + 1).trajectory(estimate)
    poses[row:] = rows(restarted)[row:]
    poses[row:, :3] += metres  # a restart in another frame
    tracking = batches(pairs.estimate.stamps, rows(pairs.groundtruth), poses, [])
    assert tracking.events == []


def test_a_robot_at_rest_is_not_frozen() -> None:
    stamps = np.arange(600) * NANOSECONDS // 20
    truth = states(
        np.random.default_rng(0).normal(0.0, 0.003, (600, 3)), np.tile([0, 0, 0, 1.0], (600, 1))
    )
    still = states(np.zeros((600, 3)), np.tile([0, 0, 0, 1.0], (600, 1)))
    assert batches(stamps, truth, still, [100]).events == []


@given(row=st.integers(25, 598), cut=st.integers(1, 599), metres=st.floats(0.2, 100.0))
def test_an_outlier_of_the_groundtruth_at_rest_is_no_motion(
    row: int, cut: int, metres: float
) -> None:
    stamps, still = np.arange(600) * NANOSECONDS // 20, np.tile([0, 0, 0, 1.0], (600, 1))
    truth = states(np.zeros((600, 3)), still)
    truth[row, 0] = metres
    estimate = states(np.zeros((600, 3)), still)
    assert batches(stamps, truth, estimate, [cut]).events == []
    truth[row + 1, 0] = metres  # two in succession are a motion
    assert len(batches(stamps, truth, estimate, [cut]).events) == 1


@given(cut=st.integers(1, 599), more_ns=st.integers(0, NANOSECONDS))
@example(cut=450, more_ns=450_000_000)
@example(cut=480, more_ns=450_000_001)
def test_long_steps_are_no_frozen_time(cut: int, more_ns: int) -> None:
    stamps = np.arange(600) * NANOSECONDS // 20
    for row in (100, 450):
        stamps[row:] += more_ns
    truth = states(
        np.outer(0.05 * np.arange(600), [1.0, 0.0, 0.0]), np.tile([0, 0, 0, 1.0], (600, 1))
    )
    estimate = truth.copy()
    estimate[300:500] = truth[300]
    tracking = TrackingLosses(AssociationRule(), diverging=False)
    for part in (slice(0, cut), slice(cut, None)):
        tracking.add(stamps[part], truth[part], estimate[part])
    (loss,) = tracking.events
    step_ns = NANOSECONDS // 20 + more_ns
    expected_ns = loss.end_ns - loss.t_ns - (step_ns if step_ns > NANOSECONDS // 2 else 0)
    assert tracking.frozen_ns == expected_ns


@pytest.mark.parametrize("count", [200, 600])
@pytest.mark.parametrize("rotates", [False, True])
def test_frozen_time_is_not_covered(count: int, *, rotates: bool) -> None:
    """Also if the rotation lives, or repeats for a part of the time."""
    pair = simulated(31, "drone", "walk", 60.0)
    poses = frozen(pair.estimate, 400, 400 + count)
    if rotates:
        poses[450:, 3:7] = rows(pair.estimate)[450:, 3:7]
    estimate = Trajectory(pair.estimate.stamps, poses[:, :3], poses[:, 3:7])
    before, after = (
        associate(pair.truth, item, pair.protocol.association).coverage.covered
        for item in (pair.estimate, estimate)
    )
    frozen_s = (count - 1) / 20.0
    assert before - after == pytest.approx(frozen_s / 60.0, abs=1.0 / 60.0)
