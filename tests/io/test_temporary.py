"""Files that are not finished yet, and those of processes that are gone."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from paths import ROOT
from text_pairs import pair

from trajeval_ros.exceptions import InputError
from trajeval_ros.io import writing
from trajeval_ros.io.writing import collect_leftovers, temporary_file, temporary_folder, write_text

__all__ = ["pair"]  # a fixture
pytestmark = pytest.mark.skipif(os.name != "posix", reason="there are no locks of files")
_WRITER = """
import sys
from pathlib import Path
from trajeval_ros.io.writing import temporary_file, temporary_folder
folder = Path(sys.argv[1])
with temporary_file(folder / "result.json") as file, temporary_folder("out", folder) as other:
    file.write_text("half")
    (other / "errors.npz").write_text("half")
    print("ready", flush=True)
    sys.stdin.read()
"""


@contextmanager
def another_process_writes(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Have another process write a file and a folder, and not come to an end."""
    with subprocess.Popen(
        [sys.executable, "-c", _WRITER, str(folder)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_what_is_being_written_stays_and_what_was_killed_goes(tmp_path: Path) -> None:
    with another_process_writes(tmp_path) as process:
        begun = names(tmp_path)
        assert [item.rpartition("-")[0] for item in begun] == [
            ".out.trajeval",
            ".result.json.trajeval",
        ]
        collect_leftovers(tmp_path)
        assert names(tmp_path) == begun
        process.kill()
        process.wait()
        assert names(tmp_path) == begun
    collect_leftovers(tmp_path)
    assert not names(tmp_path)


def test_writing_collects_what_was_left_beside(tmp_path: Path) -> None:
    with another_process_writes(tmp_path) as process:
        process.kill()
        process.wait()
    write_text(tmp_path / "table.csv", "1")
    assert names(tmp_path) == ["table.csv"]


def test_nothing_else_is_ever_collected(tmp_path: Path) -> None:
    kept = [
        ".result.json.trajeval-0123456",
        ".trajeval-01234567",
        "out.trajeval-01234567",
        ".out.trajeval-01234567.txt",
        ".out-abcdefgh",
    ]
    for name in kept:
        (tmp_path / name).mkdir()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "file").touch()
    link = tmp_path / ".link.trajeval-01234567"
    link.symlink_to(elsewhere)
    collect_leftovers(tmp_path)
    assert names(tmp_path) == sorted([*kept, "elsewhere", link.name])
    assert names(elsewhere) == ["file"]


def test_a_folder_taken_for_left_over_before_it_was_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lock = writing.lock
    taken = []

    def another_is_faster(file: int, *, wait: bool) -> bool:
        if wait and not taken:
            [path] = tmp_path.iterdir()
            taken.append(path.name)
            path.rmdir()
        return lock(file, wait=wait)

    monkeypatch.setattr(writing, "lock", another_is_faster)
    with temporary_folder("out", tmp_path) as folder:
        assert folder.is_dir()
        assert folder.name not in taken
    assert not names(tmp_path)


def test_a_disk_without_locks_is_written_to_and_nothing_is_collected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(*_: object, **__: object) -> bool:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(writing, "lock", unknown)
    left = tmp_path / ".table.csv.trajeval-01234567"
    left.touch()
    write_text(tmp_path / "table.csv", "1")
    collect_leftovers(tmp_path)
    assert names(tmp_path) == [left.name, "table.csv"]


def test_a_file_has_the_rights_that_a_user_gives_to_files(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "table.csv", "1")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "table.csv").stat().st_mode) == 0o640


def test_a_folder_that_can_not_be_written_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none/table\.csv can't be written: no such file"):
        write_text(tmp_path / "none" / "table.csv", "1")
    with pytest.raises(FileNotFoundError), temporary_file(tmp_path / "none" / "table.csv"):
        pass


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="there is no /proc")
def test_a_folder_that_nobody_can_write_is_one_error() -> None:
    with pytest.raises(FileNotFoundError), temporary_folder("x", Path("/proc")):
        pass


@pytest.mark.slow
def test_a_killed_evaluation_leaves_nothing_after_the_next(
    pair: list[str], tmp_path: Path
) -> None:
    # It stops where it draws, and is killed there.
    (tmp_path / "sitecustomize.py").write_text(
        "import os, sys\n"
        "class Stop:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'matplotlib.figure':\n"
        "            print('drawing', flush=True)\n"
        "            sys.stdin.read()\n"
        "sys.meta_path.insert(0, Stop())\n"
    )
    out = tmp_path / "results" / "out"
    command = [sys.executable, "-m", "trajeval_ros", *pair, "--quiet", "--output", str(out)]
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    with subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "drawing\n"
        process.send_signal(signal.SIGKILL)
        process.wait()
    [left] = out.parent.iterdir()
    assert left.name.startswith(".out.trajeval-")
    out.mkdir()  # as a kill between the last two steps leaves it
    environment["PYTHONPATH"] = str(ROOT)
    subprocess.run(command, env=environment, check=True)
    assert names(out.parent) == ["out"]
    assert not [name for name in names(out) if name.startswith(".")]


def test_a_folder_that_is_removed_before_it_is_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Path] = []

    def make(path: Path) -> int:
        made.append(path)
        if len(made) == 1:  # as if another process had removed it
            raise FileNotFoundError(2, "No such file or directory", str(path))
        path.mkdir()
        return os.open(path, os.O_RDONLY)

    monkeypatch.setattr(writing, "_make_folder", make)
    with temporary_folder("x", tmp_path) as folder:
        assert folder.is_dir()
        assert folder == made[1]
    with pytest.raises(FileNotFoundError), temporary_folder("x", tmp_path / "missing"):
        pass
