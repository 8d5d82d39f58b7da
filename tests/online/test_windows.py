"""Windows of the live evaluator: their errors, and how they are written."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_feeding import SECOND, feed, make_pair
from strategies import seeds

from trajeval_ros import Gauge, Protocol, evaluate
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.metrics.absolute_errors import absolute_errors
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.protocol import PROTOCOLS
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.window import Window


@pytest.mark.slow
@pytest.mark.parametrize("window", ["5s", "4m", "37"])
@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.SIM3])
def test_a_window_has_the_errors_of_its_pairs(window: str, gauge: Gauge) -> None:
    groundtruth, estimate = make_pair(5, 600)
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge=gauge), Window.parse(window)))
    whole = OnlineEvaluator(OnlineSettings(Protocol(gauge=gauge)))
    for live in (evaluator, whole):
        feed(live, groundtruth, estimate, drain_s=0.37)
    snapshot, all_pairs = evaluator.snapshot(), whole.association()
    stamps = all_pairs.groundtruth.stamps
    along = all_pairs.groundtruth.travelled
    inside = {
        "5s": stamps >= stamps[-1] - 5 * SECOND,
        "4m": along >= along[-1] - 4.0,
        "37": np.arange(len(stamps)) >= len(stamps) - 37,
    }[window]
    assert snapshot.window_pairs == np.count_nonzero(inside)
    assert isinstance(snapshot.alignment, Alignment)
    aligned = snapshot.alignment.similarity.trajectory(all_pairs.estimate[inside])
    errors = absolute_errors(all_pairs.groundtruth[inside], aligned)
    rmse = float(np.sqrt(np.mean(errors.position_m**2)))
    assert snapshot.window_position_rmse_m == pytest.approx(rmse, rel=1e-9)
    rotation = snapshot.ate["rotation_deg"]
    assert rotation is not None
    assert errors.rotation_deg is not None
    assert rotation.mean == pytest.approx(errors.rotation_deg.mean(), rel=1e-9)


@pytest.mark.slow
def test_groundtruth_coverage_is_of_the_whole_run_whatever_the_window() -> None:
    groundtruth, estimate = make_pair(5, 600)
    recorded = evaluate(groundtruth, estimate, PROTOCOLS["default"]).association
    for text in ("0", "2s", "3"):
        live = OnlineEvaluator(OnlineSettings(window=Window.parse(text)))
        assert live.snapshot().coverage is None
        feed(live, groundtruth, estimate, drain_s=0.37)
        assert live.snapshot().coverage == recorded.coverage


@pytest.mark.parametrize("window", ["0", "5s", "4m", "37"])
def test_a_snapshot_before_the_first_pair_has_no_errors(window: str) -> None:
    snapshot = OnlineEvaluator(OnlineSettings(window=Window.parse(window))).snapshot()
    assert (snapshot.pairs, snapshot.window_pairs, snapshot.ate) == (0, 0, {})
    assert snapshot.position_rmse_m is snapshot.window_position_rmse_m is None


@pytest.mark.slow
@settings(max_examples=10)
@given(seed=seeds)
def test_a_window_of_the_whole_run_is_the_whole_run(seed: int) -> None:
    groundtruth, estimate = make_pair(seed, 200)
    evaluator = OnlineEvaluator()
    feed(evaluator, groundtruth, estimate)
    snapshot = evaluator.snapshot()
    assert snapshot.window_position_rmse_m == snapshot.position_rmse_m
    position = snapshot.ate["position_m"]
    assert position is not None
    assert position.rmse == pytest.approx(snapshot.position_rmse_m, rel=1e-9)


@pytest.mark.slow
def test_lengths_and_window_change_while_it_runs() -> None:
    groundtruth, estimate = make_pair(3, 400)
    short, long = Length(1.0, "m"), Length(2.0, "m")
    metres = OnlineSettings(protocol=Protocol(lengths=(short,)), window=Window(20, "pairs"))
    changing, steady = OnlineEvaluator(metres), OnlineEvaluator(metres)
    half = groundtruth.stamps[200]
    for evaluator in (changing, steady):
        feed(
            evaluator,
            groundtruth[groundtruth.stamps <= half],
            estimate[estimate.stamps <= half],
        )
    both = dataclasses.replace(metres.protocol, lengths=(long, short))
    changing.change(dataclasses.replace(metres, protocol=both, window=Window()))
    at_change = changing.pairs
    for evaluator in (changing, steady):
        feed(evaluator, groundtruth[groundtruth.stamps > half], estimate[estimate.stamps > half])
    now, before = changing.snapshot(), steady.snapshot()
    # Short and long batches multiply quaternions in sums of another order (`lie.multiply`). Four
    # products of unit quaternions, each known to 4 u in each of four components, make an angle
    # that is known to 64 u, and a step of one metre that is known to as much; two of them differ
    # by twice that, their means by N u more.
    one, other = now.relative["1m"], before.relative["1m"]
    assert (one.count, one.given_up) == (other.count, other.given_up)
    rounding = (128 + one.count) * np.finfo(np.float64).eps / 2.0
    assert one.position_m == pytest.approx(other.position_m, rel=0, abs=rounding)
    assert one.rotation_deg == pytest.approx(other.rotation_deg, rel=0, abs=np.degrees(rounding))
    assert now.relative["2m"].count > 0
    # The wider window began with what the narrow one had left, and has forgotten nothing since.
    assert now.window_pairs > changing.pairs - at_change
    assert now.window_position_rmse_m is not None


@given(size=st.integers(0, 10**9), unit=st.sampled_from(["", "s", "m"]))
def test_windows_are_read_as_they_are_written(size: int, unit: str) -> None:
    window = Window.parse(f"{size}{unit}")
    assert Window.parse(str(window)) == window


@pytest.mark.parametrize("text", ["99999999999s", "1000000001m", "9" * 20, "9" * 400])
def test_a_window_longer_than_any_run_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="above the limit of 1e\\+09"):
        Window.parse(text)


@pytest.mark.parametrize("text", ["0", "30s", "50m", "500", "2.5m"])
def test_windows_are_written_as_they_are_read(text: str) -> None:
    assert str(Window.parse(text)) == text
