"""Conversion of rows of decimal numbers to float64, by blocks of bytes, without a loop over rows.

`np.loadtxt` is not used, for three reasons. It needs more time for two trajectories of a million
rows than their evaluation. It does not read timestamps exactly. It accepts only one separator.
Here, eight digits are converted as one 64-bit word with three multiplications (SWAR), for all
numbers of a column at once.

A number with up to about 15 digits is an integer below 2**53, divided by a power of ten below
10**22. Both are exact in float64, and the single division rounds correctly. The result is equal
to `float(text)` to the last bit. Numbers with more digits, with exponents or NaN are converted by
numpy, which is slower.
"""

from __future__ import annotations

from collections.abc import Callable
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

_MOST_DIGITS = 19  # integers of up to 19 digits fit into uint64
_FLOAT_POWERS: Floats = POWERS_OF_TEN.astype(np.float64)
# For this whole part and larger ones, `whole * 10**places + fraction` can reach 2**53.
_TOO_LARGE_WHOLE = np.array([2**53 // 10**places for places in range(20)], dtype=np.uint64)
# Masks for the low 4 bits of the last `count` bytes of a word.
_DIGIT_MASKS = np.array(
    [0x0F0F0F0F0F0F0F0F << 8 * (8 - count) & 2**64 - 1 for count in range(9)], dtype=np.uint64
)


@dataclass(frozen=True)
class RowFormat:
    """The columns of a file and how they are read."""

    columns: int
    time: int | None  # index of the column with timestamps, or None
    values: tuple[int, ...]  # indices of the columns that are read as numbers
    separator: str = ""  # as `Layout.separator`
    dates: bool = False  # whether the timestamps are calendar dates
    names: tuple[str, ...] = ()  # names of the columns, for messages; () if unknown

    @cached_property
    def pick(self) -> slice | list[int]:
        """Index of the columns `values`; a slice if they are consecutive, since it is faster."""
        if self.values == tuple(range(self.values[0], self.values[-1] + 1)):
            return slice(self.values[0], self.values[-1] + 1)
        return list(self.values)


@dataclass(frozen=True, eq=False)
class ParsedRows:
    """The numbers of a block of N rows."""

    # N exact numbers of the time column; None if there is no such column.
    stamps: ExactNumbers | None
    timed: Booleans  # (N,) bool, whether the timestamp is finite; all True without a time column
    values: Floats  # (N, M), the columns `RowFormat.values`


def parse_rows(block: bytes, rows: RowFormat) -> ParsedRows:
    """Return the numbers of a block of complete lines; empty lines are skipped."""
    if rows.separator:
        tokens = tokenize_fields(block, rows.columns, rows.separator)
    else:
        tokens = tokenize(block, rows.columns)
    stamps, timed = None, np.ones(len(tokens.starts), dtype=bool)
    every = slice(None)
    try:
        values = np.empty((len(timed), 0))
        if rows.values:
            values = _parse_numbers(tokens[every, rows.pick]).reshape(-1, len(rows.values))
        if rows.time is not None:
            # A block may have no row: the last one, if a comment ends the file.
            parse = _parse_dates if rows.dates and len(timed) else _parse_stamps
            stamps, timed = parse(tokens[every, rows.time])
    except WordError as error:
        column = int(np.argwhere(tokens.starts == error.start)[0, 1])
        named = f" ({rows.names[column]})" if rows.names else ""
        raise RowError(
            line_of(tokens, error.start), f"{error.reason}, in column {column + 1}{named}"
        ) from None
    return ParsedRows(stamps, timed, values)


@dataclass(frozen=True, eq=False)
class _Decimals:
    """The parts of N numbers: sign, and whole + fraction / 10**places.

    All arrays have shape (N,). If all numbers have the same places, `places` has shape (1,).
    """

    negative: Booleans
    whole: NDArray[np.uint64]
    fraction: NDArray[np.uint64]
    places: Indices


def _parse_decimals(tokens: Tokens) -> _Decimals | None:
    """Return the parts of the numbers; None if a number is not a plain decimal number."""
    if tokens.dots is None:
        return None
    first = tokens.text[tokens.starts]
    negative = first == ord("-")
    begins = tokens.starts + (negative | (first == ord("+")))
    places = np.maximum(tokens.ends - tokens.dots - 1, 0)
    digits = tokens.dots - begins
    if max(digits.max(initial=0), places.max(initial=0)) > _MOST_DIGITS:
        return None
    if (digits + places).min(initial=1) == 0:  # a sign or a point without digits
        return None
    whole = _parse_digits(tokens.text, tokens.dots, digits)
    fraction = _parse_digits(tokens.text, tokens.ends, places)
    if (places == places[:1]).all():  # most writers have a fixed format
        places = places[:1]
    return _Decimals(negative, whole, fraction, places)


def _parse_numbers(tokens: Tokens) -> Floats:
    """Return the numbers (N,), equal to the results of `float`."""
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
    """Return N exact numbers, and the mask (N,) of the finite ones."""
    parts = _parse_decimals(tokens)
    if parts is None:
        return exact_numbers(characters_of(tokens)), np.isfinite(_convert(tokens))
    stamps = ExactNumbers(parts.negative, parts.whole, billionths(parts.fraction, parts.places))
    return stamps, np.ones(len(parts.whole), dtype=bool)


def _parse_dates(tokens: Tokens) -> tuple[ExactNumbers, Booleans]:
    """Return calendar dates as N exact seconds since 1970, and the mask (N,) of present dates."""
    words = _words(tokens)
    empty = words == b""
    try:
        return exact_dates(np.where(empty, b"1970-01-01", words)), ~empty
    except ValueError:
        _refuse_first(tokens, words, lambda word: exact_dates(np.array([word])), "a date (UTC)")
        raise


def _parse_digits(text: Bytes, ends: Indices, counts: Indices) -> NDArray[np.uint64]:
    """Return the integers (N,) in `text[end - count:end]`, of at most 19 digits."""
    # The 8 bytes before an end are one little-endian word: the first digit is the lowest byte.
    words: NDArray[np.uint64] = np.ndarray(
        (len(text) - 7,), dtype="<u8", buffer=text.data, strides=(1,)
    )
    integers = np.zeros(len(ends), dtype=np.uint64)
    shortest, longest = counts.min(initial=_MOST_DIGITS), int(counts.max(initial=0))
    for done in range(0, longest, 8):
        if longest - done == 1:  # the ninth of nine decimals, the most common format
            digit = np.where(counts == longest, text[ends - longest] & 0x0F, np.uint8(0))
            integers += digit * POWERS_OF_TEN[done]
            break
        word = words[ends - (done + 8)]
        # Clears the bytes before the number, and the upper 4 bits of all digits.
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
    """Return numbers of any notation as `float` converts them (N,); NaN for empty words."""
    words = _words(tokens)
    missing = words == b""
    words[missing] = b"0"
    try:
        if (words.view(np.uint8) == ord("_")).any():  # Python accepts 1_000; in data it is damage
            raise ValueError
        with np.errstate(over="ignore"):  # 1e400 becomes infinity
            numbers = words.astype(np.float64)
    except ValueError:
        _refuse_first(tokens, words, lambda word: float(word.replace(b"_", b"?")), "a number")
        raise
    numbers[missing] = np.nan
    return numbers


def _words(tokens: Tokens) -> NDArray[np.bytes_]:
    characters = characters_of(tokens)
    words: NDArray[np.bytes_] = characters.view(f"S{characters.shape[1]}").ravel()
    return words


def _refuse_first(
    tokens: Tokens, words: NDArray[np.bytes_], parse: Callable[[bytes], object], what: str
) -> None:
    """Raise WordError for the first word that can't be parsed."""
    for start, word in zip(tokens.starts.tolist(), words.tolist(), strict=True):
        if not word:  # a missing value
            continue
        try:
            parse(word)
        except ValueError:
            shown = word[:40].decode(errors="replace")
            raise WordError(start, f"{shown!r} is not {what}") from None
