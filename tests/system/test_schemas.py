"""Stored files of earlier schemas are read or refused; those of schemas to come are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")

import pyarrow
import pyarrow.parquet
from paths import TESTS

from trajeval_ros import run, simulate, write_result
from trajeval_ros.batch import records, results_table
from trajeval_ros.batch.gate import GateValues
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import install_command
from trajeval_ros.io.live import state_file
from trajeval_ros.io.live.state_file import StateWriter, read_states
from trajeval_ros.io.results import error_archive, result_json

DATA = TESTS / "data"
STORED = DATA / "schema_1"


def test_the_schemas_are_these() -> None:
    # Whoever raises a number keeps a stored file of the one before, and says here what reads it.
    assert {
        result_json.SCHEMA,
        error_archive.SCHEMA,
        error_archive.TABLE_SCHEMA,
        state_file.FORMAT,
        results_table.SCHEMA,
        results_table.POOLED_SCHEMA,
        records.SCHEMA,
    } == {
        "trajeval/3",
        "trajeval-errors/1",
        "trajeval-error-table/1",
        "trajeval-states/1",
        "trajeval-runs/1",
        "trajeval-pooled/1",
        "trajeval-run/2",
    }


def test_a_folder_of_version_0_3_names_what_reads_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "vio.pairs").write_bytes((STORED / "vio.pairs").read_bytes())
    assert main(["finish", str(tmp_path), "--quiet", "--output", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == (
        f"trajeval: {tmp_path} is of version 0.3, which recorded pairs; read it with that "
        f"version: {install_command('trajeval-ros==0.3.*')}\n"
    )
    assert not (tmp_path / "out").exists()


def test_results_name_their_schema(tmp_path: Path) -> None:
    flight = simulate(seed=1, duration_s=10.0)
    result = write_result(run(flight.groundtruth, [flight.estimate]), tmp_path)
    assert json.loads(result.read_text())["schema"] == result_json.SCHEMA
    with np.load(tmp_path / "errors.npz") as file:
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
        f"{path} has schema trajeval-runs/2, and this version reads trajeval-runs/1; give the "
        "runs.parquet of another output folder, or use the version that wrote it"
    )


def test_states_of_a_later_schema_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "vio.states"
    with monkeypatch.context() as patch:
        patch.setattr(state_file, "FORMAT", "trajeval-states/99")
        StateWriter(path, {}).close()
    with pytest.raises(InputError, match="has schema trajeval-states/99, and this version"):
        read_states(path)
