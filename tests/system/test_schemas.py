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
from trajeval_ros.io.live import pair_file
from trajeval_ros.io.live.pair_file import PairWriter, read_pairs
from trajeval_ros.io.results import error_archive, result_json

DATA = TESTS / "data"
STORED = DATA / "schema_1"


def test_the_schemas_are_these() -> None:
    # Whoever raises a number keeps a stored file of the one before, and says here what reads it.
    assert {
        result_json.SCHEMA,
        error_archive.SCHEMA,
        error_archive.TABLE_SCHEMA,
        pair_file.FORMAT,
        results_table.SCHEMA,
        results_table.POOLED_SCHEMA,
        records.SCHEMA,
    } == {
        "trajeval/2",
        "trajeval-errors/1",
        "trajeval-error-table/1",
        "trajeval-pairs/4",
        "trajeval-runs/1",
        "trajeval-pooled/1",
        "trajeval-run/2",
    }


def test_stored_pairs_of_schema_1_are_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # They lack the groundtruth between pairs, without which its path is not known.
    path = tmp_path / "vio.pairs"
    path.write_bytes((STORED / "vio.pairs").read_bytes())
    assert main(["finish", str(tmp_path), "--quiet", "--output", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == (
        f"trajeval: {path} has schema trajeval-pairs/1, and this version reads trajeval-pairs/4; "
        "evaluate a recording of the run, or use the version that wrote it\n"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("schema", [2, 3])
def test_stored_pairs_of_earlier_schemas_are_read(tmp_path: Path, schema: int) -> None:
    # Those of schema 2 hold no covariances. The numbers are of the version that wrote them.
    path = tmp_path / "vio.pairs"
    path.write_bytes((DATA / f"schema_{schema}" / "vio.pairs").read_bytes())
    assert read_pairs(path).covariances is None
    file = tmp_path / "result.json"
    assert main(["finish", str(tmp_path), "--quiet", "--json", str(file)]) == 0
    [evaluated] = json.loads(file.read_text())["runs"]
    assert evaluated["association"]["pairs"] == 19
    assert evaluated["ate"]["position_m"]["rmse"] == pytest.approx(0.18078643878, rel=1e-9)
    if schema == 3:  # its sentences have no level and code
        read, lost = evaluated["estimate"]["remarks"][0], evaluated["remarks"][-1]
        assert read["text"] == "format: nav_msgs/msg/Odometry"
        assert (lost["level"], lost["code"]) == ("warning", "live_run")
        assert "1 message of /vio lost" in lost["text"]


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


def test_pairs_of_a_later_schema_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "vio.pairs"
    with monkeypatch.context() as patch:
        patch.setattr(pair_file, "FORMAT", "trajeval-pairs/99")
        PairWriter(path, {}).close()
    with pytest.raises(InputError, match="has schema trajeval-pairs/99, and this version"):
        read_pairs(path)
