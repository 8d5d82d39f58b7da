"""Numbers become the characters that Python gives them, all at once."""

from __future__ import annotations

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from trajeval_ros.io.text import number_characters
from trajeval_ros.io.text.number_characters import (
    Characters,
    lines_of,
    lines_of_floats,
    of_floats,
    of_integers,
    of_seconds,
)

all_floats = arrays.arrays(
    np.float64, st.integers(1, 30), elements=st.floats(allow_nan=False, allow_infinity=False)
)
usual_floats = arrays.arrays(np.float64, st.integers(1, 30), elements=st.floats(-1e4, 1e4))
stamps = arrays.arrays(np.int64, st.integers(1, 30), elements=st.integers(-(2**63), 2**63 - 1))


def words(characters: Characters) -> list[str]:
    return [line.decode() for line in lines_of([characters])]


@given(all_floats)
def test_floats_are_written_as_repr_writes_them(numbers: np.ndarray) -> None:
    assert words(of_floats(numbers)) == [repr(each) for each in numbers.tolist()]


@given(usual_floats, st.integers(0, 12))
def test_floats_of_few_digits_keep_them(numbers: np.ndarray, digits: int) -> None:
    numbers = np.round(numbers, digits)
    assert words(of_floats(numbers)) == [repr(each) for each in numbers.tolist()]


@pytest.mark.parametrize("scale", [1e-4, 1e-3, 1.0, 1e3, 1e7, 1e14])
def test_many_floats_of_a_size(scale: float) -> None:
    numbers = np.random.default_rng(0).normal(size=20_000) * scale
    assert words(of_floats(numbers)) == [repr(each) for each in numbers.tolist()]


def test_floats_at_the_borders() -> None:
    powers = np.concatenate([2.0 ** np.arange(-60, 60), 10.0 ** np.arange(-30, 30)])
    near = [np.nextafter(powers, 0.0), powers, np.nextafter(powers, np.inf)]
    numbers = np.concatenate([*near, -powers, [0.0, -0.0, 5e-324, 1.7e308, 0.1, 1.0 / 3.0]])
    assert words(of_floats(numbers)) == [repr(each) for each in numbers.tolist()]


@given(stamps)
def test_integers_are_exact(numbers: np.ndarray) -> None:
    assert words(of_integers(numbers)) == [str(each) for each in numbers.tolist()]


@given(stamps)
def test_seconds_keep_every_nanosecond(numbers: np.ndarray) -> None:
    written = words(of_seconds(numbers))
    assert [Decimal(word) * 10**9 for word in written] == numbers.tolist()
    assert {len(word.partition(".")[2]) for word in written} == {9}


@pytest.mark.parametrize("has_orjson", [True, False])
@given(
    arrays.arrays(
        np.float64,
        st.tuples(st.integers(1, 8), st.integers(1, 8)),
        elements=st.floats(allow_nan=False, allow_infinity=False)
        | st.floats(-1e17, 1e17)
        | st.floats(-1e-3, 1e-3),
    ),
    st.sampled_from([b" ", b","]),
)
def test_lines_are_the_same_with_and_without_orjson(
    has_orjson: bool, rows: np.ndarray, separator: bytes
) -> None:
    if has_orjson:
        pytest.importorskip("orjson", reason="orjson is missing, the extra `fast`")
    expected = [separator.join(repr(each).encode() for each in row) for row in rows.tolist()]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(number_characters, "HAVE_ORJSON", has_orjson)
        assert lines_of_floats(rows, separator) == expected
        assert lines_of_floats(np.asfortranarray(rows), separator) == expected


@pytest.mark.parametrize("exponent", [-5, -4, -3, 0, 14, 15, 16, 17])
def test_lines_of_floats_at_the_borders_of_exponents(exponent: int) -> None:
    border = 10.0**exponent
    rows = np.array([[np.nextafter(border, 0.0), border, np.nextafter(border, np.inf), -border]])
    assert lines_of_floats(rows, b" ") == [" ".join(map(repr, rows[0].tolist())).encode()]
