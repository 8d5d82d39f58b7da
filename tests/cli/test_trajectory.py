"""`trajeval trajectory`, and --start and --end where errors are measured."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from paths import TESTS

from trajeval_ros.batch.config import plan_of
from trajeval_ros.cli.app import main
from trajeval_ros.cli.plotting import Plotting
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory_edits import TimeSpan
from trajeval_ros.io.save_trajectories import save_trajectories
from trajeval_ros.io.sources import read_trajectory

PAIR = TESTS / "data/parity/pairs/drone_loop"
GT, EST = str(PAIR / "gt.txt"), str(PAIR / "est.txt")


def rows(text: str) -> dict[str, list[str]]:
    return {words[0]: words[1:] for words in map(str.split, text.splitlines()[1:]) if words}


def test_the_table_says_what_trajectories_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trajectory", GT, EST]) == 0
    result = rows(capsys.readouterr().out)
    estimate = read_trajectory(EST)
    poses, duration, rate, path, mean, *_ = result["est"]
    assert int(poses) == len(estimate)
    assert float(duration) == pytest.approx(estimate.duration_s, abs=1e-3)
    assert float(rate) == pytest.approx(20.0)
    assert float(path) == pytest.approx(estimate.path_length_m, abs=1e-3)
    assert float(mean) == pytest.approx(estimate.path_length_m / estimate.duration_s, abs=1e-3)
    assert int(result["gt"][0]) == 4000


@pytest.mark.parametrize("largest", ["-1", "0", "nan", "inf"])
def test_the_end_of_a_colour_scale_is_positive(
    largest: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["trajectory", EST, "--plot", "xy", "--colour-by", "speed", "--output", "unused"]
    assert main([*command, "--colour-max", largest]) == 2
    expected = f"--colour-max must be positive and needs --colour-by; found {float(largest):g}"
    assert expected in capsys.readouterr().err


def test_a_topic_goes_to_text_and_back(tmp_path: Path) -> None:
    save = ["trajectory", GT, EST, "-q", "--save-as", "mcap", "--output", str(tmp_path)]
    assert main(save) == 0
    bag = tmp_path / "trajectories.mcap"
    texts = ["trajectory", str(bag), "-q", "--save-as", "tum", "--output", str(tmp_path / "texts")]
    assert main(texts) == 0
    for name, source in (("gt", GT), ("est", EST)):
        read, original = read_trajectory(tmp_path / f"texts/{name}.txt"), read_trajectory(source)
        for column in ("stamps", "positions", "quaternions"):
            np.testing.assert_array_equal(getattr(read, column), getattr(original, column))


def test_aligned_and_synchronised(tmp_path: Path) -> None:
    save = ["--save-as", "tum", "--output", str(tmp_path), "-q"]
    assert (
        main(["trajectory", EST, "--reference", GT, "--gauge", "se3", "--synchronise", *save]) == 0
    )
    pair = ["-g", str(tmp_path / "est_reference.txt"), "-e", str(tmp_path / "est.txt")]
    of_saved, of_all = tmp_path / "saved.json", tmp_path / "all.json"
    assert main(["evaluate", *pair, "--gauge", "none", "-q", "--json", str(of_saved)]) == 0
    assert (
        main(["evaluate", "-g", GT, "-e", EST, "--gauge", "se3", "-q", "--json", str(of_all)]) == 0
    )
    saved, everything = (
        json.loads(path.read_text())["runs"][0]["ate"] for path in (of_saved, of_all)
    )
    for metric in ("position_m", "rotation_deg"):
        assert saved[metric]["rmse"] == pytest.approx(everything[metric]["rmse"], rel=1e-9)
        assert saved[metric]["count"] == everything[metric]["count"]


def test_transformed_there_and_back(tmp_path: Path) -> None:
    (tmp_path / "move.yaml").write_text(
        "transform:\n  translation: {x: 1.0, y: 2.0, z: -3.0}\n"
        "  rotation: {x: 0.0, y: 0.0, z: 0.0, w: 1.0}\nscale: 2.0\n"
    )
    moved = ["--transform-left", str(tmp_path / "move.yaml"), "--save-as", "tum", "-q"]
    assert main(["trajectory", EST, *moved, "--output", str(tmp_path / "out")]) == 0
    result, before = read_trajectory(tmp_path / "out/est.txt"), read_trajectory(EST)
    np.testing.assert_allclose(result.positions, 2.0 * before.positions + [1.0, 2.0, -3.0])
    assert main(["trajectory", EST, "--transform-right", str(tmp_path / "move.yaml")]) == 2


@pytest.mark.parametrize("scale", ["-1.0", "0", ".inf", ".nan", "true", "twice"])
def test_a_scale_is_a_number_above_zero(
    scale: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "move.yaml"
    path.write_text(
        "transform:\n  translation: {x: 1.0, y: 2.0, z: -3.0}\n"
        f"  rotation: {{x: 0.0, y: 0.0, z: 0.0, w: 1.0}}\nscale: {scale}\n"
    )
    assert main(["trajectory", EST, "--transform-left", str(path)]) == 2
    assert "scale must be a number greater than zero" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        (["--synchronise"], "give --reference"),
        (["--gauge", "se3"], "give --reference"),
        (["--align-states", "1"], "need --gauge"),
        (["--association", "nearest"], "need --synchronise"),
        (["--message", "Path"], "--message applies to bags"),
        (["--save-as", "csv"], "unknown format 'csv'"),
        (["--motion-filter", "1"], "--motion-filter '1' is not valid"),
        (["--start", "yesterday"], "start 'yesterday' is not valid"),
        (["--start", "1e6"], "est: no pose in the time span"),
        (["--world-axes", "camera"], "unknown axes 'camera'"),
    ],
)
def test_mistakes_are_told_in_a_sentence(
    arguments: list[str], printed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["trajectory", EST, *arguments]) == 2
    error = capsys.readouterr().err
    assert printed in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("start", "end"), [("5", "20"), ("@1500000005.5", None), ("5", "+15"), (None, "10")]
)
def test_a_part_of_the_time_is_evaluated(
    start: str | None, end: str | None, tmp_path: Path
) -> None:
    span = [*(["--start", start] if start else []), *(["--end", end] if end else [])]
    cut = ["trajectory", GT, EST, "--reference", GT, *span, "--save-as", "tum", "-q"]
    assert main([*cut, "--output", str(tmp_path)]) == 0
    files = str(tmp_path / "gt.txt"), str(tmp_path / "est.txt")
    results = []
    for truth, estimate, more in ((GT, EST, span), (*files, [])):
        path = tmp_path / f"{len(results)}.json"
        given = ["evaluate", "-g", truth, "-e", estimate, *more, "-q", "--json", str(path)]
        assert main(given) == 0
        results.append(json.loads(path.read_text()))
    assert results[0]["runs"][0]["ate"] == results[1]["runs"][0]["ate"]
    assert results[0]["runs"][0]["association"]["groundtruth_coverage"] == pytest.approx(
        results[1]["runs"][0]["association"]["groundtruth_coverage"]
    )
    settings = [result["provenance"]["settings"] for result in results]
    assert (settings[0]["start"], settings[0]["end"]) != (None, None)
    assert (settings[1]["start"], settings[1]["end"]) == (None, None)


def test_a_comparison_takes_a_part_of_the_time(tmp_path: Path) -> None:
    whole = f"folder: {PAIR.parent}\ngroundtruth: '{{sequence}}/gt.txt'\n"
    whole += "runs: {vio: '{sequence}/est.txt'}\nsequences: [drone_loop]\n"
    config = tmp_path / "runs.yaml"
    config.write_text(f"{whole}start: 5\nend: '+10'\n")
    request = plan_of(config, {}).request
    assert request.time_span == TimeSpan(5 * 10**9, 15 * 10**9)
    config.write_text(whole)
    assert plan_of(config, {}).request.fingerprint != request.fingerprint
    assert plan_of(config, {"start": "5", "end": "15"}).request.fingerprint == request.fingerprint


def test_the_reference_of_a_plot_is_the_reference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `plot`")
    drawn = []
    monkeypatch.setattr(
        Plotting, "write", lambda self, folder, several, reference: drawn.append(reference) or []
    )
    options = ["--reference", GT, "--plot", "xy", "--output", str(tmp_path)]
    assert main(["trajectory", EST, *options, "-q"]) == 0
    [reference] = drawn
    np.testing.assert_array_equal(reference.positions, read_trajectory(GT).positions)


def test_a_merge_counts_and_prints_what_it_drops(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [tmp_path / "robot0.txt", tmp_path / "robot1.txt"]
    for place, path in enumerate(paths):
        rows = [f"{1700000000 + i / 10} {i + place} 0 0 0 0 0 1" for i in range(20)]
        path.write_text("\n".join(rows) + "\n")
    command = ["trajectory", *map(str, paths), "--merge", "--save-as", "tum", "--output"]
    assert main([*command, str(tmp_path / "out")]) == 0
    assert "20 of 40 poses dropped: an earlier source has a pose" in capsys.readouterr().err


@pytest.mark.parametrize("orientations", [True, False])
def test_clock_and_marker_are_those_of_an_evaluation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], *, orientations: bool
) -> None:
    """The paired, aligned poses have the position errors of `trajeval evaluate`."""
    groundtruth = HandEye.from_text("0.3,-0.1,0.2,0,0,0.6,0.8")
    assert groundtruth is not None
    moved = groundtruth.inverse().of_body(read_trajectory(GT))
    if not orientations:
        moved = dataclasses.replace(moved, quaternions=None)
    late = read_trajectory(EST)
    late = dataclasses.replace(late, stamps=late.stamps - 250_000_000)
    names = {"gt": moved, "est": late}
    for name, trajectory in names.items():
        named = [dataclasses.replace(trajectory, name=name)]
        save_trajectories(tmp_path, named, "tum", "PoseStamped")
    gt, est = str(tmp_path / "gt.txt"), str(tmp_path / "est.txt")
    options = ["--gauge", "yaw", "--time-offset", "0.25", "--hand-eye", "0.3,-0.1,0.2,0,0,0.6,0.8"]
    assert main(["evaluate", "-g", gt, "-e", est, *options, "--json", "-"]) == 0
    expected = json.loads(capsys.readouterr().out)["runs"][0]["ate"]["position_m"]
    saved = tmp_path / "saved"
    command = ["trajectory", est, "--reference", gt, *options, "--synchronise"]
    assert main([*command, "--save-as", "tum", "--output", str(saved)]) == 0
    aligned, reference = (np.loadtxt(saved / f"est{end}.txt") for end in ("", "_reference"))
    errors = np.linalg.norm(aligned[:, 1:4] - reference[:, 1:4], axis=1)
    assert len(errors) == expected["count"]
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(expected["rmse"], rel=1e-4)
    plain = read_trajectory(EST)
    assert aligned[0, 0] == pytest.approx(plain.stamps[0] * 1e-9, abs=0.06)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--time-offset", "auto"], "trajectory applies known values only"),
        (["--hand-eye", "auto"], "trajectory applies known values only"),
        (["--hand-eye", "0,0,0,0,0,0,1"], "need a reference; give --reference SOURCE"),
    ],
)
def test_a_calibration_is_given(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["trajectory", EST, *options]) == 2
    assert message in capsys.readouterr().err
