"""`trajeval evaluate` as a user meets it: its output, its exit status, its one-line refusals."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from paths import ROOT
from text_pairs import START, pair, refused, write_tum
from waiting import PATIENCE_S

from trajeval_ros.cli.app import main

__all__ = ["pair"]  # a fixture


def test_the_verdict_states_that_only_the_scale_is_applied(
    pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    protocol = tmp_path / "scale.yaml"
    protocol.write_text("base: evo\ngauge: sim3\napply: scale\n")
    assert main([*pair, "--protocol", str(protocol)]) == 0
    assert ", only its scale applied; " in capsys.readouterr().out.splitlines()[2]


def test_a_diverged_estimate_is_evaluated_as_far_as_it_has_poses(
    pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = np.loadtxt(pair[-1])
    rows[-40:, 1:4] = 6.0 * 10.0 ** np.arange(0.0, 200.0, 5.0)[:, None]
    diverged = tmp_path / "diverged.txt"
    np.savetxt(diverged, rows, fmt="%.9f")
    assert main([*pair[:-1], str(diverged), "--json", "-"]) == 0
    run = json.loads(capsys.readouterr().out)["runs"][0]
    beyond = int(np.count_nonzero(rows[:, 1] > 1e12))
    assert run["association"]["dropped"] == {"not_finite": beyond}
    assert run["association"]["pairs"] == len(rows) - beyond
    assert np.isfinite(run["ate"]["position_m"]["rmse"])


@pytest.mark.parametrize(
    "lengths", ["2,8,16", "16,8,2", "8,1000,16,1s", "16,2s", "50%,16,1%", "1s,16"]
)
def test_the_drift_is_of_the_longest_sub_trajectories_in_metres(
    pair: list[str], lengths: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*pair, "--lengths", lengths, "--json", "-"]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    drifts = {
        segment["length_m"]: segment["position_percent"]["mean"]
        for segment in run["re"]["segments"]
        if segment.get("position_percent")
    }
    assert main([*pair, "--lengths", lengths]) == 0
    text = re.search(r"drift (\S+) % over (\S+) m", capsys.readouterr().out)
    assert text is not None
    assert float(text[2]) == pytest.approx(max(drifts), rel=1e-3)
    assert float(text[1]) == pytest.approx(drifts[max(drifts)], rel=1e-2)


def test_json_goes_alone_to_standard_output_and_twice_the_same(
    pair: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*pair, "--json", "-"]) == 0
    first = capsys.readouterr().out
    assert main([*pair, "--json", "-"]) == 0
    assert capsys.readouterr().out == first
    result = json.loads(first)
    assert result["schema"] == "trajeval/3"
    assert len(result["runs"]) == 1
    ate = result["runs"][0]["ate"]
    assert list(ate["position_m"]) == [
        "rmse", "mean", "median", "std", "min", "max", "p95", "count",
    ]  # fmt: skip
    assert ate["velocity_mps"] is None
    assert result["runs"][0]["alignment"]["gauge"] == "se3"


def test_quiet_says_nothing_and_writes_what_was_asked_for(
    pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "result.json"
    assert main([*pair, "--quiet", "--json", str(file)]) == 0
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""
    assert json.loads(file.read_text())["runs"][0]["association"]["pairs"] == 400


@pytest.mark.slow
def test_output_folder_holds_results_errors_and_figures(pair: list[str], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the plot extra is not installed")
    folder = tmp_path / "some" / "result"
    assert main([*pair, "--quiet", "--output", str(folder)]) == 0
    names = {file.name for file in folder.iterdir()}
    assert {"result.json", "errors.npz", "trajectory_top.png", "relative_error.png"} <= names
    assert [path.name for path in folder.parent.iterdir()] == ["result"]
    result = json.loads((folder / "result.json").read_text())
    errors = np.load(folder / "errors.npz")
    rmse = np.sqrt(np.mean(errors["estimate.position_m"] ** 2))
    assert rmse == pytest.approx(result["runs"][0]["ate"]["position_m"]["rmse"], rel=1e-12)
    assert len(errors["estimate.8m.starts"]) == result["runs"][0]["re"]["segments"][0]["pairs"]


def test_several_estimates_are_told_apart_by_their_folders(
    pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other").mkdir()
    other = write_tum(tmp_path / "other" / "estimate.txt", scale=1.05)
    assert main([*pair, "-e", str(other), "--json", "-"]) == 0
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert [run["estimate"]["name"].split("/")[-2:] for run in runs][1] == ["other", "estimate"]
    assert runs[0]["estimate"]["name"] != runs[1]["estimate"]["name"]
    assert runs[0]["ate"]["position_m"]["rmse"] < runs[1]["ate"]["position_m"]["rmse"]


@pytest.mark.parametrize(
    ("bound", "status"),
    [
        ("ate.position_m.rmse < 0.5", 0),
        ("ate.position_m.rmse < 0.01", 1),
        ("re.8m.position_percent.mean <= 5", 0),
        ("association.estimate_coverage >= 1", 0),
        ("ate.velocity_mps.rmse < 100", 1),
    ],
)
def test_requirements_decide_the_exit_status(
    pair: list[str], bound: str, status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*pair, "--quiet", "--require", bound]) == status
    assert (bound.split()[0] in capsys.readouterr().err) == (status == 1)


@pytest.mark.parametrize("length", ["8m", "2.5m", "10%", "12.5%", "1s", "0.5s", "pooled"])
def test_every_relative_error_can_be_required(
    pair: list[str], length: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lengths = ["8m", "2.5m", "10%", "12.5%", "1s", "0.5s"]
    asked = [*pair, "--lengths", ",".join(lengths)]
    assert main([*asked, "--json", "-"]) == 0
    errors = json.loads(capsys.readouterr().out)["runs"][0]["re"]
    of_length = dict(zip(lengths, errors["segments"], strict=True)) | {"pooled": errors["pooled"]}
    metric = "rotation_deg" if length.endswith("s") else "position_percent"
    mean = of_length[length][metric]["mean"]
    path = f"re.{length.replace('.', '_')}.{metric}.mean"
    for factor, status in ((1.001, 0), (0.999, 1)):
        bound = f"{path} < {factor * mean:.9f}"
        assert main([*asked, "--quiet", "--require", bound]) == status


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--require", "re.9m.position_m.rmse < 1"], "results have no '9m'"),
        (["--require", "re.10%.position_m.rmse < 1"], "results have no '10%'"),
        (["--require", "re.poled.position_percent.rmse < 1"], "did you mean 'pooled'"),
        (["--require", "ate.position.rmse < 1"], "did you mean 'position_m'"),
        (["--require", "ate.position_m < 1"], "is not a number; add one of rmse"),
        (["--require", "ate < 1"], "ate is not a number; add one of position_m"),
        (["--gauge", "SE3"], "unknown gauge 'SE3' (did you mean se3?)"),
        (["--require", "nonsense"], "write it as"),
        (["--gauge", "se4"], "none, translation, yaw, planar, se3, sim3"),
        (["--gauge", "se3", "--modality", "mono"], "modality mono means gauge sim3"),
        (["--modality", "sonar"], "use one of mono"),
        (["--protocol", "kiti"], "did you mean kitti?"),
        (["--lengths", "8,banana"], "'banana' is not a length"),
        (["--lengths", "-3"], "-3"),
        (["--align-states", "0"], "all or a number"),
        (["--gauge", "sim3", "--align-states", "1"], "one state does not determine a scale"),
        (["--max-gap", "-1"], "must be greater than 0"),
        (["--ate-form", "best"], "no such option: --ate-form"),
        (["--gage", "se3"], "--gauge"),
    ],
)
def test_a_wrong_option_gets_one_sentence(
    pair: list[str],
    options: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    target = tmp_path / "never.json"
    line = refused([*pair, "--json", str(target), *options], capsys)
    assert words in line
    assert not target.exists()


GOOD = "1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n3.0 1 1 0 0 0 0.1 1\n4.0 0 2 1 0 0 0.2 1\n"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "does not exist"),
        ("", "empty"),
        (GOOD + "5.0 1 2", "line 5"),
        (GOOD + "5.0 1 x 3 0 0 0 1\n", "line 5"),
        ("1.0 nan 0 0 0 0 0 1\n" * 3, ""),
        ("1.0 0 0 0 0 0 0 1\n1.0 1 0 0 0 0 0 1\n1.0 2 0 0 0 0 0.1 1\n", "stamp"),
        (GOOD.replace("1.0 0", "0.0 0", 1).replace("2.0", "0.0").replace("3.0", "0.0")
         .replace("4.0", "0.0"), "stamp"),
        ("1700000001.0 0 0 0 0 0 0 1\n", ""),
        ("\x00\x01\x02\x03" * 64, ""),
    ],
    ids=["missing", "empty", "half a line", "letters", "all NaN", "all stamps equal",
         "all stamps zero", "one pose", "binary"],
)  # fmt: skip
def test_a_bad_estimate_gets_one_sentence(
    pair: list[str],
    content: str | None,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bad = tmp_path / "bad.txt"
    if content is not None:
        bad.write_text(content)
    output = tmp_path / "result"
    line = refused([*pair[:3], "-e", str(bad), "--output", str(output)], capsys)
    assert "bad" in line
    assert words.lower() in line.lower()
    assert not output.exists()


def test_clocks_that_never_meet_are_explained(
    pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulated = write_tum(tmp_path / "simulated.txt", start=0.0)
    assert "simulated time" in refused([*pair[:3], "-e", str(simulated)], capsys)
    shifted = write_tum(tmp_path / "shifted.txt", start=START + 3600.0)
    line = refused([*pair[:3], "-e", str(shifted)], capsys)
    assert "time offset" in line
    offset = re.search(r"common start: (-?[\d.]+) s", line)
    assert offset is not None
    assert main([*pair[:3], "-e", str(shifted), "-q", "--time-offset", offset[1]]) == 0


def test_nanoseconds_and_seconds_meet(pair: list[str], tmp_path: Path) -> None:
    rows = np.loadtxt(pair[4])
    lines = [
        f"{round(row[0] * 1e9)} " + " ".join(f"{value:.9f}" for value in row[1:]) for row in rows
    ]
    (tmp_path / "nanoseconds.txt").write_text("\n".join(lines))
    result = tmp_path / "result.json"
    arguments = [*pair[:3], "-e", str(tmp_path / "nanoseconds.txt"), "-q", "--json", str(result)]
    assert main(arguments) == 0
    run = json.loads(result.read_text())["runs"][0]
    assert run["association"]["pairs"] == 400
    assert any("nanoseconds" in note["text"] for note in run["estimate"]["remarks"])


def test_it_works_elsewhere_with_a_home_that_cannot_be_written(
    pair: list[str], tmp_path: Path
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    environment = {**os.environ, "HOME": "/proc/nowhere", "XDG_CACHE_HOME": "/proc/nowhere"}
    environment["PYTHONPATH"] = str(ROOT)
    done = subprocess.run(
        [sys.executable, "-m", "trajeval_ros", *pair],
        cwd=elsewhere,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "ATE" in done.stdout
    assert list(elsewhere.iterdir()) == []


def test_help_teaches_by_example(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    assert main(["evaluate", "--help"]) == 0
    output = capsys.readouterr().out
    assert "--modality stereo-inertial" in " ".join(output.split())
    assert main(["--version"]) == 0
    assert re.fullmatch(r"trajeval_ros \d+\.\d+\.\d+\n", capsys.readouterr().out)


@pytest.mark.parametrize("option", ["--json", "--output"])
def test_a_place_that_cannot_be_written_gets_one_sentence(
    pair: list[str], option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused([*pair, "-q", option, "/proc/nowhere/result"], capsys)
    assert "/proc/nowhere" in line
    assert ".part" not in line


@pytest.mark.slow
def test_an_estimate_has_the_given_name_everywhere(
    pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    second = tmp_path / "second.txt"
    second.write_bytes(Path(pair[-1]).read_bytes())
    output, recording = tmp_path / "result", tmp_path / "result.rrd"
    named = [*pair[:-1], f"Ours, v2={pair[-1]}", "-e", str(second)]
    options = ["--output", str(output), "--figure-format", "svg", "--rrd", str(recording)]
    assert main([*named, *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("Ours, v2: position error")
    assert any(re.match(r"Ours, v2 +position \[m\]", line) for line in lines)
    runs = json.loads((output / "result.json").read_text())["runs"]
    assert [run["estimate"]["name"] for run in runs] == ["Ours, v2", "second"]
    assert runs[0]["estimate"]["source"] == pair[-1]
    assert any("Ours, v2" in path.read_text() for path in output.glob("*.svg"))
    assert b"Ours, v2" in recording.read_bytes()


def test_two_estimates_of_one_given_name_are_refused(
    pair: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused([*pair[:-1], f"Ours={pair[-1]}", "-e", f"Ours={pair[-1]}"], capsys)
    assert "two sources have the name 'Ours'" in line


def test_a_file_with_an_equals_sign_in_its_name_is_a_source(
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("lr=0.1.txt").write_bytes(Path(pair[-1]).read_bytes())
    assert main([*pair[:-1], "lr=0.1.txt", "-e", "half=lr=0.1.txt"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("lr=0.1: position error")
    assert any(line.startswith("half: position error") for line in lines)
    assert "0.2.txt does not exist" in refused([*pair[:-1], "lr=0.2.txt"], capsys)


def test_the_kitti_protocol_begins_with_the_numbers_of_its_ranking(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = np.zeros((800, 12))
    rows[:, 5] = 1.0
    angles = np.arange(800) / 400.0
    for name, scale in (("groundtruth", 1.0), ("estimate", 1.02)):
        rotations = angles * scale
        rows[:, [0, 2, 8, 10]] = np.stack(
            [np.cos(rotations), np.sin(rotations), -np.sin(rotations), np.cos(rotations)], axis=1
        )
        rows[:, [3, 11]] = scale * 200.0 * np.stack([1.0 - np.cos(angles), np.sin(angles)], axis=1)
        np.savetxt(tmp_path / f"{name}.txt", rows)
    sources = [str(tmp_path / f"{name}.txt") for name in ("groundtruth", "estimate")]
    assert main(["evaluate", *sources, "--protocol", "kitti"]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert re.match(
        r"estimate: \d\.\d{3} %, \S+ deg/100 m \(KITTI, 100 to 300 m\); position ", first
    )
    assert "drift" not in first
    assert main(["evaluate", *sources, "--protocol", "kitti", "--json", "-"]) == 0
    pooled = json.loads(capsys.readouterr().out)["runs"][0]["re"]["pooled"]
    assert float(first.split()[1]) == pytest.approx(pooled["position_percent"]["mean"], rel=1e-3)


@pytest.mark.parametrize(
    ("options", "statistic"),
    [
        (["--statistic", "median"], "median"),
        (["--statistic", "rmse"], "rmse"),
        (["--protocol", "evo"], "rmse"),
        (["--protocol", "evo", "--statistic", "mean"], "mean"),
    ],
)
def test_the_statistic_of_relative_errors_is_chosen(
    options: list[str],
    statistic: str,
    pair: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    result = tmp_path / "result.json"
    assert main([*pair, *options, "--lengths", "8", "--json", str(result)]) == 0
    [_, _, row] = capsys.readouterr().out.partition("Relative error, ")[2].splitlines()[:3]
    (segment,) = json.loads(result.read_text())["runs"][0]["re"]["segments"]
    assert float(row.split()[3]) == pytest.approx(segment["position_m"][statistic], rel=1e-3)


def test_an_unknown_statistic_is_refused(
    pair: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert "use one of rmse, mean, median" in refused([*pair, "--statistic", "p95"], capsys)
