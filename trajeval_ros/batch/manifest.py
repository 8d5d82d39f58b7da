"""Runs from a manifest: a CSV or Parquet file with one row per run."""

from __future__ import annotations

import csv
import io
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from sys import intern
from typing import Any

from trajeval_ros.batch.patterns import is_url, split_topic
from trajeval_ros.batch.plan import PlannedRun, natural
from trajeval_ros.batch.remote_files import open_store, require_allowed, require_readable_scheme
from trajeval_ros.batch.results_table import load_pyarrow
from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.checks import require_known

_CSV, _PARQUET = ".csv", ".parquet"
_TRIAL = "trial"  # the only optional column
_COLUMNS = ("algorithm", "sequence", _TRIAL, "groundtruth", "estimate")
_OTHER_SEPARATORS = {";": "semicolons", "\t": "tabs"}
_EXAMPLE = f"write a header line {','.join(_COLUMNS)} and one line per run"

Row = dict[str, str]


def is_manifest(target: str) -> bool:
    """Return whether a path or URL is a manifest, by its ending."""
    return target.endswith((_CSV, _PARQUET))


def runs_in_manifest(target: str, hosts: Collection[str]) -> tuple[PlannedRun, ...]:
    """Return the runs that a manifest lists.

    The list is complete: other trials are not expected. An algorithm without any run of a sequence
    that another algorithm has is missing there. `target`: path or URL of the manifest. Relative
    paths in it start at its folder.
    """
    groups: dict[tuple[str, str], dict[str, PlannedRun]] = defaultdict(dict)
    for place, row in _rows(target):
        where = f"{target}, {place}"
        for column, value in row.items():
            if not value and column != _TRIAL:
                raise InputError(f"{where}: {column} is empty; fill it in or remove the row")
        # Texts that occur in many rows are stored once.
        run = PlannedRun(
            intern(row["algorithm"]),
            intern(row["sequence"]),
            intern(row.get(_TRIAL, "")),
            groundtruth=intern(_source(row["groundtruth"], target, hosts, where)),
            estimate=_source(row["estimate"], target, hosts, where),
        )
        trials = groups[run.algorithm, run.sequence]
        if run.trial in trials:
            raise InputError(
                f"{where}: the run {run.name} is listed twice; remove one, or name every trial in "
                f"the column {_TRIAL}"
            )
        trials[run.trial] = run
    if not groups:
        raise InputError(f"{target} lists no runs; {_EXAMPLE}")
    return tuple(_in_order(groups, target))


def _in_order(
    groups: dict[tuple[str, str], dict[str, PlannedRun]], target: str
) -> Iterator[PlannedRun]:
    sequences = natural({sequence for _, sequence in groups})
    for algorithm in dict.fromkeys(algorithm for algorithm, _ in groups):
        for sequence in sequences:
            trials = groups.get((algorithm, sequence))
            if trials is None:
                why = f"{target} lists no run of {algorithm} on {sequence}"
                yield PlannedRun(algorithm, sequence, "", missing=why)
            else:
                yield from (trials[trial] for trial in natural(trials))


def _source(text: str, target: str, hosts: Collection[str], where: str) -> str:
    """Return a SOURCE of a manifest, with its path from the manifest's folder on."""
    path, topic = split_topic(text)
    if "\0" in text:
        raise InputError(f"{where}: {text!r} has a character that is not valid in a path")
    if not is_url(path) and not Path(path).is_absolute():
        folder = target.rpartition("/")[0]
        path = f"{folder}/{path}" if is_url(target) else str(Path(folder) / path)
    if is_url(path):
        require_allowed(path, hosts, where)
        require_readable_scheme(path, where)
    return path + topic


def _rows(target: str) -> Iterator[tuple[str, Row]]:
    """Yield all rows with their places, "line 2" or "row 1"."""
    data = _content(target)
    yield from _csv_rows(target, data) if target.endswith(_CSV) else _parquet_rows(target, data)


def _content(target: str) -> bytes:
    if is_url(target):
        with open_store(target) as (files, path):
            data: bytes = files.cat_file(path)
            return data
    try:
        return Path(target).read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{target} does not exist; check the path") from error
    except OSError as error:
        raise InputError(f"{target} can't be read: {reason_of(error)}") from error


def _csv_rows(target: str, data: bytes) -> Iterator[tuple[str, Row]]:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{target}, line {line} is not UTF-8; save the file as UTF-8") from error
    _require_commas(text.partition("\n")[0], target)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        header = [cell.strip() for cell in next(reader, [])]
        _require_columns(header, target)
        for cells in reader:
            if not cells:
                continue
            place = f"line {reader.line_num}"
            if len(cells) != len(header):
                raise InputError(
                    f"{target}, {place}: {counted(len(cells), 'value')} for "
                    f"{counted(len(header), 'column')}; give one value per column"
                )
            yield place, dict(zip(header, map(str.strip, cells), strict=True))
    except csv.Error as error:
        raise InputError(
            f"{target}, line {reader.line_num} is not valid CSV: {error}; correct the line"
        ) from error


def _require_commas(header: str, target: str) -> None:
    """Refuse another separator, as spreadsheets write it with many regional settings."""
    for separator, name in _OTHER_SEPARATORS.items():
        names = {cell.strip(' "\r') for cell in header.split(separator)}
        if len(names.intersection(_COLUMNS)) > 1:
            raise InputError(
                f"{target}, line 1: the columns are separated by {name}; save the file with commas"
            )


def _parquet_rows(target: str, data: bytes) -> Iterator[tuple[str, Row]]:
    arrow, parquet = load_pyarrow()
    try:
        with parquet.ParquetFile(arrow.BufferReader(data)) as file:
            header = file.schema_arrow.names
            _require_columns(header, target)
            number = 0
            for batch in file.iter_batches():
                columns = [_texts(batch.column(name), name, target) for name in header]
                for cells in zip(*columns, strict=True):
                    number += 1
                    row = [(cell or "").strip() for cell in cells]
                    yield f"row {number}", dict(zip(header, row, strict=True))
    except (OSError, ValueError) as error:
        raise InputError(f"{target} is not a complete Parquet file; write it again") from error


def _texts(column: Any, name: str, target: str) -> list[str | None]:
    arrow, _ = load_pyarrow()
    try:
        texts: list[str | None] = column.cast(arrow.string()).to_pylist()
    except (ValueError, NotImplementedError) as error:
        raise InputError(f"{target}: column {name} is {column.type}; write it as text") from error
    return texts


def _require_columns(header: Sequence[str], target: str) -> None:
    if not any(header):
        raise InputError(f"{target} is empty; {_EXAMPLE}")
    require_known(header, _COLUMNS, target, "column")
    for name in _COLUMNS:
        if name not in header and name != _TRIAL:
            raise InputError(f"{target} has no column {name}; {_EXAMPLE}")
        if header.count(name) > 1:
            raise InputError(f"{target} has two columns {name}; remove one")
