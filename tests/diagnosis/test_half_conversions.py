"""Conversions between NED, FRD and ENU, FLU that were done by half are named, and none wrongly."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from paths import SHARED
from scipy.spatial.transform import Rotation

from benchmarks.diagnosis import diagnosis_of
from benchmarks.diagnosis_runs import Pair, simulated
from trajeval_ros import evaluate, read_trajectory
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis

Array = NDArray[np.float64]
# Nine seconds of motion do not always distinguish conventions.
UNDECIDED: dict[str, list[list[str]]] = {"PX4": [[], ["convention_tie"]]}
DATA = SHARED / "data"
M = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
B = np.diag([1.0, -1.0, -1.0])
EYE = np.eye(3)
TO_NWU = B @ M
# By name: W and B of the positions W p, of the rotations W R B, and what must be said first; each
# is applied to poses in ENU and FLU. `None` stands for nothing.
TURNED: dict[str, tuple[Array, Array, Array, str | None]] = {
    "right": (EYE, EYE, EYE, None),
    "raw NED and FRD": (M, M, B, "up_axis"),
    "only positions converted": (EYE, M, B, "axes_mixed"),
    "only orientations converted": (M, EYE, EYE, "axes_mixed"),
    "body left in FRD": (EYE, EYE, B, "body"),
    "attitude of FLU in NED": (EYE, M, EYE, "axes_mixed"),
    "only z flipped": (np.diag([1.0, 1.0, -1.0]) @ M, EYE, EYE, "axes_mixed"),
    "x and y exchanged, z not": (np.diag([1.0, 1.0, -1.0]), EYE, EYE, "axes_mixed"),
    "NWU for ENU": (TO_NWU, TO_NWU, EYE, None),
    "attitude in NWU": (EYE, TO_NWU, EYE, "axes_mixed"),
}
WRITTEN: dict[str, tuple[Callable[[Array], Array], str]] = {
    "w first": (lambda q: q[:, [3, 0, 1, 2]], "wxyz"),
    "conjugated": (lie.conjugate, "transposed"),
}


@cache
def recording(name: str) -> Pair:
    if name == "simulated":
        return simulated(5000, "drone", "walk", 100.0)
    if name == "PX4":
        log = DATA / "px4" / "synthetic_1_16.ulg"
        truth = read_trajectory(f"{log}:vehicle_local_position_groundtruth")
        return Pair(name, truth, read_trajectory(f"{log}:vehicle_odometry")[:900])
    folder = DATA / "euroc"
    truth = read_trajectory(folder / "groundtruth" / "MH_01.txt")
    return Pair(name, truth, read_trajectory(folder / "vio_mono" / "MH_01.txt"), Gauge.YAW)


needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the recordings are not here")
on_recordings = pytest.mark.parametrize(
    "name",
    ["simulated", pytest.param("PX4", marks=needs_data), pytest.param("MH_01", marks=needs_data)],
)


def causes(pair: Pair, **changes: Array) -> list[str]:
    """Return the causes of findings, without the step: the PX4 log has a reset of 0.8 m."""
    estimate: Trajectory = dataclasses.replace(pair.estimate, **changes)
    findings = diagnosis_of(dataclasses.replace(pair, estimate=estimate)).findings
    return [finding.cause for finding in findings if finding.cause != "step"]


@on_recordings
@pytest.mark.parametrize("conversion", TURNED)
def test_a_conversion_by_half_is_named(name: str, conversion: str) -> None:
    pair = recording(name)
    of_positions, world, body, expected = TURNED[conversion]
    assert pair.estimate.quaternions is not None
    rotated = lie.multiply(lie.from_matrix(world), pair.estimate.quaternions)
    named = causes(
        pair,
        positions=pair.estimate.positions @ of_positions.T,
        quaternions=lie.multiply(rotated, lie.from_matrix(body)),
    )
    assert named[:1] in ([[]] if expected is None else [[expected], *UNDECIDED.get(name, [])])


@on_recordings
@pytest.mark.parametrize("written", WRITTEN)
def test_a_wrong_form_of_quaternions_is_named(name: str, written: str) -> None:
    pair = recording(name)
    change, expected = WRITTEN[written]
    assert pair.estimate.quaternions is not None
    named = causes(pair, quaternions=change(pair.estimate.quaternions))
    assert named[:1] in [[expected], *UNDECIDED.get(name, [])]


@on_recordings
def test_late_stamps_of_publication_are_stated(name: str) -> None:
    """35 ms late."""
    pair = recording(name)
    named = causes(pair, stamps=pair.estimate.stamps + 35_000_000)
    assert named == ["small_clock_offset"]


KITTI = UpAxis("-y", "KITTI's camera axes")


@pytest.mark.parametrize(
    ("sides", "up", "named"),
    [
        (("estimate",), KITTI, "vertical axis of the estimate's frame is probably z, within"),
        # That of the groundtruth is doubted before, unless the user gives it.
        (("truth", "estimate"), UpAxis("-y"), "the body turns about z; set --up=-z or --up=z"),
    ],
)
def test_axes_are_named_as_in_the_file(sides: tuple[str, ...], up: UpAxis, named: str) -> None:
    """KITTI's files, which are read with -y up, have z up if KISS-ICP writes them."""
    pair = simulated(5004, "car", "walk", 100.0)
    given = {side: dataclasses.replace(getattr(pair, side), up=up) for side in sides}
    first = diagnosis_of(dataclasses.replace(pair, **given)).suggested
    assert first is not None
    assert named in first.text
    assert first.tried is not None
    assert first.tried.ratios[0] < 0.2
    assert first.correction.get("up", "z,z") in {"z,z", "-z,-z"}


def small_angles() -> tuple[Trajectory, Array]:
    """Return a groundtruth that tilts by up to 5 deg about all axes, and these angles (N, 3)."""
    time = np.arange(0.0, 60.0, 0.05)
    places = np.column_stack([2.0 * time, 4.0 * np.sin(0.3 * time), np.cos(0.5 * time)])
    angles = np.radians(5.0) * np.sin(np.outer(time, [0.7, 1.1, 0.4]))
    rotations = Rotation.from_euler("xyz", angles).as_quat()
    return Trajectory.from_positions(places, rotations, seconds=time), angles


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (180.0 / np.pi, "degrees were probably read as radians"),
        (np.pi / 180.0, "radians were probably read as degrees"),
        (0.0, "(those of the estimate are constant)"),
        (1.0, None),
    ],
)
def test_small_angles_in_another_unit_are_named(factor: float, message: str | None) -> None:
    truth, angles = small_angles()
    noise = np.random.default_rng(7).normal(0.0, 0.01, truth.positions.shape)
    rotations = Rotation.from_euler("xyz", factor * angles).as_quat()
    estimate = Trajectory.from_positions(truth.positions + noise, rotations, stamps=truth.stamps)
    named = [
        warning
        for warning in evaluate(truth, estimate).warnings
        if "the rotations agree" in warning
    ]
    assert len(named) == (message is not None)
    assert message is None or message in named[0]
    assert factor or not any(unit in named[0] for unit in ("degrees", "radians", "times as large"))


def test_constant_rotations_of_the_groundtruth_are_named() -> None:
    estimate, _ = small_angles()
    noise = np.random.default_rng(7).normal(0.0, 0.01, estimate.positions.shape)
    constant = np.tile(Rotation.from_euler("xyz", [0.3, 0.2, 0.7]).as_quat(), (len(noise), 1))
    truth = Trajectory.from_positions(estimate.positions + noise, constant, stamps=estimate.stamps)
    assert "(those of the groundtruth are constant)" in evaluate(truth, estimate).warnings[0]
