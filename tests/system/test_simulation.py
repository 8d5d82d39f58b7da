from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros.cli.simulate import STORAGES
from trajeval_ros.cli.simulate import simulate as simulate_verb
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.protocol import Protocol, metres
from trajeval_ros.pipeline.pipeline import evaluate
from trajeval_ros.simulation import drifting_odometry
from trajeval_ros.simulation.drifting_odometry import TILT_DEG, Simulation, simulate
from trajeval_ros.simulation.simulated_sensors import imu_readings

YAW = Protocol(gauge=Gauge.YAW, lengths=metres(40))


@pytest.fixture(scope="module")
def flight() -> Simulation:
    return simulate(3)


def _columns(trajectory: Trajectory) -> list[np.ndarray]:
    return [
        trajectory.stamps,
        trajectory.positions,
        trajectory.quaternions,
        trajectory.velocities,
    ]


def test_same_seed_gives_the_same_arrays_and_another_seed_others(flight: Simulation) -> None:
    again, other = simulate(3), simulate(4)
    for side in ("groundtruth", "estimate"):
        for first, second, third in zip(
            *(_columns(getattr(item, side)) for item in (flight, again, other)), strict=True
        ):
            np.testing.assert_array_equal(first, second)
            assert first.shape != third.shape or not np.array_equal(first, third)


@pytest.mark.parametrize("seed", range(5))
def test_velocity_is_the_derivative_of_position(seed: int) -> None:
    truth = simulate(seed, 30.0).groundtruth
    derivative = np.gradient(truth.positions, truth.seconds, axis=0)
    np.testing.assert_allclose(derivative[1:-1], truth.velocities[1:-1], atol=2e-5)


@pytest.mark.parametrize("seed", range(5))
def test_flies_as_a_quadrotor_does(seed: int) -> None:
    truth = simulate(seed).groundtruth
    speed = np.linalg.norm(truth.velocities, axis=1)
    assert speed.min() > 0.25
    assert 1.0 < np.median(speed) < 3.0
    assert speed.max() < 4.0
    assert truth.positions[:, 2].min() > 0.0
    body = truth.rotations.as_matrix()
    assert np.degrees(np.arccos(body[:, 2, 2])).max() < 30.0
    # Nose towards the course, seen from above, and no jump from one state to the next.
    course = np.arctan2(truth.velocities[:, 1], truth.velocities[:, 0])
    nose = np.arctan2(body[:, 1, 0], body[:, 0, 0])
    assert np.cos(course - nose).min() > 0.9
    rotation = (truth.rotations[:-1].inv() * truth.rotations[1:]).magnitude()
    assert np.degrees(rotation.max()) < 3.0


@pytest.mark.parametrize("seed", range(5))
def test_drifts_as_a_vio_does(seed: int) -> None:
    evaluation = evaluate(*_sides(simulate(seed)), YAW)
    assert evaluation.warnings == ()
    (segments,) = evaluation.relative
    assert 0.3 < segments.statistics["position_percent"].rmse < 1.5
    assert 0.05 < evaluation.ate["position_m"].rmse < 1.5
    assert 0.05 < evaluation.ate["yaw_deg"].rmse < 3.0
    # Gravity is observed: two axes, each never beyond twice its standard deviation.
    assert evaluation.ate["tilt_deg"].max < 2.0 * np.sqrt(2.0) * TILT_DEG
    assert evaluation.ate["velocity_mps"].rmse < 0.15


def test_without_drift_only_the_frame_and_the_stamps_differ(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("_YAW_DEG_PER_SQRT_S", "_VELOCITY_SHARE", "_SCALE", "TILT_DEG"):
        monkeypatch.setattr(drifting_odometry, name, 0.0)
    simulation = simulate(0, 60.0)
    evaluation = evaluate(*_sides(simulation), YAW)
    assert evaluation.ate["position_m"].max < 5e-3
    assert evaluation.ate["rotation_deg"].max < 0.2
    assert evaluation.ate["velocity_mps"].max < 5e-3
    assert evaluate(*_sides(simulation), Protocol(gauge=Gauge.NONE)).ate["position_m"].rmse > 1.0


def test_rates_stamps_gap_and_frames(flight: Simulation) -> None:
    truth, estimate = flight.groundtruth, flight.estimate
    assert truth.stamps[0] > 1_699_999_999 * 10**9
    for side, rate_hz in ((truth, 200.0), (estimate, 20.0)):
        steps = np.diff(side.stamps)
        assert (steps > 0).all()
        assert np.median(steps) == pytest.approx(1e9 / rate_hz, rel=0.01)
        assert len(np.unique(steps)) > len(steps) // 4
    steps_s = np.diff(estimate.stamps) / 1e9
    assert 2.0 <= steps_s.max() <= 2.1
    assert np.sort(steps_s)[-2] < 0.06
    assert truth.stamps[0] < estimate.stamps[0]
    assert estimate.stamps[-1] < truth.stamps[-1]
    assert np.intersect1d(truth.stamps, estimate.stamps).size < 5
    assert (truth.frame, estimate.frame) == ("world", "odom")
    assert truth.child_frame == estimate.child_frame == "base_link"


def test_refuses_what_makes_no_flight() -> None:
    for arguments in ((0, 1.0), (0, np.nan), (-1, 10.0)):
        with pytest.raises(SettingsError):
            simulate(*arguments)


def simulate_command(bag: Path, *, overwrite: bool = False, **options: Any) -> None:
    arguments = [f"--{name}={value}" for name, value in options.items()]
    arguments += ["--overwrite"] if overwrite else []
    simulate_verb.main([str(bag), *arguments], standalone_mode=False)


@pytest.mark.parametrize("storage", STORAGES)
def test_the_bag_holds_what_was_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], storage: str
) -> None:
    bag = tmp_path / "a folder" / "flight"
    simulate_command(bag, seed=7, duration=10.0, storage=storage)
    simulation = simulate(7, 10.0)
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) == 2
    assert re.search(r"--groundtruth '?.*flight'?:/groundtruth/pose ", printed)

    truth = read_trajectory(f"{bag}:/groundtruth/pose")
    estimate = read_trajectory(f"{bag}:/vio/odometry")
    for read, written in ((truth, simulation.groundtruth), (estimate, simulation.estimate)):
        np.testing.assert_array_equal(read.stamps, written.stamps)
        np.testing.assert_array_equal(read.positions, written.positions)
        assert (read.rotations * written.rotations.inv()).magnitude().max() < 1e-12
        assert read.frame == written.frame
    np.testing.assert_allclose(estimate.velocities, simulation.estimate.velocities, atol=1e-12)
    assert estimate.child_frame == "base_link"


def test_overwrites_only_what_it_wrote(tmp_path: Path) -> None:
    bag = tmp_path / "flight"
    simulate_command(bag, seed=0, duration=5.0)
    with pytest.raises(InputError, match="--overwrite"):
        simulate_command(bag, seed=1, duration=5.0)
    simulate_command(bag, seed=1, duration=5.0, overwrite=True)
    estimate = read_trajectory(f"{bag}:/vio/odometry")
    np.testing.assert_array_equal(estimate.stamps, simulate(1, 5.0).estimate.stamps)

    (bag / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="not overwritten"):
        simulate_command(bag, seed=2, duration=5.0, overwrite=True)
    assert (bag / "notes.txt").read_text() == "mine"
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="not overwritten"):
        simulate_command(tmp_path / "empty", seed=2, duration=5.0, overwrite=True)


@pytest.mark.slow
def test_overwrites_only_the_covariance_that_it_wrote(tmp_path: Path) -> None:
    bag, file = tmp_path / "fly", tmp_path / "fly.npz"
    simulate_command(bag, duration=5.0, profile="paper")
    shutil.rmtree(bag)
    first = file.read_bytes()
    with pytest.raises(InputError, match=r"fly\.npz exists.*--overwrite"):
        simulate_command(bag, seed=1, duration=5.0, profile="paper")
    assert file.read_bytes() == first
    assert not bag.exists()
    simulate_command(bag, seed=1, duration=5.0, profile="paper", overwrite=True)
    assert file.read_bytes() != first

    file.write_text("mine")
    with pytest.raises(InputError, match=r"fly\.npz is not a joint covariance"):
        simulate_command(bag, duration=5.0, profile="paper", overwrite=True)
    assert file.read_text() == "mine"
    estimate = read_trajectory(f"{bag}:/vio/odometry")
    assert len(estimate) == 51


def test_noise_of_an_imu_has_the_densities_of_its_data_sheet(flight: Simulation) -> None:
    first, second = (imu_readings(flight.groundtruth, seed) for seed in (1, 2))
    dt = np.diff(flight.groundtruth.stamps)[1:, None] / 1e9
    for name, density in (("rates", 1.7e-4), ("accelerations", 2e-3)):  # per square root of Hz
        apart = np.diff(getattr(first, name) - getattr(second, name), axis=0) / 2.0
        assert np.std(apart * np.sqrt(dt)) == pytest.approx(density, rel=0.03)


def test_readings_of_an_imu_are_between_the_states(flight: Simulation) -> None:
    stamps = flight.groundtruth.stamps
    readings = imu_readings(flight.groundtruth, 1)
    assert np.abs(2 * readings.stamps - stamps[:-1] - stamps[1:]).max() <= 1
    assert readings.frame == "base_link"


def test_nothing_is_written_for_a_flight_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(SettingsError):
        simulate_command(tmp_path / "new" / "flight", duration=-1.0)
    assert not list(tmp_path.iterdir())


def _sides(simulation: Simulation) -> tuple[Trajectory, Trajectory]:
    return simulation.groundtruth, simulation.estimate
