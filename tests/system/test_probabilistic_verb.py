"""`trajeval evaluate --association continuous`, on files, end to end."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from decimated import decimated
from flights import Flight, fly
from written_trajectories import write

from trajeval_ros.cli.app import main
from trajeval_ros.continuous_time.samples import MODELS, Noise
from trajeval_ros.formatting.numbers import with_unit
from trajeval_ros.geometry.trajectory import Trajectory

NAMES = ("best", "middling", "worst")
CONTINUOUS = ["--association", "continuous", "--gauge", "se3", "--lengths", "none"]


@pytest.fixture(scope="module")
def flight() -> Flight:
    return fly(0)


@pytest.fixture(scope="module")
def files(flight: Flight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flight")
    write(folder / "groundtruth.txt", flight.groundtruth)
    for name, estimate in zip(NAMES, flight.estimates, strict=True):
        write(folder / f"{name}.txt", estimate)
    return folder


def evaluated(files: Path, *options: str, estimates: tuple[str, ...] = NAMES[:1]) -> list[Any]:
    output = files / f"result{abs(hash(options + estimates))}.json"
    arguments = ["evaluate", "-g", str(files / "groundtruth.txt"), "--quiet"]
    for name in estimates:
        arguments += ["-e", str(files / f"{name}.txt")]
    assert main([*arguments, *options, "--json", str(output)]) == 0
    runs: list[Any] = json.loads(output.read_text())["runs"]
    return runs


@pytest.mark.slow
def test_three_estimates_are_ranked_and_measured_fairly(files: Path, flight: Flight) -> None:
    runs = evaluated(files, *CONTINUOUS, estimates=NAMES)
    linear = evaluated(files, "--association", "linear", "--max-gap", "10", "--lengths", "none")
    assert linear[0]["probabilistic"] is None
    assert linear[0]["ate"]["position_m"]["rmse"] > 4.0 * flight.true_ate_m(0)
    for place, run in enumerate(runs):
        block = run["probabilistic"]
        true = flight.true_ate_m(place)
        assert block["ate"]["supported_m"] == pytest.approx(true, rel=0.2)
        low, high = block["ate"]["interval_95_m"]
        assert low < true < high
        assert block["model"] == run["association"]["model"] == "matern"
        assert block["groundtruth_samples"] == len(flight.groundtruth)
        assert len(block["per_axis"]) == 6
        assert block["nll_per_pose"] * run["association"]["pairs"] == pytest.approx(
            -block["log_likelihood"]
        )
        assert any("share its error" in statement for statement in block["statements"])
    weighted = [run["probabilistic"]["ate"]["weighted_m"] for run in runs]
    assert weighted == sorted(weighted)
    surprise = [run["probabilistic"]["nll_per_pose"] for run in runs]
    assert surprise == sorted(surprise)
    factors = [run["probabilistic"]["log_bayes_factors"] for run in runs]
    assert set(factors[0]) == {"middling", "worst"}
    assert 0.0 < factors[0]["middling"] < factors[0]["worst"]
    assert factors[1]["best"] == pytest.approx(-factors[0]["middling"])


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_every_model_gives_a_whole_result(files: Path, model: str) -> None:
    (run,) = evaluated(files, *CONTINUOUS, "--continuous-model", model)
    block = run["probabilistic"]
    assert run["association"]["model"] == model
    assert block["model"] == model or model == "auto"
    assert np.isfinite(block["log_likelihood"])
    blamed = any("are too low there" in statement for statement in block["statements"])
    assert blamed == (model in ("linear", "nearest"))


@pytest.mark.parametrize("gauge", ["none", "translation", "yaw", "se3", "sim3"])
def test_every_gauge_but_a_planes(files: Path, gauge: str) -> None:
    (run,) = evaluated(files, "--association", "continuous", "--gauge", gauge)
    chain = run["probabilistic"]["chain"]
    assert (chain is None) == (gauge in ("none", "translation"))
    if chain is not None:
        assert chain["scale"] == pytest.approx(1.0, abs=0.01)
        assert len(chain["tilt_z"]) == 2


def test_the_headline_is_the_ate_that_the_groundtruth_supports(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sides = ["-g", str(files / "groundtruth.txt"), "-e", str(files / "best.txt")]
    output = files / "headline.json"
    assert main(["evaluate", *sides, *CONTINUOUS, "--json", str(output)]) == 0
    headline, below, *_ = capsys.readouterr().out.splitlines()
    (run,) = json.loads(output.read_text())["runs"]
    ate = run["probabilistic"]["ate"]
    supported, low, high, whole = (
        with_unit(number, "m")
        for number in (ate["supported_m"], *ate["interval_95_m"], run["ate"]["position_m"]["rmse"])
    )
    assert supported != whole
    assert headline.startswith(
        f"best: position error {supported} RMSE after alignment (ATE, approximate 95 % interval "
        f"{low} to {high}) over "
    )
    assert below == (
        f"  position error {whole} RMSE after alignment (ATE) over all pairs, gaps of the "
        "groundtruth included"
    )


@pytest.mark.slow
def test_noise_is_the_users(files: Path) -> None:
    sure, unsure = (
        evaluated(files, *CONTINUOUS, "--groundtruth-noise", noise)[0]["probabilistic"]
        for noise in ("0.002,0.1", "0.05,1")
    )
    assert unsure["groundtruth_noise"] == pytest.approx({"position_m": 0.05, "rotation_deg": 1.0})
    assert unsure["chi2_per_dof"] < sure["chi2_per_dof"]


@pytest.mark.slow
def test_folder_has_figures_and_columns(
    files: Path, flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    arguments = ["evaluate", "-g", str(files / "groundtruth.txt"), *CONTINUOUS]
    for name in NAMES[:2]:
        arguments += ["-e", str(files / f"{name}.txt")]
    assert main([*arguments, "--output", str(tmp_path / "out")]) == 0
    for figure in ("groundtruth_uncertainty", "mahalanobis", "likelihood_by_edge"):
        assert (tmp_path / "out" / f"{figure}.png").stat().st_size > 5_000
    columns = np.load(tmp_path / "out" / "errors.npz")
    count = len(flight.truth)
    assert columns["best.probabilistic.residuals"].shape == (count, 6)
    assert columns["best.probabilistic.sigmas"].shape == (count, 6)
    assert columns["best.probabilistic.supported"].dtype == bool
    assert columns["best.probabilistic.edges"].shape == (count - 1,)
    printed = capsys.readouterr().out
    assert "model matern, including gaps" in printed
    assert "ATE supported [m]" in printed
    assert "log Bayes factor" in printed


def test_estimates_without_common_stamps_have_no_bayes_factor(files: Path, flight: Flight) -> None:
    shifted = flight.estimates[1]
    write(files / "elsewhere.txt", Trajectory(
        shifted.stamps + 1_000_000, shifted.positions, shifted.quaternions
    ))  # fmt: skip
    runs = evaluated(files, *CONTINUOUS, estimates=("best", "elsewhere"))
    assert len(runs) > 0
    for run in runs:
        assert run["probabilistic"]["log_bayes_factors"] == {}
        assert any(
            "only 0 common timestamps" in statement
            for statement in run["probabilistic"]["statements"]
        )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--continuous-model", "matern"], "needs --association continuous, not auto"),
        (
            ["--association", "continuous", "--continuous-model", "spline"],
            "unknown continuous model",
        ),
        (["--association", "continuous", "--gauge", "planar"], "gauge planar is not supported"),
        (
            ["--association", "continuous", "--groundtruth-noise", "0,0"],
            "must be greater than zero",
        ),
        (["--groundtruth-noise", "0.1,0.1"], "--association continuous"),
        (["--association", "continuous", "--covariance", "message"], "use association linear"),
    ],
)
def test_what_means_nothing_is_refused(
    files: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["evaluate", "-g", str(files / "groundtruth.txt")]
    assert main([*arguments, "-e", str(files / "best.txt"), *options]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_bad_groundtruth_is_said(
    files: Path, flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    estimate = str(files / "best.txt")
    write(tmp_path / "one.txt", flight.groundtruth[:1])
    assert main(["evaluate", "-g", str(tmp_path / "one.txt"), "-e", estimate, *CONTINUOUS]) == 2
    assert "has 1 pose" in capsys.readouterr().err
    write(tmp_path / "single.txt", flight.estimates[0][40:41])
    write(tmp_path / "two.txt", flight.estimates[0][40:42])
    first = ["-g", str(files / "groundtruth.txt"), *CONTINUOUS, "--align-states", "1"]
    assert main(["evaluate", "-e", str(tmp_path / "single.txt"), *first]) == 2
    assert "likelihood of a single pose" in capsys.readouterr().err
    assert main(["evaluate", "-e", str(tmp_path / "two.txt"), *first]) == 0
    assert "nan" not in capsys.readouterr().out.lower()
    still = Trajectory(
        flight.groundtruth.stamps,
        np.ones_like(flight.groundtruth.positions),
        flight.groundtruth.quaternions,
    )
    write(tmp_path / "still.txt", still)
    assert main(["evaluate", "-g", str(tmp_path / "still.txt"), "-e", estimate, *CONTINUOUS]) == 0
    printed = capsys.readouterr()
    assert "does not move" in printed.out + printed.err
    # A gap longer than all the rest, and only two poses left of one side of it.
    ends = np.r_[np.arange(5), len(flight.groundtruth) - 2, len(flight.groundtruth) - 1]
    write(tmp_path / "gap.txt", flight.groundtruth[ends])
    assert main(["evaluate", "-g", str(tmp_path / "gap.txt"), "-e", estimate, *CONTINUOUS]) == 0
    printed = capsys.readouterr().out
    assert "nan" not in printed.lower()
    assert (
        "uncertainty of the groundtruth"
    ) in printed or "the uncertainty of the groundtruth is larger" in printed


def test_a_recording_at_two_hertz(
    recording: Callable[[str], Trajectory], shared_data: Path, tmp_path: Path
) -> None:
    """EuRoC V1_02, groundtruth left at 2 Hz with dropouts: the ATE of all of it, within 20 %."""
    whole = recording("euroc/groundtruth/V1_02_asl.csv")
    few = decimated(whole, 2.0, 5, Noise()).samples
    write(tmp_path / "groundtruth.txt", few)
    estimate = str(shared_data / "euroc" / "V1_02_estimate.txt")
    everything = str(shared_data / "euroc" / "groundtruth" / "V1_02_asl.csv")
    ates = []
    for source, options in (
        (everything, ["--association", "linear"]),
        (str(tmp_path / "groundtruth.txt"), ["--association", "continuous"]),
    ):
        output = tmp_path / "result.json"
        arguments = ["evaluate", "-g", source, "-e", estimate, "--gauge", "se3", "--quiet"]
        assert main([*arguments, *options, "--json", str(output)]) == 0
        ates.append(json.loads(output.read_text())["runs"][0])
    true = ates[0]["ate"]["position_m"]["rmse"]
    assert ates[1]["probabilistic"]["ate"]["supported_m"] == pytest.approx(true, rel=0.2)


@pytest.mark.slow
def test_a_recording_with_a_hole_of_twelve_seconds(shared_data: Path, tmp_path: Path) -> None:
    """TUM fr2_desk, whose motion capture also lost hundreds of single samples."""
    folder = shared_data / "tum"
    arguments = ["evaluate", "-g", str(folder / "fr2_desk_groundtruth.txt"), "--quiet"]
    arguments += ["-e", str(folder / "fr2_desk_ORB.txt"), "--modality", "mono"]
    results = {}
    for name, options in {
        "outside": [],
        "bridged": ["--max-gap", "100"],
        "modelled": ["--association", "continuous"],
    }.items():
        output = tmp_path / f"{name}.json"
        assert main([*arguments, *options, "--lengths", "none", "--json", str(output)]) == 0
        (results[name],) = json.loads(output.read_text())["runs"]
    outside = results["outside"]["ate"]["position_m"]["rmse"]
    assert results["bridged"]["ate"]["position_m"]["rmse"] > 10.0 * outside
    ate = results["modelled"]["probabilistic"]["ate"]
    assert ate["supported_m"] == pytest.approx(outside, rel=0.05)
    assert ate["weighted_m"] == pytest.approx(outside, rel=0.2)
    assert ate["supported_share"] == pytest.approx(
        results["outside"]["association"]["estimate_coverage"], abs=0.02
    )
