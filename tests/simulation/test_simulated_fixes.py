"""GNSS fixes of a simulated antenna: when they are measured, and errors as large as stated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry.geodesy import east_north_up
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.simulation.simulated_sensors import ANTENNA_M, SITE, gnss_fixes

DURATION_S = 200.0


def circle() -> Trajectory:
    """Return a body on a circle that turns with it, at 25 Hz."""
    seconds = np.arange(0.0, DURATION_S, 0.04)
    angle = 0.1 * seconds
    positions = np.stack([30.0 * np.cos(angle), 30.0 * np.sin(angle), 2.0 + 0.0 * angle], axis=1)
    quaternions = Rotation.from_rotvec(np.outer(angle, [0.0, 0.0, 1.0])).as_quat()
    stamps = 10**18 + np.round(seconds * NANOSECONDS).astype(np.int64)
    return Trajectory(stamps, positions, quaternions)


@pytest.mark.parametrize("receiver", ["rtk", "consumer"])
def test_fixes_come_once_a_second_from_the_first_second_to_the_last(receiver: str) -> None:
    truth = circle()
    begins = set()
    for seed in range(8):
        fixes = gnss_fixes(truth, receiver, seed)
        since_s = (fixes.stamps - truth.stamps[0]) / NANOSECONDS
        assert ((since_s - 0.3) % 1.0).max() < 0.74  # rows are 0.04 s apart
        assert since_s[0] < 1.04 + DURATION_S / 15.0  # an outage may be at the start
        assert since_s[-1] > DURATION_S - 1.04 - DURATION_S / 15.0
        steps = np.diff(since_s)
        np.testing.assert_allclose(steps, np.round(steps), atol=0.04)
        assert (np.round(steps) == 1.0).mean() > 0.95
        assert steps.max() > DURATION_S / 40.0 - 1.0  # an outage
        begins.add(round(float(since_s[0]), 2))
        again = gnss_fixes(truth, receiver, seed)
        np.testing.assert_array_equal(fixes.stamps, again.stamps)
    assert len(begins) > 4


def test_errors_of_an_rtk_receiver_are_as_large_as_stated() -> None:
    truth, ratios = circle(), []
    for seed in range(30):
        result = gnss_fixes(truth, "rtk", seed)
        fixes = result.reading.fixes
        assert fixes is not None
        rows = truth.stamps.searchsorted(result.stamps)
        states = truth[rows]
        assert states.rotations is not None
        antenna = states.positions + states.rotations.apply(ANTENNA_M)
        errors = east_north_up(fixes.places, SITE) - antenna
        assert fixes.covariances is not None
        sigma = np.sqrt(np.diagonal(fixes.covariances, axis1=1, axis2=2))
        ratios.append(np.square(errors / sigma).mean(axis=0))
        assert set(np.round(sigma[:, 0], 12)) == {0.01, 0.35}
    # Errors are correlated over 100 s: a run has few independent ones.
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1.0, atol=0.35)
