"""What `diagnose` prints of every mistake: the sentences, and the numbers of all tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from kept_runs import assert_prints


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
    typed = f"diagnose -g truth.txt -e {name}.txt --gauge yaw"
    assert_prints(f"diagnose_{name}", typed, kept_runs, tmp_path, capsys)
