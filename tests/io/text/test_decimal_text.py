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
from trajeval_ros.io.text.decimals import ParsedRows, RowFormat, parse_rows
from trajeval_ros.io.text.stamps import to_nanoseconds
from trajeval_ros.io.text.tokens import RowError, tokenize

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


def parsed(block: bytes, columns: int, time: int | None, separator: str = "") -> ParsedRows:
    values = range(0 if time is None else time + 1, columns)
    return parse_rows(block, RowFormat(columns, time, tuple(values), separator))


def same_bits(left: float, right: float) -> bool:
    return struct.pack("d", left) == struct.pack("d", right) or (
        math.isnan(left) and math.isnan(right)
    )


@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=6))
def test_every_number_has_the_bits_that_float_gives(rows: list[tuple[str, ...]]) -> None:
    block = "\n".join(" ".join(row) for row in rows).encode()
    found = parsed(block, 3, None).values
    assert len(found) > 0
    for row, texts in zip(found.tolist(), rows, strict=True):
        assert all(same_bits(value, float(text)) for value, text in zip(row, texts, strict=True))


def is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


@given(st.lists(st.tuples(*[st.text("01.-+e", min_size=1, max_size=5)] * 2), max_size=4))
def test_words_are_numbers_if_float_reads_them(rows: list[tuple[str, str]]) -> None:
    """Also if as many points as words are in the wrong words."""
    block = "\n".join(" ".join(row) for row in rows).encode()
    if all(is_number(word) for row in rows for word in row):
        found = parsed(block, 2, None).values
        assert all(
            same_bits(value, float(word))
            for values, words in zip(found.tolist(), rows, strict=True)
            for value, word in zip(values, words, strict=True)
        )
        return
    wrong = next(line for line, row in enumerate(rows) if not all(map(is_number, row)))
    with pytest.raises(RowError) as raised:
        parsed(block, 2, None)
    assert raised.value.line == wrong
    assert "is not a number" in raised.value.reason


@pytest.mark.parametrize("text", ["1.2.3 4\n", "4 1.2.3\n", "1 2.5\n3.5.1 4\n"])
def test_two_points_in_a_word_are_damage(text: str) -> None:
    with pytest.raises(RowError, match="is not a number"):
        parsed(text.encode(), 2, None)


@given(st.lists(st.integers(-(10**15), 10**15), min_size=1), st.integers(0, 15))
def test_plain_decimals_have_the_bits_that_float_gives(integers: list[int], places: int) -> None:
    texts = [str(Decimal(integer).scaleb(-places)) for integer in integers]
    texts = [f"{Decimal(text):f}" for text in texts]
    found = parsed("\n".join(texts).encode(), 1, None).values[:, 0]
    assert all(
        same_bits(value, float(text)) for value, text in zip(found.tolist(), texts, strict=True)
    )


@given(
    st.lists(st.integers(0, 2_000_000_000 * 10**9), min_size=1),
    st.sampled_from(["{:.9f}", "{:.18e}", "{:.12f}", "{:.24e}", "{:.9E}", "{:+.9f}"]),
)
def test_seconds_are_exact(nanoseconds: list[int], form: str) -> None:
    texts = [form.format(Decimal(each).scaleb(-9)) for each in nanoseconds]
    stamps = parsed("\n".join(texts).encode(), 1, 0).stamps
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
    stamps = parsed(text.encode(), 1, 0).stamps
    assert stamps is not None
    assert to_nanoseconds(stamps)[0].tolist() == [nanoseconds]


def test_nanoseconds_from_boot_are_recognised_by_their_steps() -> None:
    stamps = parsed(b"9000000000\n9500000000\n10000000000\n", 1, 0).stamps
    assert stamps is not None
    found, in_nanoseconds = to_nanoseconds(stamps)
    assert (found.tolist(), in_nanoseconds) == ([9 * 10**9, 95 * 10**8, 10**10], True)


def test_whole_seconds_may_lie_days_apart() -> None:
    stamps = parsed(b"5000000\n10000000\n15000000\n", 1, 0).stamps
    assert stamps is not None
    found, in_nanoseconds = to_nanoseconds(stamps)
    assert (found.tolist(), in_nanoseconds) == ([5 * 10**15, 10**16, 15 * 10**15], False)
    found, in_nanoseconds = to_nanoseconds(stamps, far_apart_is_ns=True)
    assert (found.tolist(), in_nanoseconds) == ([5_000_000, 10_000_000, 15_000_000], True)


@pytest.mark.parametrize(
    ("text", "unit_ns", "nanoseconds"),
    [
        ("1700000000123.25", 10**6, 1700000000123250000),
        ("1700000000123456.5", 10**3, 1700000000123456500),
        ("12", 1, 12),
        ("5000000", 10**9, 5 * 10**15),
        ("-2.5", 10**6, -2500000),
    ],
)
def test_a_unit_that_is_named_is_believed(text: str, unit_ns: int, nanoseconds: int) -> None:
    stamps = parsed(text.encode(), 1, 0).stamps
    assert stamps is not None
    assert to_nanoseconds(stamps, unit_ns)[0].tolist() == [nanoseconds]
    huge = parsed(b"99999999999999999", 1, 0).stamps
    assert huge is not None
    with pytest.raises(InputError):
        to_nanoseconds(huge, 10**6)


@pytest.mark.parametrize("text", ["1700000000000\n1700000000005", "99999999999999999999"])
def test_other_units_are_refused(text: str) -> None:
    stamps = parsed(text.encode(), 1, 0).stamps
    assert stamps is not None
    with pytest.raises(InputError, match="neither seconds nor nanoseconds"):
        to_nanoseconds(stamps)


@pytest.mark.parametrize("line_end", ["\n", "\r\n", ",\n", " \n", "\n\n\n"])
@pytest.mark.parametrize("separator", [" ", "\t", ",", ", ", ";", "    "])
def test_separators_and_line_ends(separator: str, line_end: str) -> None:
    rows = [["1.5", "-2", "3e0"], ["4", "5.25", "-6.5"]]
    block = "".join(separator.join(row) + line_end for row in rows)
    values = parsed(block.encode(), 3, None).values
    np.testing.assert_array_equal(values, [[1.5, -2.0, 3.0], [4.0, 5.25, -6.5]])


@pytest.mark.parametrize(
    ("block", "line", "reason"),
    [
        (b"1 2\n3\n4 5\n", 1, "2 columns expected, found 1"),
        (b"1 2\n3 4\n5 6 7\n", 2, "2 columns expected, found 3"),
        (b"1 2\n\n3 abc\n", 2, "'abc' is not a number, in column 2"),
        (b"1 2\n1_0 3\n", 1, "'1_0' is not a number, in column 1"),
        (b"1 2\n- 3\n", 1, "'-' is not a number, in column 1"),
        (b"1 2\n1.2.3 3\n", 1, "'1.2.3' is not a number, in column 1"),
        (b"1 2\n1-2 3\n", 1, "'1-2' is not a number, in column 1"),
        (b"1 2\n" + b"9" * 500 + b" 3\n", 1, "contains a word of 500 characters, in column 1"),
    ],
)
def test_what_is_no_row_is_named_with_its_line(block: bytes, line: int, reason: str) -> None:
    for time_column in (None, 0):
        with pytest.raises(RowError) as caught:
            parsed(block, 2, time_column)
        assert (caught.value.line, caught.value.reason) == (line, reason)


def test_rows_without_a_finite_stamp_are_marked() -> None:
    rows = parsed(b"1 2\nnan 3\n3 4\n", 2, 0)
    assert rows.timed.tolist() == [True, False, True]


@given(
    st.lists(st.tuples(numbers, numbers, st.sampled_from(["", "a b", '"x,y"', "é"])), min_size=1),
    st.sampled_from([",", ";", "\t"]),
    st.booleans(),
)
def test_fields_may_be_empty_or_text(
    rows: list[tuple[str, ...]], separator: str, spaced: bool
) -> None:
    space = " " if spaced else ""
    lines = [f"{a}{separator}{space}{text}{space}{separator}{b}" for a, b, text in rows]
    block = "\n\n".join(lines).encode()
    values = parse_rows(block, RowFormat(3, None, (0, 2), separator)).values
    assert len(values) > 0
    for row, texts in zip(values.tolist(), rows, strict=True):
        assert all(same_bits(each, float(text)) for each, text in zip(row, texts[:2], strict=True))


def test_an_empty_field_is_a_missing_value() -> None:
    rows = parse_rows(b"1,2,3\n,5,\n7,,9\n", RowFormat(3, 0, (1, 2), ","))
    assert rows.timed.tolist() == [True, False, True]
    np.testing.assert_array_equal(rows.values, [[2, 3], [5, np.nan], [np.nan, 9]])


@pytest.mark.parametrize(
    ("block", "line", "reason"),
    [
        (b"1,2,3\n4,5\n", 1, "3 columns expected, found 2"),
        (b"1,2,3\n\n1,2,x\n", 2, "'x' is not a number, in column 3 (z)"),
        (b"1,1 2,3\n", 0, "'1 2' is not a number, in column 2 (y)"),
    ],
)
def test_what_is_no_row_of_a_table_names_its_column(block: bytes, line: int, reason: str) -> None:
    with pytest.raises(RowError) as caught:
        parse_rows(block, RowFormat(3, None, (0, 1, 2), ",", names=("x", "y", "z")))
    assert (caught.value.line, caught.value.reason) == (line, reason)


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("2024-03-01 12:00:00.123456789", 1709294400123456789),
        ("2024/03/01T12:00:00Z", 1709294400000000000),
        ("2024-03-01T12:00:00.5+00:00", 1709294400500000000),
        ("1969-12-31 23:59:59.75", -250000000),
        ("2024-03-01T14:00:00.5+02:00", 1709294400500000000),
        ("2024-03-01 08:30-0330", 1709294400000000000),
        ("2024-03-01T00:30:00+05:45", 1709232300000000000),
    ],
)
def test_dates_are_exact(text: str, nanoseconds: int) -> None:
    stamps = parse_rows(f"{text},1\n".encode(), RowFormat(2, 0, (1,), ",", dates=True)).stamps
    assert stamps is not None
    assert to_nanoseconds(stamps, 10**9)[0].tolist() == [nanoseconds]


def test_offsets_from_utc_may_change() -> None:
    dates = [
        "2024-03-31T01:59:59.9+01:00",
        "2024-03-31T03:00:00.1+02:00",
        "2024-03-31T01:00:00.3Z",
    ]
    block = "".join(f"{date},1\n" for date in dates).encode()
    stamps = parse_rows(block, RowFormat(2, 0, (1,), ",", dates=True)).stamps
    assert stamps is not None
    assert np.diff(to_nanoseconds(stamps, 10**9)[0]).tolist() == [200_000_000, 200_000_000]


@pytest.mark.parametrize("text", ["2024-13-01 12:00:00", "12:00", "2024-03-01 12:00:00+92:00"])
def test_what_is_no_date_is_named(text: str) -> None:
    block = f"2024-03-01 12:00:00,1\n{text},1\n".encode()
    with pytest.raises(RowError) as caught:
        parse_rows(block, RowFormat(2, 0, (1,), ",", dates=True))
    assert caught.value.reason == f"{text!r} is not a date (UTC), in column 1"


@pytest.mark.parametrize("separator", [" ", ",", "\t", " , "])
def test_words_and_their_points_are_where_they_stand(separator: str) -> None:
    """A point is at the word's end if it has none; with other characters there are no points."""
    rows = [["1.5", "20", "-3.25"], [".5", "+7.", "0"], ["6", "-.25", "1234567.125"]]
    block = "".join(f"{separator.join(row)}\n" for row in rows)
    found = tokenize(block.encode(), 3)
    assert found.dots is not None
    text = bytes(found.text).decode()
    for row, starts, ends, dots in zip(rows, found.starts, found.ends, found.dots, strict=True):
        for word, start, end, dot in zip(row, starts, ends, dots, strict=True):
            assert text[start:end] == word
            assert text[dot] == "." if "." in word else dot == end
    for word in ("1e5", "1.2.3", "+-1", "nan"):
        assert tokenize(f"{word} 1.0 2.0\n{block}".encode(), 3).dots is None
