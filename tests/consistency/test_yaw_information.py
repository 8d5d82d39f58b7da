"""Yaw that no sensor observes: falls of its standard deviation are named, others are not."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import SHARED

from trajeval_ros.consistency.yaw_information import YawInformation
from trajeval_ros.formatting.remarks import Remark
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.covariance_frames import world_from_body_rotations
from trajeval_ros.io.sources import read_trajectory

Z = np.array([0.0, 0.0, 1.0])
SIMULATION = SHARED / "data" / "real_estimators" / "openvins_simulation"
MH_01 = SHARED / "data" / "euroc" / "openvins" / "MH_01_with_covariance.csv"
UPPER = np.triu_indices(6)


def remark_of(stamps: Stamps, covariances: Floats, up: Floats = Z) -> Remark | None:
    tested = YawInformation()
    tested.add(stamps, covariances, up)
    return tested.remark


def blocks(yaw_deg: Floats, tilt_deg: float = 0.01) -> tuple[Stamps, Floats]:
    """Return covariances at 10 Hz with standard deviations of yaw (N,)."""
    stamps = 10**8 * np.arange(len(yaw_deg), dtype=np.int64)
    covariances = np.zeros((len(yaw_deg), 3, 3))
    covariances[:, 0, 0] = covariances[:, 1, 1] = np.radians(tilt_deg) ** 2
    covariances[:, 2, 2] = np.radians(yaw_deg) ** 2
    return stamps, covariances


def runs(name: str) -> list[tuple[Stamps, Floats, Floats]]:
    """Return stamps, orientations and rotation covariances of all seeds."""
    if not SIMULATION.is_dir():
        pytest.skip("no recordings of real estimators")
    file = np.load(SIMULATION / f"{name}.npz")
    result = []
    for states, upper in zip(file["estimate"], file["covariance"].astype(float), strict=True):
        full = np.zeros((len(upper), 6, 6))
        full[:, UPPER[0], UPPER[1]] = upper
        full += np.swapaxes(np.triu(full, 1), 1, 2)
        result.append((file["stamps_ns"], states[:, 3:7], full))
    return result


@pytest.mark.parametrize("cameras", ["mono", "stereo"])
def test_all_filters_without_first_estimates_are_named(cameras: str) -> None:
    result = [remark_of(stamps, full[:, 3:, 3:]) for stamps, _, full in runs(f"{cameras}_fej_off")]
    assert len(result) == 8
    for item in result:
        assert item is not None
        assert item.text.startswith("the standard deviation of yaw falls from 1.13 to 0.0")


@pytest.mark.parametrize("cameras", ["mono", "stereo"])
def test_no_filter_with_first_estimates_is_named(cameras: str) -> None:
    # One of them diverges, and its covariances fall suddenly.
    result = list(runs(f"{cameras}_fej_on"))
    assert len(result) == 8
    for stamps, quaternions, full in result:
        assert remark_of(stamps, full[:, 3:, 3:]) is None
        # About the body's axes, whose z axis is not vertical, as some estimators publish them.
        to_body = np.swapaxes(lie.to_matrix(quaternions), 1, 2)
        assert remark_of(stamps, world_from_body_rotations(full, to_body)[:, 3:, 3:]) is None


def test_a_real_recording_is_not_named() -> None:
    if not MH_01.is_file():
        pytest.skip("no recordings of EuRoC")
    estimate = read_trajectory(MH_01)
    assert estimate.covariances is not None
    assert remark_of(estimate.stamps, estimate.covariances[:, 3:, 3:]) is None


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["paper", "stereo", "euroc"])
def test_no_simulated_estimator_is_named(profile: str, tmp_path: Path) -> None:
    from trajeval_ros.cli.app import main

    bag = tmp_path / "bag"
    assert (
        main(["simulate", str(bag), "--profile", profile, "--duration", "45", "--seed", "3"]) == 0
    )
    estimate = read_trajectory(f"{bag}:/vio/odometry")
    assert estimate.covariances is not None
    assert remark_of(estimate.stamps, estimate.covariances[:, 3:, 3:]) is None


@given(
    cuts=st.lists(st.integers(1, 599), max_size=6),
    last=st.floats(0.05, 2.0),
    sudden=st.booleans(),
)
def test_batches_do_not_matter(cuts: list[int], last: float, sudden: bool) -> None:
    yaw_deg = np.geomspace(1.0, last, 600)
    yaw_deg[300:] *= 0.7 if sudden else 1.0
    stamps, covariances = blocks(yaw_deg)
    tested = YawInformation()
    for begin, end in itertools.pairwise([0, *sorted(cuts), 600]):
        tested.add(stamps[begin:end], covariances[begin:end], Z)
    assert tested.remark == remark_of(stamps, covariances)


def test_the_standard_deviations_are_said() -> None:
    """Those of the fall, or of the first and the smallest one."""
    later = remark_of(*blocks(np.concatenate([np.full(210, 2.0), np.geomspace(2.0, 1.0, 190)])))
    first = remark_of(*blocks(np.concatenate([np.geomspace(1.5, 0.15, 190), np.full(210, 0.16)])))
    assert later is not None
    assert first is not None
    assert "falls from 2 to 1 deg" in later.text
    assert "falls from 1.5 to 0.15 deg" in first.text


def test_other_axes_and_planes_are_not_tested() -> None:
    stamps, covariances = blocks(np.geomspace(1.0, 0.1, 400))
    rotated = covariances[:, [2, 0, 1]][:, :, [2, 0, 1]]  # x is vertical
    assert remark_of(stamps, rotated) is None
    assert remark_of(stamps, rotated, np.array([1.0, 0.0, 0.0])) is not None
    covariances[:, 0, 0] = 0.0
    assert remark_of(stamps, covariances) is None
    assert remark_of(stamps, np.full_like(covariances, np.nan)) is None
