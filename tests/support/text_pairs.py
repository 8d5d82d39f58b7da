"""Pairs of text files for the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trajeval_ros.cli.app import main

START = 1_700_000_000.0


def write_tum(
    path: Path, *, count: int = 400, rate: float = 20.0, start: float = START, scale: float = 1.0
) -> Path:
    """Write a loop of 40 m with a slowly turning body; `scale` makes an estimate of it."""
    time = np.arange(count) / rate
    rotation = 2.0 * np.pi * time / time[-1]
    columns = [
        start + time,
        6.0 * scale * np.cos(rotation),
        6.0 * scale * np.sin(rotation),
        scale * np.sin(3.0 * rotation),
        np.zeros(count),
        np.zeros(count),
        np.sin(rotation / 2.0),
        np.cos(rotation / 2.0),
    ]
    np.savetxt(path, np.column_stack(columns), fmt="%.9f")
    return path


@pytest.fixture
def pair(tmp_path: Path) -> list[str]:
    groundtruth = write_tum(tmp_path / "groundtruth.txt", count=4000, rate=200.0)
    estimate = write_tum(tmp_path / "estimate.txt", scale=1.01)
    return ["evaluate", "-g", str(groundtruth), "-e", str(estimate)]


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that must fail with status 2 and one line on stderr; return that line."""
    status = main(arguments)
    captured = capsys.readouterr()
    assert status == 2
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("trajeval: ")
    assert "Traceback" not in captured.err
    return lines[0]
