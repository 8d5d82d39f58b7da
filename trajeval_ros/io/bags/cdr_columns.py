"""Columns that serialised messages become."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Indices

Numbers = NDArray[Any]


@dataclass(frozen=True)
class StringColumn:
    """A column of strings: `names[codes[row]]` is the string of a row."""

    names: tuple[str, ...]
    codes: Indices


@dataclass(frozen=True)
class Columns:
    """Fields by column.

    Attributes:
        rows: (N,) int64, increasing: the number of the payload, or for elements of a sequence the
            row of the enclosing columns.
        numbers: (N,) or (N, k) by field.
        texts: Strings by field.
        sequences: Columns by field, with one row per element, in order. A sequence of numbers or
            strings has one column, with the empty name.
    """

    rows: Indices
    numbers: dict[str, Numbers]
    texts: dict[str, StringColumn]
    sequences: dict[str, Columns]


def joined(parts: Sequence[Columns], *, in_order: bool = False) -> Columns:
    """Return the concatenated columns of several parts.

    Args:
        parts: At least one, all of the same fields.
        in_order: Whether to sort the rows by payload. The sort is stable.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    rows = np.concatenate([part.rows for part in parts])
    order = np.argsort(rows, kind="stable") if in_order else np.arange(len(rows))
    moved = np.empty(len(rows), dtype=np.int64)
    moved[order] = np.arange(len(rows))
    befores = np.cumsum([0, *(len(part.rows) for part in parts)])
    sequences = {}
    for path in first.sequences:
        inner = [
            dataclasses.replace(
                part.sequences[path], rows=moved[before + part.sequences[path].rows]
            )
            for part, before in zip(parts, befores, strict=False)
        ]
        sequences[path] = joined(inner, in_order=True)
    return Columns(
        rows[order],
        {
            path: np.concatenate([part.numbers[path] for part in parts])[order]
            for path in first.numbers
        },
        {path: _joined_texts([part.texts[path] for part in parts], order) for path in first.texts},
        sequences,
    )


def _joined_texts(parts: Sequence[StringColumn], order: Any) -> StringColumn:
    names: dict[str, int] = {}
    codes = []
    for part in parts:
        known = [names.setdefault(name, len(names)) for name in part.names]
        codes.append(np.array(known, dtype=np.int64)[part.codes])
    return StringColumn(tuple(names), np.concatenate(codes)[order])
