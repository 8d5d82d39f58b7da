"""Tables of made-up numbers, and what gates say of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.batch.gate import Gate, GateValues
from trajeval_ros.batch.gates import Judgement, judge
from trajeval_ros.batch.gates_output import to_json
from trajeval_ros.batch.results_table import ResultsTable

GATE = "ate.position_m.rmse worse than 5 %"


def made_table(
    path: Path, trials: dict[str, list[float | None]], hashes: dict[str, list[str]] | None = None
) -> GateValues:
    """Return a table of an algorithm's ATE and coverage by sequence; None is a failed run."""
    import pyarrow
    from pyarrow import parquet

    texts = (
        "status",
        "reason",
        "groundtruth_sha256",
        "estimate_sha256",
        "kind",
        "metric",
        "length",
    )
    statistics = ("mean", "median", "std", "min", "max", "p95", "estimate_coverage")
    rows = []
    for sequence, values in trials.items():
        for trial, value in enumerate(values):
            row = dict.fromkeys(texts) | dict.fromkeys(statistics)
            row |= {"algorithm": "vio", "sequence": sequence, "trial": str(trial)}
            row |= {"rmse": value, "own_groundtruth_coverage": value}
            row |= {"status": "failed", "reason": "tracking was lost", "span_s": None}
            if value is not None:
                own = (hashes or {}).get(sequence) or [f"{value!r} {index}" for index in range(99)]
                row |= {"status": "ok", "reason": None, "kind": "ate", "metric": "position_m"}
                row |= {"groundtruth_sha256": "g", "estimate_sha256": own[trial], "span_s": 60.0}
            rows.append(row)
    metadata = {"trajeval.schema": "trajeval-runs/1", "trajeval.title": "made",
                "trajeval.settings": "{}"}  # fmt: skip
    arrow = pyarrow.Table.from_pylist(rows)
    parquet.write_table(arrow.replace_schema_metadata(metadata), path)
    return GateValues(ResultsTable(path))


def trials_of(
    sequences: int, count: int, factor: float = 1.0, spread: float = 0.1, seed: int = 0
) -> dict[str, list[float | None]]:
    generator = np.random.default_rng(seed)
    return {
        f"s{index}": list(factor * generator.lognormal(0.0, spread, count))
        for index in range(sequences)
    }


def judged(
    folder: Path,
    before: dict[str, list[float | None]],
    now: dict[str, list[float | None]],
    *gates: str,
    paired: bool = False,
) -> Judgement:
    tables = (made_table(folder / "old.parquet", before), made_table(folder / "new.parquet", now))
    return judge([Gate.parse(gate) for gate in gates or (GATE,)], *tables, paired=paired)


def pooled_word(judgement: Judgement) -> str:
    pooled = judgement.gates[0].pooled
    assert pooled is not None
    return pooled.verdict


def as_json(judgement: Judgement, title: str = "runs", remarks: Sequence[str] = ()) -> Any:
    """Return the judgement as JSON says it; refuses NaN and infinities."""

    def refused(word: str) -> None:
        raise AssertionError(word)

    text = to_json(judgement, title, remarks)
    assert text == to_json(judgement, title, remarks)
    return json.loads(text, parse_constant=refused)
