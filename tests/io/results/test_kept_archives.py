"""What files of errors contain: shapes and bounds of all columns, as they were kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from kept import assert_kept, shortened
from kept_runs import printed
from recorded_errors import read_recording

from trajeval_ros.cli import evaluation_folder
from trajeval_ros.io.results.error_archive import ARCHIVE, TABLE

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is missing")

FLIGHT = "evaluate -g run:/groundtruth/pose -e run:/vio/odometry"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "typed"),
    [
        ("two", "evaluate truth.txt a.txt d.txt --gauge yaw --lengths 4,8%"),
        ("available", f"{FLIGHT} --as-available twist"),
        ("likelihood", f"{FLIGHT} --association continuous --groundtruth-noise 0.01,0.2"),
        ("vi", "evaluate vi:/groundtruth/pose vi:/vio/odometry --covariance message"),
        ("fixes", "evaluate -g drive:/fix -e drive:/vio/odometry"),
    ],
)
def test_files_of_errors_contain_what_they_did(
    name: str,
    typed: str,
    kept_runs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(evaluation_folder, "_HAVE_FIGURES", False)
    typed = f"{typed} --quiet --output out --mcap out.mcap"
    assert "status 0" in printed(typed, kept_runs, tmp_path, capsys)
    lines = []
    with np.load(tmp_path / "out" / ARCHIVE) as archive:
        lines += [f"{key} {item.dtype} {shortened(item)}" for key, item in archive.items()]
    table = parquet.read_table(tmp_path / "out" / TABLE)
    lines += [f"{item.name} {item.type} {table[item.name].null_count}" for item in table.schema]
    for topic, read in read_recording(tmp_path / "out.mcap").items():
        times = shortened((np.array(read.times) - 1_700_000_000 * 10**9) / 1e9)
        lines.append(f"{topic} {read.type} {len(read.times)} {times}")
        first = read.messages[0] if read.messages else None
        if hasattr(first, "vector"):
            lines.append(f"  {shortened(read.vectors)}")
        elif hasattr(first, "data") and not isinstance(first.data, str):
            lines.append(f"  {shortened(read.numbers)}")
    assert_kept(f"archive_{name}", "\n".join(lines) + "\n")
