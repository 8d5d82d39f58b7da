"""Stored files of schema 1 are read; files of a schema that nobody knows are refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from trajeval_ros.batch import pooling, records, results_table
from trajeval_ros.batch.gate_values import GateValues
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.live import pair_file
from trajeval_ros.io.live.pair_file import PairWriter, read_pairs
from trajeval_ros.io.results import error_archive, result_json

STORED = Path(__file__).with_name("data") / "schema_1"


def test_the_schemas_are_these() -> None:
    # Whoever raises a number keeps a stored file of the one before, and says here what reads it.
    assert {
        result_json.SCHEMA,
        error_archive.SCHEMA,
        pair_file.FORMAT,
        results_table.SCHEMA,
        pooling.SCHEMA,
        records.SCHEMA,
    } == {
        "trajeval/1",
        "trajeval-errors/1",
        "trajeval-pairs/1",
        "trajeval-runs/1",
        "trajeval-pooled/1",
        "trajeval-run/1",
    }


def agree(stored: Any, made: Any, where: str = "") -> None:
    """Whatever was stored is still said, and means the same; more may be said."""
    if isinstance(stored, dict):
        assert stored.keys() <= made.keys(), where
        for key, value in stored.items():
            agree(value, made[key], f"{where}.{key}")
    elif isinstance(stored, list):
        assert len(stored) == len(made), where
        for place, value in enumerate(stored):
            agree(value, made[place], f"{where}[{place}]")
    elif isinstance(stored, float):
        assert made == pytest.approx(stored, rel=1e-6, abs=1e-9), where
    else:
        assert made == stored, where


def test_a_stored_live_run_gives_the_stored_result(tmp_path: Path) -> None:
    (tmp_path / "vio.pairs").write_bytes((STORED / "vio.pairs").read_bytes())
    assert main(["finish", str(tmp_path), "--quiet", "--output", str(tmp_path / "out")]) == 0
    stored = json.loads((STORED / "result.json").read_text())
    made = json.loads((tmp_path / "out" / "result.json").read_text())
    for each in (stored, made):
        each["provenance"].pop("inputs")
        for run in each["runs"]:
            run.pop("warnings")
            run["live"].pop("clock")
    agree(stored, made)
    with np.load(tmp_path / "out" / "errors.npz") as file:
        assert file["schema"] == error_archive.SCHEMA


def test_a_stored_table_is_a_baseline() -> None:
    values = GateValues(ResultsTable(STORED / "runs.parquet"))
    values.find("ate.position_m.rmse")
    rows = ResultsTable(STORED / "runs.parquet").select(
        ["algorithm", "rmse"], kind="ate", metric="position_m"
    )
    assert len(rows) == 8
    assert {row["algorithm"] for row in rows} == {"good", "bad"}
    assert all(0.0 < row["rmse"] < 1.0 for row in rows)


def test_a_table_of_another_schema_is_one_sentence(tmp_path: Path) -> None:
    table = pyarrow.parquet.read_table(STORED / "runs.parquet")
    metadata = {**table.schema.metadata, b"trajeval.schema": b"trajeval-runs/2"}
    path = tmp_path / "runs.parquet"
    pyarrow.parquet.write_table(table.replace_schema_metadata(metadata), path)
    with pytest.raises(InputError) as refused:
        ResultsTable(path)
    assert str(refused.value) == (
        f"{path} is of schema trajeval-runs/2, and this version of trajeval reads "
        "trajeval-runs/1; name another runs.parquet, or use the version that wrote it"
    )


def test_pairs_of_another_schema_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "vio.pairs"
    with monkeypatch.context() as patch:
        patch.setattr(pair_file, "FORMAT", "trajeval-pairs/2")
        PairWriter(path, {}).close()
    with pytest.raises(InputError, match="is of schema trajeval-pairs/2, and this version"):
        read_pairs(path)
    assert main(["finish", str(tmp_path), "--quiet"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
