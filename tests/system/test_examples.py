"""Programs in examples: the simulated lidar, and an estimator of one's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from halls import distances
from paths import ROOT
from scipy.spatial.transform import Rotation

from examples.lidar_odometry import demo
from examples.lidar_odometry.odometry import in_one_process, undistorted
from examples.lidar_odometry.world import PERIOD_S, RANGE_SIGMA_M, Flight, Hall
from trajeval_ros import Protocol, evaluate
from trajeval_ros.exceptions import InputError

OWN = ROOT / "examples" / "own_estimator" / "icp.py"


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight()


def test_ranges_in_a_hall_are_those_of_geometry() -> None:
    low = np.array([[2.0, -1, -1], [-5, -5, -5]])
    hall = Hall(low, np.array([[3.0, 1, 1], [5, 5, 5]]))
    slanted = np.array([1.0, 1, 0]) / np.sqrt(2.0)
    rays = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, 1], slanted])
    outcome = hall.ranges(np.zeros((4, 3)), rays)
    np.testing.assert_allclose(outcome, [2.0, 5.0, 5.0, 5.0 * np.sqrt(2.0)], rtol=1e-6)
    # From behind the box, it is not seen.
    assert hall.ranges(np.array([[4.0, 0, 0]]), rays[:1]) == pytest.approx([1.0])


def test_the_path_is_clear_of_boxes(flight: Flight) -> None:
    hall, path = flight.hall, flight.groundtruth.positions[::50]
    outside = np.maximum(hall.low[:-1] - path[:, None], path[:, None] - hall.high[:-1])
    assert np.linalg.norm(outside.clip(min=0.0), axis=2).min() > 0.5


def test_a_sweep_is_distorted_by_the_motion_and_repeatable(flight: Flight) -> None:
    stamp, points, after = flight.sweep(20)
    again = flight.sweep(20)
    assert stamp == again[0]
    assert (points == again[1]).all()
    assert after.max() < PERIOD_S
    # The true motion undoes the distortion: the points are on the surfaces of the hall.
    poses = [pose_at(flight, stamp), pose_at(flight, stamp + round(PERIOD_S * 1e9))]
    step = np.linalg.inv(poses[0]) @ poses[1]
    still = moved(undistorted(points, after, step), poses[1])
    undone, rough = (
        float(np.percentile(distances(flight.hall, item), 90))
        for item in (still, moved(points, poses[1]))
    )
    assert undone < 3.0 * RANGE_SIGMA_M
    assert rough > 3.0 * undone


@pytest.mark.slow
def test_own_estimator_is_short_and_accurate(flight: Flight) -> None:
    assert len(OWN.read_text().splitlines()) <= 80
    odometry = in_one_process(str(OWN), 20, flight)
    protocol = Protocol(modality="lidar", lengths=(1,))
    ate = evaluate(flight.groundtruth, odometry, protocol).ate["position_m"]
    assert ate is not None
    assert ate.count == 20
    assert ate.rmse < 0.05


def result(ate_m: float, name: str = "small_gicp") -> dict:
    parts = {"ate": {"position_m": {"rmse": ate_m}}, "re": {}, "alignment": {"scale": 1.0}}
    return {"runs": [{"estimate": {"name": name}, **parts}]}


def test_demo_refuses_errors_above_the_limit() -> None:
    demo.check(result(0.019), is_real_time=False)
    demo.check(result(9.0, "icp"), is_real_time=False)
    demo.check(result(0.021), is_real_time=True)
    with pytest.raises(InputError, match=r"small_gicp: position ATE 0\.021 m, more than 0\.02 m"):
        demo.check(result(0.021), is_real_time=False)


def test_demo_measures_the_difference_of_all_errors() -> None:
    assert demo.difference(result(0.02), result(0.02)) == 0.0
    assert demo.difference(result(0.02), result(0.03)) == pytest.approx(0.01)
    more = result(0.02)
    more["runs"][0]["re"]["segments"] = [1.0]
    assert demo.difference(result(0.02), more) == np.inf


def test_demo_never_removes_other_files(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match=r"contains thesis\.tex; choose another folder"):
        demo.remove_existing(tmp_path)
    assert (tmp_path / "thesis.tex").exists()


def test_demo_removes_the_results_of_an_earlier_one(tmp_path: Path) -> None:
    for name in ("bag", "live", "live_2", "live_10", "recorded"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").touch()
    (tmp_path / "rerun.png").touch()
    demo.remove_existing(tmp_path)
    assert not any(tmp_path.iterdir())
    demo.remove_existing(tmp_path / "new" / "folder")
    assert (tmp_path / "new" / "folder").is_dir()


def pose_at(flight: Flight, stamp: int) -> np.ndarray:
    place = int(np.abs(flight.groundtruth.stamps - stamp).argmin())
    pose = np.eye(4)
    pose[:3, 3] = flight.groundtruth.positions[place]
    pose[:3, :3] = Rotation.from_quat(flight.groundtruth.quaternions[place]).as_matrix()
    return pose


def moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return points @ pose[:3, :3].T + pose[:3, 3]
