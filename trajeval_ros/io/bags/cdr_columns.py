"""Columns that serialised messages become, and the codes of their strings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.io.bags.blocks import Buffer, are_same, bytes_type, gather

Numbers = NDArray[Any]
Offsets = int | Indices  # an int if all messages have the same: most of the time is saved


@dataclass(frozen=True, eq=False)
class StringColumn:
    """A column of strings: `names[codes[row]]` is the string of a row."""

    names: tuple[str, ...]
    codes: Indices


@dataclass(frozen=True, eq=False)
class Columns:
    """Fields by column."""

    # (N,) int64, increasing: the number of the payload, or for elements of a sequence the row of
    # the enclosing columns.
    rows: Indices
    numbers: dict[str, Numbers]  # (N,) or (N, k) by field
    texts: dict[str, StringColumn]  # strings by field
    # Columns by field, with one row per element, in order. A sequence of numbers or strings has
    # one column, with the empty name.
    sequences: dict[str, Columns]


def joined(parts: Sequence[Columns], *, in_order: bool = False) -> Columns:
    """Return the concatenated columns of several parts.

    `in_order`: whether to sort the rows by payload. The sort is stable.
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


def texts_at(
    buffer: Buffer, places: Indices, lengths: Offsets, is_terminated: bool
) -> tuple[tuple[str, ...], Offsets]:
    """Return the strings at the places (N,) as names and codes; -1 is an invalid string."""
    names: dict[str, int] = {}
    if isinstance(lengths, int):
        code = _texts_of_length(buffer, places, lengths, is_terminated, names)
        return tuple(names), code
    codes = np.empty(len(places), dtype=np.int64)
    for length in np.unique(lengths).tolist():
        rows = np.flatnonzero(lengths == length)
        codes[rows] = _texts_of_length(buffer, places[rows], length, is_terminated, names)
    return tuple(names), codes


def _texts_of_length(
    buffer: Buffer, places: Indices, length: int, is_terminated: bool, names: dict[str, int]
) -> Offsets:
    """Return the codes of strings of one length. New strings are added to the names."""
    if not len(places):
        return np.zeros(0, dtype=np.int64)
    if not length:
        return names.setdefault("", len(names))
    cells = gather(buffer, places, bytes_type(length))
    if are_same(cells):
        return _code(cells[0].tobytes(), is_terminated, names)
    contents, which = np.unique(cells.view(f"S{length}"), return_inverse=True)
    # numpy removes zeros at the end of strings, the terminator included.
    whole = [content.ljust(length, b"\0") for content in contents.tolist()]
    codes = np.array([_code(item, is_terminated, names) for item in whole], dtype=np.int64)
    return np.asarray(codes[which])


def _code(content: bytes, is_terminated: bool, names: dict[str, int]) -> int:
    """Return the code of a string, -1 if it is invalid."""
    if is_terminated:
        if content[-1]:
            return -1
        content = content[:-1]
    try:
        return names.setdefault(content.decode(), len(names))
    except UnicodeDecodeError:
        return -1
