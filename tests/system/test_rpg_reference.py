"""The authors' toolbox, number by number, and the tutorial's Table III."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
from rpg_toolbox import METRICS, SLIPPED

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import PROTOCOLS
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.pipeline.pipeline import evaluate

PAIRS = [f"vio_mono/{sequence}" for sequence in ("MH_01", "MH_05", "V2_03")] + [
    f"vislam_ba/{sequence}/{trial}"
    for sequence in ("MH_01", "MH_05", "V2_03")
    for trial in range(10)
]
ALIGNMENTS = {
    "sim3_-1": (Gauge.SIM3, None),
    "se3_-1": (Gauge.SE3, None),
    "posyaw_-1": (Gauge.YAW, None),
    "none_-1": (Gauge.NONE, None),
    "se3_1": (Gauge.SE3, 1),
    "posyaw_1": (Gauge.YAW, 1),
}

Recording = Callable[[str], Trajectory]
Reference = Callable[[str], Any]


def run(
    pair: dict[str, Any], recording: Recording, gauge: Gauge, states: int | None, **others: Any
) -> Evaluation:
    protocol = dataclasses.replace(PROTOCOLS["rpg"], gauge=gauge, align_states=states, **others)
    return evaluate(recording(pair["groundtruth"]), recording(pair["estimate"]), protocol)


def assert_statistics(
    actual: Statistics | None, theirs: dict[str, float], relative: float, absolute: float
) -> None:
    assert actual is not None
    assert actual.count == theirs["num_samples"]
    for name in ("rmse", "mean", "median", "std", "min", "max"):
        expected = pytest.approx(theirs[name], rel=relative, abs=absolute)
        assert getattr(actual, name) == expected, name


@pytest.mark.slow
@pytest.mark.parametrize("name", PAIRS)
def test_absolute_errors_are_the_toolboxs(
    name: str, recording: Recording, reference: Reference
) -> None:
    pair = reference("rpg_toolbox")["pairs"][name]
    assert pair["align"].keys() == ALIGNMENTS.keys()
    for key, (gauge, states) in ALIGNMENTS.items():
        result = run(pair, recording, gauge, states, lengths=())
        theirs = pair["align"][key]
        assert len(result.association) == pair["n_matched"]
        assert_statistics(result.ate["position_m"], theirs["trans_m"], 1e-8, 1e-10)
        assert_statistics(result.ate["rotation_deg"], theirs["rot_deg"], 1e-7, 1e-9)
        assert result.alignment.similarity.scale == pytest.approx(theirs["scale"], rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize(
    ("scale", "gauge"), [("scale_from_sim3_-1", Gauge.SIM3), ("scale_1", Gauge.SE3)]
)
def test_relative_errors_are_the_toolboxs(
    name: str, scale: str, gauge: Gauge, recording: Recording, reference: Reference
) -> None:
    numbers = reference("rpg_toolbox")
    pair = numbers["pairs"][name]
    result = run(pair, recording, gauge, None)
    assert result.relative is not None
    assert [item.length_m for item in result.relative] == pytest.approx(
        pair["subtraj_lengths_m"], rel=1e-12
    )
    for segments, (length, theirs) in zip(
        result.relative, pair["rel"][scale].items(), strict=True
    ):
        if (name, length) == SLIPPED:
            theirs = numbers["dropped_index_case"]["corrected"]
            if gauge is Gauge.SIM3:  # its positions are given for scale 1
                theirs = {key: their for key, their in theirs.items() if key != "trans_m"}
        else:
            assert theirs.keys() == METRICS.keys()
        for metric, expected in theirs.items():
            absolute = 1e-9 if "deg" in metric else 1e-10
            assert_statistics(segments.statistics[METRICS[metric]], expected, 1e-8, absolute)


def test_the_toolboxs_slip_is_not_ours(recording: Recording, reference: Reference) -> None:
    name, length = SLIPPED
    pair = reference("rpg_toolbox")["pairs"][name]
    result = run(pair, recording, Gauge.SE3, None)
    assert result.relative is not None
    position = result.relative[0].statistics["position_m"]
    assert position is not None
    as_coded = pair["rel"]["scale_1"][length]["trans_m"]["rmse"]
    assert position.rmse == pytest.approx(as_coded / 1.0432, rel=1e-3)


@pytest.mark.parametrize(
    "states", [1, 434, 869, 1304, None], ids=["first", "quarter", "half", "most", "all"]
)
def test_table_iii_on_vins_mono(
    states: int | None, recording: Recording, reference: Reference
) -> None:
    numbers = reference("rpg_toolbox")["vins_mono_MH_01"]
    theirs = numbers["table3_style_posyaw"]["-1" if states is None else str(states)]
    pair = {"estimate": "euroc/vins_mono/MH_01.csv", "groundtruth": "euroc/groundtruth/MH_01.txt"}
    plain = run(pair, recording, Gauge.YAW, states, lengths=())
    tutorial = run(pair, recording, Gauge.YAW, states, lengths=(), ate_form="tutorial")
    assert len(plain.association) == numbers["n_matched"]
    for result, metric, key in (
        (plain, "position_m", "ate_pos_m"),
        (plain, "rotation_deg", "ate_rot_deg"),
        (tutorial, "position_m", "ate_pos_eq23_m"),
        (tutorial, "rotation_deg", "ate_rot_deg"),
    ):
        statistics = result.ate[metric]
        assert statistics is not None
        assert statistics.rmse == pytest.approx(theirs[key], rel=1e-8)


def test_the_placeholder_that_the_recordings_begin_with_is_left_unmatched(
    recording: Recording, reference: Reference
) -> None:
    pair = reference("rpg_toolbox")["pairs"]["vio_mono/MH_01"]
    result = run(pair, recording, Gauge.SE3, 1, lengths=())
    assert not any("placeholder" in warning for warning in result.warnings)
