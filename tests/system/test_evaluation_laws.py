"""Laws of an evaluation: what no metric sees, orders of errors, and repeatability."""

from __future__ import annotations

import dataclasses
import pickle
from itertools import pairwise

import numpy as np
import pytest
from evaluation_settings import BASE
from hypothesis import given, settings
from strategies import (
    Pair,
    all_statistics,
    assert_same_numbers,
    make_element,
    make_estimate,
    make_groundtruth,
    moved,
    pairs,
    seeds,
)

from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.metrics.evaluation import ATE_METRICS
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.pipeline.pipeline import evaluate

CASES = [
    (gauge, states)
    for gauge in Gauge
    for states in (None, 1, 30)
    if not (gauge is Gauge.SIM3 and states == 1)
]


@pytest.mark.slow
@pytest.mark.parametrize(("gauge", "states"), CASES)
@settings(max_examples=6)
@given(pair=pairs(), seed=seeds)
def test_no_metric_sees_the_gauge(gauge: Gauge, states: int | None, pair: Pair, seed: int) -> None:
    protocol = dataclasses.replace(BASE, gauge=gauge, align_states=states)
    before = evaluate(pair.groundtruth, pair.estimate, protocol)
    element = make_element(gauge, seed)
    after = evaluate(pair.groundtruth, moved(pair.estimate, element), protocol)
    assert_same_numbers(before, after)
    if states is None:
        assert before.ate["rotation_deg"] is not None
        assert before.relative is not None
        assert all(len(item.errors.ends) for item in before.relative)


@pytest.mark.slow
@pytest.mark.parametrize("gauge", list(Gauge))
@settings(max_examples=5)
@given(pair=pairs(), seed=seeds)
def test_no_metric_sees_the_gauge_in_the_tutorials_forms(
    gauge: Gauge, pair: Pair, seed: int
) -> None:
    protocol = dataclasses.replace(BASE, gauge=gauge, ate_form="tutorial", re_form="tutorial")
    before = evaluate(pair.groundtruth, pair.estimate, protocol)
    after = evaluate(pair.groundtruth, moved(pair.estimate, make_element(gauge, seed)), protocol)
    assert_same_numbers(before, after)


@pytest.mark.slow
@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.SE3, Gauge.SIM3])
@settings(max_examples=5)
@given(pair=pairs(), seed=seeds)
def test_weighted_alignment_does_not_see_the_gauge(gauge: Gauge, pair: Pair, seed: int) -> None:
    protocol = dataclasses.replace(BASE, gauge=gauge, align_weights="covariance")
    element = make_element(gauge, seed)
    assert pair.estimate.covariances is not None
    # Turned, too, but only their traces weigh.
    covariances = element.scale**2 * pair.estimate.covariances
    scaled = dataclasses.replace(moved(pair.estimate, element), covariances=covariances)
    before = evaluate(pair.groundtruth, pair.estimate, protocol)
    assert_same_numbers(before, evaluate(pair.groundtruth, scaled, protocol))


@pytest.mark.slow
@settings(max_examples=6)
@given(pair=pairs(), seed=seeds)
def test_turning_both_worlds_about_gravity_changes_no_plain_metric(pair: Pair, seed: int) -> None:
    protocol = dataclasses.replace(BASE, gauge=Gauge.YAW)
    element = make_element(Gauge.YAW, seed)
    before = evaluate(pair.groundtruth, pair.estimate, protocol)
    after = evaluate(moved(pair.groundtruth, element), pair.estimate, protocol)
    assert_same_numbers(before, after)


@pytest.mark.slow
@settings(max_examples=6)
@given(pair=pairs(), seed=seeds)
def test_turning_both_worlds_freely_changes_neither_positions_nor_angles(
    pair: Pair, seed: int
) -> None:
    element = make_element(Gauge.SE3, seed)
    before = evaluate(pair.groundtruth, pair.estimate, BASE).absolute
    after = evaluate(moved(pair.groundtruth, element), pair.estimate, BASE).absolute
    assert before.rotation_deg is not None
    assert after.rotation_deg is not None
    np.testing.assert_allclose(after.position_m, before.position_m, rtol=0, atol=1e-10)
    np.testing.assert_allclose(after.rotation_deg, before.rotation_deg, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("gauge", list(Gauge))
@settings(max_examples=5)
@given(pair=pairs())
def test_plain_errors_do_not_see_the_worlds_origin(gauge: Gauge, pair: Pair) -> None:
    protocol = dataclasses.replace(BASE, gauge=gauge)
    shift = Similarity(np.eye(3), np.array([6000.0, -8000.0, 500.0]))
    before = evaluate(pair.groundtruth, pair.estimate, protocol)
    estimate = moved(pair.estimate, shift) if gauge is Gauge.NONE else pair.estimate
    after = evaluate(moved(pair.groundtruth, shift), estimate, protocol)
    assert_same_numbers(before, after, relative=1e-9, absolute=1e-9)


@pytest.mark.slow
@settings(max_examples=6)
@given(pair=pairs())
def test_the_tutorials_form_grows_with_the_distance_from_the_worlds_origin(pair: Pair) -> None:
    # Eq. (23) turns the aligned position about the origin by the rotation error: 10 km away, a
    # hundredth of a radian is a hundred metres. That is why `plain` is the default.
    protocol = dataclasses.replace(BASE, gauge=Gauge.YAW, ate_form="tutorial", lengths=())
    shift = Similarity(np.eye(3), np.array([6000.0, -8000.0, 0.0]))
    near = evaluate(pair.groundtruth, pair.estimate, protocol).ate["position_m"]
    far = evaluate(moved(pair.groundtruth, shift), pair.estimate, protocol)
    position = far.ate["position_m"]
    assert near is not None
    assert position is not None
    assert position.rmse > 10.0 * near.rmse
    assert any("origin" in warning for warning in far.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("gauge", list(Gauge))
@settings(max_examples=6)
@given(pair=pairs())
def test_aligning_by_all_states_is_never_worse_in_position(gauge: Gauge, pair: Pair) -> None:
    def rmse(states: int | None) -> float:
        protocol = dataclasses.replace(BASE, gauge=gauge, align_states=states, lengths=())
        position = evaluate(pair.groundtruth, pair.estimate, protocol).ate["position_m"]
        assert position is not None
        return position.rmse

    best = rmse(None)
    for states in (1, 5, 20, 39):
        if states == 1 and gauge is Gauge.SIM3:
            continue
        assert best <= rmse(states) * (1.0 + 1e-12)


@pytest.mark.slow
@settings(max_examples=6)
@given(pair=pairs())
def test_a_larger_gauge_never_leaves_a_larger_position_error(pair: Pair) -> None:
    def rmse(gauge: Gauge) -> float:
        protocol = dataclasses.replace(BASE, gauge=gauge, lengths=())
        position = evaluate(pair.groundtruth, pair.estimate, protocol).ate["position_m"]
        assert position is not None
        return position.rmse

    nested = (Gauge.NONE, Gauge.TRANSLATION, Gauge.YAW, Gauge.SE3, Gauge.SIM3)
    errors = [rmse(gauge) for gauge in nested]
    assert all(after <= before * (1.0 + 1e-12) for before, after in pairwise(errors))


@pytest.mark.slow
@settings(max_examples=6)
@given(pair=pairs(), seed=seeds)
def test_the_order_of_rows_does_not_matter(pair: Pair, seed: int) -> None:
    random = np.random.default_rng(seed)
    shuffled = Pair(
        pair.groundtruth[random.permutation(len(pair.groundtruth))],
        pair.estimate[random.permutation(len(pair.estimate))],
    )
    assert len(np.unique(pair.estimate.stamps)) == len(pair.estimate)
    before = evaluate(pair.groundtruth, pair.estimate, BASE)
    after = evaluate(shuffled.groundtruth, shuffled.estimate, BASE)
    assert all_statistics(before) == all_statistics(after)


@pytest.mark.parametrize("gauge", list(Gauge))
@given(pair=pairs())
@settings(max_examples=5)
def test_evaluating_twice_gives_the_same_bytes(gauge: Gauge, pair: Pair) -> None:
    def as_bytes() -> bytes:
        result = evaluate(pair.groundtruth, pair.estimate, dataclasses.replace(BASE, gauge=gauge))
        columns = dataclasses.asdict(result.absolute)
        segments = [dataclasses.asdict(item.errors) for item in result.relative or ()]
        return pickle.dumps((all_statistics(result), columns, segments, result.warnings))

    assert as_bytes() == as_bytes()


@pytest.mark.parametrize("gauge", list(Gauge))
def test_inputs_are_never_written_to(gauge: Gauge) -> None:
    groundtruth = make_groundtruth(3)
    estimate = make_estimate(groundtruth, 4)
    for trajectory in (groundtruth, estimate):
        for value in vars(trajectory).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
    before = pickle.dumps((groundtruth, estimate))
    for weights in ("none", "covariance"):
        protocol = dataclasses.replace(BASE, gauge=gauge, align_weights=weights)
        evaluate(groundtruth, estimate, protocol)
    assert pickle.dumps((groundtruth, estimate)) == before


@pytest.mark.parametrize(("gauge", "states"), CASES)
@settings(max_examples=5)
@given(seed=seeds)
def test_a_perfect_estimate_has_no_error(gauge: Gauge, states: int | None, seed: int) -> None:
    groundtruth = make_groundtruth(seed)
    estimate = moved(groundtruth, make_element(gauge, seed + 1))
    result = evaluate(
        groundtruth, estimate, dataclasses.replace(BASE, gauge=gauge, align_states=states)
    )
    flat = {"tilt_deg", "vertical_m"} if gauge is Gauge.PLANAR else set()
    expected = set(ATE_METRICS) - flat
    # Thirty states of a slow motion may be too straight for their rotation to be trusted.
    if states != 30:
        assert {name for name, item in result.ate.items() if item is not None} == expected
    errors = {
        name: statistic
        for name, statistic in all_statistics(result).items()
        if statistic is not None
    }
    assert errors
    for name, statistics in errors.items():
        assert statistics.max < 1e-8, name


@settings(max_examples=6)
@given(pair=pairs())
def test_every_metric_has_as_many_errors_as_there_are_pairs(pair: Pair) -> None:
    result = evaluate(pair.groundtruth, pair.estimate, BASE)
    assert len(result.ate) > 0
    for statistics in result.ate.values():
        assert statistics is not None
        assert statistics.count == len(result.association)
        _assert_ordered(statistics)
    for segments in result.relative or ():
        for name in ("position_m", "rotation_deg", "yaw_deg", "tilt_deg", "velocity_mps"):
            item = segments.statistics[name]
            assert item is not None
            assert item.count == len(segments.errors.ends)
            _assert_ordered(item)


def _assert_ordered(item: Statistics) -> None:
    assert 0.0 <= item.min <= item.median <= item.p95 <= item.max
    assert item.min <= item.mean <= item.rmse <= item.max * (1.0 + 1e-12)
    assert item.rmse**2 == pytest.approx(item.mean**2 + item.std**2)
