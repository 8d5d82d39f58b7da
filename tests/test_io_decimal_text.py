"""Numbers from text are the floats that python reads, and stamps are exact."""

from __future__ import annotations

import math
import struct
from decimal import ROUND_HALF_UP, Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.text.decimals import RowError, parse_rows
from trajeval_ros.io.text.stamps import to_nanoseconds

digits = st.text("0123456789", max_size=24)
plain = st.builds(
    lambda sign, whole, dot, fraction: f"{sign}{whole}{dot}{fraction}",
    st.sampled_from(["", "-", "+"]),
    digits,
    st.sampled_from(["", "."]),
    digits,
).filter(lambda text: any(character.isdigit() for character in text))
exponential = st.builds(
    lambda mantissa, mark, exponent: f"{mantissa}{mark}{exponent}",
    plain,
    st.sampled_from(["e", "E", "e+", "e-"]),
    st.integers(0, 320),
)
numbers = st.one_of(
    plain,
    exponential,
    st.floats().map(repr),
    st.floats(-1e4, 1e4).map(lambda number: f"{number:.9f}"),
    st.sampled_from(["nan", "inf", "-inf", "-0", "-0.0", "1e400", "007", "5.", ".5"]),
)


def same_bits(left: float, right: float) -> bool:
    return struct.pack("d", left) == struct.pack("d", right) or (
        math.isnan(left) and math.isnan(right)
    )


@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=6))
def test_every_number_has_the_bits_that_float_gives(rows: list[tuple[str, ...]]) -> None:
    block = "\n".join(" ".join(row) for row in rows).encode()
    parsed = parse_rows(block, 3, None).values
    for row, texts in zip(parsed.tolist(), rows, strict=True):
        assert all(same_bits(value, float(text)) for value, text in zip(row, texts, strict=True))


@given(st.lists(st.integers(-(10**15), 10**15), min_size=1), st.integers(0, 15))
def test_plain_decimals_have_the_bits_that_float_gives(integers: list[int], places: int) -> None:
    texts = [str(Decimal(integer).scaleb(-places)) for integer in integers]
    texts = [f"{Decimal(text):f}" for text in texts]
    parsed = parse_rows("\n".join(texts).encode(), 1, None).values[:, 0]
    assert all(
        same_bits(value, float(text)) for value, text in zip(parsed.tolist(), texts, strict=True)
    )


@given(
    st.lists(st.integers(0, 2_000_000_000 * 10**9), min_size=1),
    st.sampled_from(["{:.9f}", "{:.18e}", "{:.12f}", "{:.24e}", "{:.9E}", "{:+.9f}"]),
)
def test_seconds_are_exact(nanoseconds: list[int], form: str) -> None:
    texts = [form.format(Decimal(each).scaleb(-9)) for each in nanoseconds]
    stamps = parse_rows("\n".join(texts).encode(), 1, 0).stamps
    assert stamps is not None
    expected = [int((Decimal(text) * 10**9).to_integral_value(ROUND_HALF_UP)) for text in texts]
    found = [
        whole * 10**9 + rest
        for whole, rest in zip(stamps.whole.tolist(), stamps.billionths.tolist(), strict=True)
    ]
    assert found == expected


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("1.403636580838555574e+09", 1403636580838555574),
        ("1403636580.06356", 1403636580063560000),
        ("1403636580863555584", 1403636580863555584),
        ("1403636580863555584.0", 1403636580863555584),
        ("1.403636580863555584e+18", 1403636580863555584),
        ("1.40363658086355558400e+18", 1403636580863555584),
        ("1403636580.8385555749", 1403636580838555575),
        ("1403636580.9999999999", 1403636581000000000),
        ("-1.5", -1500000000),
        ("1.5e-3", 1500000),
        ("1e-30", 0),
    ],
)
def test_stamps_become_nanoseconds(text: str, nanoseconds: int) -> None:
    stamps = parse_rows(text.encode(), 1, 0).stamps
    assert stamps is not None
    assert to_nanoseconds(stamps)[0].tolist() == [nanoseconds]


def test_nanoseconds_from_boot_are_recognised_by_their_steps() -> None:
    stamps = parse_rows(b"5000000\n10000000\n15000000\n", 1, 0).stamps
    assert stamps is not None
    assert to_nanoseconds(stamps) == (pytest.approx([5e6, 10e6, 15e6]), True)


@pytest.mark.parametrize("text", ["1700000000000\n1700000000005", "99999999999999999999"])
def test_other_units_are_refused(text: str) -> None:
    stamps = parse_rows(text.encode(), 1, 0).stamps
    assert stamps is not None
    with pytest.raises(InputError, match="neither seconds nor nanoseconds"):
        to_nanoseconds(stamps)


@pytest.mark.parametrize("line_end", ["\n", "\r\n", ",\n", " \n", "\n\n\n"])
@pytest.mark.parametrize("separator", [" ", "\t", ",", ", ", ";", "    "])
def test_separators_and_line_ends(separator: str, line_end: str) -> None:
    rows = [["1.5", "-2", "3e0"], ["4", "5.25", "-6.5"]]
    block = "".join(separator.join(row) + line_end for row in rows)
    values = parse_rows(block.encode(), 3, None).values
    np.testing.assert_array_equal(values, [[1.5, -2.0, 3.0], [4.0, 5.25, -6.5]])


@pytest.mark.parametrize(
    ("block", "line", "reason"),
    [
        (b"1 2\n3\n4 5\n", 1, "has 1 column instead of 2"),
        (b"1 2\n3 4\n5 6 7\n", 2, "has 3 columns instead of 2"),
        (b"1 2\n\n3 abc\n", 2, "has 'abc' where a number should be"),
        (b"1 2\n1_0 3\n", 1, "has '1_0' where a number should be"),
        (b"1 2\n- 3\n", 1, "has '-' where a number should be"),
        (b"1 2\n1.2.3 3\n", 1, "has '1.2.3' where a number should be"),
        (b"1 2\n1-2 3\n", 1, "has '1-2' where a number should be"),
        (b"1 2\n" + b"9" * 500 + b" 3\n", 1, "has a word of 500 characters"),
    ],
)
def test_what_is_no_row_is_named_with_its_line(block: bytes, line: int, reason: str) -> None:
    for time_column in (None, 0):
        with pytest.raises(RowError) as caught:
            parse_rows(block, 2, time_column)
        assert (caught.value.line, caught.value.reason) == (line, reason)


def test_rows_without_a_finite_stamp_are_marked() -> None:
    rows = parse_rows(b"1 2\nnan 3\n3 4\n", 2, 0)
    assert rows.timed.tolist() == [True, False, True]
