"""The gauge paper's section VII on EuRoC V1_01, and on a simulated folder in a plain clone."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from tracks_folders import write_tracks_folder

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.inertial import GRAVITY, ImuNoise
from trajeval_ros.papers.examination import (
    Examination,
    MeasuredScene,
    MeasurementModel,
    examine,
    reject_outliers,
)
from trajeval_ros.papers.gauge_trials import (
    compare_handlings,
    covariances,
    fixed_covariance,
    free_covariance,
    sweep,
)
from trajeval_ros.papers.keyframe_selection import select
from trajeval_ros.papers.sensor_recording import SensorRecording
from trajeval_ros.papers.solver import GaugeHandling
from trajeval_ros.papers.tracks_folder import read_tracks_folder

NOISE = ImuNoise(6e-4, 2e-2)


def _nothing() -> None:
    pass


@pytest.fixture(scope="module")
def recording(shared_data: Path) -> SensorRecording:
    return read_tracks_folder(shared_data / "euroc_v1_01_tracks")


@pytest.fixture(scope="module")
def examined(recording: SensorRecording) -> Examination:
    return examine(recording, MeasurementModel(3, 30, 1.0, NOISE, 9.81))


def _position_rmse(recording: SensorRecording) -> float:
    rejection = reject_outliers(select(recording, 3, 30, 1.0, NOISE, GRAVITY))
    outcome = compare_handlings(MeasuredScene.of(rejection), 1, _nothing)
    return float(outcome[GaugeHandling.FREE].position_m[0])


def test_data_are_as_they_were_measured(examined: Examination) -> None:
    np.testing.assert_allclose(examined.gravity, [-0.045, 0.001, -9.805], atol=0.01)
    assert examined.rejection.median_px == pytest.approx(0.63, abs=0.01)
    assert examined.rejection.within_3px == pytest.approx(0.976, abs=0.002)
    assert examined.drift_deg == pytest.approx(0.69, abs=0.02)
    first, coarse, *_, last = examined.rejection.rounds
    assert first == (5773, 340)
    assert coarse == (5736, 334)
    np.testing.assert_allclose(last, (5133, 321), rtol=0.02)
    problem = examined.scene.problem
    np.testing.assert_allclose(problem.preintegrated.durations_s, 0.15, atol=1e-6)
    assert len(problem.preintegrated.durations_s) == 29


@pytest.mark.slow
def test_the_papers_table_three_has_its_row(examined: Examination) -> None:
    outcome = compare_handlings(examined.scene, 20, _nothing)
    for trials in outcome.values():
        assert trials.position_m.mean() == pytest.approx(0.0125, abs=0.002)
        assert trials.rotation_deg.mean() == pytest.approx(0.35, abs=0.03)
        assert trials.velocity_mps.mean() == pytest.approx(0.0085, abs=0.002)
    fixed = outcome[GaugeHandling.FIXATION]
    for trials in outcome.values():
        assert trials.position_m.mean() == pytest.approx(fixed.position_m.mean(), rel=0.02)
    iterations = {handling: trials.iterations.mean() for handling, trials in outcome.items()}
    assert iterations[GaugeHandling.FIXATION] == pytest.approx(6.65, abs=0.5)
    assert iterations[GaugeHandling.PRIOR] == pytest.approx(7.20, abs=0.5)
    assert iterations[GaugeHandling.FREE] == pytest.approx(6.50, abs=0.5)


@pytest.mark.slow
def test_the_sweep_peaks_between_both_ends(examined: Examination) -> None:
    weights = [1.0, 7.0, 10.0, 100.0, 1e3, 1e5, 1e8]
    iterations = [item.iterations.mean() for item in sweep(examined.scene, 5, _nothing, weights)]
    peak = int(np.argmax(iterations))
    assert 7.0 <= weights[peak] <= 2000.0
    assert iterations[peak] > 2.0 * max(iterations[0], iterations[-1])


def test_transformed_covariance_is_that_of_fixation(examined: Examination) -> None:
    assert 1e-5 < covariances(examined.scene, 0, is_converged=False).difference < 2e-3
    assert covariances(examined.scene, 0, is_converged=True).difference < 1e-8


def test_positions_are_as_certain_as_their_gauge_makes_them(examined: Examination) -> None:
    problem, state = examined.scene.problem, examined.rejection.state

    def at_keyframes(covariance: Floats) -> Floats:
        variances = np.diagonal(covariance).reshape(-1, 9)[[0, 15, 29], :3].sum(axis=1)
        return 1e3 * np.sqrt(variances)

    np.testing.assert_allclose(
        at_keyframes(free_covariance(problem, state)), [54, 47, 41], atol=2.0
    )
    np.testing.assert_allclose(
        at_keyframes(fixed_covariance(problem, state)), [0, 14, 18], atol=1.0
    )


@pytest.mark.slow
def test_without_the_lever_arm_positions_are_wrong(recording: SensorRecording) -> None:
    camera = dataclasses.replace(recording.camera, lever_arm=np.zeros(3))
    assert _position_rmse(recording) < 0.015
    assert _position_rmse(dataclasses.replace(recording, camera=camera)) > 0.02


@pytest.mark.slow
def test_without_biases_nothing_is_estimated(recording: SensorRecording) -> None:
    biased = dataclasses.replace(
        recording,
        groundtruth=dataclasses.replace(
            recording.groundtruth, gyroscope_biases=None, accelerometer_biases=None
        ),
    )
    assert _position_rmse(biased) > 0.1
    with pytest.raises(InputError, match="check the gyroscope's biases"):
        examine(biased, MeasurementModel(3, 30, 1.0, NOISE, 9.81))


@pytest.mark.slow
def test_command_on_a_simulated_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    folder = write_tracks_folder(tmp_path / "V1_01_simulated")
    study = tmp_path / "study"
    options = ["--trials", "1", "--pixel-noise", "0.2", "--imu-noise", "1.7e-4,2e-3"]
    arguments = ["--output", str(study), "--tracks", str(folder), *options]
    assert main(["study", "gauge", *arguments]) == 0
    printed = capsys.readouterr().out
    assert "Sensors are simulated, except for tracks of V1_01_simulated" in printed
    # Beside the paper's values of that sequence.
    table = (study / "tables.md").read_text()
    assert "0.07851 / 0.4382 / 0.04644" in table
    assert "| 1e8 |" in table
    numbers = json.loads((study / "study.json").read_text())
    assert numbers["sensors"]["tracks of V1_01_simulated"] == "measured"
    assert numbers["sensors"]["sine plane"] == "simulated"
    assert numbers["examination"]["keyframes"] == 16
    assert len(numbers["prior_weight_sweep"]["trials"]["tracks of V1_01_simulated"]) == 16
    for name in ("covariances", "gauges", "prior_weight"):
        assert (study / f"{name}_V1_01_simulated.png").is_file()
