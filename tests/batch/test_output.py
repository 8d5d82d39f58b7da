"""The folder of a comparison: one writer at a time, and whole again after whatever happened."""

from __future__ import annotations

import ast
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import comparison_runs
import pytest
from comparison_runs import here, write_run, write_runs
from waiting import PATIENCE_S, until

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")

from paths import ROOT

from trajeval_ros.batch import compare_runs, source_hash, worker
from trajeval_ros.batch.compare_runs import LOCK, only_writer
from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.comparison_report import is_drawn
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.finished_comparison import POOLED_FILE, REPORT, RUNS
from trajeval_ros.batch.planned_figures import FigureChoice
from trajeval_ros.batch.results_table import read_pooled
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.bag import Bag

NO_FIGURES = FigureChoice(0)
posix = pytest.mark.skipif(os.name != "posix", reason="there are no locks of files")


def compare(config: Path, *options: str) -> int:
    return comparison_runs.compare(config, *options, output=config.parent / "out")


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files but what is remembered of inputs, which depends on how new they are."""
    files = [path for path in folder.iterdir() if path.is_file() and path.name != "inputs.json"]
    return {file.name: file.read_bytes() for file in files}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    config = write_runs(folder, ["hall"], trials=1)
    assert compare(config, "-q") == 0
    (folder / "out").rename(folder / "kept")
    return config


@pytest.fixture
def config(finished: Path) -> Iterator[Path]:
    """A comparison that was finished, as it was then."""
    out = finished.parent / "out"
    shutil.copytree(finished.parent / "kept", out)
    yield finished
    shutil.rmtree(out)


@posix
def test_a_second_comparison_is_refused_and_names_the_first(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = config.parent / "out"
    with only_writer(out):
        before = contents(out)
        assert compare(config, "-q") == 2
        text = capsys.readouterr().err
        assert contents(out) == before
    assert text == (
        f"trajeval: {out} is in use by process {os.getpid()} on {os.uname().nodename}; wait with "
        "--wait, or choose another --output\n"
    )
    assert not (out / LOCK).exists()


@posix
def test_with_wait_it_comes_after_the_first(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = config.parent / "out"
    (out / "tables.md").unlink()
    held, told = only_writer(out), threading.Event()
    held.__enter__()
    second = threading.Thread(target=lambda: compare(config, "-q", "--wait"))
    lock = compare_runs.lock

    def telling(file: int, *, wait: bool) -> bool:
        if wait:
            told.set()
        return lock(file, wait=wait)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compare_runs, "lock", telling)
        second.start()
        assert told.wait(PATIENCE_S)
        assert not (out / "tables.md").exists()
        held.__exit__(None, None, None)
        second.join()
    assert (out / "tables.md").exists()
    assert f"waiting: {out} is in use by process" in capsys.readouterr().err
    assert not (out / LOCK).exists()


@posix
def test_a_killed_comparison_holds_nothing(config: Path) -> None:
    out = config.parent / "out"
    code = (
        "import sys; from pathlib import Path\n"
        "from trajeval_ros.batch.compare_runs import only_writer\n"
        "from trajeval_ros.io.writing import temporary_file\n"
        "with only_writer(Path(sys.argv[1])):\n"
        "    with temporary_file(Path(sys.argv[1]) / 'runs' / 'a.run'):\n"
        "        print('ready', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(out)],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        with pytest.raises(InputError, match=f"is in use by process {process.pid} on "):
            only_writer(out).__enter__()
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert (out / LOCK).exists()
    assert compare(config, "-q") == 0
    assert not [path for path in out.rglob("*") if path.name.startswith(".")]


def test_what_was_deleted_or_changed_is_written_again(config: Path) -> None:
    out = config.parent / "out"
    whole = contents(out)
    stamps = {name: (out / name).stat().st_mtime_ns for name in whole}
    assert compare(config, "-q") == 0
    assert {name: (out / name).stat().st_mtime_ns for name in whole} == stamps
    tables = [name for name in whole if name.endswith((".md", ".tex", ".csv"))]
    assert len(tables) > 4
    for name in tables[::2]:
        (out / name).unlink()
    for name in tables[1::2]:
        (out / name).write_text("half")
    assert compare(config, "-q") == 0
    assert contents(out) == whole
    for name in (RUNS, POOLED_FILE, REPORT):
        (out / name).unlink()
        assert compare(config, "-q") == 0
        assert contents(out) == whole, name


def test_statistics_of_other_tables_are_not_taken_for_these(tmp_path: Path) -> None:
    # As a kill between the two files leaves them.
    config = write_runs(tmp_path, ["hall"], trials=1)
    out = tmp_path / "out"
    run_plan(plan_of(config, {}), out, here)
    old = (out / POOLED_FILE).read_bytes()
    write_run(tmp_path / "bad" / "hall_trial0.txt", 1.2)
    run_plan(plan_of(config, {}), out, here)
    new = read_pooled(out / POOLED_FILE)
    (out / POOLED_FILE).write_bytes(old)
    assert read_pooled(out / POOLED_FILE) != new
    run_plan(plan_of(config, {}), out, here)
    assert read_pooled(out / POOLED_FILE) == new


def test_a_report_of_other_tables_is_drawn_again_whatever_the_clock_says(config: Path) -> None:
    out = config.parent / "out"
    future = 4 * 10**9
    os.utime(out / REPORT, (future, future))
    assert is_drawn(out, NO_FIGURES)
    run_plan(plan_of(config, {"gauge": "yaw"}), out, here)
    assert not is_drawn(out, NO_FIGURES)
    os.utime(out / REPORT, (0, 0))
    run_plan(plan_of(config, {}), out, here)
    assert is_drawn(out, NO_FIGURES)


def test_verdicts_about_other_tables_do_not_stay(config: Path, tmp_path: Path) -> None:
    out = config.parent / "out"
    baseline = tmp_path / "old.parquet"
    shutil.copy(out / RUNS, baseline)
    gate = ["--baseline", str(baseline), "--fail-if", "ate.position_m.rmse worse than 50 %"]
    gate += ["--undecided", "pass"]
    assert compare(config, "-q", *gate) == 0
    assert compare(config, "-q") == 0
    names = ["gates.json", "gates.md"]
    assert sorted(path.name for path in out.glob("gates.*")) == names
    run_plan(plan_of(config, {"gauge": "yaw"}), out, here)
    assert not list(out.glob("gates.*"))


def test_other_sources_are_other_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = write_runs(tmp_path, ["hall"], trials=1)
    out = tmp_path / "out"
    assert run_plan(plan_of(config, {}), out, here).done == 2
    assert run_plan(plan_of(config, {}), out, here).done == 0
    monkeypatch.setattr(worker, "hash_of_numbers", lambda: "other")
    assert run_plan(plan_of(config, {}), out, here).done == 2


def test_the_hash_is_of_names_and_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "trajeval_ros"
    shutil.copytree(ROOT / "trajeval_ros", package)
    monkeypatch.setattr(source_hash, "_PACKAGE", package)

    def hashes() -> tuple[str, str]:
        numbers, all_ = source_hash.hash_of_numbers, source_hash.hash_of_package
        return numbers.__wrapped__(), all_.__wrapped__()

    first = hashes()
    assert hashes() == first
    (package / "cli" / "app.py").write_text("# another\n")
    drawn = hashes()
    assert drawn[0] == first[0]
    assert drawn[1] != first[1]
    errors = package / "metrics" / "absolute_errors.py"
    errors.write_text(errors.read_text() + "\n")
    changed = hashes()
    assert changed[0] != first[0]
    errors.rename(package / "metrics" / "errors_.py")
    assert len({*first, *drawn, *changed, *hashes()}) == 7


@pytest.mark.slow
def test_all_that_numbers_come_from_is_hashed() -> None:
    package = ROOT / "trajeval_ros"

    def imported(file: Path) -> set[Path]:
        result = set()
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                names = [node.module, *(f"{node.module}.{item.name}" for item in node.names)]
                result |= {ROOT / f"{name.replace('.', '/')}.py" for name in names}
        return {item for item in result if item.is_file()}

    known, new = set[Path](), {package / "batch" / "worker.py"}
    while new:
        known |= new
        new = {item for file in new for item in imported(file)} - known
    assert package / "metrics" / "absolute_errors.py" in known
    assert package / "io" / "text" / "reader.py" in known
    assert known <= set(source_hash.sources_of_numbers())


def test_where_nobody_can_write_a_finished_comparison_is_shown(
    config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = config.parent / "out"
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK and access(path, mode))
    whole = contents(out)
    assert compare(config) == 0
    assert "unchanged" in capsys.readouterr().out
    assert contents(out) == whole


@posix
def test_no_bag_that_was_read_stays_in_the_temporary_folder(
    flights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with Bag(flights / "mcap"):
        [folder] = tmp_path.iterdir()
        assert folder.name.startswith(".bag.trajeval-")
    until(lambda: not list(tmp_path.iterdir()), "it goes with the bag")
