"""Comparisons of as-available accuracy: ranks, tables and gates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from comparison_runs import compare

from trajeval_ros import simulate
from trajeval_ros.cli.app import main
from trajeval_ros.geometry.trajectory import Trajectory

SECOND = 10**9
FLIGHT = simulate(seed=4, duration_s=30.0)
TRUTH = FLIGHT.groundtruth


def write(path: Path, side: Trajectory, latency_s: float, noise_m: float) -> None:
    """Write poses with a column of receive times, under a rotation and with white noise."""
    random = np.random.default_rng(1)
    assert side.quaternions is not None
    positions = side.positions + random.normal(0.0, noise_m, (len(side), 3))
    seconds = side.stamps / SECOND
    rows = np.column_stack([seconds, positions, side.quaternions, seconds + latency_s])
    header = "t,x,y,z,qx,qy,qz,qw,received"
    np.savetxt(path, rows, fmt="%.9f", delimiter=",", header=header, comments="")


@pytest.fixture
def config(tmp_path: Path) -> Path:
    write(tmp_path / "truth_flight.csv", TRUTH, 0.0, 0.0)
    write(tmp_path / "accurate_flight.csv", TRUTH[::10], 0.2, 0.02)
    write(tmp_path / "prompt_flight.csv", TRUTH[::10], 0.01, 0.05)
    path = tmp_path / "runs.yaml"
    path.write_text(
        "as_available: hold\nmodality: stereo\nlengths: none\n"
        "groundtruth: truth_{sequence}.csv\n"
        "runs:\n  accurate: accurate_{sequence}.csv\n  prompt: prompt_{sequence}.csv\n"
    )
    return path


@pytest.mark.slow
def test_changed_ranks_are_marked_and_gates_test_the_numbers(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    output = tmp_path / "out"
    assert compare(config, output=output) == 0
    text = capsys.readouterr().out
    assert "As-available error [m], RMSE" in text
    assert text.count("ATE: 1") == 1
    assert text.count("ATE: 2") == 2  # also in the caption
    for title in ("Age error [m], RMSE", "Age of the pose in use [s]", "Available [%]"):
        assert title in text
    baseline = tmp_path / "main.parquet"
    (output / "runs.parquet").rename(baseline)
    gate = ["--baseline", str(baseline), "--fail-if"]
    number = "as_available.age_error_m.rmse worse than 10 % untested"
    assert compare(config, *gate, number, output=output) == 0
    write(config.with_name("prompt_flight.csv"), TRUTH[::10], 0.05, 0.05)
    assert compare(config, *gate, number, output=output) == 1


def test_requirements_of_one_run(config: Path) -> None:
    folder = config.parent
    sources = [str(folder / "truth_flight.csv"), str(folder / "prompt_flight.csv")]
    arguments = ["evaluate", *sources, "--quiet", "--as-available", "hold", "--require"]
    assert main([*arguments, "as_available.age_s.p95 < 0.2"]) == 0
    tight = ["as_available.available_percent > 99.5", "--deadline", "0.03"]
    assert main([*arguments, *tight]) == 1
    assert main(["evaluate", *sources, "--quiet", "--require", "as_available.age_s.p95 < 9"]) != 0


def test_options_need_the_accuracy(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = config.parent
    sources = [str(folder / f"{name}_flight.csv") for name in ("truth", "prompt")]
    for option in (["--deadline", "0.2"], ["--received", "log"], ["--receive-clock", "1"]):
        assert main(["evaluate", *sources, *option]) == 2
        assert f"{option[0]} needs --as-available; add it" in capsys.readouterr().err
    assert main(["evaluate", *sources, "--as-available", "guess"]) == 2
    assert "use one of" in capsys.readouterr().err
