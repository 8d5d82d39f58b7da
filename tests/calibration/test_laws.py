"""Laws of the calibration: what changes neither clock nor body changes no number."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from calibration_flights import Fault, fly
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import make_element, moved, seeds

from trajeval_ros.calibration.calibrate import Calibration, SystematicErrors, calibrate
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory

FAULT = Fault(0.08, 0.0, (0.4, -0.7, 1.1), (0.1, -0.05, 0.2))
NONE = SystematicErrors(0.0, 0.0)
few = hypothesis_settings(max_examples=3)


def values(calibration: Calibration) -> list[np.ndarray]:
    result = [calibration.offset.value, calibration.rotation.value, calibration.lever.value]
    assert all(value is not None for value in result)
    return [value for value in result if value is not None]


def sigmas(calibration: Calibration) -> list[np.ndarray]:
    result = [calibration.offset.sigma, calibration.rotation.sigma, calibration.lever.sigma]
    return [sigma for sigma in result if sigma is not None]


def assert_same(computed: Calibration, theirs: Calibration, tolerance: float = 1e-6) -> None:
    for mine, other in zip(values(computed), values(theirs), strict=True):
        assert np.allclose(mine, other, rtol=0.0, atol=tolerance)
    for mine, other in zip(sigmas(computed), sigmas(theirs), strict=True):
        assert np.allclose(mine, other, rtol=1e-3, atol=tolerance)


@pytest.mark.slow
@few
@given(seed=seeds, gauge=st.sampled_from([Gauge.TRANSLATION, Gauge.YAW, Gauge.SE3, Gauge.SIM3]))
def test_gauge_elements_change_nothing(seed: int, gauge: Gauge) -> None:
    truth, estimate = fly(seed % 1000, 40.0, fault=FAULT)
    element = make_element(gauge, seed)
    before = calibrate(truth, estimate, gauge, systematic=NONE)
    after = calibrate(truth, moved(estimate, element), gauge, systematic=NONE)
    assert_same(before, after)
    assert after.scale * element.scale == pytest.approx(before.scale, rel=1e-9)


@few
@given(seed=seeds, gauge=st.sampled_from([Gauge.TRANSLATION, Gauge.YAW, Gauge.SE3, Gauge.SIM3]))
def test_gauge_elements_change_nothing_with_positions_alone(seed: int, gauge: Gauge) -> None:
    truth, estimate = fly(seed % 1000, 40.0, fault=FAULT)
    truth = dataclasses.replace(truth, quaternions=None)
    element = make_element(gauge, seed)
    before = calibrate(truth, estimate, gauge, systematic=NONE)
    after = calibrate(truth, moved(estimate, element), gauge, systematic=NONE)
    for actual, theirs in ((before.offset, after.offset), (before.lever, after.lever)):
        assert actual.value is not None
        assert theirs.value is not None
        assert np.allclose(actual.value, theirs.value, rtol=0.0, atol=1e-6)


@pytest.mark.slow
@few
@given(seed=seeds, shift_s=st.floats(-3.0, 3.0))
def test_a_shift_of_the_groundtruth_is_the_offset(seed: int, shift_s: float) -> None:
    truth, estimate = fly(seed % 1000, 40.0, fault=dataclasses.replace(FAULT, offset_s=0.0))
    shift = round(shift_s * 1e9)
    shifted = dataclasses.replace(truth, stamps=truth.stamps + shift)
    before = calibrate(truth, estimate, systematic=NONE)
    after = calibrate(shifted, estimate, systematic=NONE)
    assert before.offset.value is not None
    assert after.offset.value is not None
    # To the last step of the iteration, a ten-thousandth of a naive standard deviation.
    assert after.offset.value - before.offset.value == pytest.approx(shift / 1e9, abs=1e-6)


@pytest.mark.slow
@few
@given(seed=seeds)
def test_another_body_of_the_estimate(seed: int) -> None:
    truth, estimate = fly(seed % 1000, 40.0, fault=FAULT)
    random = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec(random.uniform(-1.0, 1.0, 3))
    lever_m = random.uniform(-0.3, 0.3, 3)
    assert estimate.rotations is not None
    other = dataclasses.replace(
        estimate,
        positions=estimate.positions + estimate.rotations.apply(lever_m),
        quaternions=(estimate.rotations * rotation).as_quat(),
    )
    _, before, arm = values(calibrate(truth, estimate, systematic=NONE))
    _, after, other_arm = values(calibrate(truth, other, systematic=NONE))
    expected = rotation.inv() * Rotation.from_rotvec(before)
    assert (expected.inv() * Rotation.from_rotvec(after)).magnitude() < 1e-5
    assert np.allclose(rotation.apply(other_arm) + lever_m, arm, rtol=0.0, atol=1e-4)


def test_scales_of_units() -> None:
    truth, estimate = fly(5, fault=FAULT)

    def in_millimetres(item: Trajectory) -> Trajectory:
        return dataclasses.replace(item, positions=1000.0 * item.positions)

    metres = calibrate(truth, estimate, systematic=NONE)
    millimetres = calibrate(in_millimetres(truth), in_millimetres(estimate), systematic=NONE)
    for actual, theirs, factor in zip(
        values(metres), values(millimetres), (1, 1, 1000), strict=True
    ):
        assert np.allclose(factor * actual, theirs, rtol=1e-9, atol=1e-9)


def test_identical_trajectories_need_nothing() -> None:
    truth, _ = fly(2)
    result = calibrate(truth, truth, systematic=NONE)
    assert [item.status for item in (result.offset, result.rotation, result.lever)] == 3 * [
        "insignificant"
    ]
    for value in values(result):
        assert np.allclose(value, 0.0, atol=1e-9)


def test_same_bytes_twice() -> None:
    truth, estimate = fly(4, fault=FAULT)
    first, second = calibrate(truth, estimate), calibrate(truth, estimate)
    assert [value.tobytes() for value in values(first)] == [
        value.tobytes() for value in values(second)
    ]


@pytest.mark.parametrize("epoch_apart_s", [0.0, 1.4e9])
def test_clocks_of_different_epochs(epoch_apart_s: float) -> None:
    truth, estimate = fly(6, fault=FAULT)
    shifted = dataclasses.replace(estimate, stamps=estimate.stamps - round(epoch_apart_s * 1e9))
    result = calibrate(truth, shifted, systematic=NONE)
    assert result.offset.is_significant
    assert result.offset.value is not None
    assert result.offset.value[0] - epoch_apart_s == pytest.approx(0.08, abs=1e-3)


@pytest.mark.slow
def test_reliabilities_are_correlations() -> None:
    for kind in ("drone", "car", "straight", "translating", "static"):
        result = calibrate(*fly(7, 40.0, kind, FAULT))
        for item in (result.offset, result.rotation, result.lever):
            assert (np.abs(item.reliability) <= 1.0).all()
