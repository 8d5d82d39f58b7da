"""Gauges, modalities, and the group laws of their elements."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation
from strategies import make_element, make_groundtruth, seeds

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import MODALITIES, Gauge, Similarity, gauge_for


@pytest.mark.parametrize("default", [Gauge.SE3, Gauge.NONE])
def test_nothing_asked_for_is_the_default(default: Gauge) -> None:
    assert gauge_for(None, None, default) is default


@pytest.mark.parametrize("modality", list(MODALITIES))
def test_a_gauge_may_repeat_the_modality_but_not_contradict_it(modality: str) -> None:
    implied = MODALITIES[modality]
    for default in Gauge:  # which contradicts nothing: nobody asked for it
        assert gauge_for(None, modality, default) is implied
    assert gauge_for(implied.value, modality, Gauge.SE3) is implied
    for other in Gauge:
        if other is not implied:
            with pytest.raises(SettingsError, match="only one"):
                gauge_for(other.value, modality, Gauge.SE3)


@pytest.mark.parametrize(("gauge", "modality"), [("yav", None), (None, "sonar")])
def test_unknown_names_are_refused_with_those_that_are(
    gauge: str | None, modality: str | None
) -> None:
    with pytest.raises(SettingsError, match=r"yaw|stereo-inertial"):
        gauge_for(gauge, modality, Gauge.SE3)


@given(seed=seeds)
def test_transforming_is_eq_8(seed: int) -> None:
    element = make_element(Gauge.SIM3, seed)
    trajectory = make_groundtruth(seed, 10)
    after = element.trajectory(trajectory)
    assert trajectory.rotations is not None
    assert after.rotations is not None
    assert trajectory.velocities is not None
    assert after.velocities is not None
    s, R, t = element.scale, element.rotation, element.translation
    for i in range(10):
        np.testing.assert_allclose(after.positions[i], s * R @ trajectory.positions[i] + t)
        np.testing.assert_allclose(after.velocities[i], s * R @ trajectory.velocities[i])
        np.testing.assert_allclose(
            after.rotations[i].as_matrix(), R @ trajectory.rotations[i].as_matrix(), atol=1e-14
        )
    np.testing.assert_array_equal(after.gyroscope_biases, trajectory.gyroscope_biases)
    np.testing.assert_array_equal(after.accelerometer_biases, trajectory.accelerometer_biases)


def test_the_identity_changes_nothing() -> None:
    trajectory = make_groundtruth(4, 10)
    after = Similarity.identity().trajectory(trajectory)
    np.testing.assert_array_equal(after.positions, trajectory.positions)
    # Normalised again: a sum of four squares, its root and a division, 4 u together.
    np.testing.assert_allclose(
        after.quaternions, trajectory.quaternions, rtol=2.0 * np.finfo(np.float64).eps
    )


@given(seed=seeds)
def test_a_similaritys_quaternion_is_its_rotation(seed: int) -> None:
    element = make_element(Gauge.SE3, seed)
    quaternion = element.rotation_xyzw
    assert quaternion[3] >= 0.0
    np.testing.assert_allclose(
        Rotation.from_quat(quaternion).as_matrix(), element.rotation, atol=1e-14
    )
