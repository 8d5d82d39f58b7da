"""The uncertainty of an alignment's rotation on recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest
from rotation_runs import freedom_numbers, of_marker, on, rmse, rotation_warnings

from trajeval_ros import Gauge, Protocol, Trajectory, evaluate
from trajeval_ros.exceptions import InputError
from trajeval_ros.metrics.evaluation import evaluate as measured


@pytest.fixture(scope="module")
def kitti(recording: Callable[[str], Trajectory]) -> tuple[Trajectory, Trajectory]:
    return recording("kitti/KITTI_00_gt.txt"), recording("kitti/KITTI_00_ORB.txt")


def by_frame(way: str = "positions") -> Protocol:
    return Protocol(association="index", align_with=way, lengths=())


def test_a_straight_street_of_kitti(kitti: tuple[Trajectory, Trajectory]) -> None:
    truth, estimate = (item[4200:4350] for item in kitti)
    result = evaluate(truth, estimate, by_frame())
    assert result.ate["rotation_deg"] is None
    assert result.alignment.freedom is not None
    std_deg, error_deg, least_deg, turn_deg, _ = freedom_numbers(result.alignment)
    assert std_deg == pytest.approx(27.1, abs=0.1)
    assert [error_deg, turn_deg] == pytest.approx([33.56, 33.56], abs=0.005)
    assert least_deg == pytest.approx(0.09, abs=0.005)
    (warning,) = rotation_warnings(result)
    assert "of the rotation error of 33.6 deg, 33.6 deg are a constant rotation" in warning
    with_poses = evaluate(truth, estimate, by_frame("poses"))
    assert rmse(with_poses, "rotation_deg") == pytest.approx(0.46, abs=0.005)
    assert rmse(with_poses, "position_m") == pytest.approx(0.6532, abs=5e-5)
    assert rotation_warnings(with_poses) == []


@pytest.mark.slow
def test_kitti_with_a_marker_is_refused(kitti: tuple[Trajectory, Trajectory]) -> None:
    truth, estimate = kitti
    assert rotation_warnings(evaluate(truth, estimate, by_frame())) == []
    marked = of_marker(truth)
    marked = dataclasses.replace(marked, reading=marked.reading.without("matrices"))
    with pytest.raises(InputError, match="another body"):
        evaluate(marked, estimate, by_frame("poses"))
    # The whole run determines its rotation: 1.303 m either way.
    with_poses = evaluate(truth, estimate, by_frame("poses"))
    before = rmse(evaluate(truth, estimate, by_frame()), "position_m")
    assert rmse(with_poses, "position_m") == pytest.approx(before, rel=5e-4)


@pytest.mark.slow
def test_full_recordings_are_silent(
    recording: Callable[[str], Trajectory], shared_data: Path
) -> None:
    euroc = [
        (f"euroc/groundtruth/{sequence}.txt", str(path.relative_to(shared_data)))
        for sequence in ("MH_01", "MH_05", "V2_03")
        for path in (
            shared_data / f"euroc/vio_mono/{sequence}.txt",
            *sorted((shared_data / "euroc/vislam_ba").glob(f"{sequence}_trial*.txt")),
        )
    ]
    assert len(euroc) == 33
    desk = ("tum/fr2_desk_groundtruth.txt", "tum/fr2_desk_ORB.txt")
    for truth, estimate in (*euroc, desk):
        for gauge in (Gauge.SE3, Gauge.YAW) if truth.startswith("euroc") else (Gauge.SE3,):
            result = evaluate(recording(truth), recording(estimate), on(gauge))
            assert rotation_warnings(result) == [], (estimate, gauge)


@pytest.mark.slow
def test_windows_of_kitti_that_are_wrong_are_said_and_no_others(
    kitti: tuple[Trajectory, Trajectory], recording: Callable[[str], Trajectory]
) -> None:
    nine = (
        recording("kitti_odom_eval/09_groundtruth.txt"),
        recording("kitti_odom_eval/09_full.txt"),
    )
    first_state = dataclasses.replace(by_frame(), align_states=1)
    counts = dict.fromkeys(("windows", "wrong", "missed", "others", "withheld", "needlessly"), 0)
    for truth, estimate in (kitti, nine):
        for length in (60, 100, 150, 200):
            for begin in range(0, len(truth) - length + 1, 30):
                part = slice(begin, begin + length)
                window = measured(truth[part], estimate[part], by_frame())
                by_first = rmse(measured(truth[part], estimate[part], first_state), "rotation_deg")
                freedom = window.alignment.freedom
                assert freedom is not None
                _, error_deg, least_deg, _, _ = freedom_numbers(window.alignment)
                wrong = error_deg > 2.0 and error_deg > 3.0 * by_first
                counts["windows"] += 1
                counts["wrong"] += wrong
                counts["missed"] += wrong and not freedom.is_misleading
                counts["others"] += freedom.is_misleading and not wrong
                counts["withheld"] += bool(window.withheld)
                fine = error_deg < 2.0 or error_deg <= 2.0 * least_deg
                counts["needlessly"] += bool(window.withheld) and fine
    assert tuple(counts.values()) == (789, 153, 0, 0, 41, 1)
