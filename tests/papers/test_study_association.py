"""`trajeval study association`: good groundtruth made poor, and what is then reported."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flights import fly
from hypothesis import given
from hypothesis import strategies as st
from strategies import make_groundtruth, seeds
from written_trajectories import write

from trajeval_ros.cli.app import main
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.papers.association_study import Degradation

DENSE = make_groundtruth(0, 600)


@given(seed=seeds, rate=st.floats(0.5, 4.0), dropouts=st.integers(0, 4))
def test_poor_groundtruth_is_a_part_of_the_good_one(seed: int, rate: float, dropouts: int) -> None:
    noise = Noise(1e-9, 1e-9)
    poor = Degradation(rate, dropouts, 2.0, 3.0, noise, seed).of(DENSE)
    rows = np.searchsorted(DENSE.stamps, poor.stamps)
    np.testing.assert_array_equal(DENSE.stamps[rows], poor.stamps)
    np.testing.assert_allclose(poor.positions, DENSE.positions[rows], atol=1e-7)
    steps = np.diff(poor.seconds)
    assert steps.min() > 0.5 / rate
    long = np.count_nonzero(steps > 1.5 / rate + 0.13)
    assert long <= dropouts
    if rate >= 1.5:
        assert long == dropouts
    again = Degradation(rate, dropouts, 2.0, 3.0, noise, seed).of(DENSE)
    np.testing.assert_array_equal(poor.positions, again.positions)


def test_noise_has_the_size_that_was_asked_for() -> None:
    poor = Degradation(9.0, 0, noise=Noise(0.05, 0.02)).of(DENSE)
    rows = np.searchsorted(DENSE.stamps, poor.stamps)
    assert np.std(poor.positions - DENSE.positions[rows]) == pytest.approx(0.05, rel=0.1)
    assert poor.rotations is not None
    assert DENSE.rotations is not None
    rotations = (DENSE.rotations[rows].inv() * poor.rotations).as_rotvec()
    assert np.std(rotations) == pytest.approx(0.02, rel=0.1)
    bare = Degradation().of(dataclasses.replace(DENSE, quaternions=None))
    assert bare.rotations is None


def test_refuses_what_cannot_be_done() -> None:
    with pytest.raises(SettingsError, match="greater than 0 Hz"):
        Degradation(0.0)
    with pytest.raises(SettingsError, match="not -1"):
        Degradation(dropouts=-1)
    with pytest.raises(SettingsError, match="ascending order"):
        Degradation(shortest_s=3.0, longest_s=1.0)
    with pytest.raises(InputError, match="do not fit into"):
        Degradation(dropouts=50).of(DENSE)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("association")
    flight = fly(3, estimate_hz=50.0)
    write(folder / "truth.txt", flight.truth)
    for place, estimate in enumerate(flight.estimates):
        write(folder / f"estimate{place}.txt", estimate[::3])
    return folder


def compared(files: Path, *options: str) -> Any:
    output = files / "comparison.json"
    arguments = ["study", "association", "-g", str(files / "truth.txt"), "--json", str(output)]
    for place in range(3):
        arguments += ["-e", str(files / f"estimate{place}.txt")]
    assert main([*arguments, *options]) == 0
    return json.loads(output.read_text())


@pytest.mark.slow
def test_the_papers_argument(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = compared(files)
    assert content["degradation"]["samples_left"] < 120
    weighted = []
    for place, estimate in enumerate(content["estimates"]):
        ratios = {
            item["association"]: item["ate_m"] / estimate["true_ate_m"]
            for item in estimate["reported"]
        }
        assert ratios["matern, supported"] == pytest.approx(1.0, abs=0.2)
        assert ratios["matern, weighted"] < ratios["matern, plain"]
        assert ratios["matern, plain"] < ratios["linear, every pose"]
        assert ratios["linear, every pose"] < ratios["nearest, every pose"]
        if place == 0:
            assert ratios["nearest, every pose"] > 4.0
        weighted.append(estimate["reported"][5]["ate_m"])
        low, high = estimate["reported"][6]["interval_m"]
        assert 0.0 < low < high
    assert weighted == sorted(weighted)
    printed = capsys.readouterr().out
    assert "all groundtruth (accurate)" in printed
    assert "2 Hz, 3 dropouts" in printed


def test_what_an_association_cannot_report_is_said(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = fly(3, estimate_hz=50.0)
    off = dataclasses.replace(flight.estimates[0], stamps=flight.truth.stamps + 1_000_000)
    write(files / "off.txt", off)
    arguments = ["study", "association", "-g", str(files / "truth.txt")]
    options = ["--rate", "0.3", "--dropouts", "0"]
    assert main([*arguments, "-e", str(files / "off.txt"), *options]) == 0
    printed = capsys.readouterr().out
    assert "linear, gaps up to 0.5 s: no pairs" in printed
    assert "are in groundtruth gaps longer than 0.5 s" in printed
    assert "nan" not in printed


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--rate", "0"], "greater than 0 Hz"),
        (["--dropout-length", "2"], "--dropout-length '2' is not valid"),
        (["--groundtruth-noise", "0"], "the groundtruth noise '0' is not valid"),
        (["--continuous-model", "spline"], "unknown continuous model"),
        (["--gauge", "planar"], "gauge planar"),
    ],
)
def test_bad_settings_are_said(
    files: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["study", "association", "-g", str(files / "truth.txt")]
    status = main([*arguments, "-e", str(files / "estimate0.txt"), *options])
    printed = capsys.readouterr()
    assert status == 2
    assert message in printed.err


def test_json_alone_on_stdout(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["study", "association", "-g", str(files / "truth.txt"), "--json", "-"]
    assert main([*arguments, "-e", str(files / "estimate0.txt")]) == 0
    assert json.loads(capsys.readouterr().out)["estimates"][0]["name"] == "estimate0"
