"""`trajeval study gauge`, end to end and small."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.papers.gauge_tables import percent_and_range
from trajeval_ros.papers.gauge_trials import compare_handlings, covariances, paths, sweep
from trajeval_ros.papers.scene import PROFILES, make_scene
from trajeval_ros.papers.solver import GaugeHandling
from trajeval_ros.simulation.drifting_odometry import simulate
from trajeval_ros.simulation.motion import recorded, shape

FIGURES = [
    "cost.png",
    "covariances_sine_random.png",
    "gauges_sine_random.png",
    "prior_paths.png",
    "prior_weight.png",
    "scenes.png",
]


def _nothing() -> None:
    pass


@pytest.mark.slow
def test_writes_tables_numbers_and_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    folder = tmp_path / "a study"
    assert main(["study", "gauge", "--output", str(folder), "--trials", "2"]) == 0
    printed = capsys.readouterr().out
    assert "0.04141 / 0.1084 / 0.02182" in printed  # the paper's
    assert "All sensors are simulated" in printed
    assert "measured with one linear algebra thread" in (folder / "tables.md").read_text()
    assert sorted(path.name for path in folder.iterdir()) == [
        *FIGURES,
        "study.json",
        "tables.md",
    ]
    from matplotlib.image import imread

    for name in FIGURES:
        assert imread(folder / name).std() > 0.03
    numbers = json.loads((folder / "study.json").read_text())
    assert len(numbers["configurations"]) == 6
    for configuration in numbers["configurations"].values():
        fixed, free = configuration["fixation"], configuration["free"]
        # Table II: the gauges agree to a percent or so, and the errors have its size.
        np.testing.assert_allclose(free["position_m"], fixed["position_m"], rtol=0.15)
        assert 0.003 < np.mean(free["position_m"]) < 0.1
        assert 0.02 < np.mean(free["rotation_deg"]) < 0.5
    differences = numbers["covariance_difference"]["sine random"]
    assert len(differences["converged"]) == len(differences["as_ceres_stops"]) == 2
    assert max(differences["converged"]) < 1e-8
    assert 1e-6 < max(differences["as_ceres_stops"]) < 2e-3
    assert set(numbers["sensors"].values()) == {"simulated"}
    assert numbers["examination"] is None
    table = (folder / "tables.md").read_text()
    assert table.count("| sine plane |") == 1


@pytest.mark.slow
def test_recordings_of_one_file_name_are_told_apart(tmp_path: Path) -> None:
    sources = []
    for seed, folder in enumerate(("MH_01", "V1_01")):
        (tmp_path / folder).mkdir()
        truth = simulate(seed, 16.0).groundtruth
        assert truth.quaternions is not None
        columns = [truth.seconds, truth.positions, truth.quaternions]
        file = tmp_path / folder / "groundtruth.txt"
        np.savetxt(file, np.column_stack(columns), fmt="%.9f")
        sources += ["--motion", str(file)]
    study = tmp_path / "study"
    part = ["--start", "2", "--duration", "12", "--trials", "1"]
    assert main(["study", "gauge", "--output", str(study), *part, *sources]) == 0
    numbers = json.loads((study / "study.json").read_text())
    motions = [name for name in numbers["configurations"] if name.startswith("motion of ")]
    assert motions == ["motion of MH_01/groundtruth", "motion of V1_01/groundtruth"]
    # Each beside the paper's values of that recording.
    table = (study / "tables.md").read_text()
    assert "0.06936" in table
    assert "0.07851" in table


def test_sweep_and_paths_have_the_papers_shape() -> None:
    scene = make_scene(shape("sine"), "plane", PROFILES["paper"], 0)
    weak, middle, strong = sweep(scene, 3, _nothing, (0.0, 10.0, 1e8))
    assert middle.iterations.mean() > 1.5 * max(weak.iterations.mean(), strong.iterations.mean())
    np.testing.assert_allclose(weak.position_m, strong.position_m, rtol=0.05)
    along, held = paths(scene, (10.0, 1e8))
    # A weak prior is given up at once and won back on the orbit; a strong one never moves.
    assert along.position_m.max() > 0.01
    assert along.position_m[-1] < 0.1 * along.position_m.max()
    assert held.position_m.max() < 1e-4
    assert along.reprojection_px[0] > 10.0 > 2.0 > along.reprojection_px[2]


def test_real_motion(shared_data: Path) -> None:
    from trajeval_ros.io.sources import read_trajectory

    flown = read_trajectory(str(shared_data / "euroc" / "groundtruth" / "V1_02_asl.csv"))
    motion = recorded(flown, 50.0, 15.0)
    times = np.linspace(0.0, motion.duration_s, 100)
    exact = flown.seconds - flown.seconds[0] - 50.0
    near = np.clip(np.searchsorted(exact, times), 0, len(flown) - 1)
    away = np.linalg.norm(motion.positions(times) - flown.positions[near], axis=1)
    assert away.max() < 0.05
    # Level and forwards, although the recorded body's x axis points up.
    cameras = motion.rotations(times) @ motion.camera_in_body
    assert np.mean(cameras[:, 2, 1]) < -0.9
    scene = make_scene(motion, "random", PROFILES["paper"], 0, keyframes=30, landmarks=150)
    outcome = compare_handlings(scene, 2, _nothing)
    assert 0.001 < outcome[GaugeHandling.FREE].position_m.mean() < 0.2
    assert covariances(scene, 0, is_converged=False).difference < 2e-3


@pytest.fixture(scope="module")
def flown() -> Trajectory:
    return simulate(1, 30.0).groundtruth


@pytest.mark.parametrize(
    ("start_s", "duration_s"),
    [(5.0, -1.0), (5.0, 0.0), (5.0, np.nan), (5.0, np.inf), (-5.0, 20.0), (np.nan, 10.0)],
)
def test_a_part_that_is_none_is_refused(
    flown: Trajectory, start_s: float, duration_s: float
) -> None:
    with pytest.raises(
        SettingsError, match="a start of at least 0 s and a duration greater than 0 s"
    ):
        recorded(flown, start_s, duration_s)


@pytest.mark.parametrize(
    ("start_s", "duration_s", "needed"), [(500.0, 10.0, 200), (500.0, 0.05, 6), (25.0, 10.0, 200)]
)
def test_a_part_that_is_not_recorded_is_refused(
    flown: Trajectory, start_s: float, duration_s: float, needed: int
) -> None:
    with pytest.raises(InputError, match=f"orientations and {needed} states are required"):
        recorded(flown, start_s, duration_s)


@pytest.mark.parametrize(("start_s", "gap_s"), [(5.0, 0.25), (5.0, 1.5), (10.001, 1.5)])
def test_a_gap_that_noise_would_fill_is_refused(
    flown: Trajectory, start_s: float, gap_s: float
) -> None:
    heard = (flown.seconds < 10.0) | (flown.seconds > 10.0 + gap_s)
    with pytest.raises(InputError, match=rf"gap of {gap_s:.1f}\d s at (9\.99|10\.00) s"):
        recorded(flown[heard], start_s, 10.0)


def test_noise_does_not_fill_a_gap_that_is_bridged(flown: Trajectory) -> None:
    noise = 1e-3 * np.random.default_rng(0).standard_normal(flown.positions.shape)
    noisy = dataclasses.replace(flown, positions=flown.positions + noise)
    heard = (flown.seconds < 10.0) | (flown.seconds > 10.18)
    exact, bridged = recorded(flown, 5.0, 10.0), recorded(noisy[heard], 5.0, 10.0)
    times = np.linspace(0.0, 9.9, 1000)
    assert np.abs(bridged.positions(times) - exact.positions(times)).max() < 5e-3


@pytest.mark.parametrize("up", [0.0, 1.0])
@pytest.mark.filterwarnings("error")
def test_a_body_that_does_not_travel_is_refused(flown: Trajectory, up: float) -> None:
    still = dataclasses.replace(flown, positions=flown.positions * [0.0, 0.0, up])
    level = Rotation.identity(len(flown))
    with pytest.raises(InputError, match="too slow"):
        recorded(dataclasses.replace(still, quaternions=level.as_quat()), 5.0, 10.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--trials", "0"], "--trials must be at least 1"),
        (["--profile", "perfect"], "unknown profile"),
        (["--motion", "nowhere.txt"], "nowhere.txt"),
        (["--tracks", "nowhere"], "nowhere is not a folder"),
        (["--every", "0"], "--every must be greater than zero"),
        (["--pixel-noise", "nan"], "--pixel-noise must be greater than zero"),
        (["--gravity", "-9.81"], "--gravity must be greater than zero"),
        (["--imu-noise", "6e-4"], "give two densities above zero"),
        (["--imu-noise", "0,2e-2"], "give two densities above zero"),
    ],
)
def test_says_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    folder = tmp_path / "study"
    assert main(["study", "gauge", "--output", str(folder), *arguments]) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert len(captured.err.splitlines()) == 1
    assert not folder.exists()


def test_differences_of_trials_are_a_median_and_a_range() -> None:
    assert percent_and_range(np.array([0.001])) == "0.1 %"
    assert percent_and_range(np.array([4e-4, 1e-5, 2e-4])) == "0.02 % (0.001 to 0.04 %)"
