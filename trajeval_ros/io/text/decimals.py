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
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.io.text.stamps import (
    POWERS_OF_TEN,
    ExactNumbers,
    billionths,
    exact_dates,
    exact_numbers,
)
from trajeval_ros.io.text.tokens import (
    Bytes,
    RowError,
    Tokens,
    WordError,
    characters_of,
    line_of,
    tokenize,
    tokenize_fields,
)

_MOST_DIGITS = 19  # of an integer that surely fits uint64
_FLOAT_POWERS: Floats = POWERS_OF_TEN.astype(np.float64)
# From this whole part on, `whole * 10**places + fraction` may be 2**53 or more.
_TOO_LARGE_WHOLE = np.array([2**53 // 10**places for places in range(20)], dtype=np.uint64)
# Keeps the low halves of the last `count` bytes of a word.
_DIGIT_MASKS = np.array(
    [0x0F0F0F0F0F0F0F0F << 8 * (8 - count) & 2**64 - 1 for count in range(9)], dtype=np.uint64
)


@dataclass(frozen=True)
class RowFormat:
    """What the rows of a file are made of.

    Attributes:
        columns: Number of columns.
        time: Index of the column with stamps, or None.
        values: Indices of the columns with the numbers that are wanted.
        separator: As `Layout.separator`.
        dates: Whether the stamps are calendar dates.
        names: Of the columns, for messages.
    """

    columns: int
    time: int | None
    values: tuple[int, ...]
    separator: str = ""
    dates: bool = False
    names: tuple[str, ...] = ()

    @cached_property
    def pick(self) -> slice | list[int]:
        """What picks the values' columns; a slice if it can, since it is fast."""
        if self.values == tuple(range(self.values[0], self.values[-1] + 1)):
            return slice(self.values[0], self.values[-1] + 1)
        return list(self.values)


@dataclass(frozen=True)
class ParsedRows:
    """The numbers of a block.

    Attributes:
        stamps: The N numbers of the time column, exactly; None if there is no such column.
        timed: (N,) bool, whether the stamp is a finite number.
        values: (N, M) of the columns that are wanted.
    """

    stamps: ExactNumbers | None
    timed: Booleans
    values: Floats


def parse_rows(block: bytes, rows: RowFormat) -> ParsedRows:
    """Read a block of whole lines; empty lines are skipped.

    Raises:
        RowError: A line has another number of columns, or something that is not a number.
    """
    if rows.separator:
        tokens = tokenize_fields(block, rows.columns, rows.separator)
    else:
        tokens = tokenize(block, rows.columns)
    stamps, timed = None, np.ones(len(tokens.starts), dtype=bool)
    every = slice(None)
    try:
        values = np.empty((len(timed), 0))
        if rows.values:
            values = _parse_numbers(tokens[every, rows.pick]).reshape(len(timed), -1)
        if rows.time is not None:
            parse = _parse_dates if rows.dates else _parse_stamps
            stamps, timed = parse(tokens[every, rows.time])
    except WordError as error:
        column = int(np.argwhere(tokens.starts == error.start)[0, 1])
        named = f" ({rows.names[column]})" if rows.names else ""
        raise RowError(
            line_of(tokens, error.start), f"{error.reason}, in column {column + 1}{named}"
        ) from None
    return ParsedRows(stamps, timed, values)


@dataclass(frozen=True)
class _Decimals:
    """Numbers as their parts, (N,) each: (whole + fraction / 10**places), and the sign.

    The places have the shape (1,) if they are the same for all.
    """

    negative: Booleans
    whole: NDArray[np.uint64]
    fraction: NDArray[np.uint64]
    places: Indices


def _parse_decimals(tokens: Tokens) -> _Decimals | None:
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


def _parse_numbers(tokens: Tokens) -> Floats:
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


def _parse_stamps(tokens: Tokens) -> tuple[ExactNumbers, Booleans]:
    """Return the numbers (N,) exactly, and which of them are finite."""
    parts = _parse_decimals(tokens)
    if parts is None:
        return exact_numbers(characters_of(tokens)), np.isfinite(_convert(tokens))
    stamps = ExactNumbers(parts.negative, parts.whole, billionths(parts.fraction, parts.places))
    return stamps, np.ones(len(parts.whole), dtype=bool)


def _parse_dates(tokens: Tokens) -> tuple[ExactNumbers, Booleans]:
    """Return calendar dates (N,) as exact seconds since 1970, and which of them are none."""
    words = _words(tokens)
    empty = words == b""
    try:
        return exact_dates(np.where(empty, b"1970-01-01", words)), ~empty
    except ValueError:
        for start, word in zip(tokens.starts.tolist(), words.tolist(), strict=True):
            if word and not _is_date(word):
                shown = word[:40].decode(errors="replace")
                raise WordError(start, f"{shown!r} is not a date (UTC)") from None
        raise


def _is_date(word: bytes) -> bool:
    try:
        exact_dates(np.array([word]))
    except ValueError:
        return False
    return True


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


def _convert(tokens: Tokens) -> Floats:
    """Return the floats (N,) that `float` makes of the numbers, whatever their form."""
    words = _words(tokens)
    missing = words == b""
    words[missing] = b"0"
    try:
        if (words.view(np.uint8) == ord("_")).any():  # python reads 1_000, but no writer means it
            raise ValueError
        with np.errstate(over="ignore"):  # 1e400 is infinite
            numbers = words.astype(np.float64)
    except ValueError:
        for start, word in zip(tokens.starts.tolist(), words.tolist(), strict=True):
            if not _is_number(word):
                shown = word[:40].decode(errors="replace")
                raise WordError(start, f"{shown!r} is not a number") from None
        raise
    numbers[missing] = np.nan
    return numbers


def _words(tokens: Tokens) -> NDArray[np.bytes_]:
    characters = characters_of(tokens)
    words: NDArray[np.bytes_] = characters.view(f"S{characters.shape[1]}").ravel()
    return words


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return b"_" not in word
