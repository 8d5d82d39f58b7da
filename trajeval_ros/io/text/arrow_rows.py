"""Rows of large plain tables, read by pyarrow: the same bits as by numpy in half the time."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajeval_ros.io.text.lines import Advance
from trajeval_ros.io.text.names import Layout
from trajeval_ros.io.text.stamps import WIDTH, Words
from trajeval_ros.io.text.table import EXACT, Rows, TextTable, require_rows


def read_with_arrow(table: TextTable, layout: Layout, advance: Advance | None) -> Rows | None:
    """Read the rows of a plain table in a file without compression.

    None if pyarrow is not installed or cannot read a row: the caller reads the table by numpy.
    """
    try:
        import pyarrow as pa
        from pyarrow import csv
    except ImportError:
        return None
    names = [str(at) for at in range(table.columns)]
    exact = {name: names[at] for at, name in enumerate(layout.columns) if name in EXACT}
    groups = {group: [names[at] for at in places] for group, places in layout.groups.items()}
    types = dict.fromkeys(exact.values(), pa.binary())
    types |= {name: pa.float64() for of_group in groups.values() for name in of_group}
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
    require_rows(table.path, len(content))
    texts = {
        name: np.concatenate([_words(part) for part in content.column(at).chunks])
        for name, at in exact.items()
    }
    if advance is not None:
        advance(table.size, table.size)
    if any(words.itemsize >= WIDTH for words in texts.values()):
        return None
    columns = {
        group: np.column_stack([content.column(name).to_numpy() for name in of_group])
        for group, of_group in groups.items()
    }
    return Rows(len(content), dict(texts), columns)


def _words(part: Any) -> Words:
    """Return an array of pyarrow as text of one width."""
    _, places, letters = part.buffers()
    ends = np.frombuffer(places, np.int32)[part.offset : part.offset + len(part) + 1]
    width = int(ends[1] - ends[0])
    if not width or (np.diff(ends) != width).any():
        return np.array(part.to_pylist(), dtype=np.bytes_)
    return np.frombuffer(letters, f"S{width}", len(part), int(ends[0]))
