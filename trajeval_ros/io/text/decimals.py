"""Rows of decimal numbers to float64, a block of bytes at a time, without a loop over rows.

Why not `np.loadtxt`: reading two trajectories of a million rows with it costs more than all of
their evaluation, it can't read stamps exactly, and it takes either spaces or commas. Here, eight
digits are one 64-bit word and three multiplications (SWAR), for all numbers of a column at once.

A number with at most 15 or so digits is an integer below 2**53 divided by a power of ten below
10**22. Both are exact in float64, so that the one division rounds correctly: the result is the
same float that `float(text)` gives, to the last bit. Numbers with more digits, exponents or NaN
are left to numpy's own conversion, which is slower and knows all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.io.text.stamps import POWERS_OF_TEN, ExactNumbers, billionths, exact_numbers

Bytes = NDArray[np.uint8]

_LONGEST_NUMBER = 400  # characters; nobody writes longer ones, and memory has an end
_PADDING = b" " * _LONGEST_NUMBER  # so that words that reach beyond a number end in the block
_MOST_DIGITS = 19  # of an integer that surely fits uint64
_FLOAT_POWERS: Floats = POWERS_OF_TEN.astype(np.float64)
# From this whole part on, `whole * 10**places + fraction` may be 2**53 or more.
_TOO_LARGE_WHOLE = np.array([2**53 // 10**places for places in range(20)], dtype=np.uint64)
# Keeps the low halves of the last `count` bytes of a word.
_DIGIT_MASKS = np.array(
    [0x0F0F0F0F0F0F0F0F << 8 * (8 - count) & 2**64 - 1 for count in range(9)], dtype=np.uint64
)


class RowError(ValueError):
    """A row that can't be read: the index of its line in the block, and what is wrong with it."""

    def __init__(self, line: int, reason: str) -> None:
        """Remember the line, which the caller turns into a number within the file."""
        super().__init__(reason)
        self.line = line
        self.reason = reason


class WordError(ValueError):
    """Something that is not a number: the index of its first character, and what it is."""

    def __init__(self, start: int, reason: str) -> None:
        """Remember where it is."""
        super().__init__(reason)
        self.start = start
        self.reason = reason


@dataclass(frozen=True)
class ParsedRows:
    """The numbers of a block.

    Attributes:
        stamps: The N numbers of the time column, exactly; None if there is no such column.
        timed: (N,) bool, whether the stamp is a finite number.
        values: (N, M) of the columns after it.
    """

    stamps: ExactNumbers | None
    timed: Booleans
    values: Floats


@dataclass(frozen=True)
class _Tokens:
    """Where numbers begin and end.

    Attributes:
        text: (bytes,) of the padded block.
        starts: Index of the first character, (N,) or (N, columns).
        ends: Index after the last character.
        dots: Index of the decimal point, or of the end if there is none; None if some number of
            the block is more than digits with a sign and a point.
    """

    text: Bytes
    starts: Indices
    ends: Indices
    dots: Indices | None

    def __getitem__(self, pick: Indices | tuple[slice, slice | int]) -> _Tokens:
        """Return some of the numbers, in one row."""
        return _Tokens(
            self.text,
            np.ravel(self.starts[pick]),
            np.ravel(self.ends[pick]),
            None if self.dots is None else np.ravel(self.dots[pick]),
        )


def parse_rows(block: bytes, columns: int, time_column: int | None) -> ParsedRows:
    """Read a block of whole lines with `columns` numbers each; empty lines are skipped.

    Spaces, tabs, commas and semicolons separate numbers, alone or in groups.

    Raises:
        RowError: A line has another number of columns, or something that is not a number.
    """
    tokens = _tokenize(block, columns)
    first = 0 if time_column is None else time_column + 1
    stamps, timed = None, np.ones(len(tokens.starts), dtype=bool)
    try:
        values = _parse_numbers(tokens[:, first:]).reshape(len(timed), columns - first)
        if time_column is not None:
            stamps, timed = _parse_stamps(tokens[:, time_column])
    except WordError as error:
        raise RowError(_line_of(tokens, error.start), error.reason) from None
    return ParsedRows(stamps, timed, values)


def _tokenize(block: bytes, columns: int) -> _Tokens:
    """Find the numbers of all lines and their decimal points."""
    if b"\0" in block:
        line = block.count(b"\n", 0, block.index(b"\0"))
        raise RowError(line, "has zero bytes, as a crash leaves them behind")
    text = np.frombuffer(b"".join((_PADDING, block, b"\n", _PADDING)), dtype=np.uint8)
    separates = text <= ord(" ")
    for separator in b",;":
        if separator in block:
            separates |= text == separator
    edges = np.flatnonzero(separates[1:] != separates[:-1])
    edges += 1
    starts, ends = edges[0::2], edges[1::2]
    _check_lines(text, starts, ends, columns)

    dots = np.flatnonzero(text == ord("."))
    first = text[starts]
    signs = np.count_nonzero((first == ord("-")) | (first == ord("+")))
    others = np.count_nonzero(text < ord("0")) - np.count_nonzero(separates)
    plain = text.max() <= ord("9") and others == signs + len(dots)
    dot_of_each = _dot_of_each(starts, ends, dots) if plain else None
    shape = (-1, columns)
    return _Tokens(
        text,
        starts.reshape(shape),
        ends.reshape(shape),
        None if dot_of_each is None else dot_of_each.reshape(shape),
    )


def _check_lines(text: Bytes, starts: Indices, ends: Indices, columns: int) -> None:
    """Raise RowError unless each line has `columns` numbers, or none."""
    is_newline = text == ord("\n")
    last_ends = ends[columns - 1 :: columns]
    if (
        len(last_ends) * columns == len(starts)
        and is_newline[last_ends].all()
        and np.count_nonzero(is_newline) == len(last_ends) + 1  # one was appended
    ):
        return
    newlines = np.flatnonzero(is_newline)
    per_line = np.diff(np.searchsorted(starts, newlines), prepend=0)
    wrong = np.flatnonzero((per_line != columns) & (per_line != 0))
    if len(wrong):
        line = int(wrong[0])
        count = int(per_line[line])
        raise RowError(line, f"has {count} column{'s' if count > 1 else ''} instead of {columns}")


def _dot_of_each(starts: Indices, ends: Indices, dots: Indices) -> Indices | None:
    """Return the index of each number's point, or its end; None if one has two points."""
    if len(dots) == len(starts) and ((starts <= dots) & (dots < ends)).all():
        return dots
    owners = np.searchsorted(ends, dots, side="right")
    if (np.diff(owners) == 0).any():
        return None
    dot_of_each = ends.copy()
    dot_of_each[owners] = dots
    return dot_of_each


@dataclass(frozen=True)
class _Decimals:
    """Numbers as their parts, (N,) each: (whole + fraction / 10**places), and the sign.

    The places have the shape (1,) if they are the same for all.
    """

    negative: Booleans
    whole: NDArray[np.uint64]
    fraction: NDArray[np.uint64]
    places: Indices


def _parse_decimals(tokens: _Tokens) -> _Decimals | None:
    """Return the parts of the numbers; None if one needs a more general way of reading."""
    if tokens.dots is None:
        return None
    first = tokens.text[tokens.starts]
    negative = first == ord("-")
    begins = tokens.starts + (negative | (first == ord("+")))
    places = np.maximum(tokens.ends - tokens.dots - 1, 0)
    digits = tokens.dots - begins
    if max(digits.max(initial=0), places.max(initial=0)) > _MOST_DIGITS:
        return None
    if (digits + places).min(initial=1) == 0:  # a lone sign or point
        return None
    whole = _parse_digits(tokens.text, tokens.dots, digits)
    fraction = _parse_digits(tokens.text, tokens.ends, places)
    if (places == places[:1]).all():  # most writers have a fixed format
        places = places[:1]
    return _Decimals(negative, whole, fraction, places)


def _parse_numbers(tokens: _Tokens) -> Floats:
    """Return the numbers (N,) as `float` reads them."""
    parts = _parse_decimals(tokens)
    if parts is None:
        return _convert(tokens)
    numerator = parts.whole * POWERS_OF_TEN[parts.places] + parts.fraction
    numbers = numerator / _FLOAT_POWERS[parts.places]
    numbers *= np.where(parts.negative, -1.0, 1.0)
    inexact = parts.whole >= _TOO_LARGE_WHOLE[parts.places]
    if inexact.any():
        rows = np.flatnonzero(inexact)
        numbers[rows] = _convert(tokens[rows])
    return numbers


def _parse_stamps(tokens: _Tokens) -> tuple[ExactNumbers, Booleans]:
    """Return the numbers (N,) exactly, and which of them are finite."""
    parts = _parse_decimals(tokens)
    if parts is None:
        return exact_numbers(_characters(tokens)), np.isfinite(_convert(tokens))
    stamps = ExactNumbers(parts.negative, parts.whole, billionths(parts.fraction, parts.places))
    return stamps, np.ones(len(parts.whole), dtype=bool)


def _parse_digits(text: Bytes, ends: Indices, counts: Indices) -> NDArray[np.uint64]:
    """Return the integers (N,) that stand in `text[end - count:end]`, of at most 19 digits."""
    # The 8 bytes before each end as one little-endian word: the first digit is the lowest byte.
    words: NDArray[np.uint64] = np.ndarray(
        (len(text) - 7,), dtype="<u8", buffer=text.data, strides=(1,)
    )
    integers = np.zeros(len(ends), dtype=np.uint64)
    shortest, longest = counts.min(initial=_MOST_DIGITS), int(counts.max(initial=0))
    for done in range(0, longest, 8):
        if longest - done == 1:  # as in nine decimals, the most common format
            digit = np.where(counts == longest, text[ends - longest] & 0x0F, np.uint8(0))
            integers += digit * POWERS_OF_TEN[done]
            break
        word = words[ends - (done + 8)]
        # Bytes before the number become zeros; so does the upper half of each digit's byte.
        word &= _DIGIT_MASKS[8 if shortest >= done + 8 else np.clip(counts - done, 0, 8)]
        word *= np.uint64(10 << 8 | 1)
        word >>= np.uint64(8)
        word &= np.uint64(0x00FF00FF00FF00FF)
        word *= np.uint64(100 << 16 | 1)
        word >>= np.uint64(16)
        word &= np.uint64(0x0000FFFF0000FFFF)
        word *= np.uint64(10_000 << 32 | 1)
        word >>= np.uint64(32)
        if done:
            word *= POWERS_OF_TEN[done]
        integers += word
    return integers


def _convert(tokens: _Tokens) -> Floats:
    """Return the floats (N,) that `float` makes of the numbers, whatever their form."""
    characters = _characters(tokens)
    words = characters.view(f"S{characters.shape[1]}").ravel()
    try:
        if (characters == ord("_")).any():  # python reads 1_000, but no writer means it
            raise ValueError
        with np.errstate(over="ignore"):  # 1e400 is infinite
            return words.astype(np.float64)
    except ValueError:
        for start, word in zip(tokens.starts.tolist(), words.tolist(), strict=True):
            if not _is_number(word):
                shown = word[:40].decode(errors="replace")
                raise WordError(start, f"has {shown!r} where a number should be") from None
        raise


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return b"_" not in word


def _characters(tokens: _Tokens) -> Bytes:
    """Return the numbers as characters (N, width), zeros after their end."""
    lengths = tokens.ends - tokens.starts
    width = int(lengths.max(initial=1))
    if width > _LONGEST_NUMBER:
        raise WordError(int(tokens.starts[lengths.argmax()]), f"has a word of {width} characters")
    words: NDArray[np.bytes_] = np.ndarray(
        (len(tokens.text) - width,), dtype=f"S{width}", buffer=tokens.text.data, strides=(1,)
    )
    characters = words[tokens.starts].view(np.uint8).reshape(-1, width)
    characters *= np.arange(width) < lengths[:, None]
    return characters


def _line_of(tokens: _Tokens, index: int) -> int:
    """Return the line in the block, from 0, of the character with that index."""
    return int(np.count_nonzero(tokens.text[:index] == ord("\n")))
