"""Mistakes of known sizes are stated with their sizes, and differences of good runs are not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.diagnosis import diagnosis_of
from benchmarks.diagnosis_runs import Pair, simulated
from trajeval_ros.diagnosis.findings import Finding
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory

DRONE = simulated(731, "drone", "walk", 100.0)
HANDHELD = simulated(732, "handheld", "walk", 100.0)
PAIRS = [DRONE, HANDHELD]


def findings(pair: Pair, estimate: Trajectory, gauge: Gauge | None = None) -> list[Finding]:
    wrong = dataclasses.replace(pair, estimate=estimate, gauge=gauge or pair.gauge)
    return list(diagnosis_of(wrong).findings)


def rotated(estimate: Trajectory, world: Rotation, body: Rotation) -> Trajectory:
    assert estimate.quaternions is not None
    rotated_copy = lie.multiply(
        lie.multiply(world.as_quat(), estimate.quaternions), body.as_quat()
    )
    return dataclasses.replace(
        estimate, positions=world.apply(estimate.positions), quaternions=rotated_copy
    )


def late(estimate: Trajectory, offset_s: float, ppm: float = 0.0) -> Trajectory:
    seconds = (estimate.stamps - estimate.stamps[0]) / 1e9
    by = np.rint(1e9 * (offset_s + 1e-6 * ppm * seconds)).astype(np.int64)
    return dataclasses.replace(estimate, stamps=estimate.stamps + by)


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
@pytest.mark.parametrize("deg", [0.0, 1.0, 4.0, 8.0, 11.0, 30.0])
def test_a_tilt_of_the_world(pair: Pair, deg: float) -> None:
    world = Rotation.from_rotvec(np.radians(deg) * np.array([0.6, 0.8, 0.0]))
    named = findings(pair, rotated(pair.estimate, world, Rotation.identity()), Gauge.YAW)
    assert [finding.cause for finding in named] == ["tilted"] * (deg >= 4.0)
    for finding in named:
        assert finding.evidence["tilt_deg"] == pytest.approx(deg, abs=1.0)
        assert finding.correction == {"gauge": "se3"}


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
@pytest.mark.parametrize("offset_s", [0.0, 0.1])
def test_an_offset_of_keyframes(pair: Pair, offset_s: float) -> None:
    """Their timestamps are right within a part of a frame, not of the time to the next one."""
    steps = np.random.default_rng(5).integers(5, 11, 400)  # of the frames, at 20 Hz
    rows = np.cumsum(steps)
    keyframes = pair.estimate[rows[rows < len(pair.estimate)]]
    named = {finding.cause: finding for finding in findings(pair, late(keyframes, offset_s))}
    assert list(named.keys() - {"keyframes"}) == ["small_clock_offset"] * bool(offset_s)
    if offset_s:
        measured_s = float(named["small_clock_offset"].correction["time_offset"])
        assert measured_s == pytest.approx(-offset_s, abs=0.005)


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
@pytest.mark.parametrize("offset_s", [0.0, 0.04, -0.1, 0.2, -0.35, 2.0, -18.0])
def test_an_offset_of_the_clock(pair: Pair, offset_s: float) -> None:
    named = findings(pair, late(pair.estimate, offset_s))
    causes = ["small_clock_offset" if abs(offset_s) <= 0.25 else "clock_offset"]
    assert [finding.cause for finding in named] == causes * (offset_s != 0.0)
    for finding in named:
        assert float(finding.correction["time_offset"]) == pytest.approx(-offset_s, abs=0.01)
        assert ("GPS time without leap seconds" in finding.sentence) == (offset_s == -18.0)


@pytest.mark.parametrize("ppm", [0.0, 500.0, -2000.0, 50_000.0, 400_000.0])
def test_a_rate_of_the_clock(ppm: float) -> None:
    named = findings(DRONE, late(DRONE.estimate, 0.0, ppm))
    assert [finding.cause for finding in named] == ["clock_drift"] * bool(ppm)
    for finding in named:
        corrected = 1e6 * (1.0 / (1.0 + 1e-6 * ppm) - 1.0)
        assert finding.evidence["ppm"] == pytest.approx(corrected, rel=0.02, abs=150.0)


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
def test_a_restart_with_another_clock_is_no_rate(pair: Pair) -> None:
    """The estimator restarts at its origin, 1 s late: one rate for both parts helps neither."""
    estimate = pair.estimate
    assert estimate.quaternions is not None
    row = len(estimate) // 2
    back = lie.heading(lie.conjugate(estimate.quaternions[row : row + 1]))
    positions, quaternions = estimate.positions.copy(), estimate.quaternions.copy()
    positions[row:] = lie.rotate(back, positions[row:] - positions[row])
    quaternions[row:] = lie.multiply(back, quaternions[row:])
    stamps = estimate.stamps.copy()
    stamps[row:] += 1_000_000_000
    restarted = dataclasses.replace(
        estimate, stamps=stamps, positions=positions, quaternions=quaternions
    )
    kept = np.delete(np.arange(len(estimate)), np.arange(row - 20, row))  # in a gap of 1 s
    assert "clock_drift" not in [finding.cause for finding in findings(pair, restarted[kept])]


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
@pytest.mark.parametrize("deg", [0.0, 2.0, 7.0, 40.0, 90.0, 180.0])
def test_a_rotation_of_the_body(pair: Pair, deg: float) -> None:
    body = Rotation.from_rotvec(np.radians(deg) * np.array([0.0, 0.6, 0.8]))
    named = findings(pair, rotated(pair.estimate, Rotation.identity(), body))
    assert [finding.cause for finding in named] == ["body"] * (deg >= 7.0)
    for finding in named:
        assert finding.evidence["angle_deg"] == pytest.approx(deg, abs=1.5)
        assert finding.tried is not None
        assert finding.tried.ratios[1] < 0.9
        assert "rotation ATE" in finding.text


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.15, 1.4, 0.6])
@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.SIM3])
def test_a_scale(scale: float, gauge: Gauge) -> None:
    """A scale within a fifth is an error of the estimate, and sim3 includes it."""
    smaller = dataclasses.replace(DRONE.estimate, positions=DRONE.estimate.positions / scale)
    named = findings(DRONE, smaller, gauge)
    is_stated = not 0.8 < scale < 1.25 and gauge is Gauge.YAW
    assert [finding.cause for finding in named] == ["scale"] * is_stated
    for finding in named:
        assert finding.evidence["scale"] == pytest.approx(scale, rel=0.05)


@pytest.mark.parametrize(
    ("metres", "unit"),
    [(1e-3, "millimetres"), (1e-2, "centimetres"), (0.0254, "inches"), (0.3048, "feet")],
)
@pytest.mark.parametrize("side", ["estimate", "groundtruth"])
def test_a_unit(metres: float, unit: str, side: str) -> None:
    """The estimate of groundtruth in feet may as well be monocular."""
    attribute = "truth" if side == "groundtruth" else side
    poses = getattr(DRONE, attribute)
    changed = dataclasses.replace(poses, positions=poses.positions / metres)
    first = diagnosis_of(dataclasses.replace(DRONE, **{attribute: changed})).suggested
    assert first is not None
    if (unit, side) == ("feet", "groundtruth"):
        assert first.cause == "scale"
        return
    assert first.sentence.startswith(f"the {side} is in {unit}:")
    assert first.correction == {f"{side}.scale": f"{metres:g}"}


@pytest.mark.parametrize("length", [0.0, 0.05, 0.5, 0.8])
def test_a_lever_arm(length: float) -> None:
    """A lever arm of 5 cm is within the noise of this run."""
    lever = length * np.array([0.6, 0.0, 0.8])
    estimate = DRONE.estimate
    assert estimate.quaternions is not None
    moved = estimate.positions + Rotation.from_quat(estimate.quaternions).apply(-lever)
    named = findings(DRONE, dataclasses.replace(estimate, positions=moved))
    assert [finding.cause for finding in named] == ["lever_arm"] * (length >= 0.5)
    for finding in named:
        assert finding.evidence["lever_m"] == pytest.approx(length, rel=0.2)
