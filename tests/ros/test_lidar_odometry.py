"""`make demo-real` in lockstep: the odometry over DDS is that of one process."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from halls import distances
from paths import ROOT

from trajeval_ros.io.sources import read_trajectory

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytest.importorskip("rerun", reason="rerun-sdk is missing; `make test-ros` has it")

from rrd import Rrd

from examples.lidar_odometry import demo
from examples.lidar_odometry.odometry import in_one_process
from examples.lidar_odometry.sensor import GROUNDTRUTH_TOPIC, sweeps_in
from examples.lidar_odometry.world import Flight

pytestmark = pytest.mark.ros

OWN = str(ROOT / "examples" / "own_estimator" / "icp.py")
SECONDS = 6.0


@pytest.mark.parametrize("estimator", ["small_gicp", OWN], ids=["small_gicp", "own"])
def test_live_odometry_is_that_of_one_process(
    estimator: str,
    environment: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if not demo.is_there(estimator):
        pytest.skip(f"{estimator} is missing; `make demo-real` has it")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    folder = tmp_path / "output"
    # It fails if a scan is unanswered, or live and recorded results differ by more than 1e-9.
    demo.run(folder, [estimator], SECONDS, is_real_time=False)
    topic, flight = demo.topic_of(estimator), Flight()
    live = read_trajectory(f"{folder / 'bag'}:{topic}")
    expected = in_one_process(estimator, sweeps_in(SECONDS), flight)
    assert (live.stamps == expected.stamps).all()
    assert np.abs(live.positions - expected.positions).max() < 1e-8
    # A stamp of the groundtruth is that of the flight, and it covers the last pose.
    groundtruth = read_trajectory(f"{folder / 'bag'}:{GROUNDTRUTH_TOPIC}")
    assert np.isin(groundtruth.stamps, flight.groundtruth.stamps).all()
    [run] = json.loads((folder / "live" / "result.json").read_text())["runs"]
    assert run["association"]["pairs"] == sweeps_in(SECONDS)
    # Scans in the picture are where the hall is.
    picture, name = Rrd(folder / "live" / "run.rrd"), run["estimate"]["name"]
    stamps, scans = picture.rows(f"world/estimate/{name}/points", "Points3D:positions")
    assert len(scans) == len(set(stamps // 500_000_000)) > SECONDS
    similarity = picture.transforms(f"world/estimate/{name}")[1][-1]
    (origin,) = picture.rows("__properties/origin", "groundtruth_m")[1]
    for scan in scans[2:]:  # the velocity of the first one is not known yet
        there = scan @ (similarity[2] * similarity[0]).T + similarity[1] + origin
        assert np.median(distances(flight.hall, there)) < 0.1
