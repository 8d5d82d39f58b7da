"""Reading of timestamps from text, exact to the nanosecond.

The resolution of float64 for seconds since 1970 is only 2.4e-7 s. Therefore a timestamp is read as
a whole number and a number of billionths. It is converted to int64 nanoseconds when the unit of
the file is known.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS

Unsigned = NDArray[np.uint64]

POWERS_OF_TEN: Unsigned = np.array([10**power for power in range(20)], dtype=np.uint64)
_LARGEST = np.uint64(2**64 - 1)
_LAST_SECOND = 9.2e9  # int64 nanoseconds end in the year 2262
_LAST_NANOSECOND = 9.2e18
_EPOCH_NANOSECONDS = 1e17  # in 1973; larger numbers are nanoseconds since 1970
_NANOSECOND_STEP = 5e5  # least median step of timestamps in nanoseconds: 2 kHz
_ONE_DATE = rb"\d{4}-\d\d?-\d\d?(?:[T ]\d\d?:\d\d(?::\d\d(?:\.\d+)?)?)?"
_DATES = rb"%s(?: %s)*" % (_ONE_DATE, _ONE_DATE)
_OFFSET = rb":\d\d(?:\.\d+)?([+-][01]\d:?[0-5]\d)(?: |$)"  # from UTC, after the time of the day


@dataclass(frozen=True, eq=False)
class ExactNumbers:
    """N numbers as sign * (whole + billionths * 1e-9)."""

    negative: Booleans  # (N,) bool
    whole: Unsigned  # (N,) uint64
    billionths: Unsigned  # (N,) uint64, from 0 to 1e9; 1e9 is possible because of rounding

    @classmethod
    def concatenate(cls, parts: list[ExactNumbers]) -> ExactNumbers:
        """Return the numbers of all parts, in order."""
        return cls(
            np.concatenate([part.negative for part in parts]),
            np.concatenate([part.whole for part in parts]),
            np.concatenate([part.billionths for part in parts]),
        )

    @classmethod
    def of_floats(cls, values: Floats) -> ExactNumbers:
        """Return finite values (N,) with the digits that they have."""
        sizes = np.abs(values)
        whole = np.floor(sizes)
        parts = np.round((sizes - whole) * NANOSECONDS)
        return cls(values < 0.0, whole.astype(np.uint64), parts.astype(np.uint64))

    def __getitem__(self, rows: Booleans) -> ExactNumbers:
        return ExactNumbers(self.negative[rows], self.whole[rows], self.billionths[rows])


def billionths(fraction: Unsigned, decimals: NDArray[np.int64]) -> Unsigned:
    """Return `fraction` / 10**`decimals` in units of 1e-9, rounded; both (N,), decimals <= 28."""
    power = POWERS_OF_TEN[np.abs(decimals - 9)]
    half = power // np.uint64(2)
    return np.where(decimals <= 9, fraction * power, (fraction + half) // power)


def exact_numbers(characters: NDArray[np.uint8]) -> ExactNumbers:
    """Read N numbers with any exponent and any number of digits.

    `characters`: (N, width), texts of numbers that `float` accepts, padded with zero bytes on the
    right. The results for NaN and infinity are undefined: drop them by their float value.

    The loop runs over the characters of a number, for all numbers at once. It keeps 19
    significant digits and rounds by the 20th.
    """
    count = len(characters)
    mantissa: Unsigned = np.zeros(count, dtype=np.uint64)
    shift, exponent = np.zeros((2, count), dtype=np.int64)
    fractional, exponential, shrinking, full, cut, round_up = np.zeros((6, count), dtype=bool)
    for character in characters.T:
        digit = character - np.uint8(ord("0"))
        is_digit = digit <= 9
        in_mantissa = is_digit & ~exponential
        kept = in_mantissa & ~full
        surplus = in_mantissa & full
        mantissa = np.where(kept, mantissa * np.uint64(10) + digit, mantissa)
        shift += (surplus & ~fractional).astype(np.int64) - (kept & fractional)
        round_up |= surplus & ~cut & (digit >= 5)
        cut |= surplus
        full |= mantissa >= POWERS_OF_TEN[18]
        in_exponent = is_digit & exponential
        exponent = np.where(in_exponent, exponent * 10 + digit, exponent) % 10_000
        shrinking |= exponential & (character == ord("-"))
        fractional |= character == ord(".")
        exponential |= (character | np.uint8(0x20)) == ord("e")
    mantissa += round_up
    shift += np.where(shrinking, -exponent, exponent)
    decimals = np.clip(-shift, 0, 28)
    unit = POWERS_OF_TEN[np.minimum(decimals, 19)]
    whole: Unsigned = np.where(decimals < 20, mantissa // unit, np.uint64(0))
    fraction = mantissa - whole * unit
    larger = POWERS_OF_TEN[np.clip(shift, 0, 19)]
    return ExactNumbers(
        negative=characters[:, 0] == ord("-"),
        whole=np.where(whole > _LARGEST // larger, _LARGEST, whole * larger),
        billionths=np.where(shift < -28, np.uint64(0), billionths(fraction, decimals)),
    )


def exact_dates(words: NDArray[np.bytes_]) -> ExactNumbers:
    """Return N dates such as `2024-03-01 12:00:00.5` as exact seconds since 1970.

    A T between day and time, slashes in the day, and a Z or an offset from UTC at the end are
    accepted. A date without an offset is read as UTC.

    Raises:
        ValueError: A word is not a date.
        InputError: A date is outside of the range of int64 nanoseconds.
    """
    plain = np.char.replace(words, b"/", b"-")
    for zone in (b"Z", b" UTC"):
        plain = np.char.replace(plain, zone, b"")
    ahead = np.zeros(len(plain), dtype="timedelta64[m]")
    for offset in set(re.findall(_OFFSET, b" ".join(plain.tolist()))):
        there = np.char.endswith(plain, offset)
        ahead[there] = int(offset[:1] + b"1") * (60 * int(offset[1:3]) + int(offset[-2:]))
        plain = np.where(there, np.char.rpartition(plain, offset)[:, 0], plain)
    if not re.fullmatch(_DATES, b" ".join(plain.tolist())):  # numpy also accepts only a year
        raise ValueError("no date")
    # Converted from str, since numpy 1.26 crashes on bytes with an invalid date such as month 13.
    dates = plain.astype(np.str_)
    if (np.abs(dates.astype("datetime64[s]").astype(np.int64)) > _LAST_SECOND).any():
        raise InputError("its dates leave the years 1678 to 2261; correct or remove them")
    stamps = (dates.astype("datetime64[ns]") - ahead).astype(np.int64)
    whole, rest = np.divmod(np.abs(stamps).view(np.uint64), np.uint64(NANOSECONDS))
    return ExactNumbers(stamps < 0, whole, rest)


def to_nanoseconds(
    numbers: ExactNumbers, unit_ns: int | None = None, *, far_apart_is_ns: bool = False
) -> tuple[NDArray[np.int64], bool]:
    """Return the timestamps (N,) in nanoseconds, and whether the file has nanoseconds.

    If the unit is unknown, numbers are nanoseconds in two cases. Most are so large that they count
    from 1970. Or they are whole numbers with a large median step that are too large for seconds,
    as from a clock that started at zero. `unit_ns`: nanoseconds per unit, if the header names the
    unit; None if it is unknown. `far_apart_is_ns`: whether whole numbers with a large median step
    are nanoseconds even if they are small enough for seconds. Set it for formats with timestamps
    in nanoseconds.
    """
    largest = float(numbers.whole.max())
    some = np.sort(numbers.whole[numbers.whole > 0])  # zero means "not set"
    typical = float(some[(len(some) - 1) // 2]) if len(some) else 0.0
    if unit_ns not in (None, 1, NANOSECONDS):
        return _scaled(numbers, unit_ns), False
    in_nanoseconds = unit_ns == 1 or (
        unit_ns is None
        and (
            typical >= _EPOCH_NANOSECONDS
            or (_is_sparse(numbers) and (far_apart_is_ns or largest > _LAST_SECOND))
        )
    )
    last = _LAST_NANOSECOND if in_nanoseconds else _LAST_SECOND
    if typical <= last < largest:
        count = int((numbers.whole > last).sum())
        raise InputError(
            f"most timestamps are near {typical:.6g}, and {count} of {len(numbers.whole)} up to "
            f"{largest:.6g}; correct or remove these rows"
        )
    if largest > last:
        raise InputError(
            f"its timestamps (up to {largest:.6g}) are neither seconds nor nanoseconds; convert "
            "the first column, or name its unit (t_ms, t_us) with --columns"
        )
    if in_nanoseconds:
        stamps = (numbers.whole + (numbers.billionths >= NANOSECONDS // 2)).astype(np.int64)
    else:
        stamps = numbers.whole.astype(np.int64) * NANOSECONDS + numbers.billionths.astype(np.int64)
    return np.where(numbers.negative, -stamps, stamps), in_nanoseconds


def _scaled(numbers: ExactNumbers, unit_ns: int) -> NDArray[np.int64]:
    """Return numbers in milliseconds or microseconds as nanoseconds (N,), rounded."""
    if float(numbers.whole.max()) * unit_ns > _LAST_NANOSECOND:
        raise InputError(
            f"its timestamps are too large for a unit of {unit_ns} ns; choose another unit"
        )
    part = np.round(numbers.billionths.astype(np.float64) * (unit_ns / NANOSECONDS))
    stamps = numbers.whole.astype(np.int64) * unit_ns + part.astype(np.int64)
    return np.where(numbers.negative, -stamps, stamps)


def _is_sparse(numbers: ExactNumbers) -> bool:
    """Return whether the numbers are whole and their median step is typical of nanoseconds."""
    if len(numbers.whole) < 2 or numbers.billionths.any():
        return False
    return float(np.median(np.abs(np.diff(numbers.whole.astype(np.float64))))) >= _NANOSECOND_STEP
