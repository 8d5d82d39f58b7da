"""Positions of the numbers or fields in a block of lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Indices

Bytes = NDArray[np.uint8]

_LONGEST_WORD = 400  # characters; longer words are not numbers and need too much memory
_PADDING = b" " * _LONGEST_WORD  # keeps the fixed-width words of `characters_of` in the block


class RowError(ValueError):
    """A row that can't be read."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line = line  # index of the line in the block, from 0
        self.reason = reason  # description of the error


class WordError(ValueError):
    """A word that is not a number."""

    def __init__(self, start: int, reason: str) -> None:
        super().__init__(reason)
        self.start = start  # index of the first character in the padded block
        self.reason = reason  # description of the error


@dataclass(frozen=True, eq=False)
class Tokens:
    """Positions of numbers in a block of text."""

    text: Bytes  # (B,), bytes of the padded block
    starts: Indices  # (N,) or (N, columns), index of the first character
    ends: Indices  # same shape, index after the last character
    # Same shape, index of the decimal point, or `ends` if there is none. None if a word of the
    # block has characters other than digits, one leading sign and one point.
    dots: Indices | None

    def __getitem__(self, pick: Indices | tuple[slice, slice | list[int] | int]) -> Tokens:
        """Return the selected numbers as arrays of one dimension."""
        return Tokens(
            self.text,
            np.ravel(self.starts[pick]),
            np.ravel(self.ends[pick]),
            None if self.dots is None else np.ravel(self.dots[pick]),
        )


def tokenize(block: bytes, columns: int) -> Tokens:
    """Return the positions (N, columns) of the numbers of all lines.

    Any number of spaces, tabs, commas and semicolons separates numbers. Empty lines are skipped.
    """
    text = _padded(block)
    separates = text <= ord(" ")
    for separator in b",;":
        if separator in block:
            separates |= text == separator
    edges = np.flatnonzero(separates[1:] != separates[:-1])
    edges += 1
    starts, ends = edges[0::2], edges[1::2]
    _check_lines(text, starts, ends, columns)

    shape = (-1, columns)
    dots = _points(text, separates, starts, ends, columns)
    return Tokens(
        text,
        starts.reshape(shape),
        ends.reshape(shape),
        None if dots is None else dots.reshape(shape),
    )


def _points(
    text: Bytes, separates: Booleans, starts: Indices, ends: Indices, columns: int
) -> Indices | None:
    """Return `Tokens.dots` (N,), or None as described there."""
    dots = np.flatnonzero(text == ord("."))
    first = text[starts]
    signs = np.count_nonzero((first == ord("-")) | (first == ord("+")))
    others = np.count_nonzero(text < ord("0")) - np.count_nonzero(separates)
    plain = text.max() <= ord("9") and others == signs + len(dots)
    return _dot_of_each(starts, ends, dots, columns) if plain else None


def _check_lines(text: Bytes, starts: Indices, ends: Indices, columns: int) -> None:
    """Check that every line has `columns` numbers or none."""
    is_newline = text == ord("\n")
    last_ends = ends[columns - 1 :: columns]
    if (
        len(last_ends) * columns == len(starts)
        and is_newline[last_ends].all()
        and np.count_nonzero(is_newline) == len(last_ends) + 1  # `_padded` appends one
    ):
        return
    newlines = np.flatnonzero(is_newline)
    per_line = np.diff(np.searchsorted(starts, newlines), prepend=0)
    wrong = np.flatnonzero((per_line != columns) & (per_line != 0))
    if len(wrong):
        line = int(wrong[0])
        count = int(per_line[line])
        raise _wrong_count(line, count, columns)


def _dot_of_each(starts: Indices, ends: Indices, dots: Indices, columns: int) -> Indices | None:
    """Return `Tokens.dots` (N,) from the indices of all points; None if a word has two points."""
    if len(dots) == len(starts) and ((starts <= dots) & (dots < ends)).all():
        return dots
    # Usually the same columns have points in all rows. This check is faster than a search.
    in_first_row = dots[: dots.searchsorted(ends[columns - 1])]
    pattern = ends[:columns].searchsorted(in_first_row, side="right")
    owners = (np.arange(0, len(starts), columns)[:, None] + pattern).ravel()
    if len(owners) != len(dots) or not ((starts[owners] <= dots) & (dots < ends[owners])).all():
        owners = ends.searchsorted(dots, side="right")
    if (np.diff(owners) == 0).any():
        return None
    dot_of_each = ends.copy()
    dot_of_each[owners] = dots
    return dot_of_each


def tokenize_fields(block: bytes, columns: int, separator: str) -> Tokens:
    """Return the positions (N, columns) of the fields of all lines, with one separator between.

    Fields can be empty or text. A separator between double quotes is text. Spaces and quotes
    around a field are removed. Empty lines are skipped.
    """
    text = _padded(block)
    is_newline = text == ord("\n")
    separates = text == ord(separator)
    if b'"' in block:
        separates &= (np.cumsum(text == ord('"')) & 1) == 0
    separates |= is_newline
    ends = np.flatnonzero(separates)
    starts = np.concatenate([[len(_PADDING)], ends[:-1] + 1])
    starts, stops = _trimmed(text, starts, ends)
    last = np.flatnonzero(is_newline[ends])  # index of the last field of every line
    per_line = np.diff(last, prepend=-1)
    blank = (per_line == 1) & (starts[last] == stops[last])
    wrong = np.flatnonzero((per_line != columns) & ~blank)
    if len(wrong):
        raise _wrong_count(int(wrong[0]), int(per_line[wrong[0]]), columns)
    if blank.any():
        keep = np.repeat(~blank, per_line)
        starts, stops = starts[keep], stops[keep]
    separates |= text <= ord(" ")
    dots = None
    if np.count_nonzero(~separates) == (stops - starts).sum():  # else a field contains spaces
        dots = _points(text, separates, starts, stops, columns)
    shape = (-1, columns)
    return Tokens(
        text,
        starts.reshape(shape),
        stops.reshape(shape),
        None if dots is None else dots.reshape(shape),
    )


def _trimmed(text: Bytes, starts: Indices, ends: Indices) -> tuple[Indices, Indices]:
    """Return the starts and ends of fields without the spaces and quotes around them."""
    around = text <= ord(" ")
    if (text == ord('"')).any():
        around |= text == ord('"')
    # Every block ends with an empty line. Therefore at least one field is empty.
    rows = np.flatnonzero((starts < ends) & (around[starts] | around[ends - 1]))
    if not len(rows):
        return starts, ends
    solid = np.append(np.flatnonzero(~around), len(text))
    begins, stops = starts[rows], ends[rows]
    firsts = np.minimum(solid[np.searchsorted(solid, begins)], stops)
    lasts = solid[np.searchsorted(solid, stops) - 1] + 1
    starts, ends = starts.copy(), ends.copy()
    starts[rows], ends[rows] = firsts, np.clip(lasts, firsts, stops)
    return starts, ends


def _padded(block: bytes) -> Bytes:
    if b"\0" in block:
        line = block.count(b"\n", 0, block.index(b"\0"))
        raise RowError(line, "contains zero bytes, as after a crash of the recorder")
    return np.frombuffer(b"".join((_PADDING, block, b"\n", _PADDING)), dtype=np.uint8)


def _wrong_count(line: int, count: int, columns: int) -> RowError:
    return RowError(line, f"{columns} columns expected, found {count}")


def characters_of(tokens: Tokens) -> Bytes:
    """Return the characters (N, width) of the numbers, with zero bytes after their ends."""
    lengths = tokens.ends - tokens.starts
    width = int(lengths.max(initial=1))
    if width > _LONGEST_WORD:
        raise WordError(
            int(tokens.starts[lengths.argmax()]), f"contains a word of {width} characters"
        )
    words: NDArray[np.bytes_] = np.ndarray(
        (len(tokens.text) - width,), dtype=f"S{width}", buffer=tokens.text.data, strides=(1,)
    )
    characters = words[tokens.starts].view(np.uint8).reshape(-1, width)
    characters *= np.arange(width) < lengths[:, None]
    return characters


def line_of(tokens: Tokens, index: int) -> int:
    """Return the index, from 0, of the line in the block that contains a character."""
    return int(np.count_nonzero(tokens.text[:index] == ord("\n")))
