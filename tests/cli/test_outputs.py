"""Where `trajeval` writes to, and who reads it: pipes, devices, links, inputs, old figures."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from comparison_runs import compare, write_run, write_runs
from paths import ROOT
from text_pairs import pair, refused, write_tum

from trajeval_ros.cli.app import main
from trajeval_ros.io.writing import write_text

__all__ = ["pair"]  # a fixture
needs_pipes = pytest.mark.skipif(os.name != "posix", reason="there are no named pipes")


@pytest.mark.slow
@needs_pipes
@pytest.mark.parametrize(
    ("more", "status"),
    [
        ([], 0),
        (["--require", "ate.position_m.rmse < 1"], 0),
        (["--require", "ate.position_m.rmse < 1e-9"], 1),
        (["--json", "-"], 0),
        (["--help"], 0),
    ],
)
def test_who_reads_the_head_alone_gets_the_right_status(
    more: list[str], status: int, pair: list[str]
) -> None:
    command = [sys.executable, "-m", "trajeval_ros", *pair, *more]
    reading, writing = os.pipe()
    os.close(reading)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, stdout=writing, stderr=subprocess.PIPE, env=environment, check=False, text=True
    )
    os.close(writing)
    assert done.returncode == status
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@needs_pipes
@pytest.mark.parametrize("stdout_as_well", [False, True])
@pytest.mark.parametrize(
    ("more", "status"),
    [(["--require", "ate.position_m.rmse < 1e-9"], 1), (["--gauge", "none of these"], 2)],
)
def test_who_reads_the_head_of_errors_gets_the_right_status(
    more: list[str], status: int, pair: list[str], *, stdout_as_well: bool
) -> None:
    command = [sys.executable, "-m", "trajeval_ros", *pair, *more]
    reading, writing = os.pipe()
    os.close(reading)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    stdout = writing if stdout_as_well else subprocess.PIPE
    done = subprocess.run(command, stdout=stdout, stderr=writing, env=environment, check=False)
    os.close(writing)
    assert done.returncode == status
    if not stdout_as_well:
        assert (b"rmse" in done.stdout) == (status == 1)


@needs_pipes
def test_output_may_be_closed(pair: list[str], tmp_path: Path) -> None:
    result = tmp_path / "result.json"
    command = [sys.executable, "-m", "trajeval_ros", *pair, "--json", str(result)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["/bin/sh", "-c", 'exec "$@" >&-', "sh", *command],
        env=environment,
        check=False,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(result.read_text())["runs"]


@needs_pipes
def test_a_pipe_is_written_to_and_a_link_stays_one(pair: list[str], tmp_path: Path) -> None:
    plain, pipe, link = (tmp_path / name for name in ("plain.json", "pipe", "link.json"))
    assert main([*pair, "-q", "--json", str(plain)]) == 0
    os.mkfifo(pipe)
    heard: list[str] = []
    reader = threading.Thread(target=lambda: heard.append(pipe.read_text()))
    reader.start()
    assert main([*pair, "-q", "--json", str(pipe)]) == 0
    reader.join()
    assert pipe.is_fifo()
    link.symlink_to("target.json")
    assert main([*pair, "-q", "--json", str(link)]) == 0
    assert link.is_symlink()
    assert heard == [plain.read_text()] == [(tmp_path / "target.json").read_text()]
    assert not list(tmp_path.glob("*.part"))


def made_links(folder: Path, made: Path, victims: Path) -> dict[Path, Path]:
    """Make a folder with links out of it, called as files that were made; return what to."""
    folder.mkdir()
    victims.mkdir()
    links = {}
    for file in made.iterdir():
        if file.is_file():
            links[folder / file.name] = victims / file.name
            (victims / file.name).write_text("mine")
            (folder / file.name).symlink_to(victims / file.name)
    return links


def assert_not_followed(links: dict[Path, Path]) -> None:
    assert links
    for link, victim in links.items():
        assert not link.is_symlink(), link
        assert link.stat().st_size > 0
        assert victim.read_text() == "mine"


@pytest.mark.slow
def test_links_in_a_folder_of_results_are_not_followed(pair: list[str], tmp_path: Path) -> None:
    assert main([*pair, "-q", "--output", str(tmp_path / "made")]) == 0
    links = made_links(tmp_path / "out", tmp_path / "made", tmp_path / "mine")
    assert main([*pair, "-q", "--output", str(tmp_path / "out")]) == 0
    assert_not_followed(links)


@pytest.mark.slow
def test_links_in_the_folder_of_a_comparison_are_not_followed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for package in ("pyarrow", "jinja2", "matplotlib"):
        pytest.importorskip(package, reason=f"{package} is missing, the extra `compare`")
    config = write_runs(tmp_path / "runs", ["hall"], ["good"], 1)
    made, out = tmp_path / "made", tmp_path / "out"
    assert compare(config, "-q", output=made) == 0
    links = made_links(out, made, tmp_path / "mine")
    assert {"runs.parquet", "report.html", "tables.md"} < {link.name for link in links}
    gate = [
        "--baseline",
        str(made / "runs.parquet"),
        "--fail-if",
        "ate.position_m.rmse worse than 5 %",
        "--undecided",
        "pass",
    ]
    assert compare(config, "-q", *gate, output=out) == 0
    assert_not_followed(links)
    elsewhere = tmp_path / "elsewhere"
    (out / "runs").rename(elsewhere)
    (out / "runs").symlink_to(elsewhere)
    assert compare(config, "-q", output=out) == 2
    text = capsys.readouterr().err
    assert f"{out}/runs is a symbolic link; remove it" in text


@pytest.mark.parametrize("name", ["figures", "report"])
def test_a_link_in_place_of_a_folder_of_a_comparison_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for package in ("pyarrow", "jinja2", "matplotlib"):
        pytest.importorskip(package, reason=f"{package} is missing, the extra `compare`")
    config = write_runs(tmp_path / "runs", ["hall"], ["good"], 1)
    mine, out = tmp_path / "mine", tmp_path / "out"
    mine.mkdir()
    out.mkdir()
    for item in ("runs_2023.html", "errors_s0.pdf"):
        (mine / item).write_text("mine")
    (out / name).symlink_to(mine)
    assert main(["compare", str(config), "-q", "--output", str(out)]) == 2
    assert f"{out / name} is a symbolic link; remove it" in capsys.readouterr().err
    assert {path.name: path.read_text() for path in mine.iterdir()} == {
        "runs_2023.html": "mine",
        "errors_s0.pdf": "mine",
    }


@pytest.mark.parametrize(
    "name",
    [
        *("README.txt", "tables.md", "report.html", "ate_position_m.csv", "result.json"),
        *("re_position_percent.csv", "figures", "report"),
    ],
)
def test_a_comparison_replaces_only_results_of_a_comparison(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    config = write_runs(tmp_path / "runs", ["hall"], ["good"], 1)
    path = tmp_path / "out" / name
    if "." in name:
        path.parent.mkdir()
        path.write_text("mine")
    else:
        path.mkdir(parents=True)
        (path / "runs_1.html").write_text("mine")
    assert main(["compare", str(config), "-q", "--output", str(path.parent)]) == 2
    text = capsys.readouterr().err
    assert f"{path} is not from a comparison, which replaces it; choose another --output" in text
    assert [item.name for item in path.parent.iterdir()] == [name]


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(
    "name", ["result.json", "errors.npz", "errors.parquet", "absolute_error.png"]
)
def test_an_evaluation_replaces_only_results_of_an_evaluation(
    name: str, pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text('{"mine": 1}')
    (tmp_path / "run.rrd").write_text("mine")
    assert main([*pair, "-q", "--output", str(tmp_path)]) == 2
    assert f"{name} is not from an evaluation, which replaces it" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == '{"mine": 1}'
    (tmp_path / name).unlink()
    assert main([*pair, "-q", "--output", str(tmp_path)]) == 0
    assert (tmp_path / "run.rrd").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_an_evaluation_replaces_what_an_interrupted_one_has_left(
    pair: list[str], tmp_path: Path
) -> None:
    assert main([*pair, "-q", "--output", str(tmp_path)]) == 0
    (tmp_path / "result.json").unlink()
    assert main([*pair, "-q", "--output", str(tmp_path)]) == 0
    assert (tmp_path / "result.json").exists()


def test_a_link_to_a_folder_or_a_device_is_replaced(tmp_path: Path) -> None:
    for number, target in enumerate((tmp_path, os.devnull, "nowhere")):
        link = tmp_path / str(number)
        link.symlink_to(target)
        write_text(link, "x")
        assert not link.is_symlink()
        assert link.read_text() == "x"
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("option", ["--json", "--rrd", "--output"])
def test_an_input_is_never_written_over(
    option: str, pair: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    if option == "--rrd":
        pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    for source in (pair[2], pair[4]):
        before = Path(source).read_bytes()
        assert "is also an input" in refused([*pair, option, source], capsys)
        assert Path(source).read_bytes() == before


def test_a_folder_is_no_file(
    pair: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "can't be written: is a directory; give a file" in refused(
        [*pair, "-q", "--json", str(tmp_path)], capsys
    )


@pytest.mark.parametrize("words", ["evaluate a b --output", "compare a b --output", "view"])
def test_results_are_on_this_machine(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = refused([*words.split(), "s3://secret@bucket/out"], capsys)
    assert "this is a URL; give a path of this machine" in text
    assert "secret" not in text


@pytest.mark.slow
def test_figures_of_another_evaluation_do_not_stay(pair: list[str], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `plot`")
    out = tmp_path / "out"
    more = ["--association", "continuous", "--groundtruth-noise", "0.01,1"]
    assert main([*pair, *more, "--output", str(out), "-q"]) == 0
    mine = out / "my_own.png"
    mine.touch()
    before = {path.name for path in out.iterdir()}
    assert main([*pair, "--lengths", "none", "--output", str(out), "-q"]) == 0
    gone = before - {path.name for path in out.iterdir()}
    assert gone >= {"relative_error.png", "groundtruth_uncertainty.png", "mahalanobis.png"}
    assert mine.exists()
    assert (out / "absolute_error.png").exists()


@needs_pipes
def test_sources_must_be_files_or_pipes(
    pair: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert "device" in refused([*pair[:4], "/dev/zero"], capsys)
    assert "a source is empty" in refused([*pair[:4], ""], capsys)


def test_options_that_would_do_nothing_are_refused(
    pair: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    text = refused([*pair, "--max-time-difference", "0.01"], capsys)
    assert "association auto interpolates and has no max time difference" in text
    more = ["--max-time-difference", "0.01", "--association", "nearest"]
    assert main([*pair, *more, "-q"]) == 0


@pytest.mark.slow
def test_names_in_any_letters_are_drawn_without_complaint(
    pair: list[str], tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `plot`")
    named = write_tum(tmp_path / "轨迹 $x_1$.txt", scale=1.01)
    assert main([*pair[:4], str(named), "--output", str(tmp_path / "out"), "-q"]) == 0
    assert [str(item.message) for item in recwarn] == []


def test_a_flight_of_years_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more, longest_s in (([], 86400), (["--profile", "euroc"], 1800)):
        command = ["simulate", str(tmp_path / "bag"), "--duration", "1e9", *more]
        assert f"takes 5 to {longest_s} s" in refused(command, capsys)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse such names")
def test_a_file_name_that_is_not_utf_8_has_results(tmp_path: Path) -> None:
    groundtruth = write_run(tmp_path / "g.txt")
    estimate = tmp_path / os.fsdecode(b"e\xff.txt")
    shutil.copy(groundtruth, estimate)
    output = tmp_path / "output"
    given = [str(groundtruth), str(estimate), "--lengths", "none", "--quiet"]
    assert main(["evaluate", *given, "--output", str(output)]) == 0
    content = json.loads((output / "result.json").read_bytes())
    assert content["runs"][0]["estimate"]["name"] == r"e\udcff"
    assert r"e\udcff.position_m" in np.load(output / "errors.npz").files
