"""The parts of the coverage: quantiles, waypoints and steps."""

from __future__ import annotations

import itertools

import numpy as np
from coverage_runs import SECOND, without
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from strategies import seeds

from trajeval_ros import Trajectory, simulate
from trajeval_ros.geometry import lie
from trajeval_ros.metrics.coverage import PairSteps, StampedPoses, StepMeter, waypoints
from trajeval_ros.metrics.statistics import LogHistogram


@given(
    values=st.lists(st.floats(1e-5, 1e5), min_size=1, max_size=60),
    share=st.sampled_from([0.1, 0.5, 0.9, 1.0]),
)
def test_a_quantile_is_the_sample_s_or_little_more(values: list[float], share: float) -> None:
    histogram, doubled = LogHistogram(), LogHistogram()
    for part in np.array_split(np.array(values), 3):
        histogram.add(part)
    doubled.add(2.0 * np.array(values))
    exact = float(np.quantile(values, share, method="inverted_cdf"))
    assert exact <= histogram.quantile(share) <= exact * 2.0 ** (1.0 / 32.0) * (1.0 + 1e-12)
    assert doubled.quantile(share) == 2.0 * histogram.quantile(share)


def test_quantiles_of_nothing_and_of_values_out_of_range() -> None:
    histogram = LogHistogram()
    assert histogram.quantile(0.9) == 0.0
    histogram.add(np.array([0.0, 1e-30, 1e30]))
    assert histogram.quantile(0.5) < 1e-6
    assert histogram.quantile(0.9) >= 1e9


@st.composite
def stamps_of_a_groundtruth(draw: st.DrawFn) -> NDArray[np.int64]:
    steps_ms = draw(
        st.lists(st.sampled_from([1, 5, 20, 49, 60, 300, 700, 5000]), min_size=1, max_size=200)
    )
    return np.cumsum([draw(st.integers(0, 10**4)), *steps_ms]).astype(np.int64) * 1_000_000


@given(
    stamps=stamps_of_a_groundtruth(),
    max_gap_ms=st.sampled_from([10, 90, 500, 2000]),
)
def test_waypoints_are_few_and_keep_the_gaps(stamps: NDArray[np.int64], max_gap_ms: int) -> None:
    gap = max_gap_ms * 1_000_000
    chosen = stamps[waypoints(stamps, gap)]
    assert {int(stamps[0]), int(stamps[-1])} <= set(chosen.tolist())
    steps, kept = np.diff(stamps), np.diff(chosen)
    assert kept[kept > gap].tolist() == steps[steps > gap].tolist()
    assert len(chosen) <= 2 + 2 * (stamps[-1] - stamps[0]) // min(50_000_000, gap // 2) + 2


def naive_steps(truth: Trajectory, pairs: Trajectory, max_gap_ns: int) -> PairSteps:
    """Return the steps by loops over all groundtruth states."""
    assert truth.quaternions is not None
    assert pairs.quaternions is not None
    found = []
    for k in range(len(pairs) - 1):
        begin, end = int(pairs.stamps[k]), int(pairs.stamps[k + 1])
        lost = 0
        for a, b in zip(truth.stamps[:-1].tolist(), truth.stamps[1:].tolist(), strict=True):
            if b - a > max_gap_ns:
                lost += max(0, min(b, end) - max(a, begin))
        inside = (truth.stamps >= begin) & (truth.stamps <= end)
        positions = np.vstack([truth.positions[inside], pairs.positions[k + 1]])
        quaternions = np.vstack([truth.quaternions[inside], pairs.quaternions[k + 1]])
        turned = lie.multiply(lie.conjugate(pairs.quaternions[k]), quaternions)
        reach = np.linalg.norm(positions - pairs.positions[k], axis=1).max()
        seen = float(end - begin > SECOND // 20)
        found.append((end - begin - lost, seen * reach, seen * np.max(lie.angle(turned))))
    time_ns, reach_m, turn_rad = zip(*found, strict=True)
    return PairSteps(np.array(time_ns), np.array(reach_m), np.array(turn_rad))


@settings(max_examples=25)
@given(seed=seeds, pieces=st.integers(1, 6))
def test_steps_are_those_of_all_groundtruth_states(seed: int, pieces: int) -> None:
    random, gap = np.random.default_rng(seed), 500_000_000
    flight = simulate(seed=seed % 50, duration_s=20.0)
    # 20 Hz, all of which are waypoints, with gaps; keyframes of any spacing.
    truth = flight.groundtruth[::10]
    begin = random.uniform(3.0, 12.0)
    truth = without(truth, truth.stamps[0] / 1e9 + begin, truth.stamps[0] / 1e9 + begin + 3.0)
    chosen = np.sort(random.choice(len(truth) - 1, 9, replace=False))
    pairs = truth[chosen]
    found = naive_steps(truth, pairs, gap)
    meter, parts = StepMeter(gap), []
    poses, all_poses = (StampedPoses.of(item, np.arange(len(item))) for item in (pairs, truth))
    edges = [0, *np.sort(random.integers(0, len(pairs) + 1, pieces)).tolist(), len(pairs)]
    passed = 0
    for first, end in itertools.pairwise(edges):
        newest = int(chosen[end - 1]) if end > first else passed
        # Some states may also come before the next pair, even in calls without a pair.
        following = int(chosen[end]) if end < len(pairs) else newest
        upto = int(random.integers(newest, max(newest, following) + 1))
        parts.append(
            meter.measure(
                StampedPoses(*(pose[passed:upto] for pose in all_poses)),
                StampedPoses(*(pose[first:end] for pose in poses)),
            )
        )
        passed = upto
    measured = PairSteps(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    np.testing.assert_array_equal(measured.time_ns, found.time_ns)
    np.testing.assert_allclose(measured.reach_m, found.reach_m, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(measured.turn_rad, found.turn_rad, rtol=1e-7, atol=1e-7)
    whole = StepMeter(gap).measure(all_poses, poses)
    for one, other in zip(measured, whole, strict=True):
        np.testing.assert_array_equal(one, other)
