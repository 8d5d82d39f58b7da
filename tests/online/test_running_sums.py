"""Sums over a run, however it comes in batches and whatever has been forgotten."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_feeding import rows_of
from numpy.typing import NDArray
from state_rows import states, trajectory
from strategies import make_element, make_groundtruth, seeds

from trajeval_ros import Gauge, Protocol, Trajectory, evaluate
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.coverage import time_without_gaps
from trajeval_ros.online import live_alignment
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_alignment import LiveAlignment
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import PairedStates, Pairing
from trajeval_ros.online.state_buffer import BufferLimits

Array = NDArray[Any]
SECOND = 10**9
RULE = AssociationRule()


def uneven(seed: int, count: int) -> Array:
    """Return timestamps with steps of all sizes, among them gaps."""
    rng = np.random.default_rng(seed)
    steps = rng.choice([10, 45, 60, 200, 499, 500, 501, 900], size=count) * 1_000_000
    return np.cumsum(steps).astype(np.int64)


@settings(max_examples=12)
@given(seed=seeds, past_s=st.sampled_from([0.1, 1.0, 5.0, np.inf]), size=st.integers(1, 40))
def test_what_is_forgotten_stays_in_the_sums(seed: int, past_s: float, size: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = uneven(seed, 120)
    truth = states(rng.normal(size=(120, 3)))
    pairing = Pairing(limits=BufferLimits(past_s))
    for begin in range(0, 120, size):
        rows = slice(begin, begin + size)
        pairing.add_groundtruth(trajectory(stamps[rows], truth[rows]))
        pairing.add_estimate(trajectory(stamps[rows] - 1, truth[rows]))
        pairing.made()
        pairing.forget()
        end = min(begin + size, 120)
        assert pairing.groundtruth_count == end
        assert pairing.groundtruth_time == time_without_gaps(stamps[:end], RULE)
        steps = np.linalg.norm(np.diff(truth[:end, :3], axis=0), axis=1)
        assert pairing.groundtruth_path_m == pytest.approx(steps.sum(), rel=1e-12)
        assert pairing.estimate_count == end
        if np.isinf(past_s):
            assert len(pairing.groundtruth) == end
        else:
            held = pairing.groundtruth.stamps
            # One state before the horizon is kept, for the interpolation.
            horizon = stamps[end - 1] - round(past_s * SECOND)
            assert held[0] <= max(horizon, stamps[0])
            assert (held[1:] > horizon).all() or held[0] == stamps[0]


@settings(max_examples=12)
@given(seed=seeds, size=st.integers(1, 30))
def test_points_have_a_path_and_a_time_of_their_own(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = uneven(seed, 60)
    points, estimate = states(rng.normal(size=(60, 3))), states(rng.normal(size=(60, 3)))
    pairing, missing, count = (
        Pairing(AssociationRule("groundtruth-stamps"), BufferLimits(2.0)),
        0,
        0,
    )
    for begin in range(0, 60, size):
        rows = slice(begin, begin + size)
        pairing.add_groundtruth(trajectory(stamps[rows], points[rows]))
        pairing.add_estimate(trajectory(stamps[rows] + 3, estimate[rows]))
        pairs = pairing.made(at_end=begin + size >= 60)
        decided = np.concatenate([[], *(part.paired for part in pairing.take_decided())])
        assert np.count_nonzero(decided) == (0 if pairs is None else len(pairs))
        count += np.count_nonzero(decided)
        missing += np.count_nonzero(decided == 0)
        pairing.forget()
        done = pairing.groundtruth_count
        assert done == count + missing
        assert pairing.groundtruth_time == (stamps[done - 1] - stamps[0] if done else 0)
        steps = np.linalg.norm(np.diff(points[:done, :3], axis=0), axis=1)
        assert pairing.groundtruth_path_m == pytest.approx(steps.sum(), rel=1e-12)
        assert pairing.estimate_count == min(begin + size, 60)
    assert pairing.groundtruth_count == 60


def sides_of(pairs: PairedStates) -> tuple[Trajectory, Trajectory]:
    return pairs.groundtruth, pairs.estimate


def pairs_of(seed: int, count: int) -> PairedStates:
    """Return pairs of a motion and of a noisy estimate of it in another frame."""
    groundtruth = make_groundtruth(seed, count)
    estimate = make_element(Gauge.SIM3, seed).trajectory(groundtruth)
    noise = 0.02 * np.random.default_rng(seed).normal(size=(count, 3))
    rows = states(estimate.positions + noise, estimate.quaternions)
    groundtruth = trajectory(groundtruth.stamps, rows_of(groundtruth))
    return PairedStates(groundtruth, trajectory(groundtruth.stamps, rows))


@pytest.mark.parametrize(
    ("std_deg", "is_kept"), [(None, True), (0.999, True), (1.0, False), (25.04, False)]
)
def test_an_alignment_is_frozen_below_a_degree(std_deg: float | None, *, is_kept: bool) -> None:
    freedom: Any = None
    if std_deg is not None:
        freedom = SimpleNamespace(std_deg=std_deg, undetermined="")
    solved = Alignment(Similarity.identity(), 30, freedom)
    for freezes in (True, False):
        aligning = LiveAlignment(Protocol(gauge=Gauge.SE3), freezes=freezes)
        with mock.patch.object(live_alignment, "solve", return_value=solved):
            aligning.add(pairs_of(1, 30))
        assert aligning.alignment is not None
        assert aligning.is_kept == (is_kept and freezes)
        if is_kept or not freezes:
            assert aligning.why_not == ""
        else:
            text = f"standard deviation of the alignment {std_deg:.1f} deg, frozen at 1 deg"
            assert aligning.why_not == text


@settings(max_examples=15)
@given(seed=seeds, size=st.integers(1, 40), first=st.integers(10, 60))
def test_the_first_states_alone_align_however_they_come(seed: int, size: int, first: int) -> None:
    pairs = pairs_of(seed, 80)
    expected = LiveAlignment(Protocol(gauge=Gauge.SIM3), freezes=False)
    expected.add(pairs.part(slice(0, first)))
    aligning = LiveAlignment(Protocol(gauge=Gauge.SIM3, align_states=first), freezes=False)
    for begin in range(0, 80, size):
        aligning.add(pairs.part(slice(begin, begin + size)))
        seen = min(begin + size, 80)
        assert aligning.is_kept == (seen >= first)
        assert int(aligning.whole.weight) == seen
        if aligning.alignment is not None:
            assert aligning.alignment.states_used == min(seen, first)
        elif seen < 3:
            assert aligning.why_not == f"{seen} of 3 states for the alignment"
    assert expected.alignment is not None
    assert aligning.alignment is not None
    one, other = expected.alignment.similarity, aligning.alignment.similarity
    np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-7)
    assert one.scale == pytest.approx(other.scale, rel=1e-7)
    # The errors of all pairs, by the sums about the first pair.
    aligned = other.positions(pairs.estimate.positions)
    rmse = np.sqrt(((pairs.groundtruth.positions - aligned) ** 2).sum(axis=1).mean())
    assert aligning.rmse(aligning.whole) == pytest.approx(rmse, rel=1e-9)


def test_before_the_first_alignment_there_are_no_errors() -> None:
    aligning = LiveAlignment(Protocol(gauge=Gauge.SE3), freezes=False)
    assert aligning.why_not == "no pairs yet"
    assert aligning.rmse(aligning.whole) is None
    pairs = pairs_of(2, 20)
    bare = dataclasses.replace(pairs.estimate, quaternions=None)
    points = PairedStates(pairs.groundtruth, bare)
    by_poses = LiveAlignment(Protocol(gauge=Gauge.SE3, align_with="poses"), freezes=False)
    by_poses.add(points)
    assert by_poses.alignment is None
    assert by_poses.why_not == "align with poses needs orientations on both sides"
    by_poses = LiveAlignment(Protocol(gauge=Gauge.SE3, align_with="poses"), freezes=False)
    by_poses.add(pairs)
    assert by_poses.alignment is not None
    assert by_poses.alignment.by_positions is not None
    by_one = LiveAlignment(Protocol(gauge=Gauge.SE3, align_states=1), freezes=False)
    by_one.add(points)
    assert by_one.why_not
    assert not by_one.is_kept
    by_one.add(pairs)
    assert by_one.is_kept
    assert by_one.why_not == ""
    assert by_one.alignment is not None
    at_first = by_one.alignment.similarity.positions(pairs.estimate.positions[:1])
    np.testing.assert_allclose(at_first, pairs.groundtruth.positions[:1], atol=1e-9)


def test_late_pairs_are_evaluated() -> None:
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge=Gauge.SE3)))
    pairs = pairs_of(3, 40)
    evaluator.add_groundtruth(pairs.groundtruth)
    for begin, end in ((10, 30), (5, 10), (30, 35)):
        assert evaluator.evaluate(pairs.part(slice(begin, end))).pairs == end - begin
        snapshot = evaluator.snapshot()
    assert evaluator.pairs == snapshot.pairs == snapshot.window_pairs == 30
    assert snapshot.dropped == {}
    assert snapshot.stamp == pairs.stamps[34]
    whole = evaluate(*sides_of(pairs.part(slice(5, 35))), Protocol(gauge=Gauge.SE3))
    assert whole.ate["position_m"] is not None
    assert snapshot.position_rmse_m == pytest.approx(whole.ate["position_m"].rmse, rel=1e-12)
    assert evaluator.evaluate(None).pairs == 0


@settings(max_examples=20)
@given(seed=seeds, past=st.integers(1, 30))
def test_states_that_come_late_are_put_where_they_belong(seed: int, past: int) -> None:
    """Those before the oldest stored state are counted, and so are those after their use."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(60)
    stamps = np.arange(60) * SECOND
    rows = states(stamps[:, None].astype(float) * np.ones(3))
    pairing = Pairing(AssociationRule(max_gap_s=1.0), BufferLimits(float(past)))
    first = np.sort(order[:30])
    pairing.add_groundtruth(trajectory(stamps[first], rows[first]))
    pairing.forget()
    oldest = int(pairing.groundtruth.stamps[0])
    late, repeated = order[30:], first[-3:]
    batch = np.concatenate([late, repeated])
    pairing.add_groundtruth(trajectory(stamps[batch], rows[batch]))
    everything = {*first.tolist(), *late.tolist()}
    if oldest > stamps[first[0]]:
        everything -= set(range(oldest // SECOND))
    kept = sorted(everything)
    result = pairing.groundtruth.trajectory()
    assert result.stamps.tolist() == [item * SECOND for item in kept]
    np.testing.assert_array_equal(result.positions[:, 0], result.stamps)
    # Before something was forgotten, any state can be added.
    are_old = (stamps[batch] < oldest) & (oldest > stamps[first[0]])
    dropped = pairing.groundtruth_counts.dropped
    assert dropped.get("too_late", 0) == np.count_nonzero(are_old)
    assert dropped.get("duplicate_stamp", 0) == np.count_nonzero(~are_old[-3:])
    assert pairing.groundtruth_count == 60 - np.count_nonzero(are_old[:-3])
