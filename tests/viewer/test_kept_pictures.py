"""What files for Rerun contain: rows, texts, colours and sizes of entities, as they were kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from kept import assert_kept
from kept_runs import printed

pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
from rrd import Rrd, described_layout

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.viewer.blueprint import blueprint
from trajeval_ros.viewer.scene_entities import EstimateEntities

VI = "evaluate vi:/groundtruth/pose vi:/vio/odometry --covariance message"


@pytest.mark.parametrize(
    ("name", "typed"),
    [
        ("one", "evaluate truth.txt a.txt"),
        ("two", "evaluate truth.txt a.txt d.txt --gauge yaw"),
        ("fixes", "evaluate -g drive:/fix -e drive:/vio/odometry"),
        ("consistency", f"{VI} --alert-limit 0.5,5 --as-available hold"),
        ("watch", "watch fault:/vio/odometry --with fault:/groundtruth/pose"),
        pytest.param(
            "groundtruth",
            "groundtruth run:/groundtruth/pose --imu run:/imu",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_pictures_show_what_they_showed(
    name: str, typed: str, kept_runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = printed(f"{typed} --rrd out.rrd", kept_runs, tmp_path, capsys)
    assert "status 0" in text
    assert_kept(f"picture_{name}", Rrd(tmp_path / "out.rrd").described())


def test_layouts_are_what_they_were() -> None:
    bounds = np.array([-3.0, -2.0, 0.0]), np.array([5.0, 9.0, 2.5])
    rotations_deg = np.append(np.linspace(0.4, 0.6, 99), 60.0)
    parts = []
    for count, is_live, has_more in ((1, False, False), (2, True, False), (4, False, True)):
        estimates = [EstimateEntities(f"vio{place}", place) for place in range(count)]
        more = dict.fromkeys(("has_consistency", "has_available", "has_map"), has_more)
        gauge = Gauge.SIM3 if has_more else Gauge.YAW
        made = blueprint(
            estimates, gauge, is_live=is_live, bounds=bounds, rotations_deg=rotations_deg, **more
        )
        parts.append(described_layout(made.root_container))
    assert_kept("layouts", "\n".join(parts))
