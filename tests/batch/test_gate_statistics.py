"""The tests behind regression gates: exactness, laws, false alarms, and power."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import TESTS
from scipy import stats

from benchmarks.gates import Cell
from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.gates import FALSE_ALARMS
from trajeval_ros.batch.permutation_tests import (
    OneSidedTests,
    PermutationTest,
    Sample,
    equal_trials,
    more_failures,
    more_trials,
    p_values,
    relabellings,
)
from trajeval_ros.geometry.arrays import Booleans, Floats

# Computed by enumeration of all relabellings, in code that shares nothing with the package.
CASES: dict[str, Any] = json.loads((TESTS / "data" / "gates" / "enumerated.json").read_text())[
    "cases"
]
GATE = Gate("ate.position_m.rmse", 0.0)


def rejects_together(side: OneSidedTests) -> Booleans:
    return side.together <= side.level_together


def rejects_alone(side: OneSidedTests) -> Booleans:
    return side.alone <= side.level_alone


def column(*values: float) -> Floats:
    return np.array(values)[:, None]


def samples_of(case: dict[str, Any], metrics: slice = slice(None)) -> list[Sample]:
    made = []
    for old, new in zip(case["old"], case["new"], strict=True):
        rows = np.array([*old, *new], dtype=float).reshape(len(old) + len(new), -1)
        rows[np.isnan(rows)] = math.inf
        z = np.column_stack([GATE.logarithms(list(item)) for item in rows.T])[:, metrics]
        made.append(Sample(z[: len(old)], z[len(old) :], paired=case.get("paired", False)))
    return made


def p_of(z: Sequence[Floats], old: int, **more: Any) -> Floats:
    """Return p-values of all sequences together, of logarithms (runs, metrics) by sequence."""
    samples = [Sample(item[:old], item[old:], **more) for item in z]
    return PermutationTest(samples, np.zeros(z[0].shape[1]), FALSE_ALARMS).worse.together


@pytest.mark.parametrize("name", CASES)
def test_small_cases_are_those_of_the_enumeration(name: str) -> None:
    case = CASES[name]
    samples = samples_of(case)
    assert math.prod(sample.count for sample in samples) == case["relabellings"]
    margins = np.full(len(case["p"]), math.log1p(case.get("margin", 0.0)))
    result = PermutationTest(samples, margins, 0.05)
    assert result.worse.together == pytest.approx(case["p_max_t"], abs=1e-12)
    # Bounds of the first metric alone, at the level of 5 %.
    first = PermutationTest(samples_of(case, slice(1)), margins[:1], 0.05)
    assert first.worse.together == pytest.approx(case["p"][:1], abs=1e-12)
    assert first.change[0] == pytest.approx(case["estimate"], abs=1e-12)
    bounds = (first.low[0], first.high[0])
    assert bounds == pytest.approx((case["lower_bound_95"], case["upper_bound_95"]), abs=1e-6)
    if not case.get("paired"):
        sizes = [(len(old), len(new)) for old, new in zip(case["old"], case["new"], strict=True)]
        assert more_trials(sizes, 0.025) == case["more_trials_for_0.025"]


@pytest.mark.parametrize(("old", "new"), [(3, 3), (4, 4), (5, 2), (2, 6)])
def test_one_sequence_is_scipys_permutation_test(old: int, new: int) -> None:
    z = np.random.default_rng(old).normal(size=old + new)
    expected = stats.permutation_test(
        (z[old:], z[:old]),
        lambda a, b, axis: a.mean(axis) - b.mean(axis),
        alternative="greater",
        n_resamples=np.inf,
        vectorized=True,
    ).pvalue
    assert p_of([z[:, None]], old)[0] == pytest.approx(expected, abs=1e-12)


def test_one_trial_of_equal_sequences_and_pairs_are_scipys_sign_flips() -> None:
    differences = np.array([0.3, -0.1, 0.2, 0.15, -0.05, 0.4, 0.02])
    expected = stats.permutation_test(
        (differences,),
        lambda x, axis: x.mean(axis),
        permutation_type="samples",
        alternative="greater",
        n_resamples=np.inf,
        vectorized=True,
    ).pvalue
    z = np.concatenate([np.zeros(7), differences])[:, None]
    assert p_of([z], 7, paired=True)[0] == pytest.approx(expected, abs=1e-12)


SIZES = st.lists(st.tuples(st.integers(1, 3), st.integers(1, 3)), min_size=1, max_size=3)
VALUES = st.sampled_from([0.0, 0.1, 0.3, 1.0, math.nan]) | st.floats(-2.0, 2.0)


@st.composite
def runs(draw: st.DrawFn) -> tuple[list[tuple[int, int]], list[Floats]]:
    sizes = draw(SIZES)
    z = [
        np.array([draw(st.lists(VALUES, min_size=2, max_size=2)) for _ in range(old + new)])
        for old, new in sizes
    ]
    for own, (old, _) in zip(z, sizes, strict=True):
        own[[0, old]] = np.where(np.isnan(own[[0, old]]), 0.7, own[[0, old]])
    return sizes, z


def samples(sizes: Sequence[tuple[int, int]], z: Sequence[Floats]) -> list[Sample]:
    return [Sample(*np.split(own, [old])) for (old, _), own in zip(sizes, z, strict=True)]


@pytest.mark.slow
@given(runs())
@settings(max_examples=60, deadline=None)
def test_laws(made: tuple[list[tuple[int, int]], list[Floats]]) -> None:
    """Order of runs and sequences and units change no p; sides exchange the two directions."""
    sizes, z = made
    result = PermutationTest(samples(sizes, z), np.zeros(2), 0.2)
    same = PermutationTest(
        samples(sizes[::-1], [np.concatenate([own[:old][::-1], own[old:][::-1]]) + place
                              for place, ((old, _), own) in enumerate(zip(sizes, z, strict=True))
                              ][::-1]),
        np.zeros(2), 0.2)  # fmt: skip
    assert same.worse.together == pytest.approx(result.worse.together, abs=1e-12)
    assert same.worse.alone[::-1] == pytest.approx(result.worse.alone, abs=1e-12)
    assert same.better.together == pytest.approx(result.better.together, abs=1e-12)
    swapped = [
        np.concatenate([own[old:], own[:old]]) for (old, _), own in zip(sizes, z, strict=True)
    ]
    other = PermutationTest(samples([(n, m) for m, n in sizes], swapped), np.zeros(2), 0.2)
    assert other.better.together == pytest.approx(result.worse.together, abs=1e-12)
    assert other.worse.together == pytest.approx(result.better.together, abs=1e-12)
    for metric in range(2):  # p-values are monotone in the margin's edge, so bounds are ordered
        if np.isfinite(result.low[metric]):
            assert result.low[metric] <= result.change[metric] + 1e-9


@given(st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=40), st.floats(-3.0, 3.0))
def test_p_values_are_monotone(relabelled: list[float], value: float) -> None:
    values = np.sort(np.array([value, *relabelled]))
    p = p_values(np.array(relabelled), values)
    assert (np.diff(p) <= 0.0).all()
    assert ((p >= 0.0) & (p <= 1.0)).all()


@pytest.mark.parametrize("paired", [False, True])
@given(data=st.data())
@settings(max_examples=15, deadline=None)
def test_p_falls_if_new_errors_grow(paired: bool, data: st.DataObject) -> None:
    z = np.array(data.draw(st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8)))[:, None]
    p = []
    for shift in (0.0, 0.2, 0.5, 2.0, 9.0):
        moved = z.copy()
        moved[4:] += shift
        p.append(p_of([moved], 4, paired=paired)[0])
    assert (np.diff(p) <= 1e-12).all()
    assert p[-1] == pytest.approx(1.0 / (2**4 if paired else 70))


@pytest.mark.slow
@given(runs())
@settings(max_examples=25, deadline=None)
def test_the_level_is_exact_over_all_relabellings(
    made: tuple[list[tuple[int, int]], list[Floats]],
) -> None:
    """Every relabelling is once the truth: at most a share k / count has p <= k / count."""
    sizes, z = made
    z = [np.where(np.isnan(own), 0.5, own) for own in z]
    p = []
    for labels in itertools.product(*(
        list(itertools.combinations(range(old + new), old)) for old, new in sizes
    )):  # fmt: skip
        if len(p) >= 400:
            return  # too many relabellings
        rows = [[*chosen, *(set(range(len(own))) - set(chosen))]
                for chosen, own in zip(labels, z, strict=True)]  # fmt: skip
        moved = samples(sizes, [own[row] for own, row in zip(z, rows, strict=True)])
        p.append(PermutationTest(moved, np.zeros(2), 0.2).worse.together.min())
    assert len(p) >= 2
    for level in np.unique(p):
        assert np.mean(np.array(p) <= level + 1e-12) <= level + 1e-12


def test_single_sequences_and_all_together_share_the_level_exactly() -> None:
    """Two sequences with 5 and 5 runs: a random half of the relabellings is the truth."""
    random = np.random.default_rng(7)
    z = [random.normal(size=(10, 1)) * scale for scale in (0.1, 1.0)]
    z[0][3] += 5.0
    alarms = 0
    for _ in range(400):
        moved = [own[random.permutation(10)] for own in z]
        test = PermutationTest(samples([(5, 5)] * 2, moved), np.zeros(1), 0.1, 399, random)
        alarms += bool(rejects_together(test.worse).any() or rejects_alone(test.worse).any())
    assert alarms <= stats.binom.ppf(0.999, 400, 0.1)


@given(st.integers(1, 6), st.integers(1, 5), st.integers(0, 2**16))
@settings(max_examples=20, deadline=None)
def test_the_same_trials_on_both_sides_never_alarm(sequences: int, trials: int, seed: int) -> None:
    z = np.random.default_rng(seed).normal(0.0, 0.3, (sequences, trials, 1))
    result = PermutationTest([Sample(item, item) for item in z], np.zeros(1), FALSE_ALARMS)
    assert not rejects_together(result.worse).any()
    assert not rejects_alone(result.worse).any()
    assert result.worse.together[0] >= 0.49


def test_random_relabellings_have_the_sizes_of_the_sides_and_the_true_ones_first() -> None:
    drawn = list(relabellings([Sample(np.zeros((30, 1)), np.zeros((20, 1)))] * 2, 500))
    assert all((item.sum(1) == 20).all() for item in drawn)
    assert (drawn[0][0] == (np.arange(50) >= 30)).all()
    assert len(np.unique(drawn[0], axis=0)) == 501
    assert abs(drawn[0][1:].mean(0) - 0.4).max() < 0.1
    (pairs,) = relabellings([Sample(np.zeros((30, 1)), np.zeros((30, 1)), paired=True)], 500)
    assert (np.abs(pairs) == 1.0).all()
    assert (pairs[0] == 1.0).all()


def test_a_missing_sequence_and_a_missing_metric_change_no_p() -> None:
    random = np.random.default_rng(0)
    z = [random.normal(size=(6, 1)) for _ in range(3)]
    gone = random.normal(size=(6, 1))
    gone[3:] = math.nan
    assert p_of([*z, gone], 3) == pytest.approx(p_of(z, 3), abs=0.02)  # other random relabellings
    small = [item[[0, 1, 3, 4]] for item in z]
    both = PermutationTest(samples([(2, 2)] * 4, [*small, gone[[0, 1, 3, 4]]]), np.zeros(1), 0.05)
    alone = PermutationTest(samples([(2, 2)] * 3, small), np.zeros(1), 0.05)
    assert both.worse.together == pytest.approx(alone.worse.together, abs=1e-12)
    assert (both.change, both.low) == (pytest.approx(alone.change), pytest.approx(alone.low))


def test_values_without_spread_are_never_worse() -> None:
    for trials in (1, 4, 10):
        result = PermutationTest([Sample(np.zeros((trials, 1)), np.zeros((trials, 1)))] * 6,
                                np.array([0.05]), FALSE_ALARMS)  # fmt: skip
        assert result.worse.together[0] == 1.0
        assert rejects_together(result.better)[0]


def test_a_zero_counts_as_the_smallest_positive_value() -> None:
    assert GATE.logarithms([0.0, 2.0, 0.5]) == pytest.approx(np.log([0.5, 2.0, 0.5]))
    assert GATE.logarithms([0.0, 0.0]) == pytest.approx([0.0, 0.0])
    missing = GATE.logarithms([math.inf, 1.0])
    assert math.isnan(missing[0])


def test_sizes_with_which_tests_can_reject() -> None:
    level = FALSE_ALARMS
    assert [equal_trials(item, level) for item in (1, 2, 3, 5, 6)] == [4, 3, 2, 2, 1]
    assert equal_trials(1, level / 2.0) == 5
    assert [more_trials([(1, 1)] * item, level) for item in (1, 5, 6)] == [38, 1, 0]
    tested = {}
    for size in ((5, 5), (10, 3), (12, 2), (4, 4), (10, 2)):
        z = np.zeros((sum(size), 1))
        test = PermutationTest(samples([size] * 2, [z, z]), np.zeros(1), level)
        tested[size] = test.tests_alone[0]
    assert tested == {(5, 5): True, (10, 3): True, (12, 2): True, (4, 4): False, (10, 2): False}


@pytest.mark.parametrize(("old", "new"), [(0, 3), (1, 4), (2, 2), (0, 0), (5, 5)])
def test_failures_of_one_number_are_fishers_exact_test(old: int, new: int) -> None:
    before, now = np.arange(6) < old, np.arange(5) < new
    exact = stats.hypergeom.sf(new - 1, 11, old + new, 5)
    assert more_failures([before], [now]) == pytest.approx(exact, abs=1e-12)


def test_failures_are_pooled_over_numbers() -> None:
    none, one = np.zeros(3, dtype=bool), np.arange(3) < 1
    assert more_failures([none], [one]) == pytest.approx(0.5)
    assert more_failures([none] * 11, [one] * 11) < 0.01
    assert more_failures([one] * 11, [one] * 11) > 0.4


# Bounds are missed by a true rate of 2.5 % once in a thousand. With two levels, Student's test
# alarms in 7 to 12 %.
@pytest.mark.slow
@pytest.mark.parametrize("spread", ["two levels", "outliers"])
@pytest.mark.parametrize(("sequences", "trials"), [(1, 5), (11, 1), (11, 2), (11, 3), (3, 10)])
def test_no_change_seldom_alarms(sequences: int, trials: int, spread: str) -> None:
    cell = Cell(trials, sequences, spread, comparisons=300, seed=1)
    assert cell.alarms() <= stats.binom.ppf(0.999, 300, FALSE_ALARMS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("common", "one", "sequences", "trials", "least"),
    [(0.2, 0.0, 11, 3, 0.88), (0.2, 0.0, 3, 10, 0.80), (0.0, 0.5, 11, 10, 0.93)],
)
def test_changes_are_found_as_often_as_the_documentation_says(
    common: float, one: float, sequences: int, trials: int, least: float
) -> None:
    cell = Cell(trials, sequences, "15 %", 1, 200, common, one)
    assert cell.alarms() >= stats.binom.ppf(0.001, 200, least)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sequences", "size"), [(11, (1, 1)), (11, (3, 3)), (1, (10, 10)), (3, (5, 5))]
)
def test_a_detectable_change_is_detected_in_four_of_five(
    sequences: int, size: tuple[int, int]
) -> None:
    random = np.random.default_rng(1)

    def test(common: float, one: float = 0.0) -> PermutationTest:
        z = random.normal(0.0, 0.15, (sequences, sum(size), 1))
        z[:, size[0] :] += common
        z[0, size[0] :] += one
        return PermutationTest(samples([size] * sequences, z), np.zeros(1), 0.025, 499, random)

    detectable = [test(0.1).detectable() for _ in range(30)]
    common = float(np.median([item[0][0] for item in detectable]))
    result = np.mean([rejects_together(test(common).worse)[0] for _ in range(200)])
    # 80 %, the deviation of 200 comparisons, and that of the median of 30 detectable changes.
    assert 0.68 < result < 0.92
    one = float(np.median([item[1][0, 0] for item in detectable]))
    assert math.isfinite(one) == (size == (5, 5))
    if math.isfinite(one):
        result = np.mean([rejects_alone(test(0.0, one).worse)[0, 0] for _ in range(200)])
        assert 0.65 < result < 0.92
