"""Association: who is paired with whom, and why the others are not."""

from __future__ import annotations

import dataclasses
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp
from strategies import START, make_estimate, make_groundtruth, seeds

from trajeval_ros.exceptions import InputError, NoMatchError, SettingsError
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.association_rule import AssociationRule

MILLISECOND = 1_000_000


def at(milliseconds: ArrayLike, start: int = START) -> Trajectory:
    """Return states at these times whose x tells their row."""
    times = start + np.round(np.asarray(milliseconds, dtype=np.float64) * MILLISECOND).astype(
        np.int64
    )
    positions = np.zeros((len(times), 3))
    positions[:, 0] = np.arange(len(times))
    return Trajectory(times, positions)


def rows(trajectory: Trajectory) -> list[int]:
    return [int(row) for row in trajectory.positions[:, 0]]


def greedy(truth: np.ndarray, estimate: np.ndarray, limit: int) -> set[tuple[int, int]]:
    """Take all close pairs, closest first, each state once."""
    close = sorted(
        (abs(int(t) - int(e)), i, j)
        for i, e in enumerate(estimate)
        for j, t in enumerate(truth)
        if abs(int(t) - int(e)) <= limit
    )
    taken_i: set[int] = set()
    taken_j: set[int] = set()
    chosen = set()
    for _, i, j in close:
        if i not in taken_i and j not in taken_j:
            taken_i.add(i)
            taken_j.add(j)
            chosen.add((i, j))
    return chosen


# A few milliseconds in few steps: ties, duplicates and the very limit happen often.
coarse_times = st.lists(st.integers(0, 300), min_size=1, max_size=40)


@given(truth=coarse_times, estimate=coarse_times)
@pytest.mark.parametrize("ordered", [True, False])
def test_nearest_is_greedy_one_to_one(
    ordered: bool, truth: list[int], estimate: list[int]
) -> None:
    if ordered:
        truth, estimate = sorted(truth), sorted(estimate)
    groundtruth, other = at(truth), at(estimate)
    # Of poses: a share of the estimate that points cover has no meaning.
    rotated = np.tile([0.0, 0.0, 0.0, 1.0], (len(truth), 1))
    groundtruth = dataclasses.replace(groundtruth, quaternions=rotated)
    expected = greedy(groundtruth.stamps, other.stamps, 20 * MILLISECOND)
    rule = AssociationRule("nearest")
    if not expected:
        with pytest.raises(NoMatchError):
            associate(groundtruth, other, rule)
        return
    pairs = associate(groundtruth, other, rule)
    actual = list(zip(rows(pairs.estimate), rows(pairs.groundtruth), strict=True))
    assert set(actual) == expected
    assert len(actual) == len({i for i, _ in actual}) == len({j for _, j in actual})
    assert rows(pairs.estimate) == sorted(rows(pairs.estimate))
    dropped = pairs.dropped.get("no_groundtruth_within_max_time_difference", 0)
    assert len(pairs) + dropped == len(estimate)
    assert pairs.estimate_coverage == pytest.approx(len(pairs) / len(estimate))


def evos_choice(stamp: int, others: list[int]) -> int:
    """Return the row of the others that evo 1.38 takes for a stamp, whatever the limit."""
    apart = [abs(other - stamp) for other in others]
    if others != sorted(others):
        return apart.index(min(apart))  # a search in file order
    if others[-1] == stamp:
        # Its bisection stops at the last two rows.
        return max(len(others) - 2, 0) if others[-2:] == [stamp] * 2 else len(others) - 1
    earlier = [row for row, other in enumerate(others) if other <= stamp]
    later = [row for row, other in enumerate(others) if other > stamp]
    if not earlier or (later and apart[later[0]] < apart[earlier[-1]]):
        return later[0]
    return earlier[-1]


@given(truth=coarse_times, estimate=coarse_times)
# The very limit: before the first, after and before one between, and after the last.
@example(truth=[310, 10, 100, 200, 300], estimate=[0, 110, 190, 320])
@pytest.mark.parametrize("ordered", [True, False])
def test_evo_takes_the_rows_that_evo_takes(
    ordered: bool, truth: list[int], estimate: list[int]
) -> None:
    if ordered:
        truth, estimate = sorted(truth), sorted(estimate)
    rule = AssociationRule("evo", 10 / 512)
    # 1/512 s is exact in binary as well, so that the very limit and ties are those of floats.
    groundtruth, other = (at(1000.0 * np.array(item) / 512, start=0) for item in (truth, estimate))
    by_truth = len(truth) < len(estimate)
    short, long = (truth, estimate) if by_truth else (estimate, truth)
    expected = [
        (row, choice)
        for row, stamp in enumerate(short)
        if abs(long[choice := evos_choice(stamp, long)] - stamp) <= 10
    ]
    if not expected:
        with pytest.raises(NoMatchError):
            associate(groundtruth, other, rule)
        return
    pairs = associate(groundtruth, other, rule)
    chosen = rows(pairs.groundtruth), rows(pairs.estimate)
    actual = list(zip(*(chosen if by_truth else chosen[::-1]), strict=True))
    assert actual == expected


def test_rpg_leaves_out_the_limit_itself_and_nearest_does_not() -> None:
    # 1/32 s is exact in binary as well.
    truth, estimate = at([0, 125], start=0), at([1, 156.25], start=0)
    assert len(associate(truth, estimate, AssociationRule("rpg", 1 / 32))) == 1
    assert len(associate(truth, estimate, AssociationRule("nearest", 1 / 32))) == 2


@pytest.mark.parametrize("method", ["nearest", "rpg"])
def test_equal_rates_half_a_period_apart_pair_in_order(method: str) -> None:
    # Each state has two equally close ones: the choice runs through the whole recording.
    truth, estimate = at(10.0 * np.arange(3000)), at(10.0 * np.arange(3000) + 5.0)
    pairs = associate(truth, estimate, AssociationRule(method))
    if method == "nearest":
        assert rows(pairs.groundtruth) == list(range(3000))
    assert len(set(rows(pairs.groundtruth))) == len(pairs)


def test_a_long_chain_of_rivals_takes_work_in_proportion() -> None:
    def calls(count: int) -> int:
        truth, estimate = at(10.0 * np.arange(count)), at(10.0 * np.arange(count) + 5.0)
        total = 0

        def seen(_frame: object, _event: str, argument: object) -> None:
            nonlocal total
            if getattr(argument, "__name__", "") in ("lexsort", "argsort", "sort", "at", "full"):
                total += 1  # work of the size of the whole recording

        sys.setprofile(seen)
        try:
            associate(truth, estimate, AssociationRule("nearest"))
        finally:
            sys.setprofile(None)
        return total

    assert calls(400) <= 2 * calls(100)


@given(seed=seeds)
def test_interpolation_is_linear_in_position_and_slerp_in_rotation(seed: int) -> None:
    groundtruth = make_groundtruth(seed, 60)
    estimate = make_estimate(groundtruth, seed + 1)
    truth = associate(groundtruth, estimate, AssociationRule("linear")).groundtruth
    assert truth.rotations is not None
    assert groundtruth.rotations is not None
    start = groundtruth.stamps[0]
    times = (groundtruth.stamps - start) / NANOSECONDS
    at_times = (truth.stamps - start) / NANOSECONDS
    for name in ("positions", "velocities", "gyroscope_biases", "accelerometer_biases"):
        column, actual = getattr(groundtruth, name), getattr(truth, name)
        expected = np.stack([np.interp(at_times, times, item) for item in column.T], axis=1)
        np.testing.assert_allclose(actual, expected, atol=1e-9)
    expected_rotations = Slerp(times, groundtruth.rotations)(at_times)
    apart = (truth.rotations * expected_rotations.inv()).magnitude()
    np.testing.assert_allclose(apart, 0.0, atol=1e-8)


@given(seed=seeds, gap_s=st.sampled_from([0.1, 0.3, 0.5, 2.0]))
def test_interpolation_never_crosses_gaps_nor_leaves_the_groundtruth(
    seed: int, gap_s: float
) -> None:
    random = np.random.default_rng(seed)
    truth_ms = np.cumsum(random.choice([20, 90, 100, 101, 299, 300, 301, 500, 501], size=40))
    estimate_ms = np.sort(random.integers(-500, truth_ms[-1] + 500, size=80))
    exact = random.uniform(size=80) < 0.3
    estimate_ms[exact] = random.choice(truth_ms, size=int(exact.sum()))
    estimate_ms = np.sort(estimate_ms)
    truth, estimate = at(truth_ms), at(estimate_ms)
    expected_rows, reasons = [], dict.fromkeys(("before", "after", "gap"), 0)
    for i, stamp in enumerate(estimate_ms):
        if stamp in truth_ms:
            expected_rows.append(i)
        elif stamp < truth_ms[0]:
            reasons["before"] += 1
        elif stamp > truth_ms[-1]:
            reasons["after"] += 1
        elif truth_ms[truth_ms > stamp].min() - truth_ms[truth_ms < stamp].max() <= gap_s * 1000:
            expected_rows.append(i)
        else:
            reasons["gap"] += 1
    if not expected_rows:
        return
    pairs = associate(truth, estimate, AssociationRule("linear", max_gap_s=gap_s))
    assert rows(pairs.estimate) == expected_rows
    assert pairs.dropped.get("before_groundtruth", 0) == reasons["before"]
    assert pairs.dropped.get("after_groundtruth", 0) == reasons["after"]
    assert pairs.dropped.get("in_groundtruth_gap", 0) == reasons["gap"]
    assert len(pairs) + sum(pairs.dropped.values()) == len(estimate)


def test_exact_stamps_take_exact_states_also_at_the_ends_and_beside_gaps() -> None:
    groundtruth = make_groundtruth(3, 30)
    stamps = groundtruth.stamps + np.arange(30) * 2 * NANOSECONDS  # nothing but gaps
    groundtruth = dataclasses.replace(groundtruth, stamps=stamps)
    pairs = associate(groundtruth, groundtruth, AssociationRule("linear"))
    assert len(pairs) == 30
    np.testing.assert_array_equal(pairs.groundtruth.positions, groundtruth.positions)
    np.testing.assert_array_equal(pairs.groundtruth.velocities, groundtruth.velocities)
    assert pairs.groundtruth.quaternions is not None
    assert groundtruth.quaternions is not None
    # Normalised again: a product, a sum of four squares, its root and a division, 6 u together.
    np.testing.assert_allclose(
        pairs.groundtruth.quaternions,
        groundtruth.quaternions,
        rtol=0,
        atol=3.0 * np.finfo(np.float64).eps,
    )


def test_one_groundtruth_state_pairs_with_its_own_stamp_alone() -> None:
    pairs = associate(at([50]), at([49, 50, 51]), AssociationRule("linear"))
    assert rows(pairs.estimate) == [1]
    assert pairs.dropped == {"before_groundtruth": 1, "after_groundtruth": 1}


def test_rows_dropped_by_the_reader_are_counted_too() -> None:
    estimate = dataclasses.replace(at([0, 10, 500]), reading=SourceInfo(dropped={"not_finite": 7}))
    pairs = associate(at([0, 10, 20]), estimate, AssociationRule("linear"))
    assert pairs.dropped == {"not_finite": 7, "after_groundtruth": 1}


@pytest.mark.parametrize("method", ["linear", "nearest", "rpg", "evo"])
@pytest.mark.parametrize("offset", [-0.75, 0.003, 12.5])
def test_a_time_offset_is_added_to_the_estimates_stamps(method: str, offset: float) -> None:
    groundtruth = make_groundtruth(5)
    shift = round(offset * NANOSECONDS)
    early = dataclasses.replace(groundtruth, stamps=groundtruth.stamps - shift)
    pairs = associate(groundtruth, early, AssociationRule(method, time_offset_s=offset))
    assert len(pairs) == len(groundtruth)
    np.testing.assert_array_equal(pairs.groundtruth.stamps, groundtruth.stamps)
    np.testing.assert_array_equal(pairs.estimate.stamps, groundtruth.stamps)
    np.testing.assert_array_equal(pairs.estimate.positions, pairs.groundtruth.positions)


@pytest.mark.parametrize("method", ["linear", "nearest", "rpg", "evo"])
def test_both_sides_of_a_pair_have_one_stamp(method: str) -> None:
    groundtruth = make_groundtruth(6)
    pairs = associate(groundtruth, make_estimate(groundtruth, 7), AssociationRule(method))
    np.testing.assert_array_equal(pairs.groundtruth.stamps, pairs.estimate.stamps)
    assert len(pairs) == len(pairs.groundtruth) == len(pairs.estimate)


def test_files_without_stamps_pair_row_by_row() -> None:
    groundtruth = make_groundtruth(8)
    estimate = dataclasses.replace(
        groundtruth,
        stamps=np.arange(len(groundtruth)) * NANOSECONDS,
        reading=SourceInfo(stamped=False),
    )
    pairs = associate(groundtruth, estimate, AssociationRule("linear"))
    assert pairs.rule.method == "index"
    np.testing.assert_array_equal(pairs.estimate.stamps, groundtruth.stamps)
    shorter = dataclasses.replace(estimate[1:], name="")
    for name, text in (("truth.txt", "truth.txt"), ("", "the groundtruth")):
        named = dataclasses.replace(groundtruth, name=name)
        with pytest.raises(InputError, match=f"^{text} has 120 poses, the estimate has 119"):
            associate(named, shorter, AssociationRule("linear"))


def test_coverage_is_a_share_of_time_without_gaps() -> None:
    truth = at(np.concatenate([np.arange(0, 10_000, 10), np.arange(60_000, 70_000, 10)]))
    half = associate(truth, at(np.arange(5, 9_990, 50)), AssociationRule("linear"))
    assert half.groundtruth_coverage == pytest.approx(0.5, abs=0.01)
    whole = associate(
        truth,
        at(np.concatenate([np.arange(5, 9_990, 50), np.arange(60_005, 69_990, 50)])),
        AssociationRule("linear"),
    )
    assert whole.groundtruth_coverage == pytest.approx(1.0, abs=0.02)
    assert whole.estimate_coverage == 1.0


def test_keyframes_far_apart_cover_the_time_between_them() -> None:
    truth = at(np.arange(0, 60_000, 10))
    sparse = associate(truth, at(np.arange(0, 59_000, 2000)), AssociationRule("linear"))
    assert sparse.groundtruth_coverage > 0.95


@pytest.mark.parametrize(
    "truth_ms",
    [
        1000.0 * np.arange(201),  # nothing but gaps
        np.arange(0, 200_001, 10)[np.arange(0, 200_001, 10) % 2000 <= 1000],  # 1 s on, 1 s off
        500.0 * np.arange(401) + 10.0 * np.random.default_rng(1).standard_normal(401),
    ],
    ids=["gaps", "on and off", "jittered"],
)
@pytest.mark.parametrize("share", [0.05, 0.3, 0.5, 1.0])
def test_a_model_s_pairs_cover_their_share_of_all_the_groundtruth_s_time(
    truth_ms: np.ndarray, share: float
) -> None:
    truth = at(truth_ms)
    first, last = truth_ms[0], truth_ms[-1]
    pairs = associate(
        truth,
        at(np.arange(first, first + share * (last - first), 50.0)),
        AssociationRule("continuous", model="linear"),
    )
    assert pairs.groundtruth_coverage == pytest.approx(share, abs=0.001)


def test_a_groundtruth_state_in_many_pairs_is_covered_once() -> None:
    truth = at(1000.0 * np.arange(100))
    pairs = associate(truth, at(40.0 * np.arange(99)), AssociationRule("evo", 2.0))
    used = set(rows(pairs.groundtruth))
    assert len(pairs) > 10 * len(used)
    assert pairs.groundtruth_coverage == len(used) / len(truth)


@pytest.mark.parametrize("who", ["groundtruth", "estimate"])
@pytest.mark.parametrize("first", [0, 3])
def test_numbers_of_frames_are_no_times(who: str, first: int) -> None:
    """As the first column of VGGT-SLAM; whole times of a system clock are none."""
    clocked = Trajectory(10**9 * np.arange(1_700_000_000, 1_700_000_040), np.zeros((40, 3)))
    counted = Trajectory(10**9 * (first + 5 * np.arange(40)), np.zeros((40, 3)))
    sides = (counted, clocked) if who == "groundtruth" else (clocked, counted)
    text = f"the {who} probably has numbers of frames instead of times; write the times of all"
    with pytest.raises(NoMatchError, match=text):
        associate(*sides, AssociationRule("linear"))


@pytest.mark.parametrize("method", ["linear", "nearest", "rpg", "evo"])
@pytest.mark.parametrize(
    ("truth", "estimate", "cause"),
    [
        (1_700_000_000.0, 1_700_000_900.0, "time offset"),
        (1_700_000_000.0, 12.0, "simulated|counts from zero"),
        (1_700_000_000.0, 5_000_000.0, "counts from zero"),
        (12.0, 1_700_000_000.0, "counts from zero"),
        (1_700_000_000.0, 1.7, "unit"),
        (1_700_000_000.0, 1_700_000.0, "unit"),
        (1_700.0, 1_700_000_000.0, "unit"),
    ],
)
def test_no_match_is_explained_with_both_time_ranges(
    method: str, truth: float, estimate: float, cause: str
) -> None:
    seconds = np.arange(0.0, 10.0, 0.1)

    def trajectory(start: float) -> Trajectory:
        stretch = start / truth if cause == "unit" else 1.0
        stamps = round(start * 1e9) + np.round(seconds * stretch * 1e9).astype(np.int64)
        return Trajectory(stamps, np.zeros((len(stamps), 3)))

    with pytest.raises(NoMatchError, match=cause) as raised:
        associate(trajectory(truth), trajectory(estimate), AssociationRule(method))
    assert f"{truth:.3f}" in str(raised.value)
    assert "\n" not in str(raised.value)


GPS_1980 = 1_700_000_000 - 315_964_800 + 18  # GPS time counts leap seconds


@pytest.mark.parametrize(("gps", "name"), [(GPS_1980, "since 1980"), (GPS_1980 % 604_800, "week")])
@pytest.mark.parametrize("is_estimate", [True, False])
def test_gps_time_is_named_with_its_offset(gps: int, name: str, *, is_estimate: bool) -> None:
    clock, counted = (at(1000.0 * (start + np.arange(30)), 0) for start in (1_700_000_000, gps))
    sides = (clock, counted) if is_estimate else (counted, clock)
    offset = (1_700_000_000 - gps) * (1 if is_estimate else -1)
    advice = f"one has GPS seconds .*{name}.*; set the time offset to {offset} s$"
    with pytest.raises(NoMatchError, match=advice):
        associate(*sides, AssociationRule("linear"))


def test_clocks_of_another_day_are_no_gps_time() -> None:
    counted = at(1000.0 * (GPS_1980 % 604_800 + 40 + 0.1 * np.arange(30)), 0)
    clock = at(1000.0 * (1_700_000_000 + 0.1 * np.arange(30)), 0)
    with pytest.raises(
        NoMatchError,
        match=r"from zero .* set the time offset to 16997471\d\d.*; otherwise, --time-offset auto",
    ):
        associate(clock, counted, AssociationRule("linear"))


def test_a_first_stamp_of_zero_is_no_clock_that_counts_from_zero() -> None:
    truth, estimate = at(1.7e12 + np.arange(0, 10_000, 1000)), at(np.array([0.0, 1.6e12]))
    for one, other in ((truth, estimate), (estimate, truth)):
        with pytest.raises(
            NoMatchError,
            match=r"1157 days apart; the estimate .* another recording.* --time-offset auto",
        ):
            associate(one, other, AssociationRule("linear"))


def test_timestamps_around_all_groundtruth_are_told_from_gaps() -> None:
    # As timestamps in single precision, 128 s apart.
    truth, around = make_groundtruth(0), make_groundtruth(0)[:2]
    stamps = truth.stamps[[0, -1]] + np.array([-1, 1]) * 10**9
    around = dataclasses.replace(around, stamps=stamps)
    with pytest.raises(NoMatchError, match=r"no timestamp of one side is within .* digits"):
        associate(truth, around, AssociationRule())


def test_overlap_without_close_stamps_is_told_from_no_overlap() -> None:
    truth, estimate = at(np.arange(0, 10_000, 1000)), at(np.arange(500, 10_000, 1000))
    with pytest.raises(NoMatchError, match="overlap"):
        associate(truth, estimate, AssociationRule("nearest"))
    with pytest.raises(NoMatchError, match=r"gaps longer than 0.5 s \(median step 1 s\); incr"):
        associate(truth, estimate[:5], AssociationRule("linear"))


@pytest.mark.parametrize(("factor", "told"), [(1e3, True), (1e-3, True), (1e6, True), (30, False)])
def test_other_units_of_the_stamps_are_told_by_a_power_of_a_thousand(
    factor: float, told: bool
) -> None:
    seconds = np.array([2_000.0, 2_001.0, 2_002.0])
    truth, estimate = at(1e3 * seconds, start=0), at(1e3 * factor * seconds, start=0)
    with pytest.raises(NoMatchError) as raised:
        associate(truth, estimate, AssociationRule("linear"))
    assert ("units of the timestamps probably differ" in str(raised.value)) is told


@pytest.mark.parametrize(("days", "told"), [(113.0, True), (0.3, False)])
def test_clocks_that_are_days_apart_are_probably_of_another_recording(
    days: float, told: bool
) -> None:
    milliseconds = np.arange(0, 10_000, 100)
    truth, estimate = at(milliseconds), at(milliseconds + int(days * 86_400_000))
    with pytest.raises(NoMatchError) as raised:
        associate(truth, estimate, AssociationRule("linear"))
    assert ("113 days apart; the estimate is probably of another" in str(raised.value)) is told
    assert ("set the time offset" in str(raised.value)) is not told


@pytest.mark.parametrize(
    "settings",
    [
        {"method": "closest"},
        {"max_time_difference_s": 0.0},
        {"max_time_difference_s": float("nan")},
        {"max_gap_s": -1.0},
        {"time_offset_s": float("inf")},
        {"time_offset_s": 1e300},
        {"time_offset_s": -1e10},  # more than stamps can hold
        {"max_gap_s": float("inf")},
        {"max_gap_s": 1e300},
        {"max_time_difference_s": float("inf")},
        {"max_time_difference_s": 1e12},
    ],
)
def test_rules_that_mean_nothing_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(SettingsError):
        AssociationRule(**settings)


@pytest.mark.parametrize("empty", ["groundtruth", "estimate"])
def test_empty_trajectories_are_refused(empty: str) -> None:
    sides = {"groundtruth": at([0, 10]), "estimate": at([0, 10])}
    sides[empty] = sides[empty][:0]
    with pytest.raises(InputError, match="no usable pose"):
        associate(sides["groundtruth"], sides["estimate"], AssociationRule("linear"))


def test_rotations_a_half_turn_apart_do_not_become_nan() -> None:
    groundtruth = Trajectory(
        np.array([0, 100 * MILLISECOND], dtype=np.int64),
        np.zeros((2, 3)),
        np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]),
    )
    middle = Trajectory(
        np.array([50 * MILLISECOND], dtype=np.int64),
        np.zeros((1, 3)),
        Rotation.identity(1).as_quat(),
    )
    truth = associate(groundtruth, middle, AssociationRule("linear")).groundtruth
    assert truth.rotations is not None
    assert truth.rotations.magnitude()[0] == pytest.approx(np.pi / 2)
