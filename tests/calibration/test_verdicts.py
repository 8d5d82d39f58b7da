"""What a recording doesn't show is named, with the reason, and no number is given."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from calibration_flights import Fault, fly
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import seeds

from trajeval_ros.calibration.calibrate import SystematicErrors, calibrate
from trajeval_ros.calibration.observability import Directions
from trajeval_ros.calibration.significance import judge
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory

FAULT = Fault(0.3, 0.0, (0.0, 0.0, 0.0), (0.1, 0.05, 0.2))
NONE = SystematicErrors(0.0, 0.0)


def without_rotations(trajectory: Trajectory) -> Trajectory:
    return dataclasses.replace(trajectory, quaternions=None)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["straight", "static"])
def test_constant_motion_shows_nothing(kind: str) -> None:
    result = calibrate(*fly(1, 60.0, kind, FAULT))
    for item in (result.offset, result.rotation, result.lever):
        assert item.status == "unobservable"
        assert item.value is None
        assert item.sigma is None
    assert "do not correlate" in result.offset.reason
    assert "motion is too uniform" in result.offset.reason
    assert "not observable" in result.lever.reason


def test_translation_alone_shows_clock_and_rotation_but_no_lever_arm() -> None:
    result = calibrate(*fly(1, 60.0, "translating", FAULT), systematic=NONE)
    assert result.offset.status == "significant"
    assert result.offset.value == pytest.approx([0.3], abs=2e-3)
    assert result.rotation.status == "insignificant"
    assert result.lever.status == "unobservable"


@pytest.mark.slow
def test_one_axis_hides_the_lever_arm_along_it() -> None:
    result = calibrate(*fly(1, 300.0, "car", FAULT), systematic=NONE)
    assert result.offset.value == pytest.approx([0.3], abs=5e-3)
    assert result.lever.value is not None
    assert result.lever.value[2] == pytest.approx(0.0, abs=1e-3)
    assert np.count_nonzero(result.lever.reliability < 0.5) == 1
    assert "along z" in result.lever.reason


@given(seed=seeds, hidden=st.integers(0, 2))
def test_components_along_what_is_hidden_have_no_standard_deviation(
    seed: int, hidden: int
) -> None:
    random = np.random.default_rng(seed)
    rotated = Rotation.random(random_state=random.integers(2**31)).as_matrix()
    # Half of the time an axis is hidden to a degree or so, else a direction between the axes.
    directions = Rotation.from_rotvec(random.normal(0.0, 0.02, 3)).as_matrix()
    if random.uniform() < 0.5:
        directions = rotated
    reliability = np.ones(3)
    reliability[hidden] = 0.1
    deviations = random.uniform(1e-3, 1e-2, 3)
    deviations[hidden] = 0.0
    covariance = (directions.T * deviations**2) @ directions
    value = directions[np.arange(3) != hidden].sum(axis=0)
    result = judge(
        value, covariance, 0.0, Directions(directions, reliability), 12, widest=0.1, unit="m"
    )
    assert result.sigma is not None
    assert result.half_width_95 is not None
    assert result.seen == 2
    known = np.abs(directions[hidden]) < np.sqrt(1.0 - 0.97**2)
    np.testing.assert_array_equal(np.isnan(result.sigma), ~known)
    np.testing.assert_array_equal(np.isnan(result.half_width_95), ~known)
    np.testing.assert_allclose(result.sigma[known], np.sqrt(np.diag(covariance))[known])


@given(st.floats(0.0, 3.5))
def test_the_p_value_is_printed_without_an_exponent(sigmas: float) -> None:
    one = Directions(np.eye(1), np.ones(1))
    result = judge(
        np.array([1e-3 * sigmas]), np.array([[1e-6]]), 0.0, one, 12, widest=1.0, unit="s"
    )
    assert result.chance is not None
    if result.status == "insignificant":
        number = result.reason.removeprefix("p = ")
        assert re.fullmatch(r"1|0\.[0-9]{1,4}", number)
        assert float(number) == pytest.approx(result.chance, rel=0.05)


def test_positions_alone_show_no_rotation() -> None:
    truth, estimate = fly(1, 60.0, fault=FAULT)
    result = calibrate(without_rotations(truth), estimate, Gauge.YAW, systematic=NONE)
    assert result.offset.value == pytest.approx([0.3], abs=3e-3)
    assert result.lever.value == pytest.approx([0.1, 0.05, 0.2], abs=0.02)
    assert result.rotation.status == "unobservable"
    assert "needs orientations on both sides" in result.rotation.reason
    neither = calibrate(without_rotations(truth), without_rotations(estimate), systematic=NONE)
    assert neither.lever.status == "unobservable"
    assert "needs the estimate's orientations" in neither.lever.reason


@pytest.mark.slow
def test_an_offset_beyond_the_search_range_is_named() -> None:
    truth, estimate = fly(1, 60.0, fault=dataclasses.replace(FAULT, offset_s=12.0))
    result = calibrate(truth, estimate)
    assert result.offset.status == "unobservable"
    assert "probably +12.00 s, outside the search range of 5 s" in result.offset.reason
    near = calibrate(truth, estimate, around_s=12.0)
    assert near.offset.value == pytest.approx([12.0], abs=2e-3)


def test_an_overlap_too_short() -> None:
    truth, estimate = fly(1, 8.0, fault=dataclasses.replace(FAULT, offset_s=0.0))
    result = calibrate(truth, estimate)
    assert result.offset.status == "unobservable"
    assert "common time span of 10 s" in result.offset.reason
    assert result.lever.status == "unobservable"


def test_a_short_run_has_an_offset_but_no_body() -> None:
    truth, estimate = fly(1, 20.0, fault=dataclasses.replace(FAULT, lever_m=(0.0, 0.0, 0.0)))
    result = calibrate(truth, estimate)
    assert result.offset.status == "significant"
    assert result.rotation.status == result.lever.status == "unobservable"
    assert any("too short to estimate rotation" in remark.text for remark in result.remarks)


@pytest.mark.parametrize("side", [0, 1])
def test_without_stamps_or_poses_there_is_nothing_to_compare(side: int) -> None:
    pair = list(fly(1, 20.0))
    pair[side] = dataclasses.replace(pair[side], reading=SourceInfo(stamped=False))
    with pytest.raises(InputError, match="no timestamps"):
        calibrate(*pair)
    pair[side] = dataclasses.replace(pair[side], reading=SourceInfo())[:1]
    with pytest.raises(InputError, match="fewer than two poses"):
        calibrate(*pair)


@pytest.mark.slow
def test_a_skew_is_found_when_asked_for() -> None:
    truth, estimate = fly(1, 180.0, fault=dataclasses.replace(FAULT, skew=5e-5))
    result = calibrate(truth, estimate, with_skew=True, systematic=NONE)
    assert result.skew is not None
    assert result.skew.is_significant
    assert result.skew.value == pytest.approx([5e-5], abs=1e-5)
    short = calibrate(*fly(1, 60.0, fault=FAULT), with_skew=True)
    assert any("clock skew from" in remark.text for remark in short.remarks)


def test_gaps_and_lost_poses_change_it_within_its_uncertainty() -> None:
    truth, estimate = fly(3, 90.0, fault=FAULT)
    whole = calibrate(truth, estimate)
    seconds = truth.seconds
    kept = np.random.default_rng(0).random(len(estimate)) > 0.3
    holed = calibrate(truth[(seconds < 50.0) | (seconds > 62.0)], estimate[kept])
    for actual, theirs in ((whole.offset, holed.offset), (whole.lever, holed.lever)):
        assert actual.value is not None
        assert theirs.value is not None
        assert theirs.sigma is not None
        assert (np.abs(actual.value - theirs.value) < 3.0 * theirs.sigma).all()
