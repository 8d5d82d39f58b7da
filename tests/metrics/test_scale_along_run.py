"""The scale along the run: simulated drifts, constant scales, and recordings."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import Array, make_element

from trajeval_ros import Protocol, Trajectory, draw, evaluate
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.metrics.scale_along_run import ScaleAlongRun, scale_along_run
from trajeval_ros.pipeline.pipeline import run
from trajeval_ros.pipeline.request import Request
from trajeval_ros.report.console import console
from trajeval_ros.report.evaluation_text import print_remarks, print_verdicts

COUNT = 4000
MONO = Protocol(gauge=Gauge.SIM3)


def flight(random: np.random.Generator, *, tails: bool = False) -> tuple[Array, Array]:
    """Return a path with turns, slow and fast parts and rests, and noisy steps along it."""
    speed = np.abs(np.convolve(random.normal(size=COUNT + 399), np.ones(400), "valid")) / 20.0
    speed[random.integers(COUNT // 2) :][:400] = 0.0
    rotation = (
        np.cumsum(np.convolve(random.normal(size=COUNT + 99), np.ones(100), "valid")) / 400.0
    )
    heading = np.stack([np.cos(rotation), np.sin(rotation), 0.2 * np.sin(rotation / 3.0)], axis=1)
    steps = speed[:, None] * heading * 0.05
    noise = random.standard_t(3, steps.shape) if tails else random.normal(size=steps.shape)
    return np.cumsum(steps, axis=0), steps + 0.1 * np.abs(steps).max(axis=1, keepdims=True) * noise


def drifting(seed: int, drift: float, *, tails: bool = False, walk: float = 0.0) -> ScaleAlongRun:
    """Return the scale of a simulated estimate; `drift` in percent per 100 m."""
    random = np.random.default_rng(seed)
    path, noisy = flight(random, tails=tails)
    travelled = np.cumsum(np.linalg.norm(np.diff(path, axis=0, prepend=path[:1]), axis=1))
    wandering = walk * np.cumsum(random.normal(size=COUNT)) / COUNT**0.5
    steps = np.exp(1e-4 * drift * travelled + wandering)[:, None] * noisy
    estimate = np.cumsum(steps, axis=0) + random.normal(scale=0.005, size=path.shape)
    groundtruth = path + random.normal(scale=0.002, size=path.shape)
    result = scale_along_run(groundtruth, estimate, 1.0)
    assert result is not None
    return result


@pytest.mark.slow
@pytest.mark.parametrize("tails", [False, True])
@pytest.mark.parametrize("drift", [0.0, -3.0, 20.0])
def test_the_drift_is_within_two_standard_deviations(drift: float, *, tails: bool) -> None:
    scales = [drifting(seed, drift, tails=tails) for seed in range(150)]
    deviations = np.array([abs(item.drift - drift) / item.drift_std for item in scales])
    assert np.mean(deviations < 2.0) >= 0.95
    # The standard deviation is not useless either.
    assert np.mean(deviations > 0.2) > 0.5
    if drift == 0.0:
        assert not any(scale.is_drifting for scale in scales)
    if drift == 20.0:
        assert np.mean([scale.is_drifting for scale in scales]) > 0.8


@pytest.mark.slow
def test_a_wandering_scale_is_seldom_called_drift() -> None:
    scales = [drifting(seed, 0.0, walk=0.2) for seed in range(150)]
    assert np.mean([scale.is_drifting for scale in scales]) < 0.05
    assert np.mean([abs(scale.drift) < 2.0 * scale.drift_std for scale in scales]) > 0.8
    assert np.median([np.ptp(scale.ratios) for scale in scales]) > 0.1


@given(st.integers(0, 1000))
def test_the_estimate_may_be_in_any_frame_and_unit(seed: int) -> None:
    random = np.random.default_rng(seed)
    path, steps = flight(random)
    estimate = np.cumsum(steps, axis=0)
    element = make_element(Gauge.SIM3, seed)
    one = scale_along_run(path, estimate, 1.0)
    other = scale_along_run(path, element.positions(estimate), 1.0 / element.scale)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(other.ratios, one.ratios, rtol=1e-6)
    np.testing.assert_allclose(
        (other.drift, other.drift_std), (one.drift, one.drift_std), rtol=1e-3, atol=1e-5
    )


def test_an_exact_drift_is_recovered() -> None:
    along = np.linspace(0.0, 200.0, 2001)
    path = np.stack([along, np.zeros_like(along), np.zeros_like(along)], axis=1)
    other = path.copy()
    other[:, 0] = (np.exp(0.001 * along) - 1.0) / 0.001  # the scale is exp(0.001 l)
    result = scale_along_run(path, other, 1.0)
    assert result is not None
    assert result.drift == pytest.approx(10.0, rel=1e-3)
    assert result.is_drifting
    assert result.length_m == pytest.approx(10.0)
    np.testing.assert_allclose(result.ratios, np.exp(0.001 * result.travelled_m), rtol=1e-4)


@pytest.mark.parametrize("count", [2, 30])
def test_few_pairs_have_no_scale(count: int) -> None:
    path = np.cumsum(np.ones((count, 3)), axis=0)
    assert scale_along_run(path, path, 1.0) is None


def test_rest_has_no_scale() -> None:
    rest = np.ones((500, 3))
    moving = np.cumsum(rest, axis=0)
    assert scale_along_run(rest, moving, 1.0) is None
    assert scale_along_run(moving, rest, 1.0) is None


def trajectories(drift: float) -> tuple[Trajectory, Trajectory]:
    random = np.random.default_rng(4)
    path, _ = flight(random)
    travelled = np.cumsum(np.linalg.norm(np.diff(path, axis=0, prepend=path[:1]), axis=1))
    steps = np.diff(path, axis=0, prepend=path[:1]) * np.exp(1e-4 * drift * travelled)[:, None]
    stamps = np.arange(COUNT) * 50_000_000 + 10**18
    estimate = np.cumsum(steps, axis=0) + random.normal(scale=0.003, size=path.shape)
    return (
        Trajectory(stamps=stamps, positions=path, name="groundtruth"),
        Trajectory(stamps=stamps, positions=estimate, name="mono"),
    )


def test_the_result_states_the_drift() -> None:
    groundtruth, estimate = trajectories(-30.0)
    outcome = run(groundtruth, [estimate], Request(protocol=MONO))
    (result,) = result_of(outcome)["runs"]
    scale = result["scale_along_run"]
    assert scale["drift_percent_per_100m"] == pytest.approx(-30.0, abs=2.0)
    assert len(scale["ratios"]) == len(scale["travelled_m"]) >= 8
    (remark,) = [item for item in result["remarks"] if item["code"] == "scale_drift"]
    assert remark["level"] == "note"
    rigid = run(groundtruth, [estimate], Request(protocol=Protocol(gauge=Gauge.SE3)))
    assert result_of(rigid)["runs"][0]["scale_along_run"] is None


@pytest.mark.parametrize("drift", [-30.0, 0.0])
def test_a_drift_is_stated_below_the_worst_place_and_a_constant_scale_never(drift: float) -> None:
    groundtruth, estimate = trajectories(drift)
    outcome = run(groundtruth, [estimate], Request(protocol=MONO))
    printed, notes = io.StringIO(), io.StringIO()
    print_verdicts(console(printed), outcome)
    print_remarks(console(notes), outcome.runs)
    worst, *below = printed.getvalue().partition("  worst: ")[2].splitlines()
    assert "scale drifts" not in worst
    assert "scale drifts" not in notes.getvalue()
    if drift:
        assert below[0].startswith("  the scale drifts by -29.9")
        assert " % per 100 m, from " in below[0]
    else:
        assert "scale drifts" not in printed.getvalue()


def test_the_figure_shows_the_scale() -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    groundtruth, estimate = trajectories(-30.0)
    (axes,) = draw(evaluate(groundtruth, estimate, MONO), "scale").axes
    assert "drift -29.9" in axes.get_legend().get_texts()[0].get_text()
    (axes,) = draw(evaluate(groundtruth, estimate, Protocol(gauge=Gauge.SE3)), "scale").axes
    assert not axes.lines
    assert "sim3" in axes.texts[0].get_text()


def test_scales_of_recordings(recording: Callable[[str], Trajectory]) -> None:
    """A stereo SLAM has a constant scale; that of a monocular odometry varies by 15 %."""
    sides = [recording(f"kitti/KITTI_00_{name}.txt") for name in ("gt", "ORB")]
    stereo = evaluate(*sides, MONO).scale_along_run
    assert stereo is not None
    assert np.ptp(stereo.ratios) < 0.02
    assert abs(stereo.drift) < 0.01
    assert not stereo.is_drifting
    names = ("groundtruth", "full")
    sides = [recording(f"kitti_odom_eval/09_{name}.txt") for name in names]
    mono = evaluate(*sides, MONO).scale_along_run
    assert mono is not None
    assert np.ptp(mono.ratios) > 0.14
    assert not mono.is_drifting
