"""Scores and recall of surveyed points: tables of steps, of knots, and shares."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros import PROTOCOLS, evaluate
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.requests.request_from import protocol_from, read_protocol
from trajeval_ros.metrics.score import KnotTable, PointTable, RecallRule

PRISM = (-0.00594496, -0.00721288, 0.272943)
LAMARIA = PROTOCOLS["lamaria"]


@pytest.mark.parametrize(
    ("error_m", "points"),
    [(0.0, 20), (0.05, 20), (0.125, 19), (0.35, 16.5), (1.0, 12), (3.5, 6), (10.0, 0), (11.0, 0)],
)
def test_lamaria_s_knots(error_m: float, points: float) -> None:
    assert LAMARIA.score is not None
    score = LAMARIA.score.score(np.array([error_m]), 4)
    assert score.value == pytest.approx(100.0 * points / 80.0)
    assert score.missing == 3


@given(st.lists(st.floats(0.0, 20.0), min_size=1, max_size=20), st.integers(0, 5))
def test_recall_counts_what_is_missing(errors: list[float], missing: int) -> None:
    result = RecallRule((1.0, 5.0)).recall(np.array(errors), len(errors) + missing)
    expected = [100 * sum(e <= b for e in errors) / (len(errors) + missing) for b in (1.0, 5.0)]
    assert result.percent == pytest.approx(expected)


@given(st.lists(st.floats(0.0, 2.0), min_size=1, max_size=20))
def test_two_knots_are_the_area_under_the_curve_of_recall(errors: list[float]) -> None:
    score = KnotTable((0.0, 0.5), (1.0, 0.0)).score(np.array(errors), len(errors))
    bounds = (np.arange(20_000) + 0.5) / 20_000 * 0.5
    area = (np.array(errors)[:, None] <= bounds).mean()
    assert score.value == pytest.approx(100.0 * area, abs=0.01)


@pytest.mark.parametrize("name", ["svo2", "hdl"])
def test_known_scores(
    name: str, recording: Callable[[str], Trajectory], reference: Callable[[str], Any]
) -> None:
    points, whole = (recording(f"hilti_2021/Campus_2_{item}.txt") for item in ("prism", name))
    hilti = PROTOCOLS["hilti-2022"].score
    assert hilti is not None
    for key, estimate in (
        (f"{name}/prism_lever/interpolate_0.5/se3", whole),
        (f"{name}/first_half/interpolate_0.5/se3", whole[: len(whole) // 2]),
    ):
        known = reference("gnss")["hilti_2021"][key]
        result = evaluate(
            points,
            estimate,
            protocol_from("lamaria", gauge="se3", lever_arm=",".join(map(str, PRISM))),
        )
        assert result.score is not None
        assert result.score.value == pytest.approx(known["score"]["lamaria_2d"], rel=1e-9)
        assert result.recall is not None
        expected = [known["recall_percent"][item]["2d"] for item in ("1m", "5m")]
        assert result.recall.percent == pytest.approx(expected)
        steps = hilti.score(result.absolute.position_m, len(points))
        assert steps.value == pytest.approx(known["score"]["hilti-2022"])
        finer = PROTOCOLS["hilti-2023"].score
        assert finer is not None
        steps = finer.score(result.absolute.position_m, len(points))
        assert steps.value == pytest.approx(known["score"]["hilti-2023"])


def test_a_file_has_knots_and_recall(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "ours.yaml"
    file.write_text(
        "association: groundtruth-stamps\ngauge: yaw\nlengths: none\n"
        "score: {knots_m: [0, 0.08], points: [1, 0], dimensions: 2}\n"
        "recall: {bounds_m: [0.5], dimensions: 2}\n"
    )
    protocol = read_protocol(file)
    assert protocol.score == KnotTable((0.0, 0.08), (1.0, 0.0), dimensions=2)
    assert protocol.recall == RecallRule((0.5,), 2)
    stamps = range(1, 40)
    truth = [f"{t}.5 {t + 0.5} {(t + 0.5) ** 2 / 50} 0" for t in stamps]
    other = [f"{t / 5} {t / 5} {(t / 5) ** 2 / 50} 0 0 0 0.6 0.8" for t in range(1, 300)]
    (tmp_path / "points.txt").write_text("\n".join(truth))
    (tmp_path / "x.txt").write_text("\n".join(other))
    files = ["-g", str(tmp_path / "points.txt"), "-e", str(tmp_path / "x.txt")]
    assert main(["evaluate", *files, "--protocol", str(file)]) == 0
    text = capsys.readouterr().out
    assert "recall of all points (level): 100 % within 0.5 m" in text
    assert "of 100 for 39 points" in text


@pytest.mark.parametrize(
    "make",
    [
        lambda: KnotTable((0.0,), (1.0,)),
        lambda: KnotTable((0.1, 0.2), (1.0, 0.0)),
        lambda: KnotTable((0.0, 0.0), (1.0, 0.0)),
        lambda: KnotTable((0.0, 0.1), (1.0, 2.0)),
        lambda: KnotTable((0.0, 0.1), (0.0, 0.0)),
        lambda: KnotTable((0.0, 0.1), (1.0, 0.0), best=0.0),
        lambda: KnotTable((0.0, 0.1), (1.0, 0.0), dimensions=1),
        lambda: PointTable((0.1,), (1.0,), dimensions=4),
        lambda: PointTable((), ()),
        lambda: PointTable((0.1, 0.2), (1.0,)),
        lambda: PointTable((0.0, 0.1), (2.0, 1.0)),
        lambda: PointTable((0.2, 0.1), (2.0, 1.0)),
        lambda: PointTable((0.1,), (0.0,)),
        lambda: PointTable((0.1,), (1.0,), 0.0),
        lambda: RecallRule(()),
        lambda: RecallRule((0.0,)),
    ],
)
def test_tables_that_can_t_be_meant(make: Callable[[], object]) -> None:
    with pytest.raises(SettingsError):
        make()
