"""Conversion of columns of numbers to characters, without a loop over numbers.

A block of characters is an array (N, width) of bytes, in which 0 means no character. Blocks are
joined side by side, and one mask removes the zeros (`lines_of`).

Floats are written with the digits of `repr`: the smallest number of digits that is read as the
same float. A float times a power of ten below 10**22 is the sum of two floats (Dekker 1971). Its
first 17 digits follow exactly from this sum. It is also exact whether 15 or 16 digits suffice.
With `repr`, a trajectory of a million poses (seven million floats) takes three seconds longer.
orjson needs a third of the time for the same characters, and is used if it is installed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS

try:
    import orjson

    HAVE_ORJSON = True
except ImportError:
    HAVE_ORJSON = False

Characters = NDArray[np.uint8]

_ZERO, _POINT, _MINUS = np.frombuffer(b"0.-", dtype=np.uint8)
_POWERS: Indices = 10 ** np.arange(19, dtype=np.int64)
_FLOAT_POWERS: Floats = np.array([float(10**power) for power in range(23)])
_SPLITTER = 2.0**27 + 1.0  # splits the 53 bits of a float into two halves
_GROUP = 4  # digits per table look-up, a word of four bytes
_DIGITS = (
    (np.arange(10**_GROUP)[:, None] // 10 ** np.arange(_GROUP - 1, -1, -1) % 10 + _ZERO)
    .astype(np.uint8)
    .view(np.uint32)[:, 0]
)
_GROUP_SIZE = np.uint64(10**_GROUP)
# Range of the floats that are converted here. Smaller ones are written with an exponent, and for
# larger ones the powers above do not suffice.
_SMALLEST, _LARGEST = 1e-4, 1e15
_LARGEST_FIXED = 1e16  # from here on, repr writes an exponent
_LONGEST = 24  # most characters of a float
_FRACTION = 20  # most digits after the point


def lines_of_floats(rows: Floats, separator: bytes) -> list[bytes]:
    """Return N lines of text with the floats of every row, as `repr` writes them.

    Args:
        rows: (N, M), finite, with M > 0.
        separator: One character between the floats.
    """
    if not HAVE_ORJSON:
        between = constant(separator, len(rows))
        blocks = [block for column in rows.T for block in (of_floats(column), between)]
        return lines_of(blocks[:-1])
    text = orjson.dumps(np.ascontiguousarray(rows), option=orjson.OPT_SERIALIZE_NUMPY)
    lines = text[2:-2].replace(b",", separator).split(b"]" + separator + b"[")
    size = np.abs(rows)
    # orjson writes floats outside this range with fewer characters than `repr`.
    alike = (size == 0.0) | ((size >= _SMALLEST) & (size < _LARGEST_FIXED))
    for row in np.flatnonzero(~alike.all(axis=1)):
        lines[row] = separator.join(repr(each).encode() for each in rows[row].tolist())
    return lines


def lines_of(blocks: list[Characters]) -> list[bytes]:
    """Return the rows of blocks (N, width) joined side by side, without zero bytes."""
    rows = np.concatenate([*blocks, constant(b"\n", len(blocks[0]))], axis=1)
    text: bytes = rows[rows != 0].tobytes()
    return text.split(b"\n")[:-1]


def constant(text: bytes, count: int) -> Characters:
    """Return a block (`count`, width) with the same text in all rows."""
    return np.broadcast_to(np.frombuffer(text, dtype=np.uint8), (count, len(text)))


def of_integers(numbers: Stamps) -> Characters:
    """Return the characters (N, 20) of integers, as `str` writes them."""
    # The absolute value of the smallest int64 does not fit into int64, but into uint64.
    return np.concatenate([_sign(numbers < 0), _whole(_absolute(numbers), 19)], axis=1)


def of_seconds(stamps: Stamps) -> Characters:
    """Return the characters (N, width) of nanoseconds as seconds with nine decimals, exact."""
    whole, rest = np.divmod(_absolute(stamps), np.uint64(NANOSECONDS))
    point = constant(b".", len(stamps))
    return np.concatenate(
        [_sign(stamps < 0), _whole(whole, 10), point, _digits(rest, 10)[:, 1:]], axis=1
    )


def of_floats(numbers: Floats) -> Characters:
    """Return the characters (N, width) of finite floats, as `repr` writes them."""
    size = np.abs(numbers)
    common = (size >= _SMALLEST) & (size < _LARGEST)
    digits, exponents, sure = _shortest(np.where(common, size, 1.0))
    common &= sure
    fixed = _fixed(digits, exponents)
    characters = np.zeros((len(numbers), max(_LONGEST, 1 + fixed.shape[1])), dtype=np.uint8)
    characters[:, :1] = _sign(np.signbit(numbers))
    characters[:, 1 : 1 + fixed.shape[1]] = fixed
    rest = np.flatnonzero(~common)
    if len(rest):
        texts = np.array([repr(each) for each in numbers[rest].tolist()], dtype=f"S{_LONGEST}")
        characters[rest] = 0
        characters[rest, :_LONGEST] = texts.view(np.uint8).reshape(len(rest), _LONGEST)
    return characters


def _shortest(size: Floats) -> tuple[Indices, Indices, Booleans]:
    """Return digits and exponents of floats, and the mask of results that are certain.

    The digits (N,) are integers of 17 digits. The exponents (N,) are e in d.ddd * 10**e. Where
    the mask (N,) is True, the digits without trailing zeros are equal to the digits of `repr`.
    """
    exponents = np.floor(np.log10(size)).astype(np.int64)
    shift = 16 - exponents
    power = _FLOAT_POWERS[shift]
    high = size * power
    low = _rounding_of_product(size, power, high)
    whole_low = np.rint(low)
    digits = high.astype(np.int64) + whole_low.astype(np.int64)
    rest = low - whole_low
    sure = (digits >= _POWERS[16]) & (digits < _POWERS[17])
    few = (digits + 50) // 100
    is_few = few / _FLOAT_POWERS[shift - 2] == size  # exact operands: correctly rounded quotient
    more = (digits + 5 - (rest < 0.0)) // 10 * 10
    apart = np.abs((more - digits) - rest)
    reach = 0.5 * np.spacing(size) * power
    # At a power of two, the distance to the next smaller float is half of that to the larger one.
    lone = np.frexp(size)[0] == 0.5
    sure &= is_few | ((apart != reach) & (apart != 5.0) & ~lone)
    return np.where(is_few, few * 100, np.where(apart < reach, more, digits)), exponents, sure


def _rounding_of_product(a: Floats, b: Floats, product: Floats) -> Floats:
    """Return a b - product, exactly (Dekker 1971)."""
    a_high, b_high = (each * _SPLITTER - (each * _SPLITTER - each) for each in (a, b))
    a_low, b_low = a - a_high, b - b_high
    rounding: Floats = (
        (a_high * b_high - product) + a_high * b_low + a_low * b_high
    ) + a_low * b_low
    return rounding


def _fixed(digits: Indices, exponents: Indices) -> Characters:
    """Return the characters of d.ddd * 10**e, with 17 digits, as decimals without an exponent."""
    places = 16 - exponents  # digits after the point
    unit = _POWERS[np.minimum(places, 18)]  # if e < 0, larger than all digits: whole is 0
    whole = digits // unit
    rest = digits - whole * unit
    below = _POWERS[np.maximum(places - 12, 0)]
    first = rest // below
    second = (rest - first * below) * _POWERS[20 - np.maximum(places, 12)]
    first *= _POWERS[np.maximum(12 - places, 0)]
    fraction = np.concatenate([_digits(first, 12), _digits(second, 8)], axis=1)
    wanted = np.maximum(_FRACTION - _trailing_zeros(fraction), 1)
    used = int(wanted.max(initial=1))
    fraction = fraction[:, :used] * (np.arange(used) < wanted[:, None])
    width = int(exponents.max(initial=0)) + 1
    return np.concatenate(
        [_whole(whole, max(width, 1)), constant(b".", len(digits)), fraction], axis=1
    )


def _trailing_zeros(characters: Characters) -> Indices:
    """Return the number (N,) of trailing zero digits in the rows."""
    reversed_rows = characters[:, ::-1] != _ZERO
    behind: Indices = reversed_rows.argmax(axis=1)
    behind[~reversed_rows.any(axis=1)] = characters.shape[1]
    return behind


def _whole(numbers: NDArray[np.int64] | NDArray[np.uint64], width: int) -> Characters:
    """Return the characters (N, width) of numbers >= 0, without leading zeros; 0 is "0"."""
    characters = _digits(numbers, width)
    begun = np.logical_or.accumulate(characters != _ZERO, axis=1)
    begun[:, -1] = True
    shown: Characters = characters * begun
    return shown


def _digits(numbers: NDArray[np.int64] | NDArray[np.uint64], width: int) -> Characters:
    """Return the last `width` digits (N, width) of numbers >= 0."""
    groups = -(-width // _GROUP)
    words = np.empty((len(numbers), groups), dtype=np.uint32)
    rest = numbers.astype(np.uint64)
    for group in range(groups - 1, -1, -1):
        above = rest // _GROUP_SIZE  # numpy divides by a constant with multiplications
        words[:, group] = _DIGITS[rest - above * _GROUP_SIZE]
        rest = above
    return words.view(np.uint8)[:, groups * _GROUP - width :]


def _absolute(numbers: Stamps) -> NDArray[np.uint64]:
    # The absolute value of the smallest int64 overflows to itself; as uint64 it is correct.
    return np.abs(numbers).view(np.uint64)


def _sign(negative: Booleans) -> Characters:
    signs: Characters = (negative[:, None] * _MINUS).astype(np.uint8)
    return signs
