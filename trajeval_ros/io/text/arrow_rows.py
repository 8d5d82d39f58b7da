"""Rows of large plain tables, read by pyarrow: the same bits as by numpy in half the time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.text.lines import Advance
from trajeval_ros.io.text.stamps import WIDTH, Words


def read_with_arrow(
    path: Path,
    first: int,
    names: Sequence[str],
    separator: str,
    numbers: Sequence[int],
    exact: Sequence[int],
    advance: Advance | None,
) -> tuple[Floats, list[Words]] | None:
    """Return columns of numbers (N, M) and columns of text (N,), by their indices.

    Args:
        path: A file without quotes and comments.
        first: Number of its lines above the first row.
        names: Different names of all its columns.
        separator: One character.
        numbers: Indices of the columns of numbers.
        exact: Indices of the columns of text.
        advance: Progress callback.

    None if pyarrow is not installed or cannot read a row: the caller reads the table by numpy.
    """
    try:
        import pyarrow as pa
        from pyarrow import csv
    except ImportError:
        return None
    types = {names[at]: pa.float64() for at in numbers}
    types |= {names[at]: pa.binary() for at in exact}
    try:
        with path.open("rb") as file:
            content = csv.read_csv(
                file,
                csv.ReadOptions(use_threads=False, skip_rows=first, column_names=list(names)),
                csv.ParseOptions(delimiter=separator, quote_char=False),
                csv.ConvertOptions(
                    column_types=types, include_columns=list(types), null_values=[]
                ),
            )
    except pa.ArrowInvalid:
        return None
    values = np.empty((len(content), len(numbers)))
    for place, at in enumerate(numbers):
        values[:, place] = content.column(names[at]).to_numpy()
    words = [np.concatenate([_words(part) for part in content.column(names[at]).chunks])
             for at in exact]  # fmt: skip
    if advance is not None:
        advance(1, 1)
    return (values, words) if all(column.itemsize < WIDTH for column in words) else None


def _words(part: Any) -> Words:
    """Return an array of pyarrow as text of one width."""
    _, places, letters = part.buffers()
    ends = np.frombuffer(places, np.int32)[part.offset : part.offset + len(part) + 1]
    width = int(ends[1] - ends[0])
    if not width or (np.diff(ends) != width).any():
        return np.array(part.to_pylist(), dtype=np.bytes_)
    return np.frombuffer(letters, f"S{width}", len(part), int(ends[0]))
