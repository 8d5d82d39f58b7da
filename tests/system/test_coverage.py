"""Coverage: keyframes are told from losses by the groundtruth's motion, live as offline."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
import pytest
from coverage_runs import SECOND, at_ms, at_rest, coverage_by, flown, keyframes, without
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from state_rows import states, trajectory
from strategies import seeds

from trajeval_ros import OnlineEvaluator, Protocol, Trajectory, evaluate, simulate
from trajeval_ros import run as evaluate_all
from trajeval_ros.formatting.numbers import whole_percent
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.coverage import Coverage, CoverageSums, PairSteps
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.window import Window
from trajeval_ros.report.verdict_lines import definitions

EUROC = ("MH_01", "MH_05", "V2_03")


def live_coverage(
    truth: Trajectory, run: Trajectory, window: str, cuts: list[int]
) -> Coverage | None:
    """Return what the live evaluator tells; the estimate comes half a second late."""
    live = OnlineEvaluator(OnlineSettings(Protocol(association="linear"), Window.parse(window)))
    sides = (
        (truth, live.add_groundtruth, 0),
        (run, live.add_estimate, SECOND // 2),
    )
    end = int(max(truth.stamps[-1], run.stamps[-1])) + SECOND
    edges = [int(truth.stamps[0]), *sorted(int(truth.stamps[0]) + cut for cut in cuts), end]
    for begin, until in itertools.pairwise(edges):
        for side, add, delay in sides:
            come = (side.stamps + delay >= begin) & (side.stamps + delay < until)
            if come.any():
                rotated = None if side.quaternions is None else side.quaternions[come]
                add(trajectory(side.stamps[come], states(side.positions[come], rotated)))
        live.update()
    live.update(at_end=True)
    return live.snapshot().coverage


def assert_same(one: Coverage | None, other: Coverage) -> None:
    assert one is not None
    assert (one.covered, one.span, one.keyframes) == (other.covered, other.span, other.keyframes)
    assert (one.longest_gap is None) == (other.longest_gap is None)
    if one.longest_gap is not None and other.longest_gap is not None:
        gap, expected = (dataclasses.asdict(item) for item in (one.longest_gap, other.longest_gap))
        assert (gap["turn_deg"] is None) == (expected["turn_deg"] is None)
        for name in gap:
            if gap[name] is not None:
                assert gap[name] == pytest.approx(expected[name], rel=1e-9), name


# The rule.


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("metres", "degrees"), [(0.5, 15.0), (1.0, 20.0)])
def test_keyframes_over_the_whole_run_cover_it(seed: int, metres: float, degrees: float) -> None:
    flight = flown(seed, 120.0)
    truth = at_rest(flight.groundtruth, 30.0, 55.0)  # hovers for 25 s
    kept = keyframes(truth, flight.estimate, metres, degrees, seed)
    result = coverage_by(truth, kept)
    assert result.keyframes
    assert result.span > 0.9
    assert result.covered == result.span
    assert result.longest_gap is None
    assert np.diff(kept.stamps).max() > 20 * SECOND
    # By the rule of full rates much of it would be lost.
    steps = np.diff(kept.stamps)
    usual = steps <= max(0.5 * SECOND, 2 * np.median(steps))
    assert steps[usual].sum() / truth.duration_s / SECOND < 0.8


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("begin_s", [20.0, 50.0, 80.0])
def test_a_loss_with_motion_is_seen_among_keyframes(seed: int, begin_s: float) -> None:
    flight = flown(seed, 120.0)
    truth, start_s = flight.groundtruth, flight.groundtruth.stamps[0] / 1e9
    whole = keyframes(truth, flight.estimate, 0.5, 15.0, seed)
    kept = without(whole, start_s + begin_s, start_s + begin_s + 10.0)
    before, after = coverage_by(truth, whole), coverage_by(truth, kept)
    assert after.keyframes
    assert after.longest_gap is not None
    assert after.longest_gap.duration_s == pytest.approx(10.5, abs=1.0)
    assert after.longest_gap.reach_m > 1.0
    assert after.span == before.span
    assert after.covered == pytest.approx(
        before.covered - after.longest_gap.duration_s / truth.duration_s, abs=1e-9
    )


EVEN, UNEVEN = np.full(20, 1.0), np.tile([1.0, 1.0, 1.0, 1.5], 5)
FEW, SOME = np.arange(20) < 1, np.arange(20) < 3  # 5 %, 15 %


def coverage_of_steps(
    times_s: NDArray[np.float64],
    reach_m: NDArray[np.float64] | float = 0.01,
    turn_deg: NDArray[np.float64] | float = 0.1,
    last: tuple[float, float, float] | None = None,
) -> Coverage:
    """Return the coverage of steps, and perhaps of one more: its time, reach and turn."""
    steps = np.column_stack(np.broadcast_arrays(times_s, reach_m, turn_deg))
    steps = steps if last is None else np.vstack([steps, last])
    times_ns = np.round(steps[:, 0] * 1e9).astype(np.int64)
    sums = CoverageSums(AssociationRule())
    sums.add(PairSteps(times_ns, steps[:, 1], np.radians(steps[:, 2])))
    return sums.coverage(int(times_ns.sum()), 1000, 0)


# Quantiles are exact to 2.2 %.
@pytest.mark.parametrize(
    ("times_s", "expected"),
    [
        (0.212 / 1.5 * UNEVEN, True),
        (0.190 / 1.5 * UNEVEN, False),
        (1.0 + 0.26 * SOME, True),
        (1.0 + 0.15 * SOME, False),
        (1.0 + 0.50 * FEW, False),
        (UNEVEN[:12][2:], True),
        (UNEVEN[:12][3:], False),
    ],
    ids=["slow", "fast", "uneven", "even", "one of 20", "10 steps", "9 steps"],
)
def test_what_keyframes_are(times_s: NDArray[np.float64], expected: bool) -> None:
    assert coverage_of_steps(times_s).keyframes is expected


def turning_on_the_spot() -> tuple[Trajectory, Trajectory]:
    """Return groundtruth that turns fast for 12 s where it stands, and keyframes but there."""
    seconds = np.arange(0.0, 60.0, 0.05)
    rotation = np.interp(seconds, [0, 30, 42, 60], [0.0, 0.3, 2.8, 3.1]) / 2.0
    zero = np.zeros(len(seconds))
    truth = Trajectory(
        np.round(seconds * 1e9).astype(np.int64),
        np.column_stack([np.interp(seconds, [0, 30, 42, 60], [0.0, 3.0, 3.0, 5.0]), zero, zero]),
        np.column_stack([zero, zero, np.sin(rotation), np.cos(rotation)]),
    )
    uneven = np.cumsum(np.tile([0.5, 0.5, 0.5, 1.5], 10))
    return truth, at_ms(1e3 * np.concatenate([uneven, 42.5 + uneven[uneven < 17.0]]))


def test_turning_counts_as_motion_where_it_is_known() -> None:
    truth, kept = turning_on_the_spot()
    known = coverage_by(truth, kept)
    assert known.longest_gap is not None
    assert known.longest_gap.turn_deg == pytest.approx(np.degrees(2.5), abs=2.0)
    unknown = coverage_by(dataclasses.replace(truth, quaternions=None), kept)
    assert unknown.keyframes
    assert unknown.longest_gap is None
    assert unknown.covered == unknown.span
    lost = coverage_by(dataclasses.replace(at_ms(1e3 * truth.seconds), quaternions=None), kept)
    assert lost.longest_gap is not None
    assert lost.longest_gap.turn_deg is None
    assert "deg" not in lost.gap_in_words


def test_a_full_rate_is_judged_by_time_alone() -> None:
    truth = at_ms(np.arange(0, 60_000, 10), metres_per_s=0.0)  # at rest all the time
    run = np.arange(0, 59_990, 50)
    result = coverage_by(truth, at_ms(run[(run < 20_000) | (run >= 30_000)]))
    assert not result.keyframes
    assert result.longest_gap is not None
    assert result.longest_gap.duration_s == pytest.approx(10.05)
    assert result.span == pytest.approx(1.0, abs=0.001)
    assert result.covered == pytest.approx((59.95 - 10.05) / 59.99)
    # Frames are dropped now and then, which makes no keyframes of the others.
    uneven = np.cumsum(np.tile([50, 50, 150], 239))
    result = coverage_by(truth, at_ms(uneven[(uneven < 20_000) | (uneven >= 30_000)]))
    assert not result.keyframes
    assert result.longest_gap is not None
    assert result.longest_gap.duration_s == pytest.approx(10.1, abs=0.1)
    # Steps of two seconds are usual, of four twice that, and of six too long.
    truth = at_ms(np.arange(0, 120_001, 10), metres_per_s=0.0)
    even = np.arange(0, 120_001, 2000)
    result = coverage_by(truth, at_ms(even[~np.isin(even, [10_000, 34_000, 36_000])]))
    assert not result.keyframes
    assert result.covered == pytest.approx(114.0 / 120.0)
    assert result.longest_gap is not None
    assert result.longest_gap.duration_s == 6.0


def test_a_longer_gap_may_be_allowed() -> None:
    flight = flown(3, 120.0)
    start_s = flight.groundtruth.stamps[0] / 1e9
    kept = without(
        keyframes(flight.groundtruth, flight.estimate, 0.5, 15.0), start_s + 40.0, start_s + 50.0
    )
    assert coverage_by(flight.groundtruth, kept).longest_gap is not None
    assert coverage_by(flight.groundtruth, kept, max_gap_s=12.0).longest_gap is None


# Live.


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(
    seed=seeds,
    lost_s=st.sampled_from([0.0, 4.0, 15.0]),
    window=st.sampled_from(["0", "5s", "3"]),
    cuts=st.lists(st.integers(0, 60 * SECOND), max_size=200),
    oriented=st.booleans(),
    thin=st.sampled_from([0.0, 0.5]),
)
def test_live_is_offline(
    seed: int, lost_s: float, window: str, cuts: list[int], oriented: bool, thin: float
) -> None:
    flight = flown(seed % 100, 60.0)
    start_s = flight.groundtruth.stamps[0] / 1e9
    truth = without(flight.groundtruth[::4], start_s + 45.0, start_s + 47.0)
    truth = dataclasses.replace(truth, velocities=None)
    run = flight.estimate
    if thin:
        run = keyframes(flight.groundtruth, run, thin, 15.0, seed)
    run = dataclasses.replace(
        without(run, start_s + 20.0, start_s + 20.0 + lost_s), velocities=None
    )
    if not oriented:
        truth = dataclasses.replace(truth, quaternions=None)
    expected = coverage_by(truth, run)
    assert expected.keyframes == (thin > 0.0)
    assert_same(live_coverage(truth, run, window, cuts), expected)


@pytest.mark.slow
@pytest.mark.parametrize(
    "run", ["vislam_ba/MH_01_trial7", "vislam_ba/V2_03_trial2", "vio_mono/V2_03"]
)
def test_live_is_offline_on_recordings(recording: Callable[[str], Trajectory], run: str) -> None:
    sequence = run.split("/")[1][:5]
    truth, estimate = (recording(f"euroc/{item}.txt") for item in (f"groundtruth/{sequence}", run))
    cuts = list(range(0, 200 * SECOND, SECOND // 5))
    assert_same(live_coverage(truth, estimate, "30s", cuts), coverage_by(truth, estimate))


# Recordings: vislam_ba publishes keyframes, vio_mono every frame.


@pytest.mark.parametrize(("sequence", "least"), list(zip(EUROC, (0.95, 0.99, 0.89), strict=True)))
def test_keyframe_runs_were_tracked(
    recording: Callable[[str], Trajectory], sequence: str, least: float
) -> None:
    truth = recording(f"euroc/groundtruth/{sequence}.txt")
    for trial in range(10):
        run = recording(f"euroc/vislam_ba/{sequence}_trial{trial}.txt")
        result = coverage_by(truth, run)
        assert result.keyframes
        assert least <= result.covered / result.span <= 1.0
        inside = run.stamps[(run.stamps >= truth.stamps[0]) & (run.stamps <= truth.stamps[-1])]
        assert result.span == pytest.approx(np.ptp(inside) / np.ptp(truth.stamps), abs=1e-3)


# What is said.


def test_span_and_longest_gap_are_told_where_they_differ() -> None:
    flight = flown(1, 120.0)
    start_s = flight.groundtruth.stamps[0] / 1e9
    whole = keyframes(flight.groundtruth, flight.estimate, 0.5, 15.0)
    cut = without(whole, start_s + 40.0, start_s + 60.0)
    for run, is_whole in ((whole, True), (cut, False)):
        evaluation = evaluate(flight.groundtruth, run)
        coverage = evaluation.association.coverage
        text = definitions(evaluation)[1]
        assert f"{len(run)} pairs cover 100 % of the estimate's poses" in text
        assert f"and {whole_percent(coverage.covered)} of the groundtruth's time" in text
        told = f", {whole_percent(coverage.span)} from the first to the last pair, longest gap "
        assert (told in text) != is_whole
        warned = [warning for warning in evaluation.warnings if "pairs cover" in warning]
        assert len(warned) == (not is_whole)
        if not is_whole:
            gap = coverage.longest_gap
            assert gap is not None
            assert gap.turn_deg is not None
            words = f"{gap.duration_s:.1f} s ({gap.reach_m:.2f} m, {gap.turn_deg:.0f} deg)"
            assert words in text
            assert words in warned[0]
    full = evaluate(flight.groundtruth, flight.estimate)
    assert " pairs cover" in definitions(full)[1]
    assert "keyframe" not in definitions(full)[1]


def test_results_have_what_is_covered_beside_the_span_and_the_gap() -> None:
    flight = simulate(seed=1, duration_s=60.0)
    outcome = evaluate_all(flight.groundtruth, [flight.estimate])
    coverage = outcome.runs[0].evaluation.association.coverage
    assert coverage.longest_gap is not None
    told = result_of(outcome)["runs"][0]["association"]
    assert told["groundtruth_coverage"] == coverage.covered
    assert told["groundtruth_span"] == coverage.span > coverage.covered
    assert told["keyframes"] is False
    assert told["longest_gap"] == dataclasses.asdict(coverage.longest_gap)
