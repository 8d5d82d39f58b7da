"""What `evaluate --diagnosis` prints of every mistake: sentences, and the numbers of all tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from kept import assert_kept
from kept_runs import printed


@pytest.mark.parametrize(
    "name",
    [
        "a", "copy", "late", "fast_clock", "scaled", "millimetres", "w_first", "inverted",
        "mirrored", "optical", "level", "frozen", "diverged", "restarted", "lever", "tilted",
        "sparse", "rounded", "twisted", "other",
    ],
)  # fmt: skip
def test_diagnosis_prints_what_it_printed(
    name: str, kept_runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    typed = f"evaluate -g truth.txt -e {name}.txt --gauge yaw --diagnosis"
    before, _, tests = printed(typed, kept_runs, tmp_path, capsys).partition("\n\n" + name + ": t")
    lines = before.splitlines()
    kept = [*lines[:2], *(line.strip() for line in lines if line.startswith("  diagnosis: "))]
    assert_kept(f"diagnosis_{name}", "\n".join([*kept, f"t{tests}"]))
