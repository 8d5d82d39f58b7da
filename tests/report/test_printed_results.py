"""What evaluations print: every line of every table and remark, as it was kept."""

from __future__ import annotations

from pathlib import Path

import pytest
from kept_runs import assert_prints

FLIGHT = "evaluate -g run:/groundtruth/pose -e run:/vio/odometry"
VI = "evaluate vi:/groundtruth/pose vi:/vio/odometry"


@pytest.mark.parametrize(
    ("name", "typed"),
    [
        ("one", "evaluate truth.txt a.txt"),
        ("two", "evaluate truth.txt a.txt d.txt --gauge yaw --lengths 4,8%,100f,5s"),
        ("scale", "evaluate truth.txt scaled.txt --gauge sim3 --align-states 50"),
        ("late", "evaluate truth.txt late.txt --time-offset auto"),
        ("corrected", "evaluate truth.txt w_first.txt --correct suggested"),
        ("protocol", "evaluate truth.txt a.txt --protocol rpg"),
        ("lever", "evaluate truth.txt lever.txt --hand-eye auto --gauge yaw"),
        ("wrong_lever", "evaluate truth.txt a.txt --hand-eye lever.yaml --gauge yaw"),
        ("required", "evaluate truth.txt a.txt --require ate.position_m.rmse<0.01"),
        ("few", "evaluate truth.txt sparse.txt"),
        ("fixes", "evaluate -g drive:/fix -e drive:/vio/odometry --fix-correlation 5"),
        ("consistency", f"{VI} --covariance message --alert-limit 0.5,5 --risk 0.05"),
        ("joint", f"{VI} --covariance vi.npz --groundtruth-noise 0.01,0.1"),
        ("available", f"{FLIGHT} --as-available twist --deadline 0.1"),
        ("json", "evaluate truth.txt d.txt --gauge yaw --lengths 4,8%,100f,5s --json -"),
        ("json_fixes", "evaluate -g drive:/fix -e drive:/vio/odometry --json -"),
        ("json_vi", f"{VI} --covariance message --alert-limit 0.5,5 --as-available hold --json -"),
        ("likelihood", f"{FLIGHT} --association continuous --groundtruth-noise 0.01,0.2"),
    ],
)
def test_results_are_printed_as_they_were(
    name: str, typed: str, kept_runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_prints(f"evaluate_{name}", typed, kept_runs, tmp_path, capsys)
