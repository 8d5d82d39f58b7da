"""Differences of rotations over time, and the only axis of a body that turns about one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration.observability import LEAST_RELIABILITY
from trajeval_ros.watchdog.rotations_over_time import between, only_axis

MOUNTED = Rotation.from_rotvec([0.4, -0.9, 0.6])
AXIS = np.array([0.6, 0.0, 0.8])


def test_the_difference_is_from_the_start_to_the_end() -> None:
    start, end = Rotation.random(7, random_state=1), Rotation.random(7, random_state=2)
    result = Rotation.from_quat(between(start.as_quat(), end.as_quat()))
    assert ((start.inv() * end).inv() * result).magnitude().max() < 1e-12


@pytest.mark.parametrize("across", [0.0, 0.01])
def test_noise_about_other_axes_is_no_rotation(across: float) -> None:
    """The noise of two sources is independent."""
    generator = np.random.default_rng(3)
    angles = generator.uniform(-0.5, 0.5, 500)
    own, other = (
        np.outer(angles, AXIS) + across * generator.normal(size=(500, 3)) for _ in range(2)
    )
    result = only_axis(own, MOUNTED.apply(other))
    assert result is not None
    assert abs(result @ AXIS) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(("factor", "is_only"), [(0.9, True), (1.1, False)])
def test_rotations_that_both_sources_measure_are_real(factor: float, *, is_only: bool) -> None:
    """Beside a reliability, the share of the variance that is not noise."""
    generator = np.random.default_rng(4)
    reliability = factor * LEAST_RELIABILITY
    angles = generator.uniform(-1.0, 1.0, 40_000)
    across = np.cross(AXIS, [0.0, 1.0, 0.0])
    shared = np.sqrt(reliability) * generator.normal(size=40_000)
    sides = [
        np.outer(10.0 * angles, AXIS)
        + np.outer(shared + np.sqrt(1.0 - reliability) * generator.normal(size=40_000), across)
        for _ in range(2)
    ]
    result = only_axis(0.01 * sides[0], MOUNTED.apply(0.01 * sides[1]))
    assert (result is not None) == is_only
