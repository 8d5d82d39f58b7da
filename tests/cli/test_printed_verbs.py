"""What the verbs print about recordings: every line, as it was kept."""

from __future__ import annotations

from pathlib import Path

import pytest
from kept_runs import assert_prints

SLOW = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "typed"),
    [
        ("info_bag", "info run"),
        ("info_vi", "info vi"),
        ("info_drive", "info drive"),
        ("info_file", "info sparse.txt"),
        ("simulate", "simulate new --duration 10 --marker --fault jump"),
        ("simulate_runs", "simulate new --duration 6 --runs 2 --profile stereo"),
        ("trajectory", "trajectory a.txt b.txt --reference truth.txt --gauge yaw --synchronise"),
        ("merge", "trajectory a.txt d.txt --merge --rate 5 --save-as euroc --output out"),
        ("project", "trajectory a.txt --project xy --motion-filter 0.5,10 --save-as rosbag2 "
         "--output out"),
        ("edited", "trajectory a.txt --axes=-y,x,z --scale 2 --clock-rate 50 --inverse poses "
         "--save-as kitti --output out"),
        ("explain", "explain --run truth.txt a.txt 0.1173"),
        ("explain_none", "explain --run truth.txt a.txt 0.0428"),
        ("watch", "watch run:/vio/odometry --imu run:/imu"),
        ("watch_jump", "watch fault:/vio/odometry --with fault:/groundtruth/pose --json -"),
        ("watch_alarms", "watch fault:/vio/odometry --with fault:/groundtruth/pose"),
        ("groundtruth", "groundtruth run:/groundtruth/pose --save-as tum --output out"),
        ("groundtruth_worn", "groundtruth worn.txt"),
        pytest.param("groundtruth_imu", "groundtruth worn.txt --imu run:/imu --save-as tum "
            "--output out", marks=SLOW),
        ("association", "study association -g truth.txt -e a.txt"),
    ],
)  # fmt: skip
def test_verbs_print_what_they_printed(
    name: str, typed: str, kept_runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_prints(f"verb_{name}", typed, kept_runs, tmp_path, capsys)
