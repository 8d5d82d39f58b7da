"""Recordings of real estimators: errors, NEES, and what is said about them."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from paths import SHARED
from ros_bags import ODOM

from trajeval_ros import CovarianceRequest, Protocol, Request, read_trajectory, run
from trajeval_ros.cli.app import main
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.playback import Playback
from trajeval_ros.online.alarms import LIMITED_QUANTITIES, AlarmLimits
from trajeval_ros.pipeline.outcome import RunOutcome
from trajeval_ros.report.verdict_lines import definitions
from trajeval_ros.ros.diagnostics import remarks_about

DATA = SHARED / "data" / "real_estimators"
TRACKS = SHARED / "data" / "euroc_v1_01_tracks"
UPPER = np.triu_indices(6)

if not DATA.is_dir():
    pytest.skip("no recordings of real estimators", allow_module_level=True)

# Mean NEES of the poses per degree of freedom, seeds 1 to 8.
NEES = {
    "stereo_fej_on": (0.912, 1.009, 1.381, 0.517, 1.222, 0.768, 1.781, 0.782),
    "stereo_fej_off": (53.99, 6.550, 27.44, 13.88, 10.06, 7.927, 47.82, 164.9),
    "mono_fej_on": (11116.0, 0.797, 0.907, 0.554, 1.262, 0.891, 1.706, 0.488),
    "mono_fej_off": (118.6, 38.57, 14.05, 26.47, 2.150, 5.381, 8.606, 47.15),
}


def states(stamps: Floats, columns: Floats, covariances: Floats | None = None) -> Trajectory:
    return Trajectory(
        stamps.astype(np.int64),
        columns[:, :3],
        columns[:, 3:7],
        columns[:, 7:10],
        covariances=covariances,
    )


def simulated(name: str) -> list[tuple[Trajectory, Trajectory]]:
    """Return groundtruth and estimate of all seeds."""
    file = np.load(DATA / "openvins_simulation" / f"{name}.npz")
    result = []
    for columns, upper in zip(file["estimate"], file["covariance"].astype(float), strict=True):
        full = np.zeros((len(upper), 6, 6))
        full[:, UPPER[0], UPPER[1]] = upper
        full += np.swapaxes(np.triu(full, 1), 1, 2)
        stamps = file["stamps_ns"]
        result.append((states(stamps, file["truth"]), states(stamps, columns, full)))
    return result


def outcome(
    groundtruth: Trajectory, estimate: Trajectory, gauge: str, *, noise: bool = False
) -> RunOutcome:
    covariances = CovarianceRequest("message", groundtruth_noise=(0.01, 0.7) if noise else None)
    request = Request(Protocol(gauge=gauge, lengths=()), covariances=covariances)
    return run(groundtruth, [estimate], request).runs[0]


def mean_nees(detected: RunOutcome) -> float:
    assert detected.consistency is not None
    assert detected.consistency.per_pose is not None
    return detected.consistency.per_pose.mean


@pytest.mark.slow
@pytest.mark.parametrize("cameras", ["mono", "stereo"])
def test_nees_orders_first_estimates(cameras: str) -> None:
    values = {}
    for kind in ("on", "off"):
        name = f"{cameras}_fej_{kind}"
        result = [outcome(*pair, "none") for pair in simulated(name)]
        values[kind] = np.array([mean_nees(item) for item in result])
        np.testing.assert_allclose(values[kind], NEES[name], rtol=5e-3)
        diverged = [
            any(cause.cause.startswith("diverged") for cause in item.diagnosis.findings)
            for item in result
        ]
        assert diverged == [value > 1000.0 for value in NEES[name]]
        by_yaw = outcome(*simulated(name)[1], "yaw").evaluation
        assert ("deviation of yaw falls" in "".join(by_yaw.warnings)) == (kind == "off")
    good = values["on"] < 1000.0
    assert (values["off"][good] >= 1.5 * values["on"][good]).all()
    assert np.median(values["off"]) >= 15.0 * np.median(values["on"])
    assert ((values["on"][good] > 0.4) & (values["on"][good] < 2.0)).all()


@pytest.mark.parametrize(
    ("name", "by_yaw_m", "in_frame_m"),
    [
        ("openvins_fej_on.csv", 0.01897, 0.02691),
        ("openvins_fej_off.csv", 0.02527, None),
        ("gtsam.csv", 0.01731, 0.02389),
        ("spectacularai.txt", 0.04496, None),
    ],
)
def test_real_tracks(name: str, by_yaw_m: float, in_frame_m: float | None) -> None:
    groundtruth = read_trajectory(TRACKS / "groundtruth_V1_01_openvins.csv")
    estimate = read_trajectory(DATA / "v1_01" / name)
    for gauge, expected in (("yaw", by_yaw_m), ("none", in_frame_m)):
        if expected is None:
            continue
        request = Request(Protocol(gauge=gauge, lengths=()))
        result = run(groundtruth, [estimate], request).runs[0].evaluation
        position = result.ate["position_m"]
        assert position is not None
        assert position.rmse == pytest.approx(expected, rel=0.01)
        # The recording is longer than the run, and nothing was lost within it.
        assert not any("cover" in warning for warning in result.warnings)
        assert [remark.code for remark in result.remarks].count("low_coverage") == 1
        # 1.4 m of path determine yaw to 1 deg.
        assert ("standard deviation of its yaw" in definitions(result)[0]) == (gauge == "yaw")


def test_nees_with_the_noise_of_the_groundtruth() -> None:
    groundtruth = read_trajectory(TRACKS / "groundtruth_V1_01_openvins.csv")
    for name, expected in (("openvins_fej_on.csv", 0.090), ("gtsam.csv", 0.096)):
        estimate = read_trajectory(DATA / "v1_01" / name)
        result = mean_nees(outcome(groundtruth, estimate, "none", noise=True))
        assert result == pytest.approx(expected, rel=0.05)


def said_of(folder: str, capsys: pytest.CaptureFixture[str], *options: str) -> str:
    bag = DATA / "lidar" / folder / "bag"
    names = ["small_gicp"] if folder == "real_time" else ["kiss_icp", "rko_lio", "small_gicp"]
    estimates = [word for name in names for word in ("-e", f"{bag}:/{name}/odometry")]
    command = ["evaluate", "-g", f"{bag}:/groundtruth/pose", *estimates, "--modality", "lidar"]
    assert main([*command, *options]) == 0
    captured = capsys.readouterr()
    return captured.out + captured.err


@pytest.mark.slow
def test_overload_is_lost_tracking(capsys: pytest.CaptureFixture[str]) -> None:
    text = said_of("overload", capsys)
    for word in ("keyframe", "square degrees", "restart"):
        assert word not in text
    assert text.count("diagnosis: the estimate diverges from") == 2
    assert "note: small_gicp_odometry: the estimate diverges from 22.8 s on for 14.8 s" in text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "estimator"),
    [
        ("overload", "kiss_icp"),
        ("overload", "rko_lio"),
        ("overload", "small_gicp"),
        ("real_time", "small_gicp"),
    ],
)
def test_overload_is_lateness_live(folder: str, estimator: str, tmp_path: Path) -> None:
    """The messages arrive at their log times, and the status is read every second."""
    names = {"/groundtruth/pose": GROUNDTRUTH, f"/{estimator}/odometry": ESTIMATE}
    live = Live(tmp_path / "live", ODOM, gauge="se3")
    text: dict[str, str] = {}
    limits = dict.fromkeys(
        (
            "coverage",
            "rate_hz",
            *(limited_quantity.name for limited_quantity in LIMITED_QUANTITIES),
        ),
        AlarmLimits(),
    )
    with Bag(DATA / "lidar" / folder / "bag") as opened:
        playback = Playback(opened, lambda _: True, list(names), with_clock=False)
        # Messages of a tenth of a second arrive together.
        tenths = groupby(playback.messages(), lambda item: item[0] // 10**8)
        for count, (_, together) in enumerate(tenths):
            live.feed(
                [
                    (names[channel.name], channel.type, logged, payload)
                    for logged, channel, payload in together
                ]
            )
            if count % 10 == 0:
                [estimate] = live.run.estimates
                result = remarks_about(live.run, estimate, estimate.snapshot(), {}, limits)
                text.update({item.code: item.text for item in result})
    live.end()
    text.update({remark["code"]: remark["text"] for remark in live.result["runs"][0]["remarks"]})
    for word in ("keyframe", "square degrees", "restart", "clock"):
        assert word not in " ".join(text.values())
    assert ("late" in text) == (folder == "overload")
    # The live numbers leave poses out that are too late; the result has all.
    assert ("later than the groundtruth buffer" in text.get("delay", "")) == (folder == "overload")


def test_a_good_run_has_no_finding(capsys: pytest.CaptureFixture[str]) -> None:
    text = said_of("real_time", capsys)
    assert "diagnosis:" not in text
    assert "warning:" not in text


@pytest.mark.slow
def test_clocks_of_parts_within_the_stated_interval(capsys: pytest.CaptureFixture[str]) -> None:
    text = said_of("lockstep", capsys, "--time-offset", "auto")
    assert "different clock offsets" not in text


def test_constant_covariances_are_a_placeholder(capsys: pytest.CaptureFixture[str]) -> None:
    bag = DATA / "lidar" / "lockstep" / "bag"
    command = ["evaluate", "-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/kiss_icp/odometry"]
    assert main([*command, "--modality", "lidar", "--covariance", "message"]) == 2
    assert "all are equal (0.1 m^2, 0.1 rad^2): a constant" in capsys.readouterr().err
