"""Strings of many messages, as a list of different texts and one code per message."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.io.bags.byte_buffers import Buffer, are_same, bytes_type, gather

Offsets = int | Indices  # an int if all messages have the same: most of the time is saved


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
    codes = np.array([_code(each, is_terminated, names) for each in whole], dtype=np.int64)
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
