"""Protection levels and areas: laws, honest runs, and numbers of the literature."""

from __future__ import annotations

import dataclasses
import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import SHARED
from scipy.stats import chi2, norm
from watched_flights import SECOND, varied, watched_bag

from trajeval_ros import CovarianceRequest, Protocol, Request, Trajectory, run
from trajeval_ros.cli.app import main
from trajeval_ros.consistency.covariance_request import IntegrityRequest
from trajeval_ros.consistency.integrity import (
    AREAS,
    Integrity,
    effective_number,
    protection_levels,
    share_interval,
    times_to_alert,
)
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.papers.flight import fly
from trajeval_ros.papers.scene import PROFILES

DATA = SHARED / "data" / "euroc"


def test_a_level_in_one_dimension_is_a_two_sided_gaussian() -> None:
    actual = protection_levels(np.array([[[4.0]]]), 0.01)
    assert actual[0] == pytest.approx(2.0 * norm.isf(0.005))


@given(st.floats(1e-7, 0.5), st.floats(0.1, 1.0), st.floats(-3.0, 3.0))
def test_a_level_bounds_the_quantile_whatever_the_axes(
    risk: float, ratio: float, angle: float
) -> None:
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    covariance = rotation @ np.diag([1.0, ratio]) @ rotation.T
    (level,) = protection_levels(covariance[None], risk)
    assert level == pytest.approx(np.sqrt(chi2.isf(risk, 2)))


def test_the_number_of_independent_poses() -> None:
    generator = np.random.default_rng(0)
    white = generator.normal(size=20_000)
    assert effective_number(white) == pytest.approx(len(white), rel=0.1)
    # An autoregression with memory a says as much as n (1 - a) / (1 + a).
    correlated = np.empty_like(white)
    correlated[0] = white[0]
    for row in range(1, len(white)):
        correlated[row] = 0.9 * correlated[row - 1] + white[row]
    assert effective_number(correlated) == pytest.approx(len(white) / 19.0, rel=0.25)


def test_the_interval_of_a_share_is_that_of_clopper_and_pearson() -> None:
    low, high = share_interval(0.1, 100.0)
    assert (low, high) == pytest.approx((0.0490, 0.1762), abs=1e-4)
    assert share_interval(0.0, 300.0) == pytest.approx((0.0, 0.0122), abs=1e-4)
    assert share_interval(1.0, 10.0)[1] == 1.0


def integrity_of_run(
    truth: Trajectory, estimate: Trajectory, request: IntegrityRequest
) -> Integrity:
    asked = Request(
        Protocol(gauge="yaw", align_states=1, lengths=()),
        covariances=CovarianceRequest("message"),
        integrity=request,
    )
    actual = run(truth, [estimate], asked).runs[0].integrity
    assert actual is not None
    return actual


@pytest.mark.slow
def test_honest_runs_keep_their_promise() -> None:
    flight = fly(5, 60.0, PROFILES["euroc"])
    over: dict[float, list[float]] = {0.1: [], 0.01: [], 0.001: []}
    count = 0.0
    for odometry in flight.runs(5, 10):
        for risk, shares in over.items():
            actual = integrity_of_run(
                flight.groundtruth, odometry.estimate, IntegrityRequest(0.5, 2.0, risk)
            )
            shares.append(1.0 - actual.parts[0].bounded)
        count += actual.parts[0].effective
    assert len(over) > 0
    for risk, shares in over.items():
        low, _ = share_interval(float(np.mean(shares)), count)
        assert low <= risk


@pytest.mark.slow
def test_an_overconfident_run_misleads() -> None:
    flight = fly(5, 10.0, PROFILES["overconfident"])
    (odometry,) = flight.runs(5, 1)
    small = IntegrityRequest(1e-3, 1e-2, 0.1)
    actual = integrity_of_run(flight.groundtruth, odometry.estimate, small)
    assert max(1.0 - part.bounded for part in actual.parts) > 0.3


def circle(noise_m: float, stated_m: float) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth, and an estimate with white noise of a stated size."""
    count = 400
    angle = np.linspace(0.0, 6.0, count)
    positions = np.stack([5.0 * np.cos(angle), 5.0 * np.sin(angle), np.sin(2.0 * angle)], axis=1)
    zero = np.zeros(count)
    quaternions = np.stack([zero, zero, np.sin(0.5 * angle), np.cos(0.5 * angle)], axis=1)
    stamps = np.arange(count, dtype=np.int64) * 50_000_000
    truth = Trajectory(stamps, positions, quaternions, name="truth")
    noise = np.random.default_rng(1).normal(0.0, noise_m, positions.shape)
    covariance = np.diag([stated_m**2] * 3 + [1e-4**2] * 3)
    return truth, dataclasses.replace(
        truth,
        positions=positions + noise,
        covariances=varied(covariance, count),
        name="estimate",
    )


@pytest.mark.parametrize(
    ("stated_m", "limit_m", "area"),
    [
        (0.05, 1.0, "nominal"),
        (0.5, 0.2, "unavailable"),
        (1e-4, 1.0, "misleading"),
        (1e-4, 1e-3, "hazardous"),
        (1e-3, 1e-4, "misleading_unavailable"),
    ],
)
def test_each_area(stated_m: float, limit_m: float, area: str) -> None:
    truth, estimate = circle(0.05, stated_m)
    asked = Request(
        Protocol(gauge="none", lengths=()),
        covariances=CovarianceRequest("message"),
        integrity=IntegrityRequest(limit_m),
    )
    actual = run(truth, [estimate], asked).runs[0].integrity
    assert actual is not None
    horizontal, vertical = actual.parts
    assert horizontal.areas[area] > 0.9
    assert horizontal.episodes[area] >= 1
    for part in (horizontal, vertical):
        assert tuple(part.areas) == AREAS
        assert sum(part.areas.values()) == pytest.approx(1.0)
        assert part.areas["nominal"] + part.areas["unavailable"] == pytest.approx(part.bounded)


def test_inflation_bounds_the_errors() -> None:
    truth, estimate = circle(0.05, 0.005)
    asked = Request(
        Protocol(gauge="none", lengths=()),
        covariances=CovarianceRequest("message"),
        integrity=IntegrityRequest(1.0),
    )
    actual = run(truth, [estimate], asked).runs[0].integrity
    assert actual is not None
    part = actual.parts[0]
    assert np.mean(part.errors <= part.inflation * part.levels) >= 0.997
    assert part.inflation > 1.0


def write(folder: Path, covariance: Floats) -> list[str]:
    """Write a bag with the circle, and return the command that evaluates it."""
    from trajeval_ros.io.bags.write_bag import write_bag

    truth, estimate = circle(0.05, 0.05)
    estimate = dataclasses.replace(estimate, covariances=varied(covariance, len(estimate)))
    write_bag(
        folder / "run",
        {
            "/truth": (truth, "geometry_msgs/msg/PoseStamped"),
            "/odom": (estimate, "nav_msgs/msg/Odometry"),
        },
    )
    sources = ["-g", f"{folder / 'run'}:/truth", "-e", f"{folder / 'run'}:/odom"]
    return ["evaluate", *sources, "--gauge", "none", "--lengths", "none"]


@pytest.mark.slow
def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = write(tmp_path, np.diag([0.05**2] * 3 + [1e-4] * 3))
    asked = [*command, "--covariance", "message", "--alert-limit", "0.5,2"]
    assert main([*asked, "--output", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    assert "horizontal" in text
    assert "protection levels from the largest axis" in text
    actual = json.loads((tmp_path / "out" / "result.json").read_text())["runs"][0]["integrity"]
    assert [part["part"] for part in actual["parts"]] == ["horizontal", "vertical", "heading"]
    assert actual["risk"] == 1e-5
    assert actual["parts"][0]["areas"]["nominal"] == 1.0
    drawn = (tmp_path / "out" / "stanford.png").exists()
    assert drawn == (find_spec("matplotlib") is not None)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--alert-limit", "0.5"], "add --covariance message"),
        (["--covariance", "message", "--risk", "1e-3"], "--risk needs --alert-limit"),
        (["--alert-limit", "a"], "the alert limit 'a' is not valid"),
        (["--alert-limit", "1,2,3"], "the alert limit '"),
        (["--alert-limit", "-1"], "must be greater than zero"),
        (["--alert-limit", "1", "--risk", "2"], "must be a probability"),
        (
            ["--covariance", "message", "--alert-limit", "1"],
            "or only zeros (unknown)",
        ),
    ],
)
def test_bad_words_are_one_sentence(
    options: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*write(tmp_path, np.zeros((6, 6))), *options]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1


@pytest.mark.skipif(not DATA.is_dir(), reason="the recordings are not here")
def test_openvins_on_mh_01_is_hazardously_misleading(tmp_path: Path) -> None:
    result = tmp_path / "result.json"
    command = [
        *("evaluate", "-g", str(DATA / "groundtruth/MH_01.txt")),
        *("-e", str(DATA / "openvins/MH_01_with_covariance.csv"), "--covariance", "message"),
        *("--gauge", "yaw", "--align-states", "1", "--lengths", "none", "--quiet"),
        *("--alert-limit", "0.2", "--json", str(result)),
    ]
    assert main(command) == 0
    actual = json.loads(result.read_text())["runs"][0]["integrity"]
    # A computation of its own, by raw covariances turned to the first state, says 67.7 %.
    assert actual["parts"][0]["areas"]["hazardous"] == pytest.approx(0.677, abs=0.005)
    assert actual["parts"][0]["availability"] == 1.0


STAMPS = np.arange(10, dtype=np.int64) * SECOND
ERRORS = np.array([0.0, 2.0, 2.0, 2.0, 0.0, 2.0, 2.0, 0.0, 2.0, 0.0])


@pytest.mark.parametrize(
    ("raised", "warnings", "seconds", "missed"),
    [
        ([], [], (), 3),  # nothing says anything
        ([3], [], (2.0,), 2),  # in the first episode, two seconds late
        ([0, 1], [], (-1.0,), 2),  # before it, and still there when it begins
        ([0], [], (), 3),  # before it, and over
        ([], [(int(5.5 * SECOND), 20 * SECOND)], (0.5, -2.5), 1),  # elsewhere, and it stays
        ([2], [(SECOND, SECOND)], (0.0,), 2),  # the earlier of the two counts
    ],
)
def test_the_time_to_alert_is_from_the_begin_of_an_episode(
    raised: list[int], warnings: list[tuple[int, int]], seconds: tuple[float, ...], missed: int
) -> None:
    levels = np.full(10, 0.5)
    levels[raised] = 3.0
    actual = times_to_alert(STAMPS, ERRORS, levels, 1.0, warnings)
    assert actual.seconds == pytest.approx(seconds)
    assert actual.missed == missed
    assert actual.worst == (max(seconds) if seconds else None)
    assert actual.median == (pytest.approx(np.median(seconds)) if seconds else None)


@pytest.mark.slow
def test_a_watch_shortens_the_time_to_alert(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = watched_bag(tmp_path, "bad", 4, "jump 1 m", covariance=1e-6 * np.eye(6))
    output = tmp_path / "result.json"
    command = ["evaluate", "-g", f"{bad}:/groundtruth", "-e", f"{bad}:/odom", "--gauge", "yaw",
               "--align-states", "1", "--covariance", "message", "--lengths", "none",
               "--json", str(output)]  # fmt: skip
    asked = ["--alert-limit", "0.5"]

    def times() -> dict[str, float]:
        parts = json.loads(output.read_text())["runs"][0]["integrity"]["parts"]
        actual: dict[str, float] = parts[0]["time_to_alert"]
        return actual

    assert main([*command, *asked]) == 0
    assert (times()["episodes"], times()["missed"], times()["median_s"]) == (1, 1, None)
    assert main([*command, *asked, "--watch-factor", "1"]) == 0
    assert "time to alert" in capsys.readouterr().out
    assert times()["missed"] == 0
    assert abs(times()["median_s"]) < 1.0
    assert main([*command, "--watch-factor", "1"]) == 2
    assert "--watch-factor needs --alert-limit" in capsys.readouterr().err
