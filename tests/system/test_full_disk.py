"""A disk that is full, at every writer: one sentence, and what was there before is still there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from comparison_runs import write_runs
from live_runs import Live, messages
from paths import ROOT
from ros_bags import ODOM
from small_disk import mounted
from text_pairs import pair

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.npz_file import write_arrays
from trajeval_ros.io.writing import write_whole

__all__ = ["pair"]  # a fixture
FULL = "can't be written: no space left on device\n"


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    with mounted(tmp_path / "disk", "80k") as folder:
        yield folder


def refused(command: list[str]) -> str:
    """Return the one line that a command says which fails."""
    done = subprocess.run(
        [sys.executable, "-m", "trajeval_ros", *command],
        env={**os.environ, "PYTHONPATH": str(ROOT), "CI": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    text = done.stderr.splitlines(keepends=True)
    assert len([line for line in text if not line.startswith("note: ")]) == 1, done.stderr
    return text[-1]


def fill(disk: Path, left: int) -> None:
    """Leave a number of bytes of a disk free."""
    (disk / "filling").write_bytes(bytes(shutil.disk_usage(disk).free - left))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
def test_an_archive_that_does_not_fit_says_nothing_of_zip_files(
    disk: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    import gc

    import numpy as np

    numbers = np.random.default_rng(1).normal(size=50_000)
    with pytest.raises(InputError, match="no space left on device"):
        write_whole(disk / "errors.npz", lambda file: write_arrays(file, {"numbers": numbers}))
    gc.collect()
    assert capfd.readouterr() == ("", "")
    assert not names(disk)


@pytest.mark.slow
@pytest.mark.parametrize("left", [0, 4096, 32768])
def test_an_evaluation_and_its_files(pair: list[str], disk: Path, left: int) -> None:
    (disk / "result.json").write_text("before")
    fill(disk, left)
    before = names(disk)
    out = disk / "out"
    assert (
        refused([*pair, "--quiet", "--output", str(out)]) == f"trajeval: the folder {out} {FULL}"
    )
    assert names(disk) == before
    if not left:
        file = str(disk / "result.json")
        assert refused([*pair, "-q", "--json", file]) == f"trajeval: {file} {FULL}"
        assert (disk / "result.json").read_text() == "before"


@pytest.mark.slow
def test_a_picture_for_rerun(pair: list[str], disk: Path) -> None:
    pytest.importorskip("rerun")
    file = str(disk / "run.rrd")
    assert refused([*pair, "--quiet", "--rrd", file]) == f"trajeval: {file} {FULL}"
    assert not names(disk)


@pytest.mark.slow
def test_a_live_run(disk: Path) -> None:
    run = disk / "run"
    live = Live(run, ODOM)
    live.feed(messages(9))
    live.end()
    fill(disk, 4096)
    text = refused(["finish", str(run), "--output", str(run), "--quiet"])
    assert text == f"trajeval: the folder {run} {FULL}"
    assert names(run) == ["groundtruth.states", "vio.states"]


@pytest.mark.slow
def test_a_simulation_and_a_comparison(disk: Path, tmp_path: Path) -> None:
    bag = disk / "flight"
    text = refused(["simulate", str(bag), "--duration", "20"])
    assert text.lower() == f"trajeval: {bag} {FULL}"
    assert not names(disk)
    out = disk / "out"
    config = str(write_runs(tmp_path / "runs"))
    text = refused(["compare", config, "--workers", "1", "--quiet", "--output", str(out)])
    assert text.startswith(f"trajeval: {out}/")
    assert text.endswith(FULL)
    assert not [path for path in out.rglob("*") if path.name.startswith(".")]
