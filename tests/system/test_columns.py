"""What an evaluation shows and gives to other libraries: reprs, HTML, columns, tables."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from strategies import make_pair

from trajeval_ros import write_result
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.pipeline.outcome import FailedRun, Outcome
from trajeval_ros.pipeline.pipeline import evaluate, run
from trajeval_ros.pipeline.request import Request

HOSTILE = '<script>alert("x")</script> & co'


def outcome_of(name: str = "vio") -> Outcome:
    pair = make_pair(3, 300, smooth=True)
    estimate = dataclasses.replace(pair.estimate, name=name)
    return run(pair.groundtruth, [estimate], Request(Protocol(gauge="yaw", lengths=(2, "1s"))))


def evaluation_of(name: str = "vio") -> Evaluation:
    return outcome_of(name).runs[0].evaluation


def test_reprs_are_short_and_without_arrays() -> None:
    outcome = outcome_of()
    outcome = dataclasses.replace(outcome, failed=(FailedRun("slam", "slam.txt", "it is empty"),))
    evaluation = outcome.runs[0].evaluation
    assert evaluation.relative is not None
    for item in (outcome, outcome.runs[0], evaluation, evaluation.relative[0]):
        text = repr(item)
        assert len(text.splitlines()) <= 8
        assert len(text) < 500
        assert "array(" not in text
    position = evaluation.ate["position_m"]
    assert position is not None
    assert f"{position.rmse:.4g} m" in repr(evaluation)
    assert f"{position.rmse:.4g} m" in repr(outcome)
    assert "slam: failed it is empty" in repr(outcome)
    assert len(repr(position).splitlines()) == 1


def test_damage_is_what_remarks_of_missing_data_say_once() -> None:
    levels = [("a", Level.ERROR), ("b", Level.WARNING), ("a", Level.ERROR), ("c", Level.ERROR)]
    remarks = [Remark(level, "damage", text) for text, level in levels]
    runs: Any = [
        SimpleNamespace(evaluation=SimpleNamespace(remarks=part))
        for part in (remarks[:2], remarks[2:])
    ]
    assert dataclasses.replace(outcome_of(), runs=tuple(runs)).damage == ("a", "c")


@pytest.mark.parametrize("name", ["vio", HOSTILE])
def test_html_is_well_formed_and_shows_names_as_they_are(name: str) -> None:
    outcome = outcome_of(name)
    for item in (outcome, outcome.runs[0].evaluation):
        html = item._repr_html_()
        assert "<script" not in html
        tree = ElementTree.fromstring(html)
        assert name in " ".join(tree.itertext())
        widths = {len(row) for row in tree.iter("tr")}
        assert len(widths) == 1


def test_columns_are_the_errors_themselves() -> None:
    evaluation = evaluation_of()
    columns = evaluation.to_columns()
    assert {len(column) for column in columns.values()} == {len(evaluation.association)}
    np.testing.assert_array_equal(columns["position_m"], evaluation.absolute.position_m)
    assert columns["stamps"].dtype == np.int64
    assert evaluation.relative is not None
    for item, spelled in zip(evaluation.relative, (2.0, "1s"), strict=True):
        relative = evaluation.to_columns(spelled)
        assert {len(column) for column in relative.values()} == {len(item.errors.ends)}
        np.testing.assert_array_equal(relative["position_m"], item.errors.position_m)


def test_a_length_that_was_not_computed_is_refused() -> None:
    with pytest.raises(SettingsError, match=re.escape("no relative errors of 9m; available: 2m")):
        evaluation_of().to_columns(9)


def test_arrow_has_the_same_numbers() -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing")
    evaluation = evaluation_of()
    table = evaluation.to_arrow()
    assert table.num_rows > 0
    assert "position_m" in table.column_names
    columns = evaluation.to_columns()
    for name in ("stamps", "position_m", "rotation_deg"):
        np.testing.assert_array_equal(table[name].to_numpy(), columns[name])
    for at, axis in enumerate("xyz"):
        column = table[f"position_world_m_{axis}"].to_numpy()
        np.testing.assert_array_equal(column, columns["position_world_m"][:, at])


def test_tables_have_the_columns_of_the_written_one(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is missing")
    pytest.importorskip("pyarrow", reason="pyarrow is missing")
    outcome = outcome_of()
    write_result(outcome, tmp_path)
    written = pandas.read_parquet(tmp_path / "errors.parquet")
    (frame,) = (item.evaluation.to_pandas() for item in outcome.runs)
    pandas.testing.assert_frame_equal(frame, written, check_dtype=False)
    assert outcome.runs[0].evaluation.to_arrow().column_names == list(written.columns)


def test_pandas_has_the_same_numbers() -> None:
    pytest.importorskip("pandas", reason="pandas is missing")
    evaluation = evaluation_of()
    frame = evaluation.to_pandas("2m")
    assert len(frame) > 0
    assert "position_m" in frame.columns
    for name, column in evaluation.to_columns("2m").items():
        np.testing.assert_array_equal(frame[name].to_numpy(), column)


@pytest.mark.parametrize("package", ["pyarrow", "pandas"])
def test_a_missing_package_gets_one_sentence(
    package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    evaluation = evaluation_of()
    monkeypatch.setitem(sys.modules, package, None)
    ask = evaluation.to_arrow if package == "pyarrow" else evaluation.to_pandas
    with pytest.raises(InputError, match=f"needs {package}; install it"):
        ask()


@pytest.mark.parametrize("columns", [3, 7])
def test_live_states_may_lack_columns(columns: int) -> None:
    pair = make_pair(3, 300, smooth=True)
    live = OnlineEvaluator()
    for add, side in (
        (live.add_groundtruth, pair.groundtruth),
        (live.add_estimate, pair.estimate),
    ):
        add(side if columns == 7 else dataclasses.replace(side, quaternions=None))
    live.update(at_end=True)
    result = live.snapshot().ate
    sides = [
        item if columns == 7 else dataclasses.replace(item, quaternions=None)
        for item in (pair.groundtruth, pair.estimate)
    ]
    expected = evaluate(*sides).ate
    assert expected["position_m"] is not None
    assert result["position_m"] is not None
    assert result["position_m"].count == expected["position_m"].count
    assert result["position_m"].rmse == pytest.approx(expected["position_m"].rmse, abs=1e-9)
    assert (result["rotation_deg"] is None) == (columns == 3)
