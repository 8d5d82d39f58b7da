"""The results of all runs as a Parquet table with one row per run, metric and length."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros import __version__
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import extra_command, pyarrow_command
from trajeval_ros.io.json_file import require_schema
from trajeval_ros.io.writing import write_whole
from trajeval_ros.metrics.columns import arrow_array

if TYPE_CHECKING:
    import pyarrow

SCHEMA = "trajeval-runs/1"
OK, FAILED, MISSING = "ok", "failed", "missing"
ATE, RE, POOLED = "ate", "re", "re.pooled"
# Kinds of rows with one value, in column `mean`; its standard deviation, if known, is in `std`.
CALIBRATION, CONSISTENCY, LIKELIHOOD = "calibration", "consistency", "likelihood"
INTEGRITY, AVAILABLE = "integrity", "as_available"
STATISTICS = ("rmse", "mean", "median", "std", "min", "max", "p95")
_ROWS_AT_ONCE = 5000
_TEXTS = ("algorithm", "sequence", "trial", "status", "reason", "kind", "metric", "length")
_COLUMNS = {
    **dict.fromkeys(_TEXTS, "string"),
    **dict.fromkeys(("length_m", "duration_s", "mean_length_m", *STATISTICS), "float64"),
    "count": "int64",
    "pairs": "int64",
    **dict.fromkeys(("estimate_coverage", "groundtruth_coverage", "scale"), "float64"),
    **dict.fromkeys(("own_groundtruth_coverage", "common_span", "span_s"), "float64"),
    **dict.fromkeys(("groundtruth_span", "longest_gap_s"), "float64"),
    **dict.fromkeys(("longest_gap_m", "longest_gap_deg"), "float64"),
    "states_used": "int64",
    "poses": "int64",
    **dict.fromkeys(
        ("groundtruth", "estimate", "groundtruth_sha256", "estimate_sha256", "key", "warnings"),
        "string",
    ),
    "diagnosis": "string",
    **dict.fromkeys(("gauge", "protocol", "settings", "version"), "string"),
}
POOLED_SCHEMA = "trajeval-pooled/1"
QUANTILES = {"p5": 0.05, "p25": 0.25, "p75": 0.75}
_POOLED_COLUMNS = {
    **dict.fromkeys(("algorithm", "sequence", "kind", "metric", "length"), "string"),
    **dict.fromkeys(("length_m", *STATISTICS, *QUANTILES), "float64"),
    **dict.fromkeys(("count", "trials", "evaluated"), "int64"),
}


def write_table(
    path: Path, rows: Iterable[dict[str, Any]], title: str, settings: dict[str, Any], state: str
) -> None:
    """Write rows in groups; memory does not grow with their number."""
    arrow, parquet = load_pyarrow()
    schema = schema_of(_COLUMNS, SCHEMA, title, settings, state)
    constant = {
        "gauge": settings["gauge"],
        "protocol": settings["protocol"],
        "settings": json.dumps(settings),
        "version": __version__,
    }

    def write(temporary: Path) -> None:
        with parquet.ParquetWriter(temporary, schema) as writer:
            batch: list[dict[str, Any]] = []
            for row in rows:
                batch.append({**row, **constant})
                if len(batch) == _ROWS_AT_ONCE:
                    writer.write_table(arrow.Table.from_pylist(batch, schema=schema))
                    batch.clear()
            writer.write_table(arrow.Table.from_pylist(batch, schema=schema))

    write_whole(path, write)


def require_types(rows: Iterable[dict[str, Any]]) -> None:
    """Check that rows have values of the types of their columns.

    Raises:
        pyarrow.ArrowException: A value has another type.
    """
    arrow, _ = load_pyarrow()
    arrow.Table.from_pylist(list(rows), schema=schema_of(_COLUMNS, SCHEMA, "", {}, ""))


def schema_of(
    columns: Mapping[str, str], schema: str, title: str, settings: dict[str, Any], state: str
) -> pyarrow.Schema:
    """Return the columns, pyarrow's types by name, and the metadata of a comparison's table."""
    arrow, _ = load_pyarrow()
    head = {"schema": schema, "title": title, "settings": json.dumps(settings), "state": state}
    return arrow.schema(
        [(name, getattr(arrow, kind)()) for name, kind in columns.items()],
        metadata={f"trajeval.{name}": value for name, value in head.items()},
    )


def state_of(path: Path) -> str:
    """Return the hash of the inputs of a table; "" if it can't be read."""
    _, parquet = load_pyarrow()
    try:
        metadata = parquet.read_schema(path).metadata or {}
    except (OSError, ValueError):
        return ""
    return bytes(metadata.get(b"trajeval.state", b"")).decode(errors="replace")


class ResultsTable:
    """A written table, of which requested columns are read."""

    def __init__(self, path: Path) -> None:
        self._arrow, parquet = load_pyarrow()
        from pyarrow import compute

        self._compute = compute
        self.path = path
        try:
            # Stays open: a baseline may be replaced by the new table before the comparison.
            self._file = parquet.ParquetFile(path)
        except FileNotFoundError as error:
            raise InputError(f"{path} does not exist; check the path") from error
        except (OSError, ValueError) as error:
            raise self._damaged() from error
        self._schema = self._file.schema_arrow
        metadata = self._schema.metadata or {}
        schema = metadata.get(b"trajeval.schema", b"").decode(errors="replace")
        what, advice = (
            "table of trajeval compare",
            "give the runs.parquet of another output folder",
        )
        require_schema(path, schema, SCHEMA, what, advice)
        settings: Any = None
        with contextlib.suppress(ValueError):
            settings = json.loads(metadata.get(b"trajeval.settings", b""))
        if not isinstance(settings, dict):
            raise self._damaged()
        # Title of the comparison.
        self.title = metadata.get(b"trajeval.title", b"").decode(errors="replace")
        self.settings: dict[str, Any] = settings  # settings that its numbers depend on

    def select(
        self, columns: Iterable[str], **allowed: str | Sequence[str | None]
    ) -> list[dict[str, Any]]:
        """Return columns of the rows in which other columns have allowed values."""
        return list(self.rows(columns, **allowed))

    def rows(
        self, columns: Iterable[str], **allowed: str | Sequence[str | None]
    ) -> Iterator[dict[str, Any]]:
        """Yield the same row by row; memory holds one group of rows."""
        names = list(columns)
        sets = {
            name: [values] if isinstance(values, str) else list(values)
            for name, values in allowed.items()
        }
        for rows in self._groups([*dict.fromkeys((*names, *sets))]):
            for name, values in sets.items():
                rows = rows.filter(self._is_one_of(rows.column(name), values))
            yield from rows.select(names).to_pylist()

    def _is_one_of(self, column: Any, values: Sequence[str | None]) -> Any:
        texts = arrow_array(
            self._arrow, np.array([value for value in values if value is not None], dtype=str)
        )
        rows_found = self._compute.is_in(column, texts)
        return self._compute.or_(rows_found, column.is_null()) if None in values else rows_found

    def distinct(self, columns: Iterable[str]) -> list[dict[str, Any]]:
        """Return the distinct values of some columns, in order of first occurrence."""
        names = list(columns)
        rows_found: dict[tuple[Any, ...], None] = {}
        for rows in self._groups(names):
            rows_found.update(dict.fromkeys(zip(*rows.to_pydict().values(), strict=True)))
        return [dict(zip(names, values, strict=True)) for values in rows_found]

    def _groups(self, names: Sequence[str]) -> Iterator[pyarrow.Table]:
        """Yield columns, one group of rows after another."""
        for name in names:
            kinds = getattr(self._arrow, _COLUMNS[name])(), self._arrow.null()
            if name not in self._schema.names or self._schema.field(name).type not in kinds:
                raise InputError(
                    f"{self.path} has no column {name} of {_COLUMNS[name]}; create it again with "
                    "trajeval compare"
                )
        try:
            for batch in self._file.iter_batches(_ROWS_AT_ONCE, columns=names, use_threads=False):
                # Other writers give columns without values the type null.
                columns = [
                    batch.column(name).cast(getattr(self._arrow, _COLUMNS[name])())
                    for name in names
                ]
                rows = self._arrow.table(columns, names=list(names))
                rows.validate(full=True)  # texts may not be UTF-8
                yield rows
        except (OSError, ValueError) as error:
            raise self._damaged() from error

    def _damaged(self) -> InputError:
        if self.path.is_dir():
            return InputError(f"{self.path} is a folder; give the runs.parquet in it")
        return InputError(
            f"{self.path} is not a complete Parquet file; create it again with trajeval compare"
        )


def load_pyarrow() -> tuple[Any, Any]:
    """Return pyarrow and its Parquet part."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError as error:
        raise InputError(
            f"trajeval compare needs pyarrow; install it: {extra_command('compare')}"
        ) from error
    except ImportError as error:
        raise InputError(
            f"pyarrow is installed but can't be used ({error}): {pyarrow_command()}"
        ) from error
    return pyarrow, parquet


def write_pooled(
    path: Path, rows: list[dict[str, Any]], title: str, settings: dict[str, Any], state: str
) -> None:
    """Write the statistics over trials as Parquet, with the hash of their inputs."""
    arrow, parquet = load_pyarrow()
    schema = schema_of(_POOLED_COLUMNS, POOLED_SCHEMA, title, settings, state)
    table = arrow.Table.from_pylist(rows, schema=schema)
    write_whole(path, lambda temporary: parquet.write_table(table, temporary))


def read_pooled(path: Path) -> list[dict[str, Any]]:
    """Return the rows that `write_pooled` wrote."""
    _, parquet = load_pyarrow()
    with parquet.ParquetFile(path) as file:  # `read_table` imports pandas, if installed
        rows: list[dict[str, Any]] = file.read(use_threads=False).to_pylist()
    return rows
