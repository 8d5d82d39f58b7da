"""Rows of large plain tables, read by pyarrow: the same bits as by numpy in half the time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.text.lines import Advance
from trajeval_ros.io.text.stamps import WIDTH, Words
from trajeval_ros.io.text.table import TextTable


def read_with_arrow(
    table: TextTable, numbers: Sequence[int], exact: Sequence[int], advance: Advance | None
) -> tuple[Floats, list[Words]] | None:
    """Return columns of numbers (N, M) and columns of text (N,), by their indices.

    None if pyarrow is not installed or cannot read a row: the caller reads the table by numpy.
    """
    try:
        import pyarrow as pa
        from pyarrow import csv
    except ImportError:
        return None
    types = {str(at): pa.float64() for at in numbers} | {str(at): pa.binary() for at in exact}
    names = [str(at) for at in range(table.columns)]
    try:
        with table.path.open("rb") as file:
            content = csv.read_csv(
                file,
                csv.ReadOptions(use_threads=False, skip_rows=table.first, column_names=names),
                csv.ParseOptions(delimiter=table.separator or " ", quote_char=False),
                csv.ConvertOptions(
                    column_types=types, include_columns=list(types), null_values=[]
                ),
            )
    except pa.ArrowInvalid:
        return None
    values = np.empty((len(content), len(numbers)))
    for place, at in enumerate(numbers):
        values[:, place] = content.column(str(at)).to_numpy()
    words = [np.concatenate([_words(part) for part in content.column(str(at)).chunks])
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
