"""The command line as it is typed: sources by position and through pipes, completion, help."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT
from strategies import make_pair

from trajeval_ros.cli.app import REPLACED, VERBS, main, verb
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.write_bag import ODOMETRY, write_bag, write_mcap
from trajeval_ros.io.find_sources import DEEPEST, MOST, find_sources
from trajeval_ros.io.save_trajectories import write_tum
from trajeval_ros.io.source_names import names_of
from trajeval_ros.io.sources import read_many
from trajeval_ros.report.console import Console

needs_bash = pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    made = make_pair(1, 100, smooth=True)
    truth, estimate = tmp_path / "truth.txt", tmp_path / "estimate.txt"
    write_tum(truth, made.groundtruth)
    write_tum(estimate, made.estimate)
    return truth, estimate


def shell(command: str, **more: str) -> subprocess.CompletedProcess[str]:
    """Run a command of bash, with `trajeval` as this Python has it."""
    function = f'trajeval() {{ "{sys.executable}" -m trajeval_ros "$@"; }}\n'
    return subprocess.run(
        ["bash", "-c", function + command],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), **more},
        check=False,
        stdin=subprocess.DEVNULL,
    )


def test_sources_by_position_are_those_by_name(
    pair: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    truth, estimate = map(str, pair)
    results = []
    for sources in ([truth, estimate, truth], ["-g", truth, "-e", estimate, "-e", truth]):
        assert main(["evaluate", *sources, "--json", "-"]) == 0
        results.append(capsys.readouterr().out)
    assert results[0] == results[1]
    assert [run["estimate"]["name"] for run in json.loads(results[0])["runs"]] == [
        "estimate",
        "truth#2",
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a", "b", "-e", "c"], "sources are given twice"),
        (["a", "-g", "b"], "sources are given twice"),
        (["a"], "estimate missing"),
        (["-g", "a"], "estimate missing"),
        (["-e", "a"], "groundtruth missing"),
        ([], "groundtruth and estimate missing"),
    ],
)
def test_sources_named_twice_or_not_at_all_are_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.slow
@needs_bash
def test_texts_come_through_pipes(pair: tuple[Path, Path]) -> None:
    truth, estimate = pair
    direct = shell(f"trajeval evaluate {truth} {estimate} --json -")
    piped = shell(f"cat {estimate} | trajeval evaluate <(cat {truth}) - --json -")
    assert piped.returncode == 0, piped.stderr
    expected, result = (json.loads(item.stdout) for item in (direct, piped))
    assert result["runs"][0]["ate"] == expected["runs"][0]["ate"]
    assert result["runs"][0]["estimate"]["source"] == "-"
    assert result["runs"][0]["estimate"]["name"] == "stdin"
    assert shell(f"cat {truth} | trajeval info -").stdout.startswith("/dev/stdin\n")
    redirected = shell(f"trajeval evaluate {truth} - --json - < {estimate}")
    assert json.loads(redirected.stdout)["runs"][0]["ate"] == expected["runs"][0]["ate"]


@needs_bash
@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("cat {} | trajeval evaluate - -", "a pipe can be read only once"),
        ("trajeval info -", "/dev/stdin is a device"),
        ("printf '1 2 x\\n' | trajeval info -", "/dev/stdin, line 1, column 3: 'x'"),
        ("printf '' | trajeval info -", "/dev/stdin is empty"),
        ("printf '\\x89MCAP0\\r\\n' | trajeval info -", "a bag can't be read from a pipe"),
    ],
)
def test_what_cannot_be_read_from_a_pipe_is_told(
    command: str, message: str, pair: tuple[Path, Path]
) -> None:
    done = shell(command.replace("{}", str(pair[0])))
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_pipe_leaves_nothing_behind(
    pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from concurrent.futures import ThreadPoolExecutor

    pipe, temporary = tmp_path / "pipe", tmp_path / "temporary"
    os.mkfifo(pipe)
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    with ThreadPoolExecutor() as pool:
        pool.submit(pipe.write_bytes, pair[0].read_bytes())
        (read,) = read_many([str(pipe)])
    (expected,) = read_many([str(pair[0])])
    assert read.stamps.tolist() == expected.stamps.tolist()
    assert not list(temporary.iterdir())


def test_topics_are_called_as_the_live_evaluator_calls_them() -> None:
    for source, name in (
        ("run.mcap:/vio/odometry", "vio_odometry"),
        ("run:/tf:map.base_link", "tf_map_base_link"),
        ("s3://bucket/run.mcap:/3d/pose", "topic_3d_pose"),
        ("run.bag:/ORB-SLAM", "ORB-SLAM"),
        ("folder/run.txt", "run"),
        ("-", "stdin"),
    ):
        assert names_of([source]) == [name]
    assert names_of(["a/run:/odom", "b/run:/odom"]) == ["a/run/odom", "b/run/odom"]


@pytest.mark.parametrize("verb", ["", *VERBS])
def test_no_names_of_types_and_no_double_defaults_are_shown(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*verb.split(), "--help"]) == 0
    text = capsys.readouterr().out
    assert "--help" in text
    for name in ("<bool>", "BOOLEAN", "│ TEXT ", "_LOCAL_PATH", "Default: .."):
        assert name not in text
    assert not re.search(r"Default: [^│]{1,12} Default:", " ".join(text.split()))


@pytest.mark.parametrize("name", VERBS)
def test_the_help_fits_a_terminal_of_80_columns(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*name.split(), "--help"]) == 0
    text = capsys.readouterr().out
    options = [option for parameter in verb(name).params for option in parameter.opts]
    if "--help-all" in options:
        assert main([name, "--help-all"]) == 0
        assert len(text.splitlines()) <= 100
        text = capsys.readouterr().out
    assert not [line for line in text.splitlines() if len(line) > 80]
    longest = [option for option in options if option.startswith("--")]
    assert not [option for option in longest if option not in text]
    examples = re.findall(r"^ {4}(.*\S)$", verb(name).help or "", re.MULTILINE)
    assert examples
    assert not [line for line in examples if f" {line} " not in text]


def test_without_arguments_the_help_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) in (0, 2)  # by the version of click
    printed = capsys.readouterr()
    assert "Usage: trajeval" in printed.out
    assert printed.err == ""


def test_usage_errors_are_sentences_like_all_others(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "a", "b", "--plots"]) == 2
    assert capsys.readouterr().err.startswith("trajeval: no such option: --plots ")


def test_studies_are_a_group(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "--help"]) == 0
    shown = capsys.readouterr().out
    assert "gauge" in shown
    assert "association" in shown
    assert main(["study", "gauges"]) == 2
    assert capsys.readouterr().err.startswith("trajeval: no such command 'gauges'")


@pytest.mark.parametrize("name", VERBS)
def test_an_option_of_a_verb_is_not_removed(name: str) -> None:
    options = {option for parameter in verb(name).params for option in parameter.opts}
    assert not options & {row.removeprefix(f"{name} ") for row in REPLACED if name in row}


def test_evaluate_has_few_options() -> None:
    options = [
        parameter for parameter in verb("evaluate").params if parameter.param_type_name == "option"
    ]
    # 45, 4 of as-available accuracy, 2 of discontinuities, --diagnosis and --statistic.
    assert len(options) <= 53
    common = [option for option in options if getattr(option, "is_common", False)]
    assert len(common) == 12


@pytest.mark.slow
@needs_bash
def test_completion_is_sourced_and_completes(tmp_path: Path) -> None:
    # By its own program: what asks for the completion is found by the program's name.
    bin_folder = tmp_path / "bin"
    bin_folder.mkdir()
    program = bin_folder / "trajeval"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m trajeval_ros "$@"\n')
    program.chmod(0o755)
    home = {"HOME": str(tmp_path), "PATH": f"{bin_folder}:{os.environ['PATH']}"}
    asked = """unset -f trajeval; eval "$(_TRAJEVAL_COMPLETE=bash_source trajeval)"
    complete -p trajeval
    compopt() { echo "$@"; }
    complete_words() {
        COMP_WORDS=("$@"); COMP_CWORD=$(( $# - 1 )); COMPREPLY=()
        _trajeval_completion trajeval; echo "${COMPREPLY[@]}"
    }
    complete_words trajeval ev
    complete_words trajeval evaluate --mc
    complete_words trajeval evaluate --gauge pl
    complete_words trajeval evaluate -g tr"""
    how, verbs, options, values, *files = shell(asked, **home).stdout.split("\n")
    assert how.endswith("trajeval")
    assert verbs.split() == ["evaluate", "evaluator"]
    assert options == "--mcap"
    assert values == "planar"
    # Nothing of its own: bash completes names of files by default.
    assert files[:2] == ["-o default", ""]


def test_a_folder_s_sources_are_listed(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    read = read_many([str(pair[1])])[0]
    (tmp_path / "a").mkdir()
    write_bag(tmp_path / "a" / "flight", {"/odom": (read, ODOMETRY)})
    write_mcap(tmp_path / "a" / "other.mcap", {"/vio": (read, ODOMETRY)})
    (tmp_path / "a" / "cut.db3").write_bytes(b"SQLite format 3\0 and no more")
    (tmp_path / "README.txt").write_text("nothing here\n")
    (tmp_path / "image.png").write_bytes(b"1 2 3 4\n")
    (tmp_path / ".hidden").mkdir()
    shutil.copy(pair[0], tmp_path / ".hidden" / "truth.txt")
    deep = tmp_path.joinpath("a", "b", "c", "d", "e")
    deep.mkdir(parents=True)
    shutil.copy(pair[0], deep / "truth.txt")
    result = find_sources(tmp_path)
    assert [str(source.path.relative_to(tmp_path)) for source in result.sources] == [
        "a/cut.db3",
        "a/flight",
        "a/other.mcap",
        "estimate.txt",
        "truth.txt",
    ]
    assert [source.topics for source in result.sources] == [(), ("/odom",), ("/vio",), (), ()]
    assert [source.kind for source in result.sources] == [
        "rosbag2 sqlite3",
        "rosbag2",
        "MCAP",
        "TUM",
        "TUM",
    ]
    assert result.sources[0].problem
    assert result.others == 2
    assert result.left_out == (f"1 folder more than {DEEPEST} levels deep",)
    assert main(["info", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "/odom" in told
    assert "other files: 2" in told
    assert f"skipped: {result.left_out[0]}" in told


@pytest.mark.slow
def test_a_folder_s_list_is_bounded(pair: tuple[Path, Path], tmp_path: Path) -> None:
    folder = tmp_path / "many"
    folder.mkdir()
    for place in range(MOST + 5):
        (folder / f"{place:03}.txt").symlink_to(pair[0])
    result = find_sources(folder)
    assert len(result.sources) == MOST
    assert result.left_out == (f"5 files after the first {MOST} sources",)


def test_a_folder_without_a_source_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "note.md").write_text("1 2 3 4\n")
    assert main(["info", str(tmp_path)]) == 2
    text = capsys.readouterr().err
    assert f"no readable bag or trajectory in {tmp_path} (1 other file)" in text


def test_a_folder_is_no_trajectory(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a directory without a bag"):
        read_many([str(tmp_path)])


@pytest.mark.parametrize("width", [40, 80, 100, 120, 160])
def test_topics_are_never_cut_by_a_terminal(
    width: int, pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = read_many([str(pair[1])])[0]
    bag = tmp_path / "run.mcap"
    write_mcap(bag, {f"/a/long/name/{name}": (read, ODOMETRY) for name in ("odometry", "pose")})
    shown = io.StringIO()
    terminal = Console(shown, width, is_terminal=True)
    monkeypatch.setattr("trajeval_ros.report.console.console", lambda: terminal)
    assert main(["info", str(bag)]) == 0
    text = shown.getvalue()
    assert "…" not in text
    rows = [line for line in text.splitlines() if line.startswith("/a/long/name/")]
    rows = [line for line in rows if ": " not in line]
    assert len(rows) == 2
    assert width < 80 or max(len(line.rstrip()) for line in rows) <= width
    assert ("columns hidden (narrow terminal): last s" in text) == (width < 120)


@pytest.mark.parametrize("width", [40, 60, 80, 100, 120])
def test_numbers_are_never_cut_by_a_terminal(
    width: int, pair: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = io.StringIO()
    terminal = Console(shown, width, is_terminal=True)
    monkeypatch.setattr("trajeval_ros.report.console.console", lambda *_: terminal)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    assert main(["trajectory", str(pair[0]), str(pair[1])]) == 0
    text = shown.getvalue()
    assert "…" not in text
    read = read_many([str(pair[0])])[0]
    row = next(line for line in text.splitlines() if line.split()[:1] == ["truth"])
    assert f"{read.path_length_m:.3f}" in row.split()
    assert width < 60 or len(row.rstrip()) <= width
    assert ("columns hidden (narrow terminal): mean m/s" in text) == (width < 80)
    shown.seek(0)
    shown.truncate()
    assert main(["evaluate", *map(str, pair)]) == 0
    words = {word for line in shown.getvalue().splitlines() for word in line.split()}
    assert {"position", "rotation", "count"} <= words
    assert "…" not in shown.getvalue()


@pytest.mark.parametrize(
    ("typed", "answer"),
    [
        ("evaluate tum a b", "trajeval evaluate GROUNDTRUTH ESTIMATE"),
        ("trajectory kitti a", "trajeval trajectory SOURCE..."),
        ("compare bag a b", "trajeval compare GROUNDTRUTH ESTIMATE..."),
        ("evaluate a b -as", "--gauge se3, or --gauge sim3 for -as"),
        ("trajectory a -p", "--plot xy"),
        ("trajectory a --save_as_tum", "--save-as tum"),
        ("compare a --save_table x", "trajeval compare RESULT... --output DIR"),
        ("evaluate a b --t_offset 1", "--time-offset"),
        ("evaluate a b --n_to_align 1", "--align-states"),
        ("rpe a b --output nowhere", "no verb rpe; use trajeval evaluate"),
        ("traj a --output nowhere", "no verb traj; use trajeval trajectory"),
    ],
)
def test_words_of_evo_are_answered(
    typed: str, answer: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(typed.split()) == 2
    assert answer in capsys.readouterr().err


def test_a_group_without_its_verb_prints_its_verbs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study"]) == 2
    printed = capsys.readouterr()
    assert "association" in printed.out
    assert printed.err == ""


def test_explain_of_one_trajectory_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "vio.txt").write_text("1 0 0 0 0 0 0 1\n")
    assert main(["explain", str(tmp_path / "vio.txt")]) == 2
    assert "the number needs its run" in capsys.readouterr().err
